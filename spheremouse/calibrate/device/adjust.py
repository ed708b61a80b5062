"""Adjustment of a device: targets, ball and discs with their joint covariance, from image points.

Wittich 2017, sections 2.4.4, 3.7 and 4.3: a bundle adjustment, the same with its discs on a sphere, and a translation
to the sphere's centre (eq. 91, 92).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from spheremouse.ball.device import Device, DistanceError
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.calibrate.device.bundle import (
    INTERIOR,
    Block,
    ImagePoints,
    Problem,
    Solution,
    checked_residuals,
    columns_of,
    distance_residuals,
    distances,
    image_rms,
    predicted,
    solve_block,
)
from spheremouse.calibrate.device.start import TargetViews
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.least_squares.adjust import outlier_statistic, variance_factors
from spheremouse.geometry.least_squares.sphere import MIN_POINTS, algebraic_sphere, off_sphere, out_of_round
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.geometry.statistics import gate

DOUBTFUL_RMS = 0.5  # px; sharp photos of the right camera stay far below

_OUTLIER_CHI2 = gate(1.0 - 1e-4, 2)  # one normal error in ten thousand exceeds it
_HUBER_KNEE = 2.0  # standard deviations, before false points are known
_MAX_DISTANCE_SIGMAS = 3.5  # standard deviations of a distance from the photos


@dataclass(frozen=True, slots=True)
class DiscViews:
    """Image points of the ball."""

    image: ImagePoints  # `photo` counts those of TargetViews, `point` the discs from 0
    position: Array  # (m, 3) m of the discs in the frame of the targets, roughly


@dataclass(frozen=True, slots=True)
class MeasuredPoints:
    """Image points with their residuals."""

    photo: NDArray[np.intp]  # (n,) counts DeviceCalibration.photos
    point: NDArray[np.intp]  # (n,) targets first, then discs; -1 for a false one
    centre: Array  # (n, 2) px
    residual: Array  # (n, 2) px, predicted minus measured
    used: NDArray[np.bool_]  # (n,) False for a false one


@dataclass(frozen=True, slots=True)
class DeviceCalibration:
    """A calibrated device in `obj`, with the origin at the ball's centre. If the scale is free, the unit is the radius.

    `covariance` is joint, of [targets (3n), radius, poses (6 each: position, rotation), discs (3 each)].
    """

    device: Device
    camera: InteriorOrientation  # adjusted, with covariance
    photos: tuple[int, ...]  # those used, in the order of the photos given
    poses: tuple[Pose, ...]
    targets: Array  # (n, 3) m
    radius: float  # m
    discs: Array  # (m, 3) m, on the ball
    sightings: NDArray[np.intp]  # (m,) number of photos that show each
    covariance: Array  # (k, k) m, rad, in the order above
    centre: Array  # (3,) of the ball in the frame of the bundle, with its origin at the first target of the axes
    ball_covariance: Array  # (4, 4) of that centre and the radius
    out_of_round: float  # standard deviation of the discs from the sphere; 0: round
    measured: MeasuredPoints
    rms_px: float  # of all image points used, per axis
    variance_factors: tuple[float, float]  # of targets and discs: estimated over assumed
    distance_residuals: Array  # (k,) m, adjusted minus measured
    ring_scale: float  # size of the rings in the photos over `target_radii`; 1 within a percent
    scale_free: bool
    unit: float  # m, by the rings' size, of a free scale; 1 if the scale is metric
    skipped: tuple[tuple[int, str], ...]  # photos left out, with the reason
    doubtful: tuple[tuple[int, str], ...]  # photos without usable discs, with the reason
    problem: Problem  # the weighted observations
    solution: Solution  # the bundle, in its own frame and in m

    @property
    def directions(self) -> Array:
        """Unit vectors to the discs, (m, 3), in `ball`, which equals `obj` in the photos."""
        return self.discs / np.linalg.norm(self.discs, axis=1, keepdims=True)

    def block(self, name: str) -> slice:
        """Return the place of `targets`, `radius`, `poses` or `discs` in `covariance`."""
        ends = np.cumsum([0, 3 * len(self.targets), 1, 6 * len(self.poses), 3 * len(self.discs)])
        i = ("targets", "radius", "poses", "discs").index(name)
        return slice(int(ends[i]), int(ends[i + 1]))

    def rig(self) -> Rig:
        targets, radius = self.block("targets"), self.block("radius")
        ball = np.zeros((4, 4))
        ball[3, 3] = self.covariance[radius, radius].item()
        cross = np.zeros((3 * len(self.targets), 4))
        cross[:, 3] = self.covariance[targets, radius][:, 0]
        d = self.device
        return Rig(
            self.camera,
            Ball(self.radius, np.zeros(3), ball),
            Targets(d.ids, d.codes, self.targets, self.covariance[targets, targets].copy(), d.target_radii / self.unit),
            d.disc_radius / self.unit,
            readout_sigma_s=UNKNOWN_READOUT,
            disc_directions=self.directions,
            cross_covariance=cross,
            scale_free=self.scale_free,
        )

    def disc_map(self) -> DiscMap:
        """Return the map with which the first run of the tracker begins.

        It has the discs' directions, and their joint covariance along `tangent_basis`.
        """
        block, radii = self.block("discs"), np.linalg.norm(self.discs, axis=1)
        by_position = np.swapaxes(tangent_basis(self.directions), 1, 2) / radii[:, None, None]  # (m, 2, 3)
        J = np.asarray(block_diag(*by_position), float)
        return DiscMap(self.directions, J @ self.covariance[block, block] @ J.T, self.sightings)


@dataclass(frozen=True, slots=True)
class BundleResult:
    """Result of bundle and sphere."""

    problem: Problem  # of the image points used
    everything: ImagePoints
    used: NDArray[np.bool_]  # (n,) of `everything`
    solution: Solution
    factors: tuple[float, float]  # variance factors of targets and discs: estimated over assumed

    @property
    def ball(self) -> Array:
        """Centre and radius of the ball, (4,) m."""
        assert self.solution.block.ball is not None
        return self.solution.block.ball


def adjust_bundle(
    views: TargetViews, discs: DiscViews, block: Block, device: Device, camera: InteriorOrientation
) -> BundleResult:
    """Adjust bundle and sphere: robustly, then without outliers, then with estimated variances.

    Raises CalibrationError if a target does not fit the photos, or if outliers remain after 40 rounds.
    """
    n = len(device.ids)
    both = views.image, replace(discs.image, point=n + discs.image.point)
    image = ImagePoints(
        *(np.concatenate([getattr(part, name) for part in both]) for name in ("photo", "point", "centre", "covariance"))
    )
    is_disc = image.point >= n
    points = np.concatenate([block.points[:n], discs.position])
    refused, left_out, without_discs = (np.zeros(len(image), dtype=bool) for _ in range(3))
    factors, knee, given = np.ones(2), _HUBER_KNEE, None
    for _ in range(40):
        used = ~refused & ~left_out & ~(without_discs & is_disc)
        used &= _fixed(image, used, block, points, n, device.disc_radius)[image.point]
        given = used | ~is_disc if given is None else given
        turned = _turned(image.photo, given & ~without_discs, used, is_disc)
        if turned is not None:
            refused[(image.photo == turned) & ~is_disc] = False
            without_discs |= image.photo == turned
            continue
        kept, index = np.unique(image.point[used], return_inverse=True)
        _require_targets(kept, device)
        factor = np.where(is_disc[used], factors[1], factors[0])[:, None, None]
        weighted = ImagePoints(image.photo[used], index, image.centre[used], factor * image.covariance[used])
        problem = Problem(device, camera, weighted, not device.distances)
        start = replace(block, points=points[kept], ball=None)  # outliers need free discs
        try:
            solution = solve_block(problem, start, knee)
        except np.linalg.LinAlgError as e:
            left_out |= image.point == _undetermined_disc(e, problem, start, kept)
            continue
        block, points[kept], knee = solution.block, solution.block.points, np.inf
        residual, cofactor = checked_residuals(solution, slice(2 * len(weighted)), 2)
        number = np.diagonal(cofactor, axis1=1, axis2=2)
        groups = [~is_disc[used], is_disc[used]]
        now = variance_factors(residual, number, groups, factors)
        spread = now / factors
        statistic = outlier_statistic(residual, cofactor) / np.where(is_disc[used], spread[1], spread[0])
        worst = np.zeros(len(kept))
        np.maximum.at(worst, index, statistic)
        false = (statistic > _OUTLIER_CHI2) & (statistic == worst[index])
        if np.any(false):
            refused[np.flatnonzero(used)[false]] = True
        elif np.any(np.abs(np.log(spread)) > 0.02):
            factors = now
        else:
            ball, outside = _ball(solution, n)
            if not np.any(outside):
                problem, solution = _on_ball(problem, solution, ball)
                return BundleResult(problem, image, used, solution, (float(factors[0]), float(factors[1])))
            left_out |= np.isin(image.point, kept[n:][outside])
    raise CalibrationError(
        "the photos do not agree among themselves: are they all of this camera, in the mode of the camera file, and "
        "did the ball stay still between them?"
    )


def shift_to_ball(result: BundleResult, views: TargetViews, device: Device) -> DeviceCalibration:
    """Move the origin to the ball's centre (eq. 91, 92), with the joint covariance."""
    solution, block, n, ball = result.solution, result.solution.block, len(device.ids), result.ball
    unit = 1.0 if device.distances else float(ball[3])
    covariance = _covariance_about_ball(solution, n, unit, in_radii=not device.distances)
    poses = []
    for i, pose in enumerate(block.poses):
        here = slice(3 * n + 1 + 6 * i, 3 * n + 7 + 6 * i)
        poses.append(Pose(pose.rotation, (pose.position - ball[:3]) / unit, covariance[here, here].copy()))
    points = (block.points - ball[:3]) / unit
    measured = _all_image_points(result)
    return DeviceCalibration(
        device=device,
        camera=replace(block.camera, covariance=solution.covariance[:INTERIOR, :INTERIOR].copy()),
        photos=views.photos,
        poses=tuple(poses),
        targets=points[:n],
        radius=float(ball[3]) / unit,
        discs=points[n:],
        sightings=np.bincount(result.problem.image.point, minlength=len(points))[n:],
        covariance=covariance,
        centre=ball[:3] / unit,
        ball_covariance=solution.covariance[-4:, -4:] / unit**2,
        out_of_round=result.problem.out_of_round / unit,
        measured=measured,
        rms_px=float(np.sqrt(np.mean(measured.residual[result.used] ** 2))),
        variance_factors=result.factors,
        distance_residuals=distances(device, block.points) - np.array([d.metres for d in device.distances]),
        ring_scale=_ring_scale(views, block),
        scale_free=not device.distances,
        unit=unit,
        skipped=views.skipped,
        doubtful=(),
        problem=result.problem,
        solution=solution,
    )


