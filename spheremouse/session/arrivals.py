"""The rate of the frames that arrive, and the time since the last one."""

import time

import numpy as np

from spheremouse.capture.fetch import PATIENCE
from spheremouse.session.timing import FrameTimes


class Arrivals:
    """Frames that came to the worker, counted from its making. `now` is s of the monotonic clock."""

    def __init__(self) -> None:
        self._times, self._last = FrameTimes(), 0.0
        self.begin()

    def begin(self) -> None:
        """Start to wait for frames."""
        self._last = time.monotonic()

    def add(self, now: float) -> None:
        """Count a frame."""
        self._last = now
        self._times.add(0.0, now)

    def silent(self, now: float) -> bool:
        """Return True if no frame has arrived for longer than a camera may take."""
        return now - self._last > PATIENCE

    def trouble(self, now: float) -> str:
        """The same in words, a second later: the thread that fetches sees it too, and knows more; empty otherwise."""
        silence = now - self._last
        return f"the camera has given no frame for {silence:.0f} s" if silence > PATIENCE + 1.0 else ""

    def rate(self, now: float) -> float:
        """Frames per second in the last second; 0 while none come."""
        return 0.0 if self.silent(now) else float(np.nan_to_num(self._times.rate))
