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

# codecs in the order they are tried
SMALL_CODECS = ("FFV1", "HFYU")  # half the size
FAST_CODECS = ("HFYU", "FFV1")  # a sixth of the time
_GREY_CODECS = ("FFV1",)  # OpenCV reads back other grey values from HFYU


def _lossless_codec(folder: Path, size: tuple[int, int], codecs: tuple[str, ...], *, colour: bool) -> str | None:
    """Return the first codec that keeps a video of noise bit for bit, by trial files in `folder`; None without one."""
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
            read_back = [] if capture is None else list(film_images(capture))
            path.unlink(missing_ok=True)
            if len(read_back) == len(images) and all(
                np.array_equal(a, b) for a, b in zip(expected, read_back, strict=True)
            ):
                return codec
    return None


class PictureWriter:
    """Writes images, (h, w, 3) BGR or (h, w) grey, into a folder.

    A `mixed` film has grey images and some in colour. It becomes a grey video if one of its first two images is grey,
    with a PNG file for each image in colour. So the first image waits for the second one.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        fps: float,
        codecs: tuple[str, ...] = SMALL_CODECS,
        *,
        mixed: bool = False,
    ) -> None:
        """Try the codecs, which takes some tenths of a second. A video without a lossless codec becomes PNG files.

        `folder` must exist. `size` is (width, height) px, and `fps` the rate at which a player shows the video.
        `codecs` are FourCCs of colour videos in order of preference; grey videos have their own. Without `mixed`, grey
        images are written as colour.
        """
        self.written = 0  # images, with the one that waits
        self._png_bytes = 0
        self._folder, self._size, self._fps = folder, size, fps
        self._codec = _lossless_codec(folder, size, codecs, colour=True)
        self._grey_codec = _lossless_codec(folder, size, _GREY_CODECS, colour=False) if mixed else None
        self._video: cv2.VideoWriter | None = None
        self._colour = True  # False: the video is grey
        self._mixed = mixed
        self._waiting: Image | None = None  # first image of a mixed film, until the second shows whether it is grey

    def add(self, image: Image) -> None:
        """Add an image of the writer's size. DatasetError: OpenCV refuses it at once; `close` detects a full disk."""
        assert image.shape[:2] == (self._size[1], self._size[0])
        if self.written == 0 and self._mixed:
            self._waiting = image.copy()
        else:
            if self.written == 0 or self._waiting is not None:
                self._begin(image)
            self._write(self.written, image)
        self.written += 1

    def size(self) -> int:
        """Bytes on the disk so far."""
        video = self._folder / "video.mkv"
        return self._png_bytes + (0 if self._video is None or not video.exists() else video.stat().st_size)

    def close(self) -> None:
        """End the video. DatasetError if its size differs from that written; OpenCV's writer reports no errors."""
        if self._waiting is not None:  # the film has one image
            self._begin(self._waiting)
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
        """Open the video, and write the image that waits. The caller writes `image`, the next one."""
        first, self._waiting = self._waiting, None
        self._colour = image.ndim == 3 and (first is None or first.ndim == 3)
        codec = self._codec if self._colour else self._grey_codec
        if codec is not None:
            self._video = _open(self._folder / "video.mkv", codec, self._fps, self._size, self._colour)
            if not self._video.isOpened():
                raise DatasetError(f"{self._folder}: the video cannot be written; is the disk full?")
        if first is not None:
            self._write(0, first)

    def _write(self, index: int, image: Image) -> None:
        """Write an image to the video in its colours. Without a video, or if colour would be lost, write a file."""
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
            self._png_bytes += path.write_bytes(
                cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes()
            )


def _open(path: Path, codec: str, fps: float, size: tuple[int, int], colour: bool) -> cv2.VideoWriter:
    return cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, size, colour)
