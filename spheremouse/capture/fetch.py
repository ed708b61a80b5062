"""The capture thread opens the camera, passes each raw frame on, and reopens the camera after a failure.

It decodes nothing, and no error of a device ends it.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Self

from spheremouse.capture import OpenCamera, Payload, RawFrame, Source
from spheremouse.capture.newest import Arrival, LatestFrame
from spheremouse.errors import SourceError, SpheremouseError, TransferError, internal_error_text
from spheremouse.tracker import Frame

MAX_FRAME_GAP_S = 2.0  # s without a frame until a stream counts as frozen; exposures and focus searches are shorter
BACK_OFF = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s
_STABLE_STREAM_S = 2.0  # s that a stream must last for the next failure to count as the first one
_MAX_LAG_S = 0.2  # s that a recording may lag behind its own pace
_POLL_S = 0.25  # s
_DESCRIBE_INTERVAL_S = 1.0  # s between two descriptions, which depend on the frames


class EndOfSource(Exception):  # noqa: N818  an end, not an error
    """A recording has no more frames; its argument, if any, is the error that ended it."""


class Fetched:
    """A raw frame around a decoded one."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self.stamp, self.sequence = frame.stamp, frame.sequence

    def frame(self, colour: bool) -> Frame:
        return self._frame

    def payload(self) -> Payload:
        image = self._frame.image
        height, width = image.shape[:2]
        return Payload("grey" if image.ndim == 2 else "bgr", width, height, image.reshape(-1).data)

    def release(self) -> None:
        """Do nothing: there is no buffer."""


class Streamed:
    """A camera around a plain source. Its `next` ignores the timeout, since a plain source has none."""

    def __init__(self, source: Source, name: str) -> None:
        self._source, self._name = source, name
        self.live = source.live
        self._frames: Iterator[Frame] = iter(())
        self._offset: float | None = None  # s, clock minus stamp of the first frame

    def next(self, timeout: float) -> RawFrame | None:
        """Return the next frame. Raise EndOfSource at the end of a recording, SourceError if a camera stops."""
        try:
            frame = next(self._frames, None)
        except SpheremouseError as e:
            if self.live:
                raise
            raise EndOfSource(e) from None
        if frame is not None and not self.live and self._is_late(frame):
            frame = next(self._frames, frame)  # skip every other frame until it has caught up
        if frame is not None:
            return Fetched(frame)
        if self.live:
            raise SourceError(f"{self._name}: delivers no more frames")
        raise EndOfSource

    def _is_late(self, frame: Frame) -> bool:
        """Return whether a recording that is played in real time lags behind its stamps."""
        now = time.monotonic()
        if self._offset is None:
            self._offset = now - frame.stamp
        return now - frame.stamp - self._offset > _MAX_LAG_S

    def describe(self) -> str:
        return self._name if self._source.fps is None else f"{self._name}, {self._source.fps:g} frames/s"

    def __enter__(self) -> Self:
        self._frames = iter(self._source.__enter__())
        return self

    def __exit__(self, *exception: Any) -> None:
        self._source.__exit__(*exception)


