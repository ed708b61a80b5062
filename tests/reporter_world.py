"""Outputs as a test wants them behind a thread of outputs, and frames for that, of which the sum is known."""

import threading
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from reporting import PATIENCE, report

from spheremouse.output import Output
from spheremouse.output.pointer import PointerSettings

EXACT = PointerSettings(horizon=0.0)
NONE = (0.0, 0.0, 0.0)


@dataclass
class World:
    """Outputs as the test wants them, and what became of them."""

    reports: list[Any] = field(default_factory=list)
    opened: int = 0
    entered: int = 0  # opened with success
    closed: list[Any] = field(default_factory=list)  # error with which each was left
    broken: BaseException | None = None  # raised by send
    missing: BaseException | None = None  # raised on opening
    gate: threading.Event | None = None  # sending waits for it
    door: threading.Event | None = None  # opening waits for it
    said: list[str] = field(default_factory=list)
    senders: list[threading.Thread] = field(default_factory=list)
    non_blocking: bool = False

    def open(self):
        self.opened += 1
        if self.door is not None:
            assert self.door.wait(PATIENCE)
        if self.missing is not None:
            raise self.missing
        return (NonBlocking if self.non_blocking else Fake)(self)

    @property
    def sum(self):
        return tuple(np.sum([m.counts for m in self.reports], axis=0)) if self.reports else (0, 0, 0)


class Fake(Output):
    """An output that keeps its reports."""

    paced = True

    def __init__(self, world):
        self._world = world

    def send(self, report):
        if self._world.gate is not None:
            assert self._world.gate.wait(PATIENCE)
        self._world.senders.append(threading.current_thread())
        if self._world.broken is not None:
            raise self._world.broken
        self._world.reports.append(report)

    def __enter__(self):
        self._world.entered += 1
        return self

    def __exit__(self, kind, error, trace):
        self._world.closed.append(error)
        raise RuntimeError("leaving fails as well")


class NonBlocking(Fake):
    paced = blocks = False


class Frames:
    """Frames that are submitted, with their sum."""

    def __init__(self, reporter):
        self._reporter, self.sum, self.frames = reporter, np.zeros(3, int), 0

    def __call__(self, *counts, rate=NONE, taken=None, wanted=True):
        self.frames += 1
        given = report(*counts, stamp=float(self.frames), counts_rate=rate)
        self.sum += counts
        self._reporter.submit(given, time.monotonic() if taken is None else taken, wanted=wanted)


def even(reporter, given):
    """Submitted counts = sent + unsent - ahead, and nothing is ahead at horizon 0."""
    status = reporter.status()
    return np.array_equal(np.add(status.sent, status.unsent), given.sum + status.ahead)
