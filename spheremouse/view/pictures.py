"""Live pictures for browsers: the lease of the daemon's memory, JPEG, and the mask for strangers."""

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from spheremouse.errors import ControlError
from spheremouse.files.jpeg import QUALITY, Image, encoded
from spheremouse.session.control.client import Client
from spheremouse.session.control.pictures import LivePicture, PictureReader

INTERVAL = 1 / 15  # s between two pictures
_RENEW = 1.0  # s between two renewals of the lease
_REST = 0.9 * INTERVAL  # s after a picture, in which no other is looked for
_POLL = 0.01  # s between two looks into the memory
_LINGER = 1.0  # s after the last request, in which the lease is kept
_RETRY = 0.5  # s after a failed lease
_AROUND_TARGET = 2.0  # radii of a target that a masked picture shows


class Shown:
    """A picture as browsers get it. The JPEG is made once for all of them."""

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


class Pictures:
    """The daemon's pictures, at most one each INTERVAL, read while browsers ask for them.

    All methods are called in the event loop.
    """

    def __init__(self, socket: Callable[[], Path | None]) -> None:
        """`socket` returns the path of the present daemon's."""
        self._socket = socket
        self._latest: Shown | None = None
        self._arrived = asyncio.Event()
        self._wanted_until = 0.0  # s, monotonic
        self._task: asyncio.Task[None] | None = None

    async def after(self, shown: Shown | None, timeout: float) -> Shown | None:
        """Return the first picture after `shown`; None if none comes within `timeout`, s."""
        self._wanted_until = time.monotonic() + _LINGER
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._read())
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while self._latest is None or self._latest is shown:
                    await self._arrived.wait()
                return self._latest
        return None

    async def _read(self) -> None:
        """Hold the lease and read the memory while browsers ask."""
        while time.monotonic() < self._wanted_until:
            try:
                await self._read_under_lease()
            except ControlError:  # the link to the daemon reports it
                await asyncio.sleep(_RETRY)
        self._latest = None

    async def _read_under_lease(self) -> None:
        reader: PictureReader | None = None
        number, renew_at, socket, self._latest = 0, 0.0, self._socket(), None
        with Client(socket) as client:
            while (now := time.monotonic()) < self._wanted_until and socket is self._socket():
                if reader is None or reader.replaced or now >= renew_at:
                    renewed = await asyncio.to_thread(client.pictures, INTERVAL)
                    number = number if renewed is reader else 0
                    reader, renew_at = renewed, now + _RENEW
                picture = reader.latest(number)
                if picture is not None:
                    number, self._latest = picture.number, Shown(picture)
                    self._arrived.set()
                    self._arrived = asyncio.Event()
                await asyncio.sleep(_POLL if picture is None else _REST)


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
