"""Outputs: `KIND:ARGUMENT` opens a context manager that takes reports.

An output is a module of this package with `open(argument: str) -> Output`. Its name is in `KINDS`. A module that sends
rates in place of counts has its default response as `RESPONSE`, and applies the options of a response itself. Other
distributions add outputs by entry points in the group `spheremouse.output`.
"""

import importlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from spheremouse.errors import OutputError
from spheremouse.files import registry
from spheremouse.finding import Finding, ok
from spheremouse.geometry import Array
from spheremouse.output.response import COUNTS_RESPONSE, Response, split_response
from spheremouse.output.sample import Sample
from spheremouse.output.third_axis import left_out, sent_as
from spheremouse.tracker import Estimate

KINDS = (
    "auto",
    "csv",
    "desktop",
    "gamepad",
    "lsl",
    "null",
    "osc",
    "parquet",
    "serial",
    "spacenav",
    "tcp",
    "text",
    "udp",
    "uinput",
    "ws",
)

Counts = tuple[int, int, int]  # x, y and third axis
Rate = tuple[float, float, float]  # counts/s
DescribeRun = Callable[[], dict[str, Any]]  # returns configuration, rig, source and versions of a run, for JSON


class Report(NamedTuple):
    """Counts since the last report, and the samples of a frame."""

    counts: Counts
    rate: Rate | None  # of the counts at its end; None if no frame confirms it
    stamp: float  # s, of the motion's end
    samples: tuple[Sample, ...] = ()  # of all balls; empty between two frames
    pointing: int = 0  # index of the ball that makes the counts
    fraction: Rate = (0.0, 0.0, 0.0)  # counts, less than one on each axis, that are made and not reported yet
    matrix: Array | None = None  # (3, 3) counts per radian of a rotation in obj; None for a hand-held ball

    @property
    def pointing_sample(self) -> Sample | None:
        """Sample of the ball that makes the counts; None between two frames."""
        return self.samples[self.pointing] if self.samples else None

    @property
    def to_camera(self) -> Array:
        """Matrix (3, 3) from counts to those by the camera's axes (x right, y up, z to the camera) in place of `obj`.

        It is the identity for a hand-held ball, whose motion is in `cam`, and if the camera's pose is unknown.
        """
        sample, M = self.pointing_sample, self.matrix
        if M is None or sample is None or sample.camera is None:
            return np.eye(3)
        R_obj_view = sample.camera.rotation * (1.0, -1.0, -1.0)
        return M @ R_obj_view.T @ np.linalg.inv(M)

    @property
    def counted(self) -> Sequence[tuple[Sample, Counts]]:
        """Each sample with its counts, which are zero for a ball that does not point."""
        if len(self.samples) == 1:  # out of the processor's cache, the loop takes 4 µs
            return ((self.samples[0], self.counts),)
        return [(s, self.counts if k == self.pointing else (0, 0, 0)) for k, s in enumerate(self.samples)]


class Mapping(Protocol):
    """Converts the motion of a ball to counts of a mouse. It carries fractions of a count to the next call."""

    @property
    def fraction(self) -> Rate:
        """Counts that are carried to the next call."""
        ...

    @property
    def matrix(self) -> Array | None:
        """Counts per radian of a rotation in `obj`, (3, 3); None for a hand-held ball."""
        ...

    def counts(self, estimate: Estimate) -> tuple[Counts, Rate | None]:
        """Return the counts of an estimate, and their rate; zeros and None if the estimate is not confirmed."""
        ...

    def interrupted(self) -> None:
        """Count no motion across a break in the frames, if it cannot be known."""
        ...


def report_of(samples: tuple[Sample, ...], mapping: Mapping, pointing: int = 0) -> Report:
    """Return the report of a frame: its samples, and the counts of the ball at index `pointing`."""
    estimate = samples[pointing].estimate
    counts, rate = mapping.counts(estimate)
    return Report(counts, rate, estimate.stamp, samples, pointing, mapping.fraction, mapping.matrix)


class OutputClosed(Exception):  # noqa: N818  an end, not an error
    """The reader of the output is gone. Leaving the output's `with` block suppresses it: a normal end."""


@dataclass(frozen=True, slots=True)
class DeliveryStatus:
    """Counts of x, y and third axis that were sent since the output was opened and have not arrived."""

    trouble: str = ""  # reason why nothing arrives although the output is open; empty: it works
    waiting: Counts = (0, 0, 0)  # may still arrive
    lost: Counts = (0, 0, 0)  # will not arrive, or their arrival is unknown


_ALL_ARRIVED = DeliveryStatus()


class Output:
    """Sends reports. Derive an output from it, and override `send` and, if need be, the others.

    An output whose receiver acknowledges counts overrides `delivery` and `drop_waiting`. After a failure such an output
    recovers by itself if reports continue.
    """

    paced: bool = False  # True: counts at a steady rate, predicted between frames; False: a report a frame
    blocks: bool = True  # `send` may wait for a device, disk or receiver; False: the tracker's thread calls it
    period: float = inf  # s; so often, the output's thread sends an empty report, which may block
    hang_hint: str = ""  # usual reason why a call hangs

    def begin(self, describe_run: DescribeRun) -> None:
        """Take the function that describes the run, before the first report."""

    def send(self, report: Report) -> None:
        """Send one report. Raise OutputError if that fails, or OutputClosed if its reader is gone."""
        raise NotImplementedError

    def delivery(self) -> DeliveryStatus:
        """Return the counts that have not arrived, from any thread."""
        return _ALL_ARRIVED

    def drop_waiting(self) -> None:
        """Drop the waiting counts, because later they would make the pointer jump."""

    def close(self) -> None:
        """Release the device, file or socket."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> bool | None:
        self.close()
        return isinstance(error, OutputClosed)


def full_spec(spec: str) -> str:
    """Return the output `KIND:ARGUMENT` without the options of its response, unless it applies them itself."""
    return spec if _applies_response(spec) else split_response(spec)[0]


def response_of(spec: str) -> Response:
    """Return the response that the run applies to the counts of an output. Raise OutputError if it is invalid."""
    return COUNTS_RESPONSE if _applies_response(spec) else split_response(spec)[1]


def _applies_response(spec: str) -> bool:
    kind = spec.partition(":")[0]
    return kind in KINDS and hasattr(importlib.import_module(f"{__name__}.{kind}"), "RESPONSE")


def open_output(spec: str) -> Output:
    """Open the output `KIND:ARGUMENT`. Raise OutputError if it does not exist or lacks a member of `Output`."""
    members = [name for name in vars(Output) if not name.startswith("_")] + ["__enter__", "__exit__"]
    return registry.open_spec(sys.modules[__name__], "output", spec, OutputError, members)


def file_of(spec: str) -> Path | None:
    """Return the file that the output `KIND:ARGUMENT` writes; None if it writes none, or to standard output."""
    module, argument = registry.resolve(sys.modules[__name__], "output", spec, OutputError)
    find: Callable[[str], Path | None] | None = getattr(module, "file_of", None)
    return None if find is None else find(argument)


def probe(spec: str) -> list[Finding]:
    """Return findings about the output `KIND:ARGUMENT` and its third axis. Raise OutputError if it is invalid.

    The output is not opened: programs would notice a mouse that appears, and a board would restart.
    """
    findings = registry.probe(sys.modules[__name__], "output", spec, OutputError)
    if missing := left_out(spec):
        findings.append(ok("third axis", missing.problem, missing.hint))
    elif sent := sent_as(spec):
        findings.append(ok("third axis", f"the ball's spin is sent as {sent}"))
    return findings
