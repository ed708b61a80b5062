"""Angular velocity of the ball along the pointer's directions, and the release of a stick.

For outputs that send rates in place of counts.
"""

import threading
import time
from collections.abc import Callable
from math import hypot

from spheremouse.output import Report
from spheremouse.output.response import COUNTS_RESPONSE, Response
from spheremouse.tracker import Status

RELEASE_TIME = 0.3  # s without a confirmed frame; a camera at 5 Hz takes 0.2 s


def pointer_rate(report: Report, response: Response = COUNTS_RESPONSE) -> list[float] | None:
    """Return the ball's angular velocity along the directions of the counts (x, y, third axis), (3,) rad/s.

    Its direction is that of the counts' rate, by the frame of `response`, and its length that of the angular velocity.
    It is zero if the ball is not tracked, and None if this frame does not confirm it.
    """
    sample = report.pointing_sample
    if sample is None or sample.status is not Status.TRACKING:
        return [0.0, 0.0, 0.0]
    if report.rate is None:
        return None
    rate = (report.to_camera @ report.rate).tolist() if response.in_camera else report.rate
    size, speed = hypot(*rate), hypot(*sample.rate.tolist())
    return [r * speed / size if size > 0.0 else 0.0 for r in rate]


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
