"""Pictures and films of an overlay, written to a disk."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Self

import cv2

from spheremouse.errors import OutputError, os_errors_as
from spheremouse.files.safe_files import NewFolder, replace
from spheremouse.session.overlay.pen import Image

_PICTURES = (".png", ".jpg", ".jpeg")
# MPEG-4 plays in every player though not in every browser, and costs 2 ms a frame; VP8, which browsers play, costs 80.
_CODECS = {".mkv": "mp4v", ".mp4": "mp4v", ".avi": "MJPG"}


class OverlayFile:
    """A picture of the last drawing, or a video of all, under its name only when it is complete. A context manager."""

    def __init__(self, path: Path, fps: float | None) -> None:
        """`fps` is the frame rate of a video. Raises OutputError if nothing can be written there, as entering does."""
        self.path = path
        self._picture = path.suffix.lower() in _PICTURES
        self._fps = fps or 30.0
        self._video: cv2.VideoWriter | None = None
        self._last: Callable[[], Image] | None = None
        self.written = False  # at the end, if there was a drawing
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file in it")
        if not self._picture and path.suffix.lower() not in _CODECS:
            known = ", ".join((*_CODECS, *_PICTURES))
            raise OutputError(f"{path}: unknown kind of overlay; end the name in one of {known}")
        if not path.parent.is_dir():
            raise OutputError(f"{path}: cannot be written: there is no folder {path.parent}")
        self._new = NewFolder(path.with_name(f"{path.name}.part"), OutputError)

    def scale(self, width: int) -> int:
        """Return the enlargement of frames of a width, px. Pictures are larger than videos."""
        return max(1, round((1280 if self._picture else 640) / width))

    def show(self, draw: Callable[[], Image]) -> None:
        """Add a drawing. It is drawn now for a video, and at the end for a picture if it is the last."""
        self._last = draw
        if self._picture:
            return
        image = draw()
        if self._video is None:
            self._video = _open_video(self._part, self._fps, (image.shape[1], image.shape[0]))
        self._video.write(image)

    def __enter__(self) -> Self:
        try:
            self._part = self._new.make() / self.path.name  # creating it at once reports errors early
        except BaseException:
            self._new.discard()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._video is not None:
                self._video.release()
            if self._last is not None:
                if self._picture:
                    write_picture(self.path, self._last())
                else:
                    self._publish()
                self.written = True
        finally:
            self._new.discard()

    def _publish(self) -> None:
        """Check that the file can be read before it gets its name, since OpenCV's writer reports no errors."""
        written = cv2.VideoCapture(str(self._part), cv2.CAP_FFMPEG)
        good = written.isOpened() and written.grab()
        written.release()
        if not good:
            raise OutputError(f"{self.path}: the video could not be written; is the disk full?")
        with os_errors_as(OutputError, f"{self.path}: cannot be written"):
            os.replace(self._part, self.path)


def write_picture(path: Path, image: Image, mode: int | None = None) -> None:
    """Write an image, which gets its name when it is complete. Raise OutputError if that fails.

    The file has the `mode`, whatever the umask. Without a mode the umask applies.
    """
    good, data = cv2.imencode(path.suffix, image)
    if not good:
        raise OutputError(f"{path}: OpenCV cannot write such a picture; use .png")
    with os_errors_as(OutputError, f"{path}: cannot be written"):
        replace(path, data.tobytes(), mode)


def _open_video(path: Path, fps: float, size: tuple[int, int]) -> cv2.VideoWriter:
    codec = cv2.VideoWriter.fourcc(*_CODECS[path.suffix.lower()])
    video = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, fps, size)
    if not video.isOpened():
        raise OutputError(f"{path}: this OpenCV cannot write such a video; use another of {', '.join(_CODECS)} or .png")
    return video
