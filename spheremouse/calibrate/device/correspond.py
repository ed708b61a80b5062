"""Correspondence of dark spots between photos: first by rays that nearly meet, then by directions on the ball.

Wittich 2017, section 3.3.1, finds points by the distance of rays (eq. 93, 94). Some of these points are false: rays
also meet by chance, and frame and room have dark spots. The discs are the points on one sphere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, Pose, unproject
from spheremouse.geometry.least_squares.sphere import algebraic_sphere
from spheremouse.geometry.matching import suppress
from spheremouse.geometry.rotation import Array

MIN_RAY_ANGLE = np.radians(10.0)  # at smaller angles a point is six times worse than the gap of its rays

_PAIR_SAMPLES = 3000  # of two points; with six false points of seven, 60 of them are clean
_REFINED_SPHERES = 60  # the best of those
_FOUR_SAMPLES = 100  # of the points of one sphere, half of which may still be false
_MAX_POINTS = 1500  # a ball with hundreds of discs has fewer
_ROUGH_TOLERANCE = 0.15  # of the radius, of a sphere by the areas of two dark spots
_AREA_FACTOR = 2.0  # of a dark spot over its expected area, by threshold, shade, or an irregular cut
_MIN_EXTENT = 0.6  # of the radius, of the discs seen: a cap of 17 degrees; bolts in a plane are no large ball


@dataclass(frozen=True, slots=True)
class Spots:
    """Dark spots of all photos."""

    photo: NDArray[np.intp]  # (n,)
    centre: Array  # (n, 2) px
    area: Array  # (n,) px²

    def __len__(self) -> int:
        return len(self.photo)


@dataclass(frozen=True, slots=True)
class _Points:
    """Points where rays of k photos nearly meet, m of them, with false ones."""

    position: Array  # (m, 3) m
    towards: Array  # (m, k, 3) unit vectors to the cameras
    cosine: Array  # (m, k) area of the spot over that of a disc seen straight on; nan without one

    @property
    def support(self) -> Array:
        """Number of photos that show each."""
        return np.sum(np.isfinite(self.cosine), axis=1)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> "_Points":
        return _Points(self.position[keep], self.towards[keep], self.cosine[keep])


def find_ball(
    spots: Spots, poses: Sequence[Pose], camera: InteriorOrientation, disc_radius: float, tolerance: float
) -> tuple[Array, float]:
    """Return centre (3,) m and radius m of the ball on which discs of `disc_radius` m lie, to about `tolerance` m.

    Rays of one disc pass each other within `tolerance` m. The areas of two spots give a rough sphere, as a disc seen
    aslant is small: (P - K) . v = R cos, with v towards the camera. The points near it give it exactly. Raises
    CalibrationError if no five points lie on a sphere.
    """
    points = _meeting_points(spots, poses, camera, disc_radius, tolerance)
    points = points.take(_disc_like(points))
    points = points.take(np.sort(np.argsort(-points.support, kind="stable")[:_MAX_POINTS]))  # those in most photos
    if len(points.position) < 5:
        raise CalibrationError(
            f"{len(points.position)} dark spots are seen alike in several photos, at least 5 discs are needed: is the "
            "ball in the photos, did it stay still between them, are its discs dark?"
        )
    rng = np.random.default_rng(0)
    largest = float(np.linalg.norm(np.ptp(points.position, axis=0))) / _MIN_EXTENT
    rough = []
    for _ in range(_PAIR_SAMPLES):
        K, R = _by_areas(points, rng.choice(len(points.position), 2, replace=False))
        if 0.0 < R < largest and is_before(poses, K, R):
            rough.append((_score(points, K, R, _ROUGH_TOLERANCE * R), K, R))
    rough.sort(key=lambda r: -r[0])
    best, centre, radius = 0.0, np.full(3, np.nan), np.nan
    for _, K, R in rough[:_REFINED_SPHERES]:
        near = np.flatnonzero(_inside(points, K, R, _ROUGH_TOLERANCE * R))
        for _ in range(_FOUR_SAMPLES if len(near) >= 5 else 0):
            four, its_radius = algebraic_sphere(points.position[rng.choice(near, 4, replace=False)])
            possible = its_radius < largest and is_before(poses, four, its_radius)
            score = _score(points, four, its_radius, tolerance) if possible else 0.0
            if score > best:
                best, centre, radius = score, four, its_radius
    for _ in range(5):
        inside = _inside(points, centre, radius, tolerance)
        if np.count_nonzero(inside) < 5:
            raise CalibrationError(
                "fewer than 5 dark spots lie on a sphere: light the ball so that its discs stand out, and photograph "
                "it from places further apart"
            )
        centre, radius = algebraic_sphere(points.position[inside])
    return centre, radius


def is_before(poses: Sequence[Pose], centre: Array, radius: float) -> bool:
    """Return whether the whole sphere is before each camera."""
    return min(float(pose.to_cam(centre)[2]) for pose in poses) > radius


def number_discs(photo: NDArray[np.intp], directions: Array, angle: float) -> NDArray[np.intp]:
    """Return the disc number of each of n spots on the ball, (n,); -1 for one seen in fewer than two photos.

    `directions` (n, 3) are unit vectors from the ball's centre; those within `angle` rad are one disc. Of two spots in
    one photo the one nearer to the disc's middle counts.
    """
    number = np.full(len(photo), -1)
    free = np.ones(len(photo), dtype=bool)
    cosine = directions @ directions.T > np.cos(angle)
    for disc in range(len(photo)):
        support = np.array([len(np.unique(photo[row & free])) if free[i] else 0 for i, row in enumerate(cosine)])
        if support.max(initial=0) < 2:
            break
        members = np.flatnonzero(cosine[int(np.argmax(support))] & free)
        middle = np.median(directions[members], axis=0)
        distance = np.linalg.norm(directions[members] - middle, axis=1)
        taken = [m for m, o in zip(members, distance, strict=True) if o == distance[photo[members] == photo[m]].min()]
        number[taken] = disc
        free[members] = False
    return number


def directions_on_ball(
    spots: Spots, poses: Sequence[Pose], camera: InteriorOrientation, centre: Array, radius: float
) -> tuple[Array, NDArray[np.intp]]:
    """Return directions from the ball's centre to the rays' intersections, (k, 3), and the k indices of the spots."""
    directions, index = [], []
    rig = ball_rig(camera, centre, radius, 0.1 * radius)
    for k, pose in enumerate(poses):
        mine = np.flatnonzero(spots.photo == k)
        found, which = directions_at(spots.centre[mine], rig, pose)
        directions.append(found)
        index.append(mine[which])
    return np.concatenate(directions), np.concatenate(index)


def ball_rig(camera: InteriorOrientation, centre: Array, radius: float, disc_radius: float) -> Rig:
    """Return a rig with camera, ball and size of the discs alone, in any frame; `centre` (3,) and both radii in m."""
    return Rig(camera, Ball(radius, centre), NO_TARGETS, disc_radius)


def _meeting_points(
    spots: Spots, poses: Sequence[Pose], camera: InteriorOrientation, disc_radius: float, tolerance: float
) -> _Points:
    """Points where rays of different photos nearly meet, at least `tolerance` apart (eq. 94)."""
    xy, dxy_duv = unproject(spots.centre, camera)
    real = np.isfinite(xy[:, 0])
    photo, xy, dxy_duv, area = spots.photo[real], xy[real], dxy_duv[real], spots.area[real]
    cam = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    length = np.linalg.norm(cam, axis=1)
    R = np.array([p.rotation for p in poses])[photo]
    direction = np.einsum("nij,nj->ni", R, cam) / length[:, None]
    origin = np.array([p.position for p in poses])
    # a small area A seen straight on from D covers A |x|^3 / D^2 in reduced coordinates, x = (x, y, 1)
    face = np.pi * disc_radius**2 * length**3 / np.abs(np.linalg.det(dxy_duv))
    found = [
        _meet(origin[a], direction[photo == a], origin[b], direction[photo == b], tolerance)
        for a, b in combinations(range(len(poses)), 2)
    ]
    points = np.concatenate(found)
    shape, rows = (len(points), len(poses)), np.arange(len(points))
    off, along, nearest = np.full(shape, np.inf), np.ones(shape), np.zeros(shape, dtype=np.intp)
    for k in np.unique(photo):
        mine, way = np.flatnonzero(photo == k), points - origin[k]
        towards_point = way @ direction[mine].T
        square = np.sum(way**2, axis=1)[:, None] - towards_point**2
        square = np.where(towards_point > 0.0, square, np.inf)
        which = np.argmin(square, axis=1)
        off[:, k], along[:, k] = np.sqrt(np.maximum(square[rows, which], 0.0)), towards_point[rows, which]
        nearest[:, k] = mine[which]
    sees = off < tolerance
    cosine = np.where(sees, area[nearest] * along**2 / face[nearest], np.nan)
    towards = -direction[nearest]
    foot = origin[None] + along[..., None] * direction[nearest]
    count = np.maximum(np.sum(sees, axis=1), 1)
    points = np.sum(np.where(sees[..., None], foot, 0.0), axis=1) / count[:, None]
    support = np.sum(sees, axis=1)
    order = np.argsort(-support, kind="stable")[: np.count_nonzero(support >= 2)]
    kept = order[suppress(points[order], np.full(len(order), tolerance))]
    return _Points(points[kept], towards[kept], cosine[kept])


def _meet(o: Array, u: Array, p: Array, v: Array, tolerance: float) -> Array:
    """Middles of the gaps between rays from o along u, (a, 3), and from p along v, (b, 3), that nearly meet, (k, 3)."""
    base = p - o
    uv = u @ v.T
    sine2 = 1.0 - uv**2
    bu, bv = (u @ base)[:, None], (v @ base)[None]
    crossing = sine2 > np.sin(MIN_RAY_ANGLE) ** 2  # rays nearly alike meet anywhere
    safe = np.where(crossing, sine2, 1.0)
    s, t = (bu - uv * bv) / safe, (uv * bu - bv) / safe
    first = o + s[..., None] * u[:, None]
    second = p + t[..., None] * v[None]
    gap = np.linalg.norm(first - second, axis=2)
    good = crossing & (gap < tolerance) & (s > 0) & (t > 0)
    return (0.5 * (first + second))[good]


def _disc_like(points: _Points) -> NDArray[np.bool_]:
    """Return True for points if their areas fit one disc: with a normal n, n . v = cos and |n| = 1."""
    fine = np.ones(len(points.position), dtype=bool)
    for i, (v, c) in enumerate(zip(points.towards, points.cosine, strict=True)):
        sees = np.isfinite(c)
        normal, _, rank, _ = np.linalg.lstsq(v[sees], c[sees], rcond=0.1)
        size = np.linalg.norm(normal)
        # photos from two directions leave one component of the normal open
        fine[i] = size < _AREA_FACTOR and (rank < 3 or size > 1.0 / _AREA_FACTOR)
    return fine


def has_wide_rays(poses: Sequence[Pose], points: Array) -> bool:
    """Return True if two photos see the middle of the points, (n, 3) m, from directions ten degrees apart."""
    rays = np.array([p.position for p in poses]) - points.mean(axis=0)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return bool(np.min(rays @ rays.T) < np.cos(MIN_RAY_ANGLE))


def _by_areas(points: _Points, which: NDArray[np.intp]) -> tuple[Array, float]:
    """Sphere by the areas of some points: P . v = K . v + R cos, by least squares."""
    sees = np.isfinite(points.cosine[which])
    v = points.towards[which][sees]
    P = np.broadcast_to(points.position[which][:, None], points.towards[which].shape)[sees]
    A = np.concatenate([v, points.cosine[which][sees][:, None]], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(A, np.sum(P * v, axis=1), rcond=1e-3)
    return solution[:3], float(solution[3]) if rank == 4 else np.nan


def _inside(points: _Points, centre: Array, radius: float, tolerance: float) -> NDArray[np.bool_]:
    """Return True for points on the sphere with areas of discs."""
    way = points.position - centre
    length = np.linalg.norm(way, axis=1)
    near = np.abs(length - radius) < tolerance
    cosine = np.einsum("mi,mki->mk", way / length[:, None], points.towards)
    with np.errstate(invalid="ignore", divide="ignore"):
        unlike = np.abs(np.log(points.cosine / np.maximum(cosine, 1e-3))) > np.log(_AREA_FACTOR)
    wrong = np.sum(unlike & np.isfinite(points.cosine), axis=1)
    return near & (wrong <= 0.34 * points.support)


def _score(points: _Points, centre: Array, radius: float, tolerance: float) -> float:
    """Score of a sphere: the photos that see its points, with less weight near the tolerance."""
    inside = _inside(points, centre, radius, tolerance)
    if np.count_nonzero(inside) < 5 or np.linalg.norm(np.ptp(points.position[inside], axis=0)) < _MIN_EXTENT * radius:
        return 0.0
    residual = (np.linalg.norm(points.position[inside] - centre, axis=1) - radius) / tolerance
    return float(np.sum(points.support[inside] * (1.0 - residual**2)))
