"""Outputs: where motion goes. `KIND:ARGUMENT` in, a context manager that takes Motions out.

An output is a module here with `open(argument: str) -> Output`; its name, one of `KINDS`, is its kind.
"""

import sys
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from spheremouse.errors import OutputError
from spheremouse.files.spec import resolve
from spheremouse.tracker import Motion

KINDS = ("auto", "desktop", "null", "serial", "text", "uinput")


class OutputClosed(Exception):  # noqa: N818  an end, not an error
    """Whoever read the output has gone. Leaving the output's `with` block swallows it: a quiet end, no error."""


class Output(Protocol):
    """Takes motions; closed by leaving its `with` block. What cannot be sent is an OutputError."""

    def send(self, motion: Motion) -> None:
        """Pass one motion on."""
        ...

    def describe(self, motion: Motion) -> str:
        """The text twin: what `send` does with this motion right now, in one line; empty for nothing."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...


@dataclass(frozen=True, slots=True)
class Passage:
    """How far the counts of x, y and third axis that an output was sent have got, since it was opened."""

    trouble: str = ""  # why nothing gets through, though it is open; empty: it does
    waiting: tuple[int, int, int] = (0, 0, 0)  # not there yet
    lost: tuple[int, int, int] = (0, 0, 0)  # will not get there, or nobody knows whether they have


@runtime_checkable
class Acknowledged(Protocol):
    """An output whose other end says what has arrived. What troubles it passes by itself, if motions go on coming."""

    def passage(self) -> Passage:
        """How far they have got; from any thread."""
        ...

    def give_up(self) -> None:
        """Drop what is waiting: later it would be a jump."""
        ...


def open_output(spec: str) -> Output:
    """The output that `KIND:ARGUMENT` names."""
    module, argument = resolve(sys.modules[__name__], "output", spec, OutputError)
    return module.open(argument)
