"""The thread that fetches: opens the camera, hands each shot to the ring, and opens it again whatever becomes of it.

Nothing here decodes, and no error of a device ends it.
"""

import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from spheremouse.daemon.ring import Arrival, Newest
from spheremouse.errors import SpheremouseError
from spheremouse.frame import Frame
from spheremouse.source import Camera, Shot, Source

PATIENCE = 2.0  # s without a frame after which a stream counts as frozen: exposures are shorter, so are focus hunts
_BACK_OFF = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s
_WAIT = 0.25  # s


class EndOfSource(Exception):  # noqa: N818  an end, not an error
    """A recording has no more frames."""


class Fetched:
    """A frame that came decoded, as a shot."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self.stamp, self.sequence = frame.stamp, frame.sequence

    def frame(self, colour: bool) -> Frame:
        """As it came, whatever is asked for."""
        return self._frame

    def release(self) -> None:
        """Nothing to give back."""


class Streamed:
    """A plain source as a camera. It cannot be waited for with a limit: whoever takes the shots sees the silence."""

    def __init__(self, source: Source, name: str) -> None:
        self._source, self._name = source, name
        self._frames: Iterator[Frame] = iter(())

    def next(self, timeout: float) -> Shot | None:
        """The next frame; EndOfSource after the last."""
        frame = next(self._frames, None)
        if frame is None:
            raise EndOfSource
        return Fetched(frame)

    def describe(self) -> str:
        """Its name and rate."""
        return self._name if self._source.fps is None else f"{self._name}, {self._source.fps:g} frames/s"

    def __enter__(self) -> Self:
        self._frames = iter(self._source.__enter__())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.__exit__(kind, error, trace)


class Capture(threading.Thread):
    """Fetches shots until it is closed."""

    def __init__(self, open_camera: Callable[[], Camera], ring: Newest, patience: float = PATIENCE) -> None:
        super().__init__(name="capture", daemon=True)
        self._open, self._ring, self._patience = open_camera, ring, patience
        self._over = threading.Event()
        self._again = threading.Event()
        self.trouble = "the camera is being opened"  # why no frames come; empty while they do
        self.opening = True  # for the first time
        self.description = ""
        self.attempts = 0  # times the camera was opened or tried to be: an honest sign of life without frames
        self._streams = 0  # times it gave a first frame
        self.dropped = 0  # frames that the driver produced and did not hand over
        self.finished = False  # the recording is at its end

    def run(self) -> None:
        """Until it is closed, or a recording ends."""
        failures = 0
        while not self._over.is_set():
            self.attempts += 1
            self._again.clear()
            try:
                failures = 0 if self._fetch() else failures + 1
            except EndOfSource:
                self.finished = True
                break
            except SpheremouseError as e:
                self.trouble = str(e)
                failures += 1
            except Exception as e:
                self.trouble = f"{type(e).__name__}: {' '.join(str(e).split())}"
                failures += 1
            self.opening = False
            self._ring.wake()
            if not self._again.is_set():
                self._over.wait(_BACK_OFF[min(max(failures - 1, 0), len(_BACK_OFF) - 1)])
        self._ring.wake()

    def _fetch(self) -> bool:
        """One stream from its opening to its end; did it give a frame?"""
        before: int | None = None
        with self._open() as camera:
            self.description = camera.describe()
            last = time.monotonic()
            try:
                while not (self._over.is_set() or self._again.is_set()):
                    shot = camera.next(_WAIT)
                    now = time.monotonic()
                    if shot is None:
                        if now - last > self._patience:
                            self.trouble = f"the camera gave no frame for {self._patience:g} s; it is opened again"
                            break
                        continue
                    last = now
                    if before is None:
                        self.trouble, self.opening = "", False
                        self._streams += 1
                    else:
                        self.dropped += max(0, shot.sequence - before - 1)
                    before = shot.sequence
                    self._ring.put(Arrival(shot, now))
            finally:
                self._ring.clear()  # a buffer must not outlive its camera
        return before is not None

    @property
    def restarts(self) -> int:
        """Times that frames came again after they had stopped."""
        return max(0, self._streams - 1)

    def reopen(self, open_camera: Callable[[], Camera]) -> None:
        """Open the camera anew, in another way."""
        self._open = open_camera
        self._again.set()

    def close(self) -> None:
        """End, and give the camera back; a driver that hangs is not waited for any longer than it deserves."""
        self._over.set()
        self.join(2.0)
        self._ring.clear()
