"""The renderer: shapes before a camera, and pictures of them by rays.

A pixel within one surface has one ray. A pixel where surfaces meet has many, and each of its surfaces takes the share
of the rays that hit it, in the light at the mean of the points hit.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, Pose, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.layers import Window
from spheremouse.simulate.shapes import Face, Ring, Shape

AT_ORIGIN = Pose(np.eye(3), np.zeros(3))  # of a camera that sees shapes in its own axes
PARTS = 256  # numbers of a shape's parts are below
_TILE_PX = 16  # px, side of bundles of rays
# Offsets of the rays in a pixel with an edge, (40, 2) px: a lattice, so that they are as many steps across a vertical
# or a horizontal edge. Of the lattices up to 40, step 17 has the smallest errors of shares over all directions of an
# edge: 0.017 RMS, 0.10 at most.
_LATTICE = (np.column_stack([np.arange(40), 17 * np.arange(40) % 40]) + 0.5) / 40.0 - 0.5

Surfaces = NDArray[np.int64]  # (shape's index + 1) * PARTS + part, 0 for none
Shade = Callable[[Surfaces, Array], NDArray[np.floating]]  # surfaces (n,), points on them (n, 3) m -> values (n, k)


def reduced(window: Window, camera: InteriorOrientation) -> Array:
    """Return x/z and y/z of a window's pixels, (2, h, w); nan where the lens has no ray."""
    return _reduced(camera.width, camera.height, camera.intrinsic, tuple(camera.distortion.tolist()))[:, *window.slices]


@lru_cache(maxsize=1)  # frames of a film and photos of a lens share them
def _reduced(
    width: int, height: int, intrinsic: tuple[float, float, float, float], distortion: tuple[float, ...]
) -> Array:
    fx, fy, cx, cy = intrinsic
    camera = InteriorOrientation(width, height, fx, fy, cx, cy, np.array(distortion))
    uv = Window(0, 0, width, height).pixels().reshape(-1, 2)
    # in parts: one with no way back through the lens takes long
    xy = np.concatenate([unproject(uv[part], camera)[0].T for part in _parts(np.arange(len(uv)), 10_000)], axis=1)
    xy.flags.writeable = False
    return xy.reshape(2, height, width)


