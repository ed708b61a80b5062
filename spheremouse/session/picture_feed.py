"""Live pictures for clients that request them: the next raw frame with the tracker's marks.

Without a request it copies and computes nothing.
"""

import time
from collections import deque
from collections.abc import Callable

from spheremouse.capture.newest import Arrival
from spheremouse.errors import DamagedFrameError, internal_error_text
from spheremouse.session.control.protocol import refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter

MIN_INTERVAL_S = 0.03  # s between two pictures
_MAX_WAIT_S = 1.0  # s for a frame
_TURN_S = 0.05  # s in which the other camera may give the next picture
_OUTPUTS_FIRST = 1e-3  # s in which the threads of the outputs, which a report wakes, get the interpreter alone


class PictureFeed:
    """Answers requests for pictures. Any thread may call `request`, the worker calls the others."""

    def __init__(self, log: Callable[[str], None]) -> None:
        """`log` takes internal errors."""
        self._log = log
        self._waiting: deque[tuple[float, PendingRequest]] = deque()  # s, and the request
        self._due = 0.0  # s, of the next picture
        self._camera = -1  # of the last picture

    def request(self, now: float, pending: PendingRequest) -> None:
        """Answer a request with the next frame."""
        self._waiting.append((now, pending))

    def show(
        self, now: float, arrival: Arrival, adapter: TrackerAdapter, result: FrameResult | None, cameras: int = 1
    ) -> None:
        """Answer the requests with a frame that is not yet released, if there are any.

        `result` is None if the frame was not tracked. Several `cameras` take turns.
        """
        raw, camera = arrival.raw, arrival.camera
        if not self._waiting or now < self._due:
            return
        if cameras > 1 and camera == self._camera and now < self._waiting[0][0] + _TURN_S:
            return
        self._camera, self._due = camera, now + MIN_INTERVAL_S
        time.sleep(_OUTPUTS_FIRST)
        try:
            image = raw.payload()
            picture = {
                "stamp": raw.stamp,
                "format": image.format,
                "width": image.width,
                "height": image.height,
                "annotations": {"camera": camera, **adapter.annotations(result)},
                "bytes": len(image.data),
                "pixels": bytes(image.data),
            }
        except DamagedFrameError:
            return
        except Exception:
            self._log(internal_error_text())
            return
        while self._waiting:
            self._waiting.popleft()[1].answer(dict(picture))

    def refuse_late(self, now: float, reason: str) -> None:
        """Refuse the requests that have waited for a second; `reason` is that of the present state."""
        while self._waiting and now >= self._waiting[0][0] + _MAX_WAIT_S:
            self._waiting.popleft()[1].answer(refused(f"there is no picture now: {reason}"))
