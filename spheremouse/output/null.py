"""`null`: takes motions and does nothing, to measure everything else."""

from types import TracebackType
from typing import Self

from spheremouse.errors import OutputError
from spheremouse.tracker import Motion


class Null:
    """An output that goes nowhere."""

    def send(self, motion: Motion) -> None:
        """Nothing."""

    def describe(self, motion: Motion) -> str:
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
    if argument:
        raise OutputError(f"null:{argument}: takes no argument; write null")
    return Null()
