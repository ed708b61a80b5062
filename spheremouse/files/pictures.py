"""Pictures of files: what their header says first, and the pixels only where they are as many as they may be.

A few bytes can say that they are a picture of any size, and decoders believe them: 3 MB of PNG become 6 GB. OSError,
whose `strerror` says in one line what is wrong and what to do, comes before memory is taken for that.
"""

import errno
import io
import warnings
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

from spheremouse.geometry.camera import MAX_PIXELS

Size = tuple[int, int]  # px, width and height

FRAME_PIXELS = 8192 * 4320  # 8K of the cinema; webcams have at most 4K
PHOTO_PIXELS = MAX_PIXELS  # those of phones have 50 or 64 megapixels, of webcams 16; decoded and searched in 0.8 GB
MOST_BYTES = 2**28  # of a file: 64 megapixels without compression
FORMATS = ("JPEG", "PNG", "TIFF", "BMP")
_TILE_WIDTH, _TILE_LENGTH = 322, 323  # TIFF 6.0, section 15


class Header(NamedTuple):
    """Size and orientation of a picture, from what stands before the pixels."""

    size: Size
    orientation: int  # of EXIF, 1 to 8; 1 is upright


def decoded(data: bytes, *, upright: bool = False) -> NDArray[np.uint8]:
    """The pixels as stored, or `upright`, (h, w, 3) blue, green, red, of a file whose header has been looked at."""
    turned = 0 if upright else cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | turned)
    except cv2.error:
        image = None
    if image is None:
        raise OSError(errno.EINVAL, "cannot be decoded; save it anew as JPEG or PNG, or leave it out")
    return np.asarray(image, np.uint8)


def read_header(data: bytes, pixels: int, *, to_the_end: bool = False) -> Header:
    """Size and orientation; OSError where this is no picture of those `FORMATS`, or has more than so many `pixels`.

    `to_the_end` decodes once, coarsely where the format allows, to see that all of it is there: OpenCV would decode
    half a picture without a word.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of large pictures and untidy tags
        Image.init()  # else some formats are unknown until others have failed
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
        except Exception as e:  # damaged files bring all sorts of errors out of decoders
            what = " ".join(str(e).split())[:80] or type(e).__name__
            raise OSError(errno.EINVAL, f"damaged ({what}); copy it from the camera again, or leave it out") from None
    return Header(size, orientation if orientation in range(1, 9) else 1)


def px(size: Size) -> str:
    """640x480."""
    return f"{size[0]}x{size[1]}"


class _RefusedError(OSError):
    pass


def _check_size(picture: Image.Image, pixels: int) -> None:
    width, height = picture.size
    if width * height > pixels:
        raise _too_large(px(picture.size), pixels)
    tags = getattr(picture, "tag_v2", None)  # a TIFF's tiles may be larger than it, and are decoded whole
    if tags is not None:
        tile = tags.get(_TILE_WIDTH, 0), tags.get(_TILE_LENGTH, 0)
        if tile[0] * tile[1] > pixels:
            raise _too_large(f"stored in tiles of {px(tile)}", pixels)


def _check_chunks(data: bytes) -> None:
    """No part of a PNG may say that it is longer than the file: OpenCV takes as much memory as it says."""
    at, kind = 8, b""
    while at + 8 <= len(data) and kind != b"IEND":  # length, kind, content, check sum: PNG specification, section 5.3
        kind = data[at + 4 : at + 8]
        at += 12 + int.from_bytes(data[at : at + 4])
    if at > len(data):
        raise _RefusedError(errno.EINVAL, "cut short or damaged; copy it from the camera again, or leave it out")


def _too_large(what: str, pixels: int) -> OSError:
    return _RefusedError(errno.EFBIG, f"is {what}; scale it to at most {pixels // 1_000_000} megapixels")
