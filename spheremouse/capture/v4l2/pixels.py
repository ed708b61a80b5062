"""A frame's bytes as the driver gives them, into luma or BGR: no device here, and nothing trusted that came from one.

YUYV, NV12 and GREY hold the luma as it is wanted: a view, nothing is copied. MJPG is decoded by libjpeg-turbo, of the
luma only where that is enough. It is asked to say so where data is missing; what it then makes up is no measurement.
Luma of YUYV and NV12 is as coded, usually from 16 (black) to 235 (white), ITU-R BT.601; of MJPG and GREY from 0 to 255.
"""

import re
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from spheremouse.capture.settings import PixelName
from spheremouse.errors import DamagedFrameError

Image = NDArray[np.uint8]

FORMATS: tuple[PixelName, ...] = ("YUYV", "NV12", "MJPG", "GREY")  # the best first: what costs least, and has colour

_JPEG = b"\xff\xd8\xff"
_STRAY = 64  # bytes before a marker that nobody needs: many cameras send some; more are what damage leaves over
_REFUSED = (
    ValueError,
    KeyError,
    RuntimeError,
    MemoryError,
)  # what simplejpeg raises; KeyError where a header ends early


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a frame in its buffer, as negotiated with the driver."""

    format: PixelName
    width: int  # px
    height: int  # px
    stride: int  # bytes from one row (of luma) to the next; of no meaning for MJPG

    @property
    def size(self) -> int:
        """Bytes that a whole frame has at least; 0 where that varies. The last row need not be padded."""
        if self.format == "MJPG":
            return 0
        if self.format == "NV12":
            return self.stride * (self.height + (self.height + 1) // 2 - 1) + self.width
        return self.stride * (self.height - 1) + self.width * (2 if self.format == "YUYV" else 1)


def luma(payload: Image, layout: Layout) -> Image:
    """Luma, (h, w), of the bytes (n,): a view of them, but for MJPG. DamagedFrameError if that is no whole picture."""
    if layout.format == "MJPG":
        return _decoded(payload, layout, "GRAY")[:, :, 0]
    _check_size(payload, layout)
    step = 2 if layout.format == "YUYV" else 1
    return np.ndarray((layout.height, layout.width), np.uint8, payload, 0, (layout.stride, step))


def bgr(payload: Image, layout: Layout) -> Image:
    """Colours, (h, w, 3) BGR, of the bytes (n,): always a copy. GREY has none: three times the same."""
    if layout.format == "MJPG":
        return _decoded(payload, layout, "BGR")
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


def _check_size(payload: Image, layout: Layout) -> None:
    if len(payload) < layout.size:
        raise DamagedFrameError(f"frame of {len(payload)} bytes; {layout.size} are a whole one")


def _decoded(payload: Image, layout: Layout, space: str) -> Image:
    """A JPEG of the negotiated size, (h, w, 1 or 3); what follows its end in the buffer does not matter."""
    if payload[:3].tobytes() != _JPEG:
        raise DamagedFrameError(f"frame of {len(payload)} bytes that does not begin as a JPEG")
    try:
        height, width, *_ = simplejpeg.decode_jpeg_header(payload, strict=False)
    except _REFUSED:
        raise DamagedFrameError(f"no JPEG: the header of a frame of {len(payload)} bytes cannot be read") from None
    if (width, height) != (layout.width, layout.height):  # before memory is taken for what a broken header says
        raise DamagedFrameError(f"JPEG of {width}x{height}, not {layout.width}x{layout.height}")
    try:
        return simplejpeg.decode_jpeg(payload, colorspace=space, strict=True)
    except _REFUSED as e:
        stray = re.search(r"(\d+) extraneous bytes before marker", str(e))
        if stray is None or int(stray[1]) > _STRAY:
            raise DamagedFrameError(f"damaged JPEG: {_said(e)}") from None
    try:
        return simplejpeg.decode_jpeg(payload, colorspace=space, strict=False)
    except _REFUSED as e:
        raise DamagedFrameError(f"damaged JPEG: {_said(e)}") from None


def _said(error: Exception) -> str:
    """Message of the decoder, in one line."""
    return " ".join(str(error).split()).removeprefix("Corrupt JPEG data: ") or type(error).__name__
