"""Decode a driver's buffer to luma or BGR, without a device. Damaged data raises an error.

YUYV, NV12 and GREY contain the luma, so it is a view of the buffer. libjpeg-turbo decodes MJPG, only the luma if no
colour is needed. It reports missing data, which it would fill by invented pixels. Luma of YUYV and NV12 is usually from
16 (black) to 235 (white), ITU-R BT.601. Luma of MJPG and GREY is from 0 to 255.
"""

import re
from dataclasses import dataclass
from typing import Literal, cast

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from spheremouse.capture import Payload
from spheremouse.capture.settings import PixelName
from spheremouse.errors import DamagedFrameError

Image = NDArray[np.uint8]

FORMATS: tuple[PixelName, ...] = ("YUYV", "NV12", "MJPG", "GREY")  # best first: cheap to decode, and with colour

_JPEG = b"\xff\xd8\xff"
_MAX_STRAY_BYTES = 64  # before a marker; many cameras send some, and damage leaves more
_DECODER_ERRORS = (ValueError, KeyError, RuntimeError, MemoryError)  # KeyError: the header ends early


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a frame in its buffer, as negotiated with the driver."""

    format: PixelName
    width: int  # px
    height: int  # px
    stride: int  # bytes from one row (of luma) to the next; unused for MJPG

    @property
    def size(self) -> int:
        """Least number of bytes of a complete frame; 0 for MJPG. The last row may lack its padding."""
        if self.format == "MJPG":
            return 0
        if self.format == "NV12":
            return self.stride * (self.height + (self.height + 1) // 2 - 1) + self.width
        return self.stride * (self.height - 1) + self.width * (2 if self.format == "YUYV" else 1)


def luma(payload: Image, layout: Layout) -> Image:
    """Return luma (h, w) of the bytes (n,), a view except for MJPG. Raises DamagedFrameError if it is incomplete."""
    if layout.format == "MJPG":
        return _decode(payload, layout, "GRAY")[:, :, 0]
    _check_size(payload, layout)
    step = 2 if layout.format == "YUYV" else 1
    return np.ndarray((layout.height, layout.width), np.uint8, payload, 0, (layout.stride, step))


def bgr(payload: Image, layout: Layout) -> Image:
    """Return a BGR copy (h, w, 3) of the bytes (n,). GREY gives three equal channels."""
    if layout.format == "MJPG":
        return _decode(payload, layout, "BGR")
    _check_size(payload, layout)
    h, w, stride = layout.height, layout.width, layout.stride
    if layout.format == "YUYV":
        pairs = np.ndarray((h, w, 2), np.uint8, payload, 0, (stride, 2, 1))
        image = cv2.cvtColor(pairs, cv2.COLOR_YUV2BGR_YUYV)
    elif layout.format == "NV12":
        chroma = np.ndarray((h // 2, w // 2, 2), np.uint8, payload, stride * h, (stride, 2, 1))
        image = cv2.cvtColorTwoPlane(luma(payload, layout), chroma, cv2.COLOR_YUV2BGR_NV12)
    else:
        image = cv2.cvtColor(luma(payload, layout), cv2.COLOR_GRAY2BGR)
    return cast(Image, image)


def payload_of(payload: Image, layout: Layout) -> Payload:
    """Return the image of the bytes (n,), a view if its rows have no padding; DamagedFrameError if incomplete."""
    _check_size(payload, layout)
    if not len(payload):
        raise DamagedFrameError("frame of 0 bytes")
    w, h = layout.width, layout.height
    if layout.format == "MJPG":
        return Payload("jpeg", w, h, payload.data)
    packed: dict[PixelName, tuple[Literal["yuyv", "nv12", "grey"], int, int]] = {  # bytes of a row, rows
        "YUYV": ("yuyv", 2 * w, h),
        "NV12": ("nv12", w, h + (h + 1) // 2),
        "GREY": ("grey", w, h),
    }
    name, row, rows = packed[layout.format]
    image = np.ndarray((rows, row), np.uint8, payload, 0, (layout.stride, 1))
    return Payload(name, w, h, image.reshape(-1).data)


def _check_size(payload: Image, layout: Layout) -> None:
    if len(payload) < layout.size:
        raise DamagedFrameError(f"frame of {len(payload)} bytes; {layout.size} are a whole one")


def _decode(payload: Image, layout: Layout, space: str) -> Image:
    """Decode a JPEG of the negotiated size to (h, w, 1 or 3). Bytes after its end are ignored."""
    if payload[:3].tobytes() != _JPEG:
        raise DamagedFrameError(f"frame of {len(payload)} bytes that does not begin as a JPEG")
    try:
        height, width, *_ = simplejpeg.decode_jpeg_header(payload, strict=False)
    except _DECODER_ERRORS:
        raise DamagedFrameError(f"no JPEG: the header of a frame of {len(payload)} bytes cannot be read") from None
    if (width, height) != (layout.width, layout.height):  # before memory is allocated by a damaged header
        raise DamagedFrameError(f"JPEG of {width}x{height}, not {layout.width}x{layout.height}")
    try:
        return simplejpeg.decode_jpeg(payload, colorspace=space, strict=True)
    except _DECODER_ERRORS as e:
        stray = re.search(r"(\d+) extraneous bytes before marker", str(e))
        if stray is None or int(stray[1]) > _MAX_STRAY_BYTES:
            raise DamagedFrameError(f"damaged JPEG: {_message(e)}") from None
    try:
        return simplejpeg.decode_jpeg(payload, colorspace=space, strict=False)
    except _DECODER_ERRORS as e:
        raise DamagedFrameError(f"damaged JPEG: {_message(e)}") from None


def _message(error: Exception) -> str:
    return " ".join(str(error).split()).removeprefix("Corrupt JPEG data: ") or type(error).__name__
