"""A start for a rolling ball, from its images alone: dark spots that rotate together, and their sphere.

The start is the direction to the ball's centre, its distance over its radius, and the size of its discs, all roughly.
Spots are followed from frame to frame. Between two frames, the spots on a ball turn by one rotation about its centre
(Wahba's problem). A search over the three unknowns minimises the residuals of these rotations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.calibrate.outline.fit import rays_of
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.matching import distances, mutual_nearest, suppress
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma

_CLOSING_WIDTHS_PX = (9, 17, 33, 65)  # px, widths of the closing, for discs up to two thirds of it
_MIN_DEPTH = 0.2  # of a spot, relative to its surroundings: print is 0.8; haze and gloss halve it
_MIN_DEPTH_SIGMAS = 5.0  # of a spot, in standard deviations of a pixel's noise
_MIN_AREA = 12.0  # px²
_MAX_AREA_ERROR = 0.12  # of a spot's area, relative to its moments' ellipse, beside a pixel's
_MIN_AXIS_RATIO = 0.2  # of an ellipse; slimmer ones are at the limb, or are lines
_MAX_STEP = 0.045  # of the picture's width, of a spot in a frame (4 rad/s at 30 Hz)
_MIN_PATH_FRAMES = 5
_MAX_GAP = 3  # frames; a spot seen later is another one
_MIN_MOTION = 3.0  # px, of a moving spot
_MIN_MOTION_SHARE = 0.01  # of the picture's width, of a moving spot
_MAX_PAIRS, _MIN_PAIRS = 120, 5  # of frames
_LAG_FRAMES = (1, 2, 4, 8, 16, 32, 64)
_RESIDUAL_SCALE_PX = 1.0  # px; spots are exact to some tenths, the model to the rest
_MIN_BALL_SHARE = 0.3  # of the moving spots on the ball
_MAX_LIMB_ANGLE = float(np.deg2rad(75.0))  # between the optical axis and the limb: no lens with this model sees farther
_CENTRES, _SIZES = 11, 15  # nodes of the search
_COARSE_STEP = 4  # every so many pairs while searching
_REWEIGHTINGS = 3  # of the rotation between two frames, by its last residuals
_MAX_STARTS, _MAX_NODES = 4, 40  # of the search that are refined; nodes among which they are chosen


@dataclass(frozen=True, slots=True)
class Spots:
    """Dark spots in one frame."""

    centre: Array  # (n, 2) px
    area: Array  # (n,) px²


@dataclass(slots=True)
class Path:
    """A spot that is followed, k times seen."""

    frame: list[int] = field(default_factory=list)  # indices of the frames it was seen in
    centre: list[Array] = field(default_factory=list)  # (2,) px each
    area: list[float] = field(default_factory=list)  # px²

    def add(self, k: int, seen: Spots, j: np.intp) -> None:
        """Append the spot j of frame k."""
        self.frame.append(k)
        self.centre.append(seen.centre[j])
        self.area.append(float(seen.area[j]))

    def expected(self, k: int) -> Array:
        """Return the place in frame k at a constant velocity, (2,) px."""
        if len(self.frame) < 2:
            return self.centre[-1]
        velocity = (self.centre[-1] - self.centre[-2]) / (self.frame[-1] - self.frame[-2])
        return self.centre[-1] + velocity * (k - self.frame[-1])

    @property
    def extent(self) -> float:
        """px, diagonal of the box it moved in."""
        return float(np.linalg.norm(np.ptp(self.centre, axis=0)))

    @property
    def smooth(self) -> bool:
        """True for a steady motion; linked noise goes to and fro."""
        velocity = np.diff(self.centre, axis=0) / np.diff(self.frame)[:, None]
        return bool(np.mean(np.diff(velocity, axis=0) ** 2) < 0.25 * np.mean(velocity**2) + 0.1)


@dataclass(frozen=True, slots=True)
class RollingStart:
    """The ball in units of its radius, roughly."""

    direction: Array  # (3,) unit vector in cam, to the ball's centre
    ratio: float  # distance of the centre over the radius
    disc_angle: float  # rad, of the discs, seen from the ball's centre


def dark_spots(image: Image) -> Spots:
    """Return the compact dark regions of any size in an image (h, w, 3) BGR or (h, w)."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    grey = cv2.GaussianBlur(grey, (0, 0), 0.8)
    noise = float(mad_sigma(np.diff(grey[::4].astype(np.float32), axis=1).ravel()))
    found: list[tuple[float, float, float]] = []  # u, v, area
    for width in _CLOSING_WIDTHS_PX:
        if width > min(grey.shape) // 4:
            break
        background = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
        depth = cv2.subtract(background, grey)
        level = cv2.add(cv2.convertScaleAbs(background, alpha=_MIN_DEPTH), np.array(_MIN_DEPTH_SIGMAS * noise + 2.0))
        contours, _ = cv2.findContours(cv2.compare(depth, level, cv2.CMP_GT), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            if len(contour) >= 6 and (spot := _fitted_spot(contour, depth, 0.8 * width)) is not None:
                found.append(spot)
    a = np.array(found).reshape(-1, 3)
    # the narrow closings find the rim of a large spot as further spots
    a = a[np.argsort(-a[:, 2], kind="stable")]
    a = a[suppress(a[:, :2], 1.2 * np.sqrt(a[:, 2] / np.pi))]
    return Spots(a[:, :2], a[:, 2])


def _fitted_spot(contour: Image, depth: Image, largest: float) -> tuple[float, float, float] | None:
    """Return u, v (px) and area (px²) of a dark region; None if it is no ellipse, cut, or wider than `largest` px."""
    x, y, w, h = cv2.boundingRect(contour)
    if max(w, h) > largest:
        return None
    x0, y0 = max(x - 1, 0), max(y - 1, 0)
    patch = depth[y0 : y + h + 1, x0 : x + w + 1].astype(np.float32)
    inside = np.zeros(patch.shape, np.uint8)
    cv2.drawContours(inside, [contour], 0, 1, thickness=cv2.FILLED, offset=(-x0, -y0))
    if inside[[0, -1]].any() and (y0 == 0 or y + h + 1 > depth.shape[0]):
        return None
    median_depth = float(np.median(patch[inside > 0]))
    with_rim = cv2.dilate(inside, np.ones((3, 3), np.uint8))
    coverage = np.clip(patch / max(median_depth, 1.0), 0.0, 1.0) * with_rim  # share of each pixel in the disc
    m = cv2.moments(coverage)
    area = m["m00"]
    if area < _MIN_AREA:
        return None
    xx, xy, yy = (m[k] / area for k in ("mu20", "mu11", "mu02"))
    root = np.hypot(0.5 * (xx - yy), xy)
    minor, major = np.sqrt(max(0.5 * (xx + yy) - root, 1e-6)), np.sqrt(0.5 * (xx + yy) + root)
    area_error = abs(area / (4.0 * np.pi * minor * major) - 1.0)
    if minor < _MIN_AXIS_RATIO * major or area_error > _MAX_AREA_ERROR + 1.0 / np.sqrt(area):
        return None
    return x0 + m["m10"] / area, y0 + m["m01"] / area, float(area)


def follow(spots: Sequence[Spots], width: int) -> list[Path]:
    """Link spots of consecutive frames that are mutual nearest neighbours of about the same size."""
    gate = _MAX_STEP * width
    done: list[Path] = []
    alive: list[Path] = []
    for k, seen in enumerate(spots):
        done += [p for p in alive if k - p.frame[-1] > _MAX_GAP]
        alive = [p for p in alive if k - p.frame[-1] <= _MAX_GAP]
        expected = np.array([p.expected(k) for p in alive]).reshape(-1, 2)
        reach = np.array([(0.35 * gate + 2.0 if len(p.frame) > 1 else gate) * (k - p.frame[-1]) for p in alive])
        area = np.array([p.area[-1] for p in alive])
        distance = distances(expected, seen.centre)
        unlike = np.abs(np.log(area[:, None] / np.maximum(seen.area[None], 1e-9))) > 0.7
        distance = np.where(unlike | (distance > reach[:, None]), np.inf, distance)
        columns = mutual_nearest(distance)
        for i in np.flatnonzero(columns >= 0):
            alive[i].add(k, seen, columns[i])
        for j in np.setdiff1d(np.arange(len(seen.centre)), columns):
            alive.append(Path())
            alive[-1].add(k, seen, j)
    return [p for p in done + alive if len(p.frame) >= _MIN_PATH_FRAMES]


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Motion of spots between two frames, p times up to n spots."""

    before: Array  # (p, n, 3) unit rays in cam
    after: Array  # (p, n, 3)
    present: NDArray[np.bool_]  # (p, n), False beyond a pair's spots and for a spot without a ray
    path: NDArray[np.intp]  # (p, n) index of the spot's path

    def every(self, step: int) -> "_Pairs":
        """Select every n-th pair."""
        return _Pairs(self.before[::step], self.after[::step], self.present[::step], self.path[::step])


def start(spots: Sequence[Spots], camera: InteriorOrientation) -> RollingStart:
    """Find the rolling ball; raises CalibrationError if nothing moves, or nothing that rotates as one ball."""
    min_motion = max(_MIN_MOTION_SHARE * camera.width, _MIN_MOTION)
    moving = [p for p in follow(spots, camera.width) if p.extent > min_motion and p.smooth]
    if len(moving) < 3:
        raise CalibrationError(
            f"{len(moving)} dark spot{'s' if len(moving) != 1 else ''} moved: no ball with discs is seen to turn; "
            "light it, put discs on it, and roll it on in all directions"
        )
    found = _rotating_ball(moving, camera)
    if found is None:
        raise CalibrationError(
            "the dark spots that move do not turn as one ball about its centre: keep hands and all else that moves "
            "out of the picture, leave the camera where it is, and roll the ball on, slowly"
        )
    direction, ratio, on_ball = found
    rig = start_rig(RollingStart(direction, ratio, 0.02), camera)
    pose = Pose(np.eye(3), -direction * ratio)
    beside = [p for p in moving if len(directions_at(np.array(p.centre), rig, pose)[1]) == 0]
    if len(beside) >= 4 and _rotating_ball(beside, camera) is not None:
        raise CalibrationError("two balls turn in the picture: roll one alone, and cover the other")
    return RollingStart(direction, ratio, _disc_angle(on_ball, rig, pose))


def _rotating_ball(paths: Sequence[Path], camera: InteriorOrientation) -> tuple[Array, float, list[Path]] | None:
    """Return direction and ratio of the ball that the spots turn with, and the paths on it; None without a ball."""
    pairs = _informative_pairs(paths, camera)
    if len(pairs.present) < _MIN_PAIRS or not pairs.present.any():
        return None
    best = _search_ball(pairs, paths, camera)
    residual = _residuals(best[None], pairs, camera.fx)[0]
    hit = pairs.present & np.isfinite(residual)
    if np.count_nonzero(hit) < _MIN_BALL_SHARE * np.count_nonzero(pairs.present):
        return None
    if np.median(residual[hit]) > _RESIDUAL_SCALE_PX or np.mean(residual[hit] < 3.0 * _RESIDUAL_SCALE_PX) < 0.5:
        return None
    direction, ratio = _direction_and_ratio(best)
    # a sheet that slides fits an endless ball that touches the camera
    if np.arccos(direction[2]) + np.arcsin(1.0 / ratio) > _MAX_LIMB_ANGLE:
        return None
    fits = pairs.present & (residual < 3.0 * _RESIDUAL_SCALE_PX)
    fitting, total = (np.bincount(pairs.path[m], minlength=len(paths)) for m in (fits, pairs.present))
    return direction, ratio, [p for p, k, n in zip(paths, fitting, total, strict=True) if 2 * k > n]


def start_rig(found: RollingStart, camera: InteriorOrientation) -> Rig:
    """Return a rig for the detectors: a ball of radius 1 without targets and pose."""
    return Rig(camera, Ball(1.0), NO_TARGETS, found.disc_angle, scale_free=True)


def _informative_pairs(paths: Sequence[Path], camera: InteriorOrientation) -> _Pairs:
    """Return the most informative pairs of frames: many common spots that moved far."""
    last = max(int(p.frame[-1]) for p in paths) + 1
    at = np.full((last, len(paths), 2), np.nan)
    for i, p in enumerate(paths):
        at[p.frame, i] = p.centre
    max_distance = 0.15 * camera.width
    scored: list[tuple[float, int, int]] = []
    for f in range(0, last - 1, max(1, last // 600)):
        best = (0.0, 0, 0)
        for lag in _LAG_FRAMES:
            if f + lag >= last:
                break
            distances = np.linalg.norm(at[f + lag] - at[f], axis=1)
            n = np.count_nonzero(np.isfinite(distances))
            if n >= 3:
                best = max(best, ((n - 2.5) * min(float(np.nanmedian(distances)), max_distance), f, f + lag))
        if best[0] > 0.0:
            scored.append(best)
    # the best of each part of the time, so that all directions of rolling count
    parts = np.array_split(np.arange(len(scored)), min(_MAX_PAIRS, len(scored))) if scored else []
    chosen = [max(scored[i] for i in part) for part in parts]
    first, second = np.array([pair[1:] for pair in chosen], dtype=int).reshape(-1, 2).T
    common = np.isfinite(at[first, :, 0] + at[second, :, 0])
    path = np.argsort(~common, axis=1, kind="stable")[:, : common.sum(axis=1).max(initial=0)]  # the common ones first
    before, after = (
        rays_of(at[frame[:, None], path].reshape(-1, 2), camera).reshape(*path.shape, 3) for frame in (first, second)
    )
    present = np.isfinite(before[..., 0] + after[..., 0])
    before, after = (np.where(present[..., None], rays, [0.0, 0.0, 1.0]) for rays in (before, after))
    return _Pairs(before, after, present, path)


def _direction_and_ratio(x: Array) -> tuple[Array, float]:
    """Return direction and distance over radius of (x/z, y/z, log of the angular radius in rad)."""
    c = np.array([x[0], x[1], 1.0])
    return c / np.linalg.norm(c), float(1.0 / np.sin(np.exp(x[2])))


def _residuals(x: Array, pairs: _Pairs, focal: float) -> Array:
    """Return residuals (h, p, n) px from the rotation of each pair, for h hypotheses, (h, 3) as `_search_ball` returns.

    A ray that misses the ball has inf. The rotation is robust, by reweighting.
    """
    c = np.concatenate([x[:, :2], np.ones((len(x), 1))], axis=1)
    c /= np.linalg.norm(c, axis=1, keepdims=True)
    D = 1.0 / np.sin(np.exp(np.minimum(x[:, 2], np.log(1.5))))
    centre = (c * D[:, None])[:, None, None, :]
    on, hit = [], np.broadcast_to(pairs.present, (len(x), *pairs.present.shape)).copy()
    for ray in (pairs.before, pairs.after):
        b = np.einsum("pnj,hj->hpn", ray, c) * D[:, None, None]
        root = b * b - (D * D - 1.0)[:, None, None]
        hit &= root > 0.0
        on.append((b - np.sqrt(np.maximum(root, 0.0)))[..., None] * ray[None] - centre)
    u, v = on
    weight = hit.astype(float)
    residual = np.full(hit.shape, np.inf)
    for _ in range(_REWEIGHTINGS):
        B = np.einsum("hpn,hpni,hpnj->hpij", weight, v, u)
        left, _, right = np.linalg.svd(B)
        left[..., :, 2] *= np.linalg.det(left @ right)[..., None]
        turned = u @ (left @ right).swapaxes(-1, -2) + centre
        z = np.maximum(turned[..., 2], 1e-3)
        error = turned[..., :2] / z[..., None] - (pairs.after[..., :2] / pairs.after[..., 2:])[None]
        residual = np.where(hit, focal * np.linalg.norm(error, axis=-1), np.inf)
        weight = hit / (1.0 + np.where(hit, residual / (2.0 * _RESIDUAL_SCALE_PX), 0.0) ** 2)
    return residual


def _cost(x: Array, pairs: _Pairs, focal: float, scale: float) -> Array:
    """Return the robust cost of h hypotheses, (h,); a ray that misses the ball is a gross error. `scale` is in px.

    Pairs count by their degrees of freedom: three spots less a rotation's three angles leave half.
    """
    count = np.maximum(pairs.present.sum(axis=1), 1)
    relative = np.minimum(_residuals(x, pairs, focal), 10.0 * scale) / scale
    value = np.where(pairs.present, np.log1p(relative**2), 0.0)
    return np.einsum("hpn,p->h", value, 1.0 / np.maximum((count - 1.5) / count, 0.1)) / pairs.present.sum()


def _search_ball(pairs: _Pairs, paths: Sequence[Path], camera: InteriorOrientation) -> Array:
    """Return the ball that the spots turn with, (3,): x/z and y/z of its centre in cam, log of its angular radius, rad.

    A grid over the middle of the spots and sizes of 0.35 to 3 times theirs, then refinements.
    """
    rays = rays_of(np.concatenate([p.centre for p in paths]), camera)
    rays = rays[np.isfinite(rays[:, 2])]
    box = np.quantile(rays[:, :2] / rays[:, 2:], [0.02, 0.98], axis=0)
    middle, half = box.mean(axis=0), 0.5 * np.ptp(box, axis=0)
    half = np.maximum(half, 0.3 * half.max())
    largest = float(np.arctan(half.max()))
    sizes = np.log(np.minimum(largest * np.geomspace(0.35, 3.0, _SIZES), 1.2))
    nodes = np.linspace(-0.9, 0.9, _CENTRES)
    grid = np.array(
        [[middle[0] + a * half[0], middle[1] + b * half[1], s] for s in sizes for a in nodes for b in nodes]
    )
    subset = pairs.every(max(1, min(_COARSE_STEP, len(pairs.present) // 20)))
    cost = np.concatenate(
        [_cost(g, subset, camera.fx, 4.0 * _RESIDUAL_SCALE_PX) for g in np.array_split(grid, len(grid) // 100 + 1)]
    )
    starts = grid[np.argsort(cost)[:_MAX_NODES]]
    starts = starts[suppress(starts, np.full(len(starts), 0.25 * half.max()), norm=np.inf)[:_MAX_STARTS]]
    refined = [_minimise(start, subset, camera.fx, 4.0 * _RESIDUAL_SCALE_PX, 0.1 * half.max()) for start in starts]
    best = refined[int(np.argmin(_cost(np.array(refined), pairs, camera.fx, _RESIDUAL_SCALE_PX)))]
    for scale, step in ((_RESIDUAL_SCALE_PX, 0.02), (0.3 * _RESIDUAL_SCALE_PX, 0.004)):
        best = _minimise(best, pairs, camera.fx, scale, step * half.max())
    return best


def _minimise(x: Array, pairs: _Pairs, focal: float, scale: float, step: float) -> Array:
    """Return the minimum of the cost near x, (3,). `step` is the size of the first simplex in x/z and y/z."""
    minimum = minimize(
        lambda y: float(_cost(y[None], pairs, focal, scale)[0]),
        x,
        method="Nelder-Mead",
        options={
            "initial_simplex": x + np.vstack([np.zeros(3), np.diag([step, step, 2.0 * step])]),
            "xatol": 1e-5,
            "fatol": 1e-6,
            "maxfev": 200,
        },
    )
    return np.asarray(minimum.x)


def _disc_angle(paths: Sequence[Path], rig: Rig, pose: Pose) -> float:
    """Return the angular radius of the discs, rad, seen from the ball's centre, from the areas of the moving spots.

    Raises CalibrationError if no disc is whole.
    """
    uv, area = np.concatenate([p.centre for p in paths]), np.concatenate([p.area for p in paths])
    directions, index = directions_at(uv, rig, pose)
    area_ratio = area[index] / appearance(directions, rig, pose).area
    area_ratio = area_ratio[np.isfinite(area_ratio)]
    if len(area_ratio) == 0:
        raise CalibrationError(
            "all discs that turn lie at the ball's edge in the picture",
            "show the ball from another side, and roll it on",
        )
    return rig.disc_angle * float(np.sqrt(np.median(area_ratio)))
