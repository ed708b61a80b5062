"""Between the thread that fetches and the one that works: the newest shot wins, and what it replaces is counted.

The pictures themselves lie where the driver put them: its buffers are the ring, and a shot that is replaced gives its
own back at once.
"""

import threading
from dataclasses import dataclass

from spheremouse.capture import Shot


@dataclass(frozen=True, slots=True)
class Arrival:
    """A shot, and when it was taken."""

    shot: Shot
    taken: float  # s, time.monotonic(): mid-exposure as far as the source knows it, never ahead of the clock


class Newest:
    """Holds one arrival at most."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrival: Arrival | None = None
        self._woken = False
        self.skipped = 0  # shots that nobody took: a newer one replaced them, or their camera went

    def put(self, arrival: Arrival) -> None:
        """From now on this is the newest."""
        with self._changed:
            old, self._arrival = self._arrival, arrival
            if old is not None:
                self.skipped += 1
            self._changed.notify()
        if old is not None:
            old.shot.release()

    def take(self, timeout: float) -> Arrival | None:
        """The newest, waited for `timeout` s at most; None then, or when somebody called `wake`."""
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
            old.shot.release()
