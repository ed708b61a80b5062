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
    check(argument)
    return Null()


def check(argument: str) -> None:
    if argument:
        raise OutputError(f"null:{argument}: takes no argument", "write null")


def probe(argument: str) -> list[Finding]:
    return [warning("output", "null: motion goes nowhere", "name one: uinput, serial:auto, desktop")]
