"""Measurements of a run: times per frame, rate of the frames that arrive, memory and processor use.

Memory does not grow with the run: the times of all frames are a histogram of logarithmic classes, 2 % wide.
"""

import math
import resource
import sys
import time
from collections import deque
from pathlib import Path

import numpy as np

from spheremouse.capture.fetch import PATIENCE

NEXT_FRAME = 0.05  # s from one frame to the next, at 20 frames/s
_SHORTEST, _LONGEST = 1e-6, 100.0  # s
_CLASSES_PER_E = 50  # classes are exp(1/50) = 2 % wide
_CLASSES = math.ceil(math.log(_LONGEST / _SHORTEST) * _CLASSES_PER_E) + 1


class FrameTimes:
    """Times per frame, s."""

    def __init__(self, window: float = 1.0) -> None:
        """`window`, s, is the period of `recent_quantile` and `rate`."""
        self._window = window
        self._recent: deque[tuple[float, float]] = deque(maxlen=2000)  # clock, seconds
        self._histogram = np.zeros(_CLASSES, dtype=np.int64)

    def add(self, seconds: float, clock: float) -> None:
        """Add the time of a frame that was done at `clock` (s, any clock that does not jump)."""
        self._recent.append((clock, seconds))
        while self._recent[0][0] < clock - self._window:
            self._recent.popleft()
        place = math.log(min(max(seconds, _SHORTEST), _LONGEST) / _SHORTEST) * _CLASSES_PER_E
        self._histogram[int(place)] += 1

    @property
    def count(self) -> int:
        """Frames so far."""
        return int(self._histogram.sum())

    def quantile(self, share: float) -> float:
        """Return the quantile `share` (0..1) of all frames, s, to 1 %; nan without a frame."""
        if self.count == 0:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self._histogram), share * self.count))
        return _SHORTEST * math.exp((place + 0.5) / _CLASSES_PER_E)

    def recent_quantile(self, share: float) -> float:
        """Return the exact quantile of the frames in the window, s; nan without a frame."""
        return float(np.quantile([s for _, s in list(self._recent)], share)) if self._recent else math.nan

    @property
    def rate(self) -> float:
        """Frames per second in the window; nan before the second frame."""
        if len(self._recent) < 2:
            return math.nan
        return (len(self._recent) - 1) / max(self._recent[-1][0] - self._recent[0][0], 1e-9)


class Arrivals:
    """Rate of the frames that arrive, and the time since the last one. `now` is s of the monotonic clock."""

    def __init__(self, patience: float = PATIENCE) -> None:
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

    def expected(self, now: float) -> bool:
        """Return True if the next frame of a camera with 20 frames/s or more is not yet late."""
        return now - self._last < NEXT_FRAME

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
