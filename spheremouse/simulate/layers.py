"""Parts of a picture: the window that an object may touch, layers that are painted over it, and a drawn hand."""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, project
from spheremouse.geometry.rotation import Array

_PER_METRE = 500  # pixels of the hand's drawing
_HALF_WIDTH, _ABOVE, _BELOW = 0.12, 0.18, 0.75  # m, extent of the drawing around the palm
_SKIN = np.array([112.0, 148.0, 205.0])  # grey values blue, green, red
_SLEEVE = np.array([112.0, 70.0, 48.0])
_MIN_HAND_DISTANCE_M = 0.1


class Window(NamedTuple):
    """A rectangle of a picture, px: its first column and row, and one past its last."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def empty(self) -> bool:
        """True for a window without pixels."""
        return self.left == self.right or self.top == self.bottom

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def pixels(self) -> Array:
        """Return u and v of each pixel, (h, w, 2)."""
        v, u = np.mgrid[self.slices]
        return np.stack([u, v], axis=-1).astype(float)


def window(points: Array, margin: int, camera: InteriorOrientation) -> Window:
    """Return the pixels up to `margin` px around points, (n, 2) px; empty without points, or if one is not finite."""
    if len(points) == 0 or not np.all(np.isfinite(points)):
        return Window(0, 0, 0, 0)
    ends = np.array([np.floor(points.min(axis=0)) - margin, np.ceil(points.max(axis=0)) + margin + 1])
    return Window(*np.clip(ends, 0, (camera.width, camera.height)).astype(int).ravel().tolist())


class Layer(NamedTuple):
    """Something painted over a part of a picture."""

    window: Window
    paint: NDArray[np.float32]  # (h, w, 4) blue, green, red, times its cover; cover 0..1


def lay(picture: NDArray[np.float32], layer: Layer, corner: tuple[int, int] = (0, 0)) -> None:
    """Paint a layer over its part of a picture, (h, w, 3), or of that part of one which begins in a `corner`, u, v."""
    left, top, right, bottom = layer.window
    part = picture[top - corner[1] : bottom - corner[1], left - corner[0] : right - corner[0]]
    part *= 1.0 - layer.paint[..., 3:]
    part += layer.paint[..., :3]


@cache
def drawn_hand() -> NDArray[np.float32]:
    """A right hand with its forearm, seen from behind it, fingers up: a paint, (h, w, 4), in grey values."""
    y, x = np.mgrid[_ABOVE : -_BELOW : -1.0 / _PER_METRE, -_HALF_WIDTH : _HALF_WIDTH : 1.0 / _PER_METRE]
    parts = [  # from, to, radius at both, m; the origin is the middle of the palm
        (-0.016, -0.030, -0.016, 0.035, 0.031, 0.030), (0.016, -0.030, 0.016, 0.035, 0.031, 0.030),
        (-0.036, 0.055, -0.046, 0.118, 0.0105, 0.009), (-0.012, 0.060, -0.015, 0.140, 0.011, 0.0095),
        (0.012, 0.060, 0.015, 0.134, 0.011, 0.0095), (0.034, 0.050, 0.044, 0.105, 0.010, 0.008),
        (-0.036, -0.025, -0.082, 0.030, 0.016, 0.011), (0.0, -0.05, 0.0, -0.30, 0.030, 0.040),
        (0.0, -0.24, 0.0, -0.80, 0.050, 0.062),
    ]  # fmt: skip
    depth = np.full(x.shape, -np.inf)
    for x0, y0, x1, y1, r0, r1 in parts:
        dx, dy = x1 - x0, y1 - y0
        s = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        radius = r0 + s * (r1 - r0)
        depth = np.maximum(depth, radius - np.hypot(x - x0 - s * dx, y - y0 - s * dy))
    cover = np.clip(0.5 + depth * _PER_METRE, 0.0, 1.0)
    round_edge = 0.62 + 0.38 * np.sqrt(np.clip(depth / 0.02, 0.0, 1.0))
    sleeve = np.clip(0.5 + (-0.24 - y) * _PER_METRE, 0.0, 1.0)[..., None]
    colour = (_SKIN * (1.0 - sleeve) + _SLEEVE * sleeve) * round_edge[..., None]
    return np.concatenate([colour * cover[..., None], cover[..., None]], axis=2).astype(np.float32)


def hand_layer(drawing: NDArray[np.float32], palm: Array, axes: Array, camera: InteriorOrientation) -> Layer | None:
    """Return a `drawing` of a hand with its palm at (3,) m in `cam`, with `axes` (2, 3) to its right and up.

    None if it is out of sight, or if a part of it is nearer than 10 cm.
    """
    h, w = drawing.shape[:2]
    corners = np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float32)
    points = palm + (corners / _PER_METRE * (1.0, -1.0) + (-_HALF_WIDTH, _ABOVE)) @ axes
    uv = project(points, camera)[0]
    place = window(uv, 1, camera)
    if place.empty or np.any(points[:, 2] < _MIN_HAND_DISTANCE_M):
        return None
    left, top, right, bottom = place
    M = cv2.getAffineTransform(corners[:3], (uv[:3] - (left, top)).astype(np.float32))
    paint = cv2.warpAffine(drawing, M, (right - left, bottom - top))
    return Layer(place, np.asarray(paint, dtype=np.float32))
