"""Hand the latest raw frame from the capture thread to the worker, and count the frames that it replaces.

The images stay in the driver's buffers. A replaced raw frame returns its buffer at once.
"""

import threading
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.capture import RawFrame
from spheremouse.tracker import Frame


@dataclass(frozen=True, slots=True)
class Arrival:
    """A raw frame, and the time at which it was taken."""

    raw: RawFrame
    taken: float  # s, time.monotonic(): mid-exposure as far as the source knows it, never ahead of the clock


class LatestFrame:
    """Holds one arrival at most."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrival: Arrival | None = None
        self._woken = False
        self.skipped = 0  # frames that were replaced, or cleared with their camera

    def put(self, arrival: Arrival) -> None:
        """Replace the latest arrival."""
        with self._changed:
            old = self._replace(arrival)
            self._changed.notify()
        if old is not None:
            old.raw.release()

    def take(self, timeout: float) -> Arrival | None:
        """Return the latest arrival; None if none comes within `timeout` (s), or after `wake`."""
        with self._changed:
            if self._arrival is None and not self._woken:
                self._changed.wait(timeout)
            taken, self._arrival, self._woken = self._arrival, None, False
            return taken

    def wake(self) -> None:
        """End a wait, because there is other work."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def clear(self) -> None:
        """Release the latest arrival."""
        with self._changed:
            old = self._replace(None)
        if old is not None:
            old.raw.release()

    def _replace(self, arrival: Arrival | None) -> Arrival | None:
        """Store an arrival, or None, and return the one that nobody has taken, which counts as skipped."""
        old, self._arrival = self._arrival, arrival
        self.skipped += old is not None
        return old


class ContiguousBuffer:
    """Makes images contiguous and writeable, as the kernels need them. One buffer serves all frames."""

    def __init__(self) -> None:
        self._image: NDArray[np.uint8] = np.zeros(0, np.uint8)

    def __call__(self, frame: Frame) -> Frame:
        """Return the frame itself if its image is suitable, otherwise a copy in the buffer."""
        image = frame.image
        if image.flags.c_contiguous and image.flags.writeable:
            return frame
        if self._image.shape != image.shape:
            self._image = np.empty(image.shape, np.uint8)
        np.copyto(self._image, image)
        return replace(frame, image=self._image)
