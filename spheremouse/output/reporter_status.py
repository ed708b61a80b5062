"""Condition of an output, sums of its counts, and its latency."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from spheremouse.output import Counts

LATENCY_COUNT = 4096  # a minute at 60 Hz


@dataclass(frozen=True, slots=True)
class Latency:
    """Time from a frame's stamp to the end of `send`, over the last frames."""

    p50: float  # s
    p99: float  # s
    max: float  # s


class LatencyLog:
    """Latencies of the last frames, added by one thread and read by others."""

    def __init__(self) -> None:
        self._seconds = deque[float](maxlen=LATENCY_COUNT)
        self.add = self._seconds.append  # takes a latency, s

    def summary(self) -> Latency | None:
        """Return quantiles and maximum; None before the first frame."""
        last = tuple(self._seconds)
        if not last:
            return None
        p50, p99 = np.percentile(last, (50.0, 99.0)).tolist()
        return Latency(p50, p99, max(last))


@dataclass(frozen=True, slots=True)
class ReporterStatus:
    """Condition of the output, sums of counts and latency."""

    failed: str | None  # reason of a failure; None: the output works
    ended: bool  # the reader of the output closed it; it is not opened again
    reports: int  # reports with counts
    dropped: int  # frames that were not sent: during a failure or pause, too late, or more than the queue holds
    sent: Counts  # acknowledged ones alone, if the output acknowledges
    unsent: Counts  # submitted during a failure or pause, or too late; or lost on the way
    ahead: Counts  # sent before the ball made them; negative: made by the ball and not sent yet
    latency: Latency | None  # None: no frame was sent yet
