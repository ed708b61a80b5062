"""Live pictures as JPEG: whole, or with all but ball and targets black."""

import math
from functools import cached_property
from typing import Any

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from spheremouse.files.jpeg import QUALITY, Image, encoded
from spheremouse.session.control.pictures import LivePicture

_AROUND_TARGET = 2.0  # radii of a target that a masked picture shows


class JpegPicture:
    """A picture of the daemon as JPEG, which is made at the first request."""

    def __init__(self, picture: LivePicture) -> None:
        self.picture = picture

    @cached_property
    def whole(self) -> bytes:
        """JPEG of the whole picture. One of the camera is passed on as it is."""
        picture = self.picture
        if picture.format == "jpeg":
            return bytes(picture.pixels)
        if picture.format in ("yuyv", "nv12"):
            return simplejpeg.encode_jpeg_yuv_planes(*_planes(picture), quality=QUALITY, fastdct=True)
        return encoded(_pixels(picture))

    @cached_property
    def masked(self) -> bytes:
        """JPEG of ball and targets alone; all else is black. Empty if the camera's picture is damaged."""
        try:
            return encoded(mask(_pixels(self.picture), self.picture.annotations or {}))
        except ValueError:
            return b""


def mask(image: Image, annotations: dict[str, Any]) -> Image:
    """Return an image, (h, w, c), that is black but for the ball and the targets."""
    seen = np.zeros_like(image)
    height, width = image.shape[:2]
    outline = np.array(annotations.get("outline") or [], dtype=float).reshape(-1, 2)
    if len(outline) > 2:
        for row, (left, right) in enumerate(zip(*spans(outline, height), strict=True)):
            if left <= right:  # rows are faster than a Boolean array, which takes memory
                part = slice(max(0, math.ceil(left)), max(0, math.floor(min(right, width)) + 1))
                seen[row, part] = image[row, part]
    for target in annotations.get("targets") or []:
        radius = _AROUND_TARGET * _radius(target["shape"])
        x, y = target["x"], target["y"]
        rows = slice(max(0, round(y - radius)), max(0, round(y + radius) + 1))
        columns = slice(max(0, round(x - radius)), max(0, round(x + radius) + 1))
        seen[rows, columns] = image[rows, columns]
    return seen


def spans(outline: NDArray[np.float64], height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the largest x, px, of a convex outline, (n, 2) px, in each row; +inf and -inf if none."""
    left, right = np.full(height, np.inf), np.full(height, -np.inf)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        low, high = sorted((y0, y1))
        rows = np.arange(max(0, int(np.ceil(low))), min(height - 1, int(np.floor(high))) + 1)
        x = x0 + (x1 - x0) * (rows - y0) / (y1 - y0) if y1 != y0 else np.full(len(rows), min(x0, x1))
        left[rows] = np.minimum(left[rows], x)
        right[rows] = np.maximum(right[rows], x if y1 != y0 else max(x0, x1))
    return left, right


def _radius(shape: list[float]) -> float:
    """Return the semi-major axis, px, of an ellipse [xx, xy, yy] px²."""
    xx, xy, yy = shape
    return float(np.sqrt(np.linalg.eigvalsh([[xx, xy], [xy, yy]])[-1].clip(0.0)))


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
