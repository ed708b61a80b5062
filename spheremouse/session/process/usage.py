"""Memory and processor use of this process."""

import math
import resource
import sys
import time
from pathlib import Path


def memory_mb() -> float:
    """MB in the machine's memory now; the most there ever were where the system does not tell."""
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
        """`now` is s of the monotonic clock."""
        cpu = time.process_time()
        self.share = (cpu - self._cpu) / (now - self._looked)
        self._looked, self._cpu = now, cpu
