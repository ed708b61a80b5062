"""Films of files, by FFmpeg: how large a frame is before one is decoded for good.

FFmpeg looks at the first frames when it opens a film, so that its size is theirs and not what the container claims.
"""

import errno
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.files.pictures import FRAME_PIXELS, Size, px


def open_capture(what: str | int, backend: int = cv2.CAP_ANY) -> cv2.VideoCapture | None:
    """A capture that is open, or None; without the lines that OpenCV and FFmpeg write to the terminal otherwise."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; read when FFmpeg is first used
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(0)
    try:
        capture = cv2.VideoCapture(what, backend)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if capture.isOpened():
        return capture
    capture.release()
    return None


def open_film(path: Path) -> cv2.VideoCapture | None:
    """A film whose frames may be decoded, or None where it is none; OSError where they are too large.

    By FFmpeg alone: others would take a picture for a film, and decode it in order to say so.
    """
    capture = open_capture(str(path), cv2.CAP_FFMPEG)
    if capture is None:
        return None
    width, height = size = film_size(capture)
    if width * height <= FRAME_PIXELS:
        return capture
    capture.release()
    most = FRAME_PIXELS // 1_000_000
    raise OSError(errno.EFBIG, f"frames of {px(size)}; scale the film to at most {most} megapixels (8K)")


def film_size(capture: cv2.VideoCapture) -> Size:
    """Of its frames, px."""
    return int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))


def film_images(capture: cv2.VideoCapture) -> Iterator[NDArray[np.uint8]]:
    """The frames as far as they can be read, (h, w, 3) blue, green, red; the film is closed after them."""
    try:
        while True:
            good, image = capture.read()
            if not good or image is None:
                return
            yield np.asarray(image, dtype=np.uint8)
    except cv2.error:
        return
    finally:
        capture.release()
