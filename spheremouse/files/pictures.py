"""Decode images and films only after their header shows that they fit into memory.

A header of a few bytes can declare any image size, and decoders allocate it. For example, 3 MB of PNG become 6 GB. Each
function but `open_film` raises an OSError before it allocates that memory. The error's `strerror` has problem and
remedy in one line.
"""

import errno
import io
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import reason_of
from spheremouse.geometry.camera import MAX_PIXELS

if TYPE_CHECKING:
    from PIL.Image import Image

Size = tuple[int, int]  # px, width and height

FRAME_PIXELS = 8192 * 4320  # 8K of the cinema; webcams have at most 4K
PHOTO_PIXELS = MAX_PIXELS  # those of phones have 50 or 64 megapixels, of webcams 16; decoded and searched in 0.8 GB
MAX_BYTES = 2**28  # of a file: 64 megapixels without compression
FORMATS = ("JPEG", "PNG", "TIFF", "BMP")
_TILE_WIDTH, _TILE_LENGTH = 322, 323  # TIFF 6.0, section 15


class Header(NamedTuple):
    """Size and orientation of an image, from its header."""

    size: Size
    orientation: int  # of EXIF, 1 to 8; 1 is upright


def decode(data: bytes, *, upright: bool = False) -> NDArray[np.uint8]:
    """Decode an image, (h, w, 3) BGR, as stored or `upright`, after `read_header`. OSError: it cannot be decoded."""
    turned = 0 if upright else cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | turned)
    except cv2.error:
        image = None
    if image is None:
        raise OSError(errno.EINVAL, "cannot be decoded; save it again as JPEG or PNG, or leave it out")
    return np.asarray(image, np.uint8)


def read_header(data: bytes, pixels: int, *, to_the_end: bool = False) -> Header:
    """Return size and orientation; OSError if this is no image of the `FORMATS`, or has more than `pixels`.

    `to_the_end` decodes the image once, coarsely if the format allows, to check that all of it is there. OpenCV decodes
    half an image without an error.
    """
    from PIL import ExifTags, Image, UnidentifiedImageError  # cameras and films do not need it

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about large images and invalid tags
        Image.init()  # some formats are unknown before
        try:
            with Image.open(io.BytesIO(data), formats=FORMATS) as picture:
                _check_size(picture, pixels)
                if picture.format == "PNG":
                    _check_chunks(data)
                size, orientation = picture.size, picture.getexif().get(ExifTags.Base.Orientation, 1)
                if to_the_end:
                    picture.draft("L", (1, 1))
                    picture.load()
        except UnidentifiedImageError:
            raise OSError(errno.EINVAL, "not a picture that can be read; name JPEG, PNG, TIFF or BMP files") from None
        except Image.DecompressionBombError:
            raise _too_large("more than 180 megapixels", pixels) from None
        except (MemoryError, _RefusedError):
            raise
        except Exception as e:  # decoders raise many errors on damaged files
            problem = f"damaged ({reason_of(e)[:80]}); copy it from the camera again, or leave it out"
            raise OSError(errno.EINVAL, problem) from None
    return Header(size, orientation if orientation in range(1, 9) else 1)


def px(size: Size) -> str:
    return f"{size[0]}x{size[1]}"


class _RefusedError(OSError):
    pass


def _check_size(picture: "Image", pixels: int) -> None:
    width, height = picture.size
    if width * height > pixels:
        raise _too_large(px(picture.size), pixels)
    tags = getattr(picture, "tag_v2", None)  # the tiles of a TIFF may be larger than the image, and are decoded whole
    if tags is not None:
        tile = tags.get(_TILE_WIDTH, 0), tags.get(_TILE_LENGTH, 0)
        if tile[0] * tile[1] > pixels:
            raise _too_large(f"stored in tiles of {px(tile)}", pixels)


def _check_chunks(data: bytes) -> None:
    """Raise OSError if a part of a PNG claims to be longer than the file; OpenCV would take that much memory."""
    at, kind = 8, b""
    while at + 8 <= len(data) and kind != b"IEND":  # length, kind, content, check sum: PNG specification, section 5.3
        kind = data[at + 4 : at + 8]
        at += 12 + int.from_bytes(data[at : at + 4])
    if at > len(data):
        raise _RefusedError(errno.EINVAL, "cut short or damaged; copy it from the camera again, or leave it out")


def _too_large(name: str, pixels: int) -> OSError:
    return _RefusedError(errno.EFBIG, f"is {name}; scale it to at most {pixels // 1_000_000} megapixels")


def open_capture(source: str | int, backend: int = cv2.CAP_ANY) -> cv2.VideoCapture | None:
    """Open a capture, or return None. OpenCV and FFmpeg print nothing."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; FFmpeg reads it at its first use
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(0)
    try:
        capture = cv2.VideoCapture(source, backend)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if capture.isOpened():
        return capture
    capture.release()
    return None


def open_film(path: Path) -> cv2.VideoCapture | None:
    """Open a film by FFmpeg, to be released by the caller; None if FFmpeg cannot read the file.

    An image is a film of one frame. Raises OSError, without the file's name, if frames are too large. FFmpeg decodes
    the first frames while it opens the file, so up to 268 megapixels are allocated before.
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
    return int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))


def film_images(capture: cv2.VideoCapture) -> Iterator[NDArray[np.uint8]]:
    """Yield the readable frames, (h, w, 3) blue, green, red, then close the film."""
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
