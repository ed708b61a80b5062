"""Record tracked frames into a dataset folder. A replay of it gives the same results bit for bit (docs/recording).

The worker submits each tracked frame, which costs it a copy of the kept part. A thread of the pool writes the frames. A
recording ends at its limits, and its folder appears complete or not at all.
"""

import os
import queue
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from spheremouse.errors import DatasetError, SpheremouseError
from spheremouse.files.dataset.write import FilmWriter
from spheremouse.session.control.status import RecordingStatus
from spheremouse.session.overlay.pen import Image, masked
from spheremouse.session.record.places import disk_is_full, lock, made_folder, refuse_full_disk
from spheremouse.session.settings import RecordSettings
from spheremouse.session.tracker_adapter import Subject
from spheremouse.tracker import Frame

_MAX_QUEUED_BYTES = 32e6  # bytes that wait for the writer: half a second of 640x480 in colour at 60 Hz
_MAX_UNWRITTEN_VIDEO_BYTES = 6e6  # bytes that the video keeps in memory before they are in its file, and its index
_CHECK_INTERVAL_S = 0.5  # s between two looks at the disk and the clock
_NOMINAL_FPS = 30.0  # of the video, for players only


class Recorder:
    """One recording. Frames that are added before it is `open` are not part of it."""

    def __init__(
        self,
        folder: Path,
        subject: Subject,
        settings: RecordSettings,
        camera_line: str = "",
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`folder` must not exist, or be empty. Raises DatasetError if the recording cannot begin.

        Call `write` then, in a thread of its own.
        """
        if not settings.everything and not subject.parts:
            problem = "a recording of a hand-held ball needs whole pictures, with the person in them"
            raise DatasetError(f"{problem}: with consent, give --everything, or set record.everything")
        self._subject, self._settings, self._clock = subject, settings, clock
        self._folder, self._camera_line = folder.absolute(), camera_line
        made_folder(self._folder.parent, DatasetError)
        refuse_full_disk(self._folder, settings, _MAX_UNWRITTEN_VIDEO_BYTES)
        camera = subject.camera
        self._size_px = camera.width, camera.height
        self._film = FilmWriter(self._folder, self._size_px)
        try:
            self._lock = lock(self._film.folder)  # after a kill, `tidy` removes a folder without a lock
        except BaseException:
            self._film.discard()
            raise
        self._frame_bytes = 3 * camera.width * camera.height
        self._frames: queue.SimpleQueue[Frame | None] = queue.SimpleQueue()
        self._max_queued = min(max(int(_MAX_QUEUED_BYTES / self._frame_bytes), 4), 64)
        self._view = subject.view  # of the last frame; `_subject` is that of the first
        self._keep: Image | None = None
        self.active = True  # until it is stopped or has ended
        self.open = self._taken = False
        self._dropped = self._bytes = 0
        self._begun = self._last = clock()

    def add(self, frame: Frame, subject: Subject | None = None) -> bool:
        """Copy a tracked frame and its present subject, without waiting. Return True if the frame is kept."""
        if not (self.open and self.active):
            return False
        if self._clock() - self._begun >= self._settings.seconds:
            self.stop()
            return False
        if frame.image.shape[1::-1] != self._size_px or not np.isfinite(frame.stamp):
            self._dropped += 1
            return False
        keep = self._mask(subject)
        if self._frames.qsize() >= self._max_queued:
            self._dropped += 1
            return False
        image = frame.image.copy() if keep is None else masked(frame.image, keep)
        self._frames.put(Frame(image, frame.stamp, frame.sequence))
        self._taken = True
        return True

    def stop(self) -> None:
        """Take no more frames. `write` returns when those taken are written."""
        self.active = False
        self._frames.put(None)

    def status(self) -> RecordingStatus:
        """Return the progress, from any thread."""
        return RecordingStatus(
            folder=str(self._folder),
            frames=self._film.frames,
            seconds=self._last - self._begun,
            bytes=self._bytes,
            dropped=self._dropped,
        )

    def write(self) -> str:
        """Write frames until the recording ends, and return the result as text. DatasetError: nothing was kept."""
        try:
            reason = self._record()
            self.open = False
            self._bytes = self._film.size()
            self._film.finish(self._scene(), self._subject.files())
        except (SpheremouseError, OSError, cv2.error) as e:
            text = " ".join(str(e).split())
            raise DatasetError(text if str(self._folder) in text else f"{self._folder}: not recorded: {text}") from None
        finally:
            self.active = self.open = False
            os.close(self._lock)
            self._film.discard()
        lost = f", {self._dropped} dropped" if self._dropped else ""
        length = f"{self._film.frames} frames in {self._last - self._begun:.1f} s, {self._bytes / 1e6:.1f} MB{lost}"
        return f"{self._folder}: {length}; {reason}"

    def _mask(self, subject: Subject | None) -> Image | None:
        """Return the part of a frame to keep; None: all of it.

        After a move of the camera, keep the parts of both poses. The tracker read the frame with the old pose and then
        with the new one.
        """
        keep = self._keep
        if subject is None or subject.view is self._view:
            return keep
        self._view = subject.view
        if not self._taken:
            self._subject = subject
        if keep is None:
            return None
        try:
            self._keep = subject.kept()
        except SpheremouseError:  # the ball is out of the picture: keep no more of it than before
            return keep
        return keep | self._keep if self._taken else self._keep

    def _scene(self) -> dict[str, Any]:
        kept = "everything" if self._settings.everything else f"{self._subject.parts}; the rest is black"
        content = {"made_by": "spheremouse record", "camera_says": self._camera_line, "kept": kept}
        return {**content, **self._subject.scene()}

    def _record(self) -> str:
        """Write until there is a reason to end, and return it."""
        if not self._settings.everything:
            self._keep = self._subject.kept()
        self._film.open(_NOMINAL_FPS)
        self._begun = self._last = looked = self._clock()
        self.open = True
        limit = 1e6 * self._settings.megabytes - _MAX_UNWRITTEN_VIDEO_BYTES - self._frame_bytes
        seconds = self._settings.seconds
        while True:
            try:
                frame = self._frames.get(timeout=_CHECK_INTERVAL_S)
            except queue.Empty:
                if self._clock() - self._begun >= seconds:
                    return f"ended after {seconds:g} s"
                continue
            now = self._clock()
            if frame is None:
                time_is_over = now - self._begun >= seconds
                return f"ended after {seconds:g} s" if time_is_over else "ended as asked"
            self._bytes = self._film.size()
            if self._bytes > limit:
                return f"ended at {self._settings.megabytes:g} MB (record.megabytes)"
            if now - looked >= _CHECK_INTERVAL_S:
                looked = now
                if disk_is_full(self._folder.parent, self._settings, _MAX_UNWRITTEN_VIDEO_BYTES):
                    return f"ended: less than {self._settings.free_megabytes:g} MB are free on the disk"
            self._film.add(frame)
            self._last = now
