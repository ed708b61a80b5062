"""Outputs: `KIND:ARGUMENT` opens a context manager that takes reports.

An output is a module of this package with `open(argument: str) -> Output`. Its name is in `KINDS`. Other distributions
add outputs by entry points in the group `spheremouse.output`.
"""

import sys
from dataclasses import dataclass
from types import TracebackType
from typing import NamedTuple, Protocol, Self, runtime_checkable

from spheremouse.errors import OutputError
from spheremouse.files import registry
from spheremouse.finding import Finding, ok
from spheremouse.output.third_axis import left_out, sent_as
from spheremouse.tracker import Estimate, unknown

KINDS = ("auto", "desktop", "null", "serial", "text", "uinput")


class Report(NamedTuple):
    """Counts since the last report, and the motion that they represent."""

    counts: tuple[int, int, int]  # x, y and third axis
    rate: tuple[float, float, float]  # counts/s at its end
    estimate: Estimate
    balls: tuple[Estimate, ...] = ()  # of all hand-held balls, the one that moves the pointer included


def no_report(stamp: float) -> Report:
    """Return a report without motion."""
    return Report((0, 0, 0), (0.0, 0.0, 0.0), unknown(stamp))


class OutputClosed(Exception):  # noqa: N818  an end, not an error
    """The reader of the output is gone. Leaving the output's `with` block suppresses it: a normal end."""


class Output(Protocol):
    """Sends reports; closed by leaving its `with` block. A report that cannot be sent raises OutputError."""

    def send(self, report: Report) -> None:
        """Send one report."""
        ...

    def describe(self, report: Report) -> str:
        """Return the effect that `send` would have now, in one line of text; empty for none."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> bool | None: ...


@dataclass(frozen=True, slots=True)
class DeliveryStatus:
    """Counts of x, y and third axis that were sent since the output was opened and have not arrived."""

    trouble: str = ""  # reason why nothing arrives although the output is open; empty: it works
    waiting: tuple[int, int, int] = (0, 0, 0)  # may still arrive
    lost: tuple[int, int, int] = (0, 0, 0)  # will not arrive, or their arrival is unknown


@runtime_checkable
class Acknowledged(Protocol):
    """An output with a receiver that acknowledges counts. After a failure it recovers by itself if reports continue."""

    def delivery(self) -> DeliveryStatus:
        """Return the counts that have not arrived, from any thread."""
        ...

    def drop_waiting(self) -> None:
        """Drop the waiting counts, because later they would make the pointer jump."""
        ...


def open_output(spec: str) -> Output:
    """Open the output `KIND:ARGUMENT`. Raise OutputError if it does not exist or lacks a method of `Output`."""
    members = ("send", "describe", "__enter__", "__exit__")
    return registry.opened(sys.modules[__name__], "output", spec, OutputError, members)


def probe(spec: str) -> list[Finding]:
    """Return findings about the output `KIND:ARGUMENT` and its third axis. Raise OutputError if it is invalid.

    The output is not opened: programs would notice a mouse that appears, and a board would restart.
    """
    findings = registry.probe(sys.modules[__name__], "output", spec, OutputError)
    if missing := left_out(spec):
        findings.append(ok("third axis", *missing.split("; ")))
    elif sent := sent_as(spec):
        findings.append(ok("third axis", f"the ball's spin is sent as {sent}"))
    return findings