class Capture(threading.Thread):
    """Fetches raw frames until it is closed. Other threads read its plain attributes."""

    def __init__(
        self,
        open_camera: OpenCamera,
        latest: LatestFrame,
        say: Callable[[str], None] = lambda _: None,
        patience: float = MAX_FRAME_GAP_S,
        camera: int = 0,
    ) -> None:
        """`say` logs internal errors and rejected frames; this thread calls it. `camera` is its number."""
        super().__init__(name="capture", daemon=True)
        self._open, self._latest, self._say, self._patience = open_camera, latest, say, patience
        self._camera = camera
        self._over = False
        self._wakeup = threading.Event()  # set to end the stream, or the wait for the next attempt
        self._failures = 0  # in a row
        self._transfer_errors = 0  # TransferErrors in a row
        self._streams = 0  # with at least one frame
        self._recorded = False  # a recording has its own clock and is not played twice
        self.trouble = "the camera is being opened"  # reason for missing frames; empty while they come
        self.opening = True  # during the first attempt
        self.description = ""
        self.attempts = 0  # to open the camera; shows that the thread runs although no frames come
        self.dropped = 0  # frames, by the driver
        self.finished = False  # at the end of a recording
        self.failure: SpheremouseError | None = None  # that ended the recording

    def run(self) -> None:
        """Fetch until `close` is called or a recording ends."""
        while not self._over:
            self.attempts += 1
            self._wakeup.clear()
            try:
                self._fetch()
            except EndOfSource as e:
                self.failure = e.args[0] if e.args else None
                self.finished = True
                break
            except SpheremouseError as e:
                self.trouble = str(e)
                self._reset_after(e)
            except Exception as e:
                trouble = f"{type(e).__name__}: {' '.join(str(e).split())}"
                if trouble != self.trouble:
                    self._say(internal_error_text())
                self.trouble = trouble
            self.opening = False
            self._latest.wake()
            self._wakeup.wait(BACK_OFF[min(max(self._failures - 1, 0), len(BACK_OFF) - 1)])
        self._latest.wake()

    def _reset_after(self, error: SpheremouseError) -> None:
        """Reset the camera at the first of the TransferErrors in a row, and again after every `len(BACK_OFF)` of them.

        The waits begin with the shortest again.
        """
        if not isinstance(error, TransferError):
            self._transfer_errors = 0
            return
        if self._transfer_errors % len(BACK_OFF) == 0:
            self._say(error.reset())
            self._failures = 0
        self._transfer_errors += 1

    def _fetch(self) -> None:
        """Open the camera and pass its frames on, until the capture ends or the stream fails."""
        began: float | None = None  # s, the first frame
        self._failures += 1
        with self._open() as camera:
            self._recorded = isinstance(camera, Streamed) and not camera.live
            self.description = camera.describe()
            last, before, described = time.monotonic(), 0, 0.0
            invalid_stamps = 0
            try:
                while not (self._over or self._wakeup.is_set()):
                    raw = camera.next(_POLL_S)
                    now = time.monotonic()
                    if raw is not None and not math.isfinite(raw.stamp):
                        if not invalid_stamps:
                            what = f"frame {raw.sequence} is rejected: its stamp must be a finite number of seconds"
                            self._say(f"{self.description}: {what}, is {raw.stamp}")
                        invalid_stamps += 1
                        raw.release()
                        raw = None
                    if raw is None:
                        if now - last > self._patience:
                            no_frame = "no frame with a valid stamp" if invalid_stamps else "no frame"
                            self.trouble = f"the camera gave {no_frame} for {self._patience:g} s; it is opened again"
                            break
                        continue
                    if began is None:
                        began, self._transfer_errors = now, 0
                        self.trouble, self.opening = "", False
                        self._streams += 1
                    else:
                        self.dropped += max(0, raw.sequence - before - 1)
                    if self._failures and now - began > _STABLE_STREAM_S:
                        self._failures = 0
                    if now - described > _DESCRIBE_INTERVAL_S:
                        self.description, described = camera.describe(), now
                    last, before = now, raw.sequence
                    self._latest.put(Arrival(raw, now if self._recorded else min(raw.stamp, now), self._camera))
            finally:
                if not self._recorded:
                    self._latest.clear(self._camera)  # a buffer must not outlive its camera

    @property
    def restarts(self) -> int:
        """Number of times that frames resumed after they had stopped."""
        return max(0, self._streams - 1)

    def reopen_with(self, open_camera: OpenCamera) -> None:
        """Replace the function that opens the camera, and reopen it."""
        self._open, self._failures, self.description = open_camera, 0, ""
        self._wakeup.set()

    def reopen(self) -> None:
        """Reopen the camera because its frames are unusable. Does nothing for a recording."""
        if not self._recorded:
            self._wakeup.set()

    def close(self) -> None:
        """End the thread and release the camera. Waits at most 2 s for a driver that hangs."""
        self._over = True
        self._wakeup.set()
        if self.is_alive():
            self.join(2.0)
        self._latest.clear(self._camera)
