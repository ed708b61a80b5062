"""Live pictures for clients that request them: the raw frame with the tracker's marks, in shared memory.

Without a lease it allocates, copies and computes nothing.
"""

import threading
import time
from collections.abc import Callable

from spheremouse.capture.newest import Arrival
from spheremouse.errors import ControlError, DamagedFrameError, internal_error_text
from spheremouse.session.control.pictures import LivePicture, PictureRing
from spheremouse.session.control.protocol import LEASE
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter

_OUTPUTS_FIRST = 1e-3  # s in which the threads of the outputs, which a report wakes, get the interpreter alone
_ANNOTATION_BYTES = 64 * 1024  # of a picture; 60 discs need 10,000


class PictureFeed:
    """Writes pictures while a lease lasts. Any thread may call `lease`, the worker calls the others."""

    def __init__(self, log: Callable[[str], None]) -> None:
        """`log` takes internal errors."""
        self._log = log
        self._lock = threading.RLock()  # held for microseconds
        self._interval, self._until = 0.0, 0.0  # s, between two pictures; s, end of the last lease
        self._ring: PictureRing | None = None
        self._due = 0.0  # s, of the next picture
        self._number = 0  # of the last picture
        self._camera = -1  # of the last picture

    def lease(self, now: float, interval: float, size: tuple[int, int]) -> PictureRing:
        """Begin a lease at `now`, or renew it, and return the ring. `size` is the expected width and height, px.

        Of several clients the one with the shortest interval decides, until all leases have ended.
        Raises ControlError if the system has no memory.
        """
        with self._lock:
            if self._ring is None:
                self._ring = PictureRing(3 * size[0] * size[1] + _ANNOTATION_BYTES)
                self._interval = interval
            self._interval, self._until = min(self._interval, interval), now + LEASE
            return self._ring

    def show(
        self, now: float, arrival: Arrival, adapter: TrackerAdapter, result: FrameResult | None, cameras: int = 1
    ) -> None:
        """Write a frame that is not yet released, if a picture is due.

        `result` is None if the frame was not tracked. Several `cameras` take turns. If the others give no frames, a
        camera's next picture comes one interval late.
        """
        interval, raw, camera = self._interval, arrival.raw, arrival.camera
        if self._ring is None or now < self._due + (interval if cameras > 1 and camera == self._camera else 0.0):
            return
        self._camera = camera
        self._due = max(self._due + interval, now + 0.5 * interval)  # the mean interval, at any rate of the camera
        time.sleep(_OUTPUTS_FIRST)
        try:
            image = raw.payload()
            marks = {"camera": camera, **adapter.annotations(result)}
            self._number += 1
            size = image.width, image.height
            self._write(LivePicture(self._number, raw.stamp, image.format, *size, image.data, marks))
        except DamagedFrameError:
            pass
        except ControlError as e:
            self._log(str(e))
            self.close()
        except Exception:
            self._log(internal_error_text())

    def expire(self, now: float) -> None:
        """Free the memory if all leases have ended."""
        with self._lock:
            if now >= self._until:
                self.close()

    def close(self) -> None:
        """Free the memory."""
        with self._lock:
            if self._ring is not None:
                self._ring.close()
            self._ring = None

    def _write(self, picture: LivePicture) -> None:
        with self._lock:
            if self._ring is not None and not self._ring.write(picture):
                self._ring.close()
                self._ring = PictureRing(len(picture.pixels) + _ANNOTATION_BYTES)
                self._ring.write(picture)