def _covariance_about_ball(solution: Solution, n: int, unit: float, in_radii: bool) -> Array:
    """Joint covariance of `DeviceCalibration`, of [n targets, radius, poses, discs], lengths over `unit`."""
    block, columns = solution.block, solution.columns
    points, poses = columns.point(np.arange(columns.points)), columns.pose(np.arange(columns.photos))
    of_row = np.concatenate([points[:n].ravel(), [columns.all - 1], poses.ravel(), points[n:].ravel()])
    J = np.zeros((len(of_row), columns.all))
    J[np.arange(len(J)), of_row] = 1.0
    turns = 3 * n + 1 + (np.arange(columns.photos)[:, None] * 6 + np.arange(3, 6)).ravel()
    lengths = np.setdiff1d(np.arange(len(J)), turns)
    places = lengths[lengths != 3 * n]  # all but the radius: they count from the centre
    J[places, columns.all - 4 + np.arange(len(places)) % 3] = -1.0
    if in_radii:  # y = x / R
        x = np.zeros(columns.all)
        x[poses[:, :3]], x[points], x[-4:] = [p.position for p in block.poses], block.points, block.ball
        y = J[lengths] @ x
        J[lengths] /= unit
        J[lengths, columns.all - 1] -= y / unit**2
    covariance = J @ solution.covariance @ J.T
    return 0.5 * (covariance + covariance.T)


