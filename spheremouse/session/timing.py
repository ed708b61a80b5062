"""Measurements of a run: times per frame, rate of the frames that arrive, memory and processor use."""

import math
import resource
import sys
import time
from collections import deque
from pathlib import Path

import numpy as np

from spheremouse.capture.fetch import MAX_FRAME_GAP_S

NEXT_FRAME_S = 0.05  # from one frame to the next, at 20 frames/s
_MIN_SLEEP_S = 0.1  # s
_MAX_FRAMES = 10_000  # that are kept: some minutes


class FrameTimes:
    """Times of the last frames, s. The window of `recent_quantile` and `rate` is 1 s."""

    def __init__(self) -> None:
        self._clocks: deque[float] = deque(maxlen=_MAX_FRAMES)
        self._seconds: deque[float] = deque(maxlen=_MAX_FRAMES)
        self._recent = 0  # frames in the window

    def add(self, seconds: float, clock: float) -> None:
        """Add the time of a frame that was done at `clock` (s, any clock that does not jump)."""
        self._clocks.append(clock)
        self._seconds.append(seconds)
        self._recent = min(self._recent + 1, _MAX_FRAMES)
        while self._clocks[-self._recent] < clock - 1.0:
            self._recent -= 1

    def quantile(self, share: float) -> float:
        """Return the quantile `share` (0..1) of the last 10,000 frames, s; nan without a frame."""
        return _quantile(list(self._seconds), share)

    def recent_quantile(self, share: float) -> float:
        """Return the quantile of the frames in the window, s; nan without a frame."""
        return _quantile(list(self._seconds)[-self._recent :], share)

    @property
    def rate(self) -> float:
        """Frames per second in the window; nan before the second frame."""
        if self._recent < 2:
            return math.nan
        return (self._recent - 1) / max(self._clocks[-1] - self._clocks[-self._recent], 1e-9)


def _quantile(seconds: list[float], share: float) -> float:
    return float(np.quantile(seconds, share)) if seconds else math.nan


def time_asleep() -> float:
    """Return the time (s) for which the computer has slept since it was started; 0 where the system has no such clock.

    A thread that loses the processor between the two clocks makes it smaller, never larger.
    """
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return 0.0
    with_sleep = time.clock_gettime(time.CLOCK_BOOTTIME)
    return with_sleep - time.monotonic()


class SleepMonitor:
    """Notices that the computer slept (suspended), while the monotonic clock stood."""

    def __init__(self) -> None:
        self._asleep = time_asleep()
        self._woke = -math.inf  # s, monotonic

    def slept(self, now: float) -> float:
        """Return the time (s) slept since the last call, 0 for less than a tenth of a second."""
        asleep = time_asleep()
        slept, self._asleep = asleep - self._asleep, max(self._asleep, asleep)
        if slept < _MIN_SLEEP_S:
            return 0.0
        self._woke = now
        return slept

    def is_older(self, taken: float) -> bool:
        """Return whether a frame was taken (s, monotonic) before the last sleep was noticed."""
        return taken < self._woke


class Arrivals:
    """Rate of the frames that arrive, and the time since the last one. `now` is s of the monotonic clock."""

    def __init__(self, patience: float = MAX_FRAME_GAP_S) -> None:
        """`patience`, s, is the longest time that a camera may take."""
        self._times, self._last, self._patience = FrameTimes(), 0.0, patience
        self.begin()

    def begin(self) -> None:
        """Start to wait for frames."""
        self._last = time.monotonic()

    def add(self, now: float) -> None:
        """Count a frame that arrived at `now`."""
        self._last = now
        self._times.add(0.0, now)

    def on_time(self, now: float) -> bool:
        """Return True if the next frame of a camera with 20 frames/s or more is not yet late."""
        return now - self._last < NEXT_FRAME_S

    def time_left(self, now: float) -> float:
        """Return the time until the next frame, s, by the mean interval of the last second; nan if that is unknown."""
        return self._last + 1.0 / self._times.rate - now

    def silent(self, now: float) -> bool:
        """Return True if no frame has arrived for longer than `patience`."""
        return now - self._last > self._patience

    def trouble(self, now: float) -> str:
        """Return the silence in words, a second later, since the capture thread may give a better reason before."""
        silence = now - self._last
        return f"the camera has given no frame for {silence:.0f} s" if silence > self._patience + 1.0 else ""

    def rate(self, now: float) -> float:
        """Frames per second in the last second; 0 while none come."""
        return 0.0 if self.silent(now) else float(np.nan_to_num(self._times.rate))


def memory_mb() -> float:
    """Return the resident memory, MB; the maximum of the run if the system does not give the present value."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return pages * resource.getpagesize() / 1e6
    except (OSError, ValueError, IndexError):
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most / (1e6 if sys.platform == "darwin" else 1e3)


class CpuShare:
    """Fraction of one core that this process used between the last two calls of `look`."""

    def __init__(self) -> None:
        self._looked, self._cpu = time.monotonic(), time.process_time()
        self.share = math.nan

    def look(self, now: float) -> None:
        """Update the share; `now` is s of the monotonic clock."""
        cpu = time.process_time()
        self.share = (cpu - self._cpu) / (now - self._looked)
        self._looked, self._cpu = now, cpu
