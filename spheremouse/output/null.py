"""`null`: discard all reports, for measurements of everything else."""

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, warning
from spheremouse.output import Output, Report


class Null(Output):
    """An output that discards all reports."""

    blocks = False

    def send(self, report: Report) -> None:
        """Discard the report."""


def open(argument: str) -> Null:
    """Return an output that discards all reports."""
    check(argument)
    return Null()


def check(argument: str) -> None:
    """Raise OutputError if there is an argument."""
    if argument:
        raise OutputError(f"null:{argument}: takes no argument", "write null")


def probe(argument: str) -> list[Finding]:
    """Return a warning that motion is discarded."""
    return [warning("output", "null: motion goes nowhere", "name one: uinput, serial:auto, desktop")]