class Viewpoint:
    """Shapes before a camera, with their bounds in reduced image coordinates."""

    def __init__(self, shapes: Sequence[Shape], pose: Pose) -> None:
        """`pose` is that of the camera in the frame of the shapes."""
        self.shapes, self.pose = tuple(shapes), pose
        self.colours = np.array([shape.colour for shape in shapes])  # (n, 3) share of light given back
        self._parted = [
            (i, s)
            for i, s in enumerate(shapes)
            if not isinstance(s, Ring) and (s.stripes if isinstance(s, Face) else s.caps)
        ]
        # (n, 2); a shape that is partly beside or behind the camera is unbounded, and one behind it has no inside
        self._low, self._high = np.full((len(shapes), 2), -np.inf), np.full((len(shapes), 2), np.inf)
        for i, shape in enumerate(shapes):
            cam = pose.to_cam(shape.outline())
            if np.all(cam[:, 2] <= 0.0):
                self._low[i], self._high[i] = np.inf, -np.inf
            elif np.all(cam[:, 2] >= 1e-3):
                flat = cam[:, :2] / cam[:, 2:]
                self._low[i], self._high[i] = flat.min(axis=0), flat.max(axis=0)

    def cast(self, xy: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the first shapes that rays hit: index, (m, k), -1 for none, and z in `cam`, (m, k) m, inf for none.

        `xy` (m, k, 2) are m bundles of k neighbouring rays each: only shapes that a bundle may meet are tried on it.
        """
        xy = np.ascontiguousarray(np.moveaxis(xy, 2, 0))  # NumPy is faster along long axes
        rays = self._rays(xy)
        first, nearness = np.full(xy.shape[1:], -1), np.zeros(xy.shape[1:])
        low, high = np.fmin.reduce(xy, axis=2), np.fmax.reduce(xy, axis=2)  # nan alone is near nothing
        near = ((high[:, None] >= self._low.T[..., None]) & (low[:, None] <= self._high.T[..., None])).all(axis=0)
        for index in np.flatnonzero(near.any(axis=1)):
            bundles = np.flatnonzero(near[index])
            inverse = self.shapes[index].hit(self.pose.position, rays[:, bundles].reshape(3, -1))
            inverse = inverse.reshape(len(bundles), -1)
            nearer = inverse > nearness[bundles]
            first[bundles] = np.where(nearer, index, first[bundles])
            nearness[bundles] = np.where(nearer, inverse, nearness[bundles])
        with np.errstate(divide="ignore"):
            return first, 1.0 / nearness

    def _rays(self, xy: Array) -> Array:
        """Directions, (3, m, k), of reduced coordinates (2, m, k), with z = 1 in `cam`."""
        R = self.pose.rotation
        return (R[:, :2] @ xy.reshape(2, -1) + R[:, 2:]).reshape(3, *xy.shape[1:])

    def _surfaces(self, xy: Array) -> tuple[Surfaces, Array]:
        """Return the surfaces, (m * k,), and the points on them, (3, m * k), that rays (2, m, k) hit first."""
        first, depth = self.cast(np.moveaxis(xy, 0, 2))
        depth[first < 0] = 0.0
        points = (self._rays(xy) * depth + self.pose.position[:, None, None]).reshape(3, -1)
        first = first.ravel()
        surfaces = (first + 1) * PARTS
        for index, shape in self._parted:
            if len(on := np.flatnonzero(first == index)):
                surfaces[on] += shape.part(points[:, on].T)
        return surfaces, points

    def paint(self, window: Window, camera: InteriorOrientation, shade: Shade) -> NDArray[np.float32]:
        """Return what pixels of a window show, (h, w, k): the values of surfaces by `shade`, in the shares of a pixel.

        Points come to `shade` as columns in memory.
        """
        xy = reduced(window, camera)
        h, w = xy.shape[1:]
        # square tiles, of which those on the right and lower border may repeat pixels
        rows, columns = (np.minimum(np.arange(0, n, _TILE_PX)[:, None] + np.arange(_TILE_PX), n - 1) for n in (h, w))
        every = (rows[:, None, :, None] * w + columns[None, :, None, :]).reshape(-1, _TILE_PX**2)
        xy, found, picture = xy.reshape(2, -1), np.empty(h * w, dtype=np.intp), np.empty(0, dtype=np.float32)
        for tiles in _parts(every, 64):
            surfaces, points = self._surfaces(xy[:, tiles])
            values = shade(surfaces, points.T)
            picture = picture if picture.size else np.empty((h * w, values.shape[1]), dtype=np.float32)
            found[tiles.ravel()], picture[tiles.ravel()] = surfaces, values
        around = np.ones((3, 3), dtype=np.uint8)
        differences = cv2.morphologyEx(found.reshape(h, w).astype(np.float32), cv2.MORPH_GRADIENT, around)
        for part in _parts(np.flatnonzero(differences), 2000):
            uv = np.column_stack([window.left + part % w, window.top + part // w])
            picture[part] = self._mixed(*unproject(uv, camera), shade)
        return picture.reshape(h, w, -1)

    def _mixed(self, xy: Array, dxy_duv: Array, shade: Shade) -> Array:
        """Return the mean values, (n, k), of pixels at reduced coordinates (n, 2) with derivatives (n, 2, 2)."""
        n, rays = len(xy), len(_LATTICE)
        fine = xy.T[..., None] + (dxy_duv @ _LATTICE.T).transpose(1, 0, 2)
        surfaces, points = self._surfaces(fine)
        seen = np.zeros((len(self.shapes) + 1) * PARTS, dtype=bool)
        seen[surfaces] = True
        kinds = np.flatnonzero(seen)
        group = (np.cumsum(seen) - 1)[surfaces] + np.repeat(len(kinds) * np.arange(n), rays)  # a surface in a pixel
        count = np.bincount(group)
        used = np.flatnonzero(count)
        count = count[used]
        mean = np.stack([np.bincount(group, x)[used] / count for x in points])
        values = shade(kinds[used % len(kinds)], mean.T) * (count / rays)[:, None]
        return np.add.reduceat(values, np.flatnonzero(np.diff(used // len(kinds), prepend=-1)))


def _parts(index: NDArray[np.intp], size: int) -> list[NDArray[np.intp]]:
    """Pieces of about `size` rows: small arrays stay in the processor's cache."""
    return np.array_split(index, max(1, len(index) // size))
