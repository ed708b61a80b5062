"""The shapes of a simulated scene, in `obj`, and the first intersections of rays with them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array

Colour = tuple[float, float, float]  # share of light given back: blue, green, red
Vector = tuple[float, float, float]

_MAX_STRIPES = 256  # maximum number of separate stripes on one face


@dataclass(frozen=True, slots=True)
class Face:
    """A convex polygon."""

    corners: Array  # (k, 3) m, obj, in one plane, going round
    colour: Colour
    stripes: float = 0.0  # m, width of floor boards across the first edge; 0: plain
    _normal: Array = field(init=False, repr=False)  # (3,)
    _inward: Array = field(init=False, repr=False)  # (k, 3) across each edge, in the plane

    def __post_init__(self) -> None:
        normal = unit(np.cross(self.corners[1] - self.corners[0], self.corners[2] - self.corners[1]))
        object.__setattr__(self, "_normal", normal)
        object.__setattr__(self, "_inward", np.cross(normal, np.roll(self.corners, -1, axis=0) - self.corners))

    def outline(self) -> Array:
        """Corners, (k, 3)."""
        return self.corners

    def normal(self, _: Array | None = None) -> Array:
        """Return the unit vector across, (3,), for any point; which side is left open."""
        return self._normal

    def hit(self, origin: Array, rays: Array) -> Array:
        """Return distances, (n,), in lengths of the `rays` (n, 3) from `origin` (3,) m, obj; inf for a miss."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((self.corners[0] - origin) @ self._normal) / (rays @ self._normal)
            inside = s > 0.0
            for corner, inward in zip(self.corners, self._inward, strict=True):
                inside &= s * (rays @ inward) >= (corner - origin) @ inward
        return np.where(inside, s, np.inf)

    def stripe(self, points: Array) -> NDArray[np.int64]:
        """Return the index, (n,), of the stripe that each of points, (n, 3) m, lies on."""
        along = self.corners[1] - self.corners[0]
        place = (points - self.corners[0]) @ along / np.linalg.norm(along) / self.stripes
        return np.clip(place, 0, _MAX_STRIPES - 1).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Ring:
    """A flat ring or, with no inner radius, a disc."""

    centre: Array  # (3,) m, obj
    across: Array  # (3,) unit normal
    inner: float  # m
    outer: float  # m
    colour: Colour

    def outline(self) -> Array:
        """Points around it, (32, 3), a little outside."""
        a = unit(np.cross(self.across, (0.3, 0.9, 0.2)))
        return self.centre + 1.01 * self.outer * circle(32) @ np.array([a, np.cross(self.across, a)])

    def normal(self, _: Array | None = None) -> Array:
        """Return the unit vector across, (3,), for any point."""
        return self.across

    def hit(self, origin: Array, rays: Array) -> Array:
        """Return distances, (n,), in lengths of the `rays` (n, 3) from `origin` (3,) m, obj; inf for a miss."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((self.centre - origin) @ self.across) / (rays @ self.across)
            offset = origin - self.centre
            r2 = s * s * np.einsum("ni,ni->n", rays, rays) + 2.0 * s * (rays @ offset) + offset @ offset
            inside = (s > 0.0) & (r2 < self.outer**2) & (r2 >= self.inner**2)
        return np.where(inside, s, np.inf)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere; the ball is the one at the origin."""

    centre: Array  # (3,) m, obj
    radius: float  # m
    colour: Colour

    def outline(self) -> Array:
        """Corners of a cube around it, (8, 3)."""
        sign = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        return self.centre + self.radius * sign

    def normal(self, points: Array) -> Array:
        """Return the unit vectors outwards at points (n, 3) m, obj, of the sphere."""
        return (points - self.centre) / self.radius

    def hit(self, origin: Array, rays: Array) -> Array:
        """Return distances, (n,), in lengths of the `rays` (n, 3) from `origin` (3,) m, obj; inf for a miss."""
        offset = self.centre - origin
        a = np.einsum("ni,ni->n", rays, rays)
        b = rays @ offset
        root = b * b - a * (offset @ offset - self.radius**2)
        return np.where((root >= 0.0) & (b > 0.0), (b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)


Shape = Face | Ring | Sphere


def unit(v: Array) -> Array:
    """Return a vector, (3,), with the length 1."""
    return v / np.linalg.norm(v)


def circle(n: int) -> Array:
    """Return `n` points around the unit circle, (n, 2)."""
    phase = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    return np.stack([np.cos(phase), np.sin(phase)], axis=1)


def pixel_parts(n: int) -> Array:
    """Middles of the n² parts of a pixel, (n², 2) px from its middle."""
    offset = (np.arange(n) + 0.5) / n - 0.5
    return np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)


def box(low: Vector, high: Vector, colour: Colour, turn: float = 0.0) -> list[Face]:
    """Six faces of a box between two corners, turned by `turn` rad about the vertical through its middle."""
    lo, hi = np.array(low), np.array(high)
    middle, half = (lo + hi) / 2.0, (hi - lo) / 2.0
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corners = np.insert(square, axis, sign, axis=1) * half
            faces.append(Face(corners @ R.T + middle, colour))
    return faces


def post(
    foot: Vector, top: Vector, radius: float, colour: Colour, *, top_radius: float | None = None, sides: int = 16
) -> list[Face]:
    """Return the faces around a post, cone or lampshade between two points, without its ends.

    All lengths are in m. `radius` is that at the foot, `top_radius` that at the top; None: the same.
    """
    a, b = np.array(foot), np.array(top)
    axis = unit(b - a)
    u = unit(np.cross(axis, (0.31, 0.17, 0.93)))
    v = np.cross(axis, u)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)[:, None]
    around = np.cos(angle) * u + np.sin(angle) * v
    low, high = a + radius * around, b + (radius if top_radius is None else top_radius) * around
    return [Face(np.array([low[i], low[i + 1], high[i + 1], high[i]]), colour) for i in range(sides)]


class Viewpoint:
    """Shapes before a camera, with their bounds in reduced image coordinates."""

    def __init__(self, shapes: Sequence[Shape], pose: Pose) -> None:
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
        """Directions, (..., 3) obj, of reduced coordinates (..., 2), so long that distances are z in cam."""
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
