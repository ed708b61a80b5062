"""`null`: takes reports and does nothing, to measure everything else."""

from types import TracebackType
from typing import Self

from spheremouse.errors import OutputError
from spheremouse.output import Report


class Null:
    """An output that goes nowhere."""

    def send(self, report: Report) -> None:
        """Nothing."""

    def describe(self, report: Report) -> str:
        """Nothing."""
        return ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


def open(argument: str) -> Null:
    """An output that goes nowhere."""
    check(argument)
    return Null()


def check(argument: str) -> None:
    """OutputError where there is an argument."""
    if argument:
        raise OutputError(f"null:{argument}: takes no argument; write null")
