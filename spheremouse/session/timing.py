"""Times per frame: over the last second for a table, over the run for its summary.

Memory does not grow with the run: the whole is a histogram of logarithmic classes, 2 % wide.
"""

import math
from collections import deque

import numpy as np

_SHORTEST, _LONGEST = 1e-6, 100.0  # s
_CLASSES_PER_E = 50  # classes are exp(1/50) = 2 % wide
_CLASSES = math.ceil(math.log(_LONGEST / _SHORTEST) * _CLASSES_PER_E) + 1


class FrameTimes:
    """Times per frame in seconds, as they come."""

    def __init__(self, window: float = 1.0) -> None:
        """`window` s is what `recent` looks back on."""
        self._window = window
        self._recent: deque[tuple[float, float]] = deque(maxlen=2000)  # clock, seconds
        self._histogram = np.zeros(_CLASSES, dtype=np.int64)

    def add(self, seconds: float, clock: float) -> None:
        """One frame took `seconds`, and was done at `clock` (s, any clock that does not jump)."""
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
        """s that `share` (0..1) of all frames stayed below, to 1 %; nan where there was none."""
        if self.count == 0:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self._histogram), share * self.count))
        return _SHORTEST * math.exp((place + 0.5) / _CLASSES_PER_E)

    def recent_quantile(self, share: float) -> float:
        """The same, exactly, of the frames in the window."""
        return float(np.quantile([s for _, s in list(self._recent)], share)) if self._recent else math.nan

    @property
    def rate(self) -> float:
        """Frames per second in the window, whatever held them up; nan before the second frame."""
        if len(self._recent) < 2:
            return math.nan
        return (len(self._recent) - 1) / max(self._recent[-1][0] - self._recent[0][0], 1e-9)
