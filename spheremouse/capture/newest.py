"""Between the thread that fetches and the one that works: the latest raw frame wins, and what it replaces is counted.

The pictures themselves lie where the driver put them: its buffers are the ring, and a raw frame that is replaced
gives its own back at once.
"""

import threading
from dataclasses import dataclass

from spheremouse.capture import RawFrame


@dataclass(frozen=True, slots=True)
class Arrival:
    """A raw frame, and when it was taken."""

    raw: RawFrame
    taken: float  # s, time.monotonic(): mid-exposure as far as the source knows it, never ahead of the clock


class LatestFrame:
    """Holds one arrival at most."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrival: Arrival | None = None
        self._woken = False
        self.skipped = 0  # frames that nobody took: a later one replaced them, or their camera went

    def put(self, arrival: Arrival) -> None:
        """From now on this is the latest."""
        with self._changed:
            old, self._arrival = self._arrival, arrival
            if old is not None:
                self.skipped += 1
            self._changed.notify()
        if old is not None:
            old.raw.release()

    def take(self, timeout: float) -> Arrival | None:
        """The latest, waited for `timeout` s at most; None then, or when somebody called `wake`."""
        with self._changed:
            if self._arrival is None and not self._woken:
                self._changed.wait(timeout)
            taken, self._arrival, self._woken = self._arrival, None, False
            return taken

    def wake(self) -> None:
        """End a wait: there is something else to do."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def clear(self) -> None:
        """Give back what is held."""
        with self._changed:
            old, self._arrival = self._arrival, None
            if old is not None:
                self.skipped += 1
        if old is not None:
            old.raw.release()
