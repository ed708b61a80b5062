"""Deflections of a stick from the angular velocity of the ball, for outputs that send rates in place of counts."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.geometry.rotation import Array
from spheremouse.output import Report
from spheremouse.tracker import Status

RELEASE_TIME = 0.3  # s without a confirmed frame; a camera at 5 Hz takes 0.2 s
_BOUNDS = {"full": (1.0, 10_000.0), "dead": (0.0, 0.9), "curve": (0.2, 5.0)}


@dataclass(frozen=True, slots=True)
class Response:
    """Deflection as a function of the rate."""

    full: float = 180.0  # deg/s, of full deflection; a hand rolls a ball at 60 to 170 deg/s in ordinary play
    dead: float = 0.02  # dead zone as a fraction of `full`
    curve: float = 1.0  # exponent; above 1, slow motion deflects less

    def deflection(self, rate: Array) -> Array:
        """Return the deflection of a rate (n,) rad/s, with length 0 to 1 and the same direction."""
        size = math.sqrt(rate @ rate)
        excess = (math.degrees(size) / self.full - self.dead) / (1.0 - self.dead)
        return rate * (min(excess, 1.0) ** self.curve / size) if excess > 0.0 and size > 0.0 else np.zeros_like(rate)


def parse_response(text: str, spec: str, keys: tuple[str, ...]) -> Response:
    """Return the response that `KEY=VALUE,KEY=VALUE` describes. Raise OutputError with the output `spec` if invalid."""
    given = options(text, dict.fromkeys(keys, float), spec, OutputError)
    for key, value in given.items():
        low, high = _BOUNDS[key]
        if not low <= float(value) <= high:
            raise OutputError(f"{spec}: {key} must be {low:g} to {high:g}, is {value:g}")
    return Response(**{key: float(value) for key, value in given.items()})


def pointer_rate(report: Report) -> Array | None:
    """Return the ball's angular velocity along the directions of the counts (x, y, third axis), (3,) rad/s.

    Its direction is that of the counts' rate, and its length that of the angular velocity. It is zero if the ball is
    not tracked, and None if this frame does not confirm it.
    """
    sample = report.pointing_sample
    if sample is None or sample.status is not Status.TRACKING:
        return np.zeros(3)
    if report.rate is None:
        return None
    counts = np.array(report.rate)
    size, speed = math.hypot(*report.rate), math.hypot(*sample.rate)
    return counts * (speed / size) if size > 0.0 else np.zeros(3)


class Watchdog:
    """Calls a function from its own thread if nothing feeds it for some time.

    A stick keeps its deflection, so a pause or a camera that stops would leave it deflected.
    """

    def __init__(self, release: Callable[[], None], timeout: float = RELEASE_TIME) -> None:
        """Call `release` once, `timeout` (s) after the last call of `feed`."""
        self._release, self._timeout = release, timeout
        self._armed, self._over, self._fed = threading.Event(), threading.Event(), 0.0  # s, monotonic, the last time
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)
        self._thread.start()

    def feed(self) -> None:
        """Start the time again."""
        self._fed = time.monotonic()
        if not self._armed.is_set():  # otherwise the thread, which this would wake, finds the time by itself
            self._armed.set()

    def close(self) -> None:
        """End the thread without a call."""
        self._over.set()
        self._armed.set()
        self._thread.join()

    def _run(self) -> None:
        while self._armed.wait() and not self._over.wait(self._left()):
            self._armed.clear()
            if self._left() > 0.0:
                self._armed.set()
            else:
                self._release()

    def _left(self) -> float:
        return max(0.0, self._fed + self._timeout - time.monotonic())
