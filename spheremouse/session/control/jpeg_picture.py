"""Live pictures as JPEG: whole, or with all but ball and targets black."""

import math
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from spheremouse.session.control.protocol import LivePicture

_QUALITY = 80  # discs of 5 px stay sharp
_AROUND_TARGET = 2.0  # radii of a target that a masked picture shows


Image = NDArray[np.uint8]
_Square = tuple[int, int, int, int]  # left, top, right, bottom, px


def encode_jpeg(image: Image) -> bytes:
    """Return a JPEG of grey values (h, w, 1), or BGR (h, w, 3)."""
    colours = "GRAY" if image.shape[2] == 1 else "BGR"
    return simplejpeg.encode_jpeg(
        np.ascontiguousarray(image), quality=_QUALITY, colorspace=colours, colorsubsampling="420", fastdct=True
    )


class JpegPicture:
    """A picture of the daemon as JPEG, which is made at the first request."""

    def __init__(self, picture: LivePicture) -> None:
        self.picture = picture

    @cached_property
    def whole(self) -> bytes:
        """JPEG of the whole picture. One of the camera is passed on as it is."""
        picture = self.picture
        if picture.format == "jpeg":
            return picture.pixels
        if picture.format in ("yuyv", "nv12"):
            return simplejpeg.encode_jpeg_yuv_planes(*_planes(picture), quality=_QUALITY, fastdct=True)
        return encode_jpeg(_pixels(picture))

    @cached_property
    def masked(self) -> bytes:
        """JPEG of ball and targets alone; all else is black. Empty if the camera's picture is damaged."""
        try:
            return encode_jpeg(mask(_pixels(self.picture), self.picture.annotations))
        except ValueError:
            return b""


def mask(image: Image, annotations: dict[str, Any]) -> Image:
    """Return an image, (h, w, c), that is black but for the ball and the targets: the given one, if it is writable."""
    height, width, channels = image.shape
    outline = tuple((round(x), round(y)) for x, y in annotations.get("outline") or ())
    squares = tuple(map(_square, annotations.get("targets") or ()))
    seen = _visibility_mask(outline, squares, height, width, channels)
    black = image if image.flags.writeable else np.empty_like(image)
    np.multiply(image.reshape(height, -1), seen, out=black.reshape(height, -1))
    return black


@lru_cache(maxsize=1)  # outline and targets change with the camera's pose alone
def _visibility_mask(
    outline: tuple[tuple[int, int], ...], squares: tuple[_Square, ...], height: int, width: int, channels: int
) -> Image:
    """Return 1 for the values of an image inside the outline or a square, else 0, (height, width * channels)."""
    from PIL import Image as Canvas  # Pillow takes 8 MB, and only masked pictures need it
    from PIL import ImageDraw

    seen = Canvas.new("L", (width, height))
    pen = ImageDraw.Draw(seen)
    if len(outline) > 2:
        pen.polygon(outline, fill=1)
    for square in squares:
        pen.rectangle(square, fill=1)
    return np.repeat(np.asarray(seen), channels, axis=1)


def _square(target: dict[str, Any]) -> _Square:
    """Return left, top, right and bottom of the square around a target."""
    xx, xy, yy = target["shape"]  # of an ellipse, px²
    # The larger eigenvalue is the square of the semi-major axis.
    radius = _AROUND_TARGET * math.sqrt(max(0.0, 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)))
    x, y = target["x"], target["y"]
    return round(x - radius), round(y - radius), round(x + radius), round(y + radius)


def _planes(picture: LivePicture) -> tuple[Image, Image, Image]:
    """Return the planes Y, U, V of a raw picture."""
    data, height, width = np.frombuffer(picture.pixels, np.uint8), picture.height, picture.width
    if picture.format == "yuyv":
        rows = data.reshape(height, 2 * width)
        y, u, v = rows[:, 0::2], rows[:, 1::4], rows[:, 3::4]
    else:
        y, uv = data[: height * width].reshape(height, width), data[height * width :].reshape(height // 2, width)
        u, v = uv[:, 0::2], uv[:, 1::2]
    return np.ascontiguousarray(y), np.ascontiguousarray(u), np.ascontiguousarray(v)


def _pixels(picture: LivePicture) -> Image:
    """Return grey values (h, w, 1), or BGR (h, w, 3)."""
    if picture.format == "jpeg":
        return simplejpeg.decode_jpeg(picture.pixels, colorspace="BGR")
    if picture.format in ("yuyv", "nv12"):
        return _planes(picture)[0][:, :, None]
    return np.frombuffer(picture.pixels, np.uint8).reshape(picture.height, picture.width, -1)