def _all_image_points(result: BundleResult) -> MeasuredPoints:
    """All image points, with the residuals of those used."""
    everything, used, image = result.everything, result.used, result.problem.image
    index = np.full(len(everything), -1)
    index[used] = np.unique(everything.point[used], return_inverse=True)[1]
    residual = np.full((len(everything), 2), np.nan)
    residual[used] = predicted(result.solution.block, image, result.problem)[0] - image.centre
    return MeasuredPoints(everything.photo, index, everything.centre, residual, used)


def check_distances(result: BundleResult, device: Device) -> None:
    """Raise DistanceError for a tape distance that contradicts photos and other distances (Baarda 1968).

    Raises CalibrationError if the photos do not even fit each other. Distances without redundancy are not checked.
    """
    residual, redundancies = distance_residuals(result.problem, result.solution)
    checked = redundancies > 1e-3
    if not np.any(checked):
        return
    sigmas = np.where(checked, np.abs(residual) / np.sqrt(np.where(checked, redundancies, 1.0)), 0.0)
    worst = int(np.argmax(sigmas))
    if sigmas[worst] <= _MAX_DISTANCE_SIGMAS:
        return
    rms = image_rms(result.problem, result.solution)
    if rms > DOUBTFUL_RMS:
        raise CalibrationError(
            f"photos and distances contradict each other, and the photos themselves are {rms:.1f} px off: does "
            "the camera file belong to this camera, mode and focus?"
        )
    by_others = device.distances[worst].metres + residual[worst] / redundancies[worst] * device.distances[worst].sigma
    raise DistanceError(device, worst, by_others, float(sigmas[worst]))


