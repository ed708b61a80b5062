"""Who may ask how much of the control socket."""

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """What a client may cost."""

    pace: float = 100.0  # requests per s, of all members together, and of all the owner's clients; connections likewise
    burst: float = 50.0  # of them at once
    kilobyte: float = 1.0  # requests that a kilobyte of a request counts for
    reading: float = 0.25  # requests that a look at what came counts for
    unsent: int = 262144  # bytes that may wait for a client to read them
    stalled: float = 5.0  # s in which a client must have read something of what waits for it
    idle: float = 30.0  # s that a client may be silent
    answer: float = 60.0  # s in which the daemon must have answered
    events: int = 1000  # that may wait to be sent to watchers


class Pace:
    """So many per second, and so many at once; debts are paid off before anything more is done."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._level, self._then = burst, time.monotonic()

    def free(self) -> bool:
        """Whether something may be done now."""
        now = time.monotonic()
        self._level = min(self._burst, self._level + (now - self._then) * self._rate)
        self._then = now
        return self._level > 0.0

    def take(self, cost: float) -> None:
        """It was done."""
        self._level -= cost

    def wait(self) -> float:
        """Seconds until something may be done."""
        return 0.0 if self.free() else (0.001 - self._level) / self._rate
