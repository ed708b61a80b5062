"""Outputs: where motion goes. `KIND:ARGUMENT` in, a context manager that takes reports out.

An output is a module here with `open(argument: str) -> Output`; its name, one of `KINDS`, is its kind. Those of other
distributions are named by entry points in the group `spheremouse.output`.
"""

import sys
from dataclasses import dataclass
from types import TracebackType
from typing import NamedTuple, Protocol, Self, runtime_checkable

from spheremouse.errors import OutputError
from spheremouse.files.registry import opened
from spheremouse.tracker import Motion, no_motion

KINDS = ("auto", "desktop", "null", "serial", "text", "uinput")


class Report(NamedTuple):
    """What an output is sent: the counts since the last report, and the motion that they stand for."""

    counts: tuple[int, int, int]  # x, y and third axis
    rate: tuple[float, float, float]  # counts/s at its end
    motion: Motion


def no_report(stamp: float) -> Report:
    """Nothing to move by."""
    return Report((0, 0, 0), (0.0, 0.0, 0.0), no_motion(stamp))


class OutputClosed(Exception):  # noqa: N818  an end, not an error
    """Whoever read the output has gone. Leaving the output's `with` block swallows it: a quiet end, no error."""


class Output(Protocol):
    """Takes reports; closed by leaving its `with` block. What cannot be sent is an OutputError."""

    def send(self, report: Report) -> None:
        """Pass one report on."""
        ...

    def describe(self, report: Report) -> str:
        """The text twin: what `send` does with this motion right now, in one line; empty for nothing."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...


@dataclass(frozen=True, slots=True)
class DeliveryStatus:
    """Counts of x, y and third axis that an output was sent since it was opened, and that have not arrived."""

    trouble: str = ""  # why nothing gets through, though it is open; empty: it does
    waiting: tuple[int, int, int] = (0, 0, 0)  # not there yet
    lost: tuple[int, int, int] = (0, 0, 0)  # will not get there, or nobody knows whether they have


@runtime_checkable
class Acknowledged(Protocol):
    """An output whose other end says what has arrived. What troubles it passes by itself, if reports go on coming."""

    def passage(self) -> DeliveryStatus:
        """Counts that have not arrived; from any thread."""
        ...

    def give_up(self) -> None:
        """Drop what is waiting: later it would be a jump."""
        ...


def open_output(spec: str) -> Output:
    """The output that `KIND:ARGUMENT` names; OutputError where there is none, or it lacks what an output must have."""
    members = ("send", "describe", "__enter__", "__exit__")
    return opened(sys.modules[__name__], "output", spec, OutputError, members)