def _turned(
    photo: NDArray[np.intp], given: NDArray[np.bool_], used: NDArray[np.bool_], is_disc: NDArray[np.bool_]
) -> int | None:
    """Return the photo of which most targets or most discs, `given` (n,), are not `used`; None if there is none.

    The ball turned before that photo: its targets and its discs cannot both fit the others.
    """
    n = int(photo.max()) + 1
    lost = [
        np.bincount(photo[of & ~used], minlength=n) / np.maximum(np.bincount(photo[of], minlength=n), 1)
        for of in (given & is_disc, given & ~is_disc)
    ]
    worst = np.maximum(*lost)
    return int(np.argmax(worst)) if worst.max() > 0.5 else None


def _fixed(
    image: ImagePoints, used: NDArray[np.bool_], block: Block, points: Array, targets: int, depth: float
) -> NDArray[np.bool_]:
    """Return True for `points`, (m,), that two used photos show, discs from directions that fix their depth.

    The first points are the `targets`. The depth of a disc needs a standard deviation below `depth` m, a disc's radius.
    Rays of photos from one place do not fix it: in the adjustment the disc would run to infinity.
    """
    fixed = np.bincount(image.point, used, minlength=len(points)) >= 2
    positions = np.array([pose.position for pose in block.poses])
    for k in targets + np.flatnonzero(fixed[targets:]):
        mine = np.flatnonzero(used & (image.point == k))
        way = points[k] - positions[image.photo[mine]]
        length = np.linalg.norm(way, axis=1)
        ray = way / length[:, None]
        parallax = np.linalg.norm(ray[:, None] - ray[None], axis=2)
        sigma = length * np.sqrt(np.trace(image.covariance[mine], axis1=1, axis2=2) / 2.0) / block.camera.fx
        fixed[k] = np.any(np.hypot(sigma[:, None], sigma[None]) < depth * parallax)
    return fixed


def _undetermined_disc(error: np.linalg.LinAlgError, problem: Problem, block: Block, kept: NDArray[np.intp]) -> int:
    """The disc that is not determined, as its rays are nearly alike; CalibrationError if it is another unknown."""
    columns = columns_of(problem, block)
    column = int(columns.free[error.args[0]]) - int(columns.point(0)[0])
    if column < 0:
        raise CalibrationError("a photo does not determine its pose: leave out photos with few targets") from None
    if column < 3 * problem.targets:
        raise CalibrationError("the photos do not fix the targets: take them from places further apart") from None
    return int(kept[column // 3])


def _require_targets(kept: NDArray[np.intp], device: Device) -> None:
    lost = [c for i, c in enumerate(device.codes) if i not in kept]
    if lost:
        raise CalibrationError(
            f"target {', '.join(lost)} does not fit the earlier photos: this or another target was moved between photos"
        )


def _ball(solution: Solution, n: int) -> tuple[Array, NDArray[np.bool_]]:
    """Sphere (4,) through all points but the first n, and True for those off it: bolts, dark spots of frame and room.

    Raises CalibrationError for fewer than five points, or for points in a plane.
    """
    discs, where = solution.block.points[n:], solution.columns.point(np.arange(n, solution.columns.points))
    if len(discs) < MIN_POINTS:
        raise CalibrationError(
            f"{len(discs)} discs on the ball are known, a sphere takes at least {MIN_POINTS}: show more of them"
        )
    centre, radius = algebraic_sphere(discs)
    if not np.isfinite(radius):
        raise CalibrationError("the discs lie in a plane: photograph more of the ball")
    blocks = np.stack([solution.covariance[np.ix_(w, w)] for w in where])
    return np.array([*centre, radius]), off_sphere(discs, blocks, centre, radius)


def _on_ball(problem: Problem, solution: Solution, ball: Array) -> tuple[Problem, Solution]:
    """Adjust once more with the discs on a sphere, near `ball` (4,); a ball out of round lets them scatter about it."""
    discs = solution.columns.point(np.arange(problem.targets, solution.columns.points)).ravel()
    C = solution.covariance[np.ix_(discs, discs)]
    try:
        scatter = out_of_round(solution.block.points[problem.targets :], C, ball[:3], float(ball[3]))
        problem = replace(problem, out_of_round=scatter)
        return problem, solve_block(problem, replace(solution.block, ball=ball))
    except (np.linalg.LinAlgError, CalibrationError):
        raise CalibrationError("the discs do not fix a sphere: photograph more of the ball") from None


def _ring_scale(views: TargetViews, block: Block) -> float:
    """Size of the rings in the photos over that in device.yaml; 1 within a percent."""
    image = views.image
    R = np.array([p.rotation for p in block.poses])[image.photo]
    P = np.array([p.position for p in block.poses])[image.photo]
    z = np.einsum("ni,ni->n", R[:, :, 2], block.points[image.point] - P)
    return float(np.median(z / views.depth[:, 0])) * views.ring_scale
