"""`null`: discard all reports, for measurements of everything else."""

from typing import Self

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, warning
from spheremouse.output import Report


class Null:
    """An output that discards all reports."""

    def send(self, report: Report) -> None:
        """Discard the report."""

    def describe(self, report: Report) -> str:
        """Return an empty text."""
        return ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass


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
