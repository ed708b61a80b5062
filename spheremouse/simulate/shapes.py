"""The shapes of a simulated scene, in `obj`, and the first intersections of rays with them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, exp

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
        """Return inverse distances, (n,), in lengths of the `rays` (3, n) from `origin` (3,) m, obj; 0 for a miss."""
        offset = self.corners - origin
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = self._normal / (offset[0] @ self._normal)
            # times the inverse distance, all are linear in the ray: the point is on the inner side of each edge
            edges = self._inward - np.sum(offset * self._inward, axis=1)[:, None] * inverse
            values = np.vstack([inverse, edges]) @ rays
        return np.where(values.min(axis=0) >= 0.0, values[0], 0.0)

    def part(self, points: Array) -> NDArray[np.int64]:
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
        """Points around it and a little outside, (32, 3) m."""
        a = unit(np.cross(self.across, (0.3, 0.9, 0.2)))
        return self.centre + 1.01 * self.outer * circle(32) @ np.array([a, np.cross(self.across, a)])

    def normal(self, _: Array | None = None) -> Array:
        """Return the unit vector across, (3,), for any point."""
        return self.across

    def hit(self, origin: Array, rays: Array) -> Array:
        """Return inverse distances, (n,), in lengths of the `rays` (3, n) from `origin` (3,) m, obj; 0 for a miss."""
        offset = origin - self.centre
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = -self.across / (offset @ self.across)
            s, *scaled = np.vstack([inverse, np.eye(3) + np.outer(offset, inverse)]) @ rays
            r2, s2 = sum(v * v for v in scaled), s * s  # of the point from the centre, times the inverse distance
        return np.where((s > 0.0) & (r2 < self.outer**2 * s2) & (r2 >= self.inner**2 * s2), s, 0.0)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere; the ball is the one at the origin."""

    centre: Array  # (3,) m, obj
    radius: float  # m
    colour: Colour
    caps: tuple[tuple[Array, float], ...] = ()  # discs: unit vector, (3,) obj, to the middle, and rad to the edge

    def outline(self) -> Array:
        """Corners of a cube around it, (8, 3)."""
        sign = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        return self.centre + self.radius * sign

    def normal(self, points: Array) -> Array:
        """Return the unit vectors outwards at points (n, 3) m, obj, of the sphere."""
        return (points - self.centre) / self.radius

    def hit(self, origin: Array, rays: Array) -> Array:
        """Return inverse distances, (n,), in lengths of the `rays` (3, n) from `origin` (3,) m, obj; 0 for a miss."""
        offset = self.centre - origin
        power = offset @ offset - self.radius**2  # of the origin outside
        b = offset @ rays
        root = b * b - np.einsum("in,in->n", rays, rays) * power
        return np.where((root >= 0.0) & (b > 0.0), (b + np.sqrt(np.maximum(root, 0.0))) / power, 0.0)

    def part(self, points: Array) -> NDArray[np.int64]:
        """Return k + 1 for points, (n, 3) m, on cap k, the first one if there are more, and 0 beside them, (n,)."""
        part = np.zeros(len(points), dtype=np.int64)
        cosines = np.array([direction for direction, _ in self.caps]) @ self.normal(points).T
        for k in reversed(range(len(self.caps))):
            part[cosines[k] > np.cos(self.caps[k][1])] = k + 1
        return part


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
    R = exp(np.array([0.0, turn, 0.0]))
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
