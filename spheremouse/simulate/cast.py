"""The renderer: shapes before a camera, and pictures of them by rays.

A pixel within one surface has one ray. A pixel where surfaces meet has many, and each of its surfaces takes the share
of the rays that hit it, in the light at the mean of the points hit.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, Pose, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.layers import Window
from spheremouse.simulate.shapes import Shape

AT_ORIGIN = Pose(np.eye(3), np.zeros(3))  # of a camera that sees shapes in its own axes
PARTS = 256  # numbers of a shape's parts are below
_TILE_PX = 16  # px, side of bundles of rays
# Offsets of the rays in a pixel with an edge, (36, 2) px: a lattice, so that they are as many steps across a vertical
# or a horizontal edge.
_LATTICE = (np.column_stack([np.arange(36), 11 * np.arange(36) % 36]) + 0.5) / 36.0 - 0.5

Surfaces = NDArray[np.int64]  # (shape's index + 1) * PARTS + part, 0 for none
Shade = Callable[[Surfaces, Array], Array]  # surfaces (n,), points on them (n, 3) m -> values (n, k)


class Rays(NamedTuple):
    """Rays of the pixels of a part of a picture."""

    window: Window
    xy: Array  # (n, 2) reduced coordinates, row by row; nan where the lens has no ray
    dxy_duv: Array  # (n, 2, 2) 1/px


def rays_of(window: Window, camera: InteriorOrientation) -> Rays:
    """Return the rays of all pixels in a window."""
    uv = window.pixels().reshape(-1, 2)
    rays = Rays(window, np.empty((len(uv), 2)), np.empty((len(uv), 2, 2)))
    for part in _parts(np.arange(len(uv)), 10_000):  # a part with no way back through the lens takes long
        rays.xy[part], rays.dxy_duv[part] = unproject(uv[part], camera)
    return rays


class Viewpoint:
    """Shapes before a camera, with their bounds in reduced image coordinates."""

    def __init__(self, shapes: Sequence[Shape], pose: Pose) -> None:
        """`pose` is that of the camera in the frame of the shapes."""
        self.shapes, self.pose = tuple(shapes), pose
        # (n, 2); a shape that is partly beside or behind the camera is unbounded, and one behind it has no inside
        self._low, self._high = np.full((len(shapes), 2), -np.inf), np.full((len(shapes), 2), np.inf)
        for i, shape in enumerate(shapes):
            cam = pose.to_cam(shape.outline())
            if np.all(cam[:, 2] <= 0.0):
                self._low[i], self._high[i] = np.inf, -np.inf
            elif np.all(cam[:, 2] >= 1e-3):
                flat = cam[:, :2] / cam[:, 2:]
                self._low[i], self._high[i] = flat.min(axis=0), flat.max(axis=0)

    def rays(self, xy: Array) -> Array:
        """Directions, (..., 3), of reduced coordinates (..., 2), so long that distances are z in cam."""
        R = self.pose.rotation
        return xy @ R[:, :2].T + R[:, 2]

    def cast(self, xy: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the first shapes that rays hit: index, (m, k), -1 for none, and z in `cam`, (m, k) m.

        `xy` (m, k, 2) are m bundles of k neighbouring rays each: only shapes that a bundle may meet are tried on it.
        """
        first = np.full(xy.shape[:2], -1, dtype=np.int64)
        depth = np.full(xy.shape[:2], np.inf)
        rays = self.rays(xy)
        flat = np.ascontiguousarray(np.moveaxis(xy, 2, 0))  # NumPy reduces the last axis of a compact array fastest
        lost = np.isnan(flat)  # no ray comes from there
        low, high = np.where(lost, np.inf, flat).min(axis=2).T, np.where(lost, -np.inf, flat).max(axis=2).T
        separate = ((high[:, None] < self._low) | (low[:, None] > self._high)).any(axis=2)
        for index in np.flatnonzero(~separate.all(axis=0)):
            near = np.flatnonzero(~separate[:, index])
            s = self.shapes[index].hit(self.pose.position, rays[near].reshape(-1, 3)).reshape(len(near), -1)
            nearer = s < depth[near]
            first[near] = np.where(nearer, index, first[near])
            depth[near] = np.where(nearer, s, depth[near])
        return first, depth

    def _surfaces(self, xy: Array) -> tuple[Surfaces, Array]:
        """Return the surfaces, (m, k), and the points on them, (m, k, 3), that rays (m, k, 2) hit first."""
        first, depth = self.cast(xy)
        points = self.pose.position + np.nan_to_num(depth, posinf=0.0)[..., None] * self.rays(xy)
        surfaces = (first + 1) * PARTS
        for index in np.unique(first[first >= 0]):
            on = first == index
            surfaces[on] += self.shapes[index].part(points[on])
        return surfaces, points

    def paint(self, rays: Rays, shade: Shade) -> Array:
        """Return what pixels show, (h, w, k): the values of surfaces by `shade`, in the shares of the pixel."""
        left, top, right, bottom = rays.window
        h, w = bottom - top, right - left
        # square tiles, of which those on the right and lower border may repeat pixels
        rows, columns = (np.minimum(np.arange(0, n, _TILE_PX)[:, None] + np.arange(_TILE_PX), n - 1) for n in (h, w))
        every = (rows[:, None, :, None] * w + columns[None, :, None, :]).reshape(-1, _TILE_PX**2)
        found = np.empty(h * w, dtype=np.int64)
        picture = np.empty(0)
        for tiles in _parts(every, 64):
            found[tiles], points = self._surfaces(rays.xy[tiles])
            values = shade(found[tiles].ravel(), points.reshape(-1, 3))
            picture = picture if picture.size else np.empty((h * w, values.shape[1]))
            picture[tiles.ravel()] = values
        base = (len(self.shapes) + 1) * PARTS
        for part in _parts(np.flatnonzero(_borders(found.reshape(h, w))), 2000):
            fine = rays.xy[part, None] + _LATTICE @ rays.dxy_duv[part].transpose(0, 2, 1)
            surfaces, points = self._surfaces(fine)
            key = np.arange(len(part))[:, None] * base + surfaces
            pairs, group, count = np.unique(key, return_inverse=True, return_counts=True)
            mean = np.stack([np.bincount(group.ravel(), x) / count for x in points.reshape(-1, 3).T], axis=1)
            values = shade(pairs % base, mean) * (count / len(_LATTICE))[:, None]
            picture[part] = np.stack([np.bincount(pairs // base, x, len(part)) for x in values.T], axis=1)
        return picture.reshape(h, w, -1)


def _parts(index: NDArray[np.intp], size: int) -> list[NDArray[np.intp]]:
    """Pieces of about `size` rows: small arrays stay in the processor's cache."""
    return np.array_split(index, max(1, len(index) // size))


def _borders(surfaces: Surfaces) -> NDArray[np.bool_]:
    """Return a mask, (h * w,), of pixels with a different neighbour, and of those above and below them."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    border = np.asarray(cv2.morphologyEx(surfaces.astype(np.float32), cv2.MORPH_GRADIENT, cross)) > 0.0
    return np.asarray(cv2.dilate(border.astype(np.uint8), np.ones((3, 1), dtype=np.uint8))).ravel() > 0
