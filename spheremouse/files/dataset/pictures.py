"""Write images of one size into a dataset folder, without loss.

They go into a video if OpenCV reproduces noise bit for bit, else into PNG files. A grey video takes a third of the time
and space of a colour video; a colour image among grey ones becomes a PNG file with its number.
"""

from pathlib import Path

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.errors import DatasetError, os_errors_as
from spheremouse.files.dataset.frames import picture_file
from spheremouse.files.pictures import film_images, open_film

SMALL = ("FFV1", "HFYU")  # codecs in the order they are tried: half the size
FAST = ("HFYU", "FFV1")  # or a sixth of the time
GREY = ("FFV1",)  # OpenCV reads back other grey values from the other codecs


def lossless_codec(folder: Path, size: tuple[int, int], codecs: tuple[str, ...], colour: bool) -> str | None:
    """Return the first codec with which OpenCV reproduces noise of (width, height) bit for bit, or None."""
    shape = (2, size[1], size[0], 3) if colour else (2, size[1], size[0])
    images = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    expected = images if colour else np.repeat(images[..., None], 3, axis=3)
    path = folder / "trial.mkv"
    for codec in codecs:
        video = _open(path, codec, 30.0, size, colour)
        if video.isOpened():
            for image in images:
                video.write(image)
            video.release()
            capture = open_film(path)
            back = [] if capture is None else list(film_images(capture))
            path.unlink(missing_ok=True)
            if len(back) == len(images) and all(np.array_equal(a, b) for a, b in zip(expected, back, strict=True)):
                return codec
    return None


class PictureWriter:
    """Writes images, (h, w, 3) BGR or (h, w) grey, into a folder. All are in colour unless `mixed`."""

    def __init__(
        self, folder: Path, size: tuple[int, int], fps: float, codecs: tuple[str, ...] = SMALL, *, mixed: bool = False
    ) -> None:
        """`size`: width and height, px; `fps`: of the video in a player. Takes some tenths of a second."""
        self.written = 0
        self._in_files = 0  # bytes
        self._folder, self._size, self._fps = folder, size, fps
        self._codec = lossless_codec(folder, size, codecs, True)
        self._grey_codec = lossless_codec(folder, size, GREY, False) if mixed else None
        self._video: cv2.VideoWriter | None = None
        self._colour = True  # True if the video has colour
        self._mixed = mixed
        self._first: Image | None = None  # the second one shows if all frames are grey

    def add(self, image: Image) -> None:
        """Add an image; DatasetError if it cannot be written and OpenCV reports that at once."""
        assert image.shape[:2] == (self._size[1], self._size[0])
        if self.written == 0 and self._mixed:
            self._first = image.copy()
        else:
            if self.written == 0 or self._first is not None:
                self._begin(image)
            self._write(self.written, image)
        self.written += 1

    def size(self) -> int:
        """Bytes on the disk so far."""
        video = self._folder / "video.mkv"
        return self._in_files + (0 if self._video is None or not video.exists() else video.stat().st_size)

    def close(self) -> None:
        """End the video. DatasetError if its size differs from that written; OpenCV's writer reports no errors."""
        if self._first is not None:
            self._begin(self._first)
        if self._video is None:
            return
        self._video.release()
        self._video = None
        video = cv2.VideoCapture(str(self._folder / "video.mkv"), cv2.CAP_FFMPEG)
        count = round(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0
        video.release()
        if count != self.written:
            raise DatasetError(f"{self._folder}: the video could not be written; is the disk full?")

    def release(self) -> None:
        """Close the files of a discarded recording."""
        if self._video is not None:
            self._video.release()
            self._video = None

    def _begin(self, image: Image) -> None:
        """Begin the video, grey if one of the first two images is; the second one is `image`."""
        first, self._first = self._first, None
        self._colour = image.ndim == 3 and (first is None or first.ndim == 3)
        codec = self._codec if self._colour else self._grey_codec
        if codec is not None:
            self._video = _open(self._folder / "video.mkv", codec, self._fps, self._size, self._colour)
            if not self._video.isOpened():
                raise DatasetError(f"{self._folder}: the video cannot be written; is the disk full?")
        if first is not None:
            self._write(0, first)

    def _write(self, index: int, image: Image) -> None:
        if self._video is None or (image.ndim == 3 and not self._colour):
            self._write_file(index, image)
        if self._video is None:
            return
        if image.ndim == 2 and self._colour:
            image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        elif image.ndim == 3 and not self._colour:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        self._video.write(image)

    def _write_file(self, index: int, image: Image) -> None:
        path = picture_file(self._folder, index)
        with os_errors_as(DatasetError, f"{path}: cannot be written"):
            path.parent.mkdir(exist_ok=True)
            self._in_files += path.write_bytes(
                cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes()
            )


def _open(path: Path, codec: str, fps: float, size: tuple[int, int], colour: bool) -> cv2.VideoWriter:
    return cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, size, colour)
