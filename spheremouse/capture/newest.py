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
    camera: int = 0  # number of the camera, of several


class LatestFrame:
    """Holds one arrival of each camera at most."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._arrivals: dict[int, Arrival] = {}  # by camera
        self._woken = False
        self.skipped = 0  # frames that were replaced, or cleared with their camera

    def put(self, arrival: Arrival) -> None:
        """Replace the latest arrival of its camera."""
        with self._changed:
            old, self._arrivals[arrival.camera] = self._arrivals.get(arrival.camera), arrival
            self.skipped += old is not None
            self._changed.notify()
        if old is not None:
            old.raw.release()

    def take(self, timeout: float) -> Arrival | None:
        """Return the arrival that was taken first; None if none comes within `timeout` (s), or after `wake`."""
        with self._changed:
            if not self._arrivals and not self._woken:
                self._changed.wait(timeout)
            self._woken = False
            if not self._arrivals:
                return None
            return self._arrivals.pop(min(self._arrivals, key=lambda camera: self._arrivals[camera].taken))

    def wake(self) -> None:
        """End a wait, because there is other work."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def clear(self, camera: int = 0) -> None:
        """Release the latest arrival of a camera, which was not taken: it counts as skipped."""
        with self._changed:
            old = self._arrivals.pop(camera, None)
            self.skipped += old is not None
        if old is not None:
            old.raw.release()


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
