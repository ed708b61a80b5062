"""Photos of a device -> where its targets, its ball and the ball's discs are, with all covariances.

Wittich 2017, sections 3.3 and 4.3: targets give the cameras' poses, rays give discs, a bundle adjustment gives both
exactly, a sphere through the discs gives the ball; then everything is moved to its centre (eq. 91, 92). Discs are
measured twice: as dark spots at first, and once the ball is known as what they must look like on it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.stats import chi2

from spheremouse.adjustment.bundle import (
    INTERIOR,
    Block,
    ImagePoints,
    Problem,
    Solution,
    columns_of,
    distances,
    predicted,
    solve_block,
)
from spheremouse.adjustment.correspond import Spots, ball_rig, near_sphere, numbered, on_ball
from spheremouse.adjustment.device import Device, DistanceError
from spheremouse.adjustment.solve import redundancy, snooped, variance_factors
from spheremouse.adjustment.sphere import FEWEST, Sphere, fit_sphere, off_sphere
from spheremouse.adjustment.start import TargetViews, first_block, target_views
from spheremouse.camera import InteriorOrientation, Pose
from spheremouse.detect.blobs import BlobDetector, BlobSettings
from spheremouse.detect.detections import Detections, Image
from spheremouse.detect.discs import DiscSettings, disc_detector
from spheremouse.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.disc_map import DiscMap
from spheremouse.errors import CalibrationError
from spheremouse.rig import UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.rotation import Array, exp, hat, tangent_basis

_TARGET_SIGMA = 0.05  # px, of a ring's centre (resect.PoseSettings)
_SPOT_SIGMA = 0.5  # px, of a dark spot's centroid: threshold, slope of the light, eccentricity
_FALSE = float(chi2.ppf(1.0 - 1e-4, 2))  # an image point further off than chance puts one of ten thousand
_HUBER = 2.0  # standard deviations from which on residuals count less, before false ones are known
_BLURRED = 0.5  # px RMS that sharp photos with a camera file of their own stay far below
_CONTRADICTS = 3.5  # standard deviations by which a distance must not miss what the photos say


@dataclass(frozen=True, slots=True)
class DiscViews:
    """Image points of the ball."""

    photo: NDArray[np.intp]  # (n,) counts those of TargetViews
    disc: NDArray[np.intp]  # (n,) from 0
    centre: Array  # (n, 2) px
    covariance: Array  # (n, 2, 2) px²
    position: Array  # (m, 3) m of the discs in the frame of the targets, roughly


@dataclass(frozen=True, slots=True)
class Measured:
    """One image point, and what became of it."""

    photo: NDArray[np.intp]  # (n,) in the order of the photos given
    point: NDArray[np.intp]  # (n,) targets first, then discs; -1 for a false one
    centre: Array  # (n, 2) px
    residual: Array  # (n, 2) px, predicted minus measured
    used: NDArray[np.bool_]  # (n,) False for a false one


@dataclass(frozen=True, slots=True)
class DeviceCalibration:
    """Everything in `obj`, whose origin is the ball's centre; where the scale is free, in radii of the ball.

    `covariance` is joint, of [targets (3n), radius, poses (6 each: position, rotation), discs (3 each)].
    """

    device: Device
    camera: InteriorOrientation  # adjusted, with covariance
    photos: tuple[int, ...]  # those used, in the order of the photos given
    poses: tuple[Pose, ...]
    targets: Array  # (n, 3)
    radius: float
    discs: Array  # (m, 3), on the ball
    sightings: NDArray[np.intp]  # (m,) photos that show each
    covariance: Array
    centre: Array  # (3,) of the ball in the frame of the bundle, whose origin is the first target of the axes
    ball_covariance: Array  # (4, 4) of that centre and the radius
    out_of_round: float  # standard deviation that the discs ask for; 0: round
    measured: Measured
    rms_px: float  # of all image points used, per axis
    variance_factors: tuple[float, float]  # of targets and discs: found over assumed
    distance_residuals: Array  # (k,) m, adjusted minus measured
    ring_scale: float  # size of the rings in the photos over `target_radii`; 1 but for a percent
    scale_free: bool
    unit: float  # m (by the rings' size) that 1 stands for; 1 where the scale is metric
    skipped: tuple[tuple[int, str], ...]  # photos left out, and why
    problem: Problem  # for what-if questions: the observations as they were weighted
    solution: Solution  # the bundle, before the sphere, in its own frame and in m
    sphere: Sphere  # in that frame

    @property
    def directions(self) -> Array:
        """Unit vectors to the discs, (m, 3), in `ball`, which is `obj` as the ball lay in the photos."""
        return self.discs / np.linalg.norm(self.discs, axis=1, keepdims=True)

    def block(self, name: str) -> slice:
        """Where `targets`, `radius`, `poses` or `discs` are in `covariance`."""
        ends = np.cumsum([0, 3 * len(self.targets), 1, 6 * len(self.poses), 3 * len(self.discs)])
        i = ("targets", "radius", "poses", "discs").index(name)
        return slice(int(ends[i]), int(ends[i + 1]))

    def rig(self) -> Rig:
        """What a tracker needs."""
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
        """The discs with the joint covariance of their directions, for the first run to begin with."""
        m = len(self.discs)
        across = tangent_basis(self.directions) / np.linalg.norm(self.discs, axis=1)[:, None, None]  # (m, 3, 2)
        J = np.zeros((2 * m, 3 * m))
        for i in range(m):
            J[2 * i : 2 * i + 2, 3 * i : 3 * i + 3] = across[i].T
        discs = self.block("discs")
        return DiscMap(self.directions, J @ self.covariance[discs, discs] @ J.T, self.sightings)


Progress = Callable[[str, float], None]  # what is being done, and which part of all is done


def calibrate_device(
    photos: Sequence[Callable[[], Image]],
    device: Device,
    camera: InteriorOrientation,
    rings: RingSettings | None = None,
    discs: DiscSettings | None = None,
    names: Sequence[str] | None = None,
    progress: Progress = lambda what, part: None,
) -> DeviceCalibration:
    """Calibrate a device from photos (h, w, 3) BGR that were taken with `camera`; each is read once.

    `names` are those of the photos, for messages; `progress` is told what is being done and which part of all is done.
    Photos that show fewer than three targets, or another device, are left out and named. Raises CalibrationError where
    too little remains, DistanceError where a tape distance contradicts the photos.
    """
    rings, discs = rings or RingSettings(), discs or DiscSettings()
    named = [f"photo {k + 1}" for k in range(len(photos))] if names is None else names
    seen, grey = [], []
    for k, read in enumerate(photos):
        progress("looking for targets", 0.4 * k / len(photos))
        image = read()
        seen.append(detect_targets(image, device.target_radii, rings))
        grey.append(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    views = target_views(seen, device, camera, _TARGET_SIGMA)
    block, views = first_block(views, device, camera, named)
    progress("looking for the ball", 0.45)
    here = [(grey[k], seen[k]) for k in views.photos]
    tolerance = _ray_tolerance(views, block, device, camera)

    def found(size: float) -> _Result:
        """With discs of that part of their radius."""
        sized = replace(device, disc_radius=size * device.disc_radius)
        observed = _first_discs(here, block, sized, discs, tolerance)
        result = _adjusted(views, observed, block, sized, camera)
        _check_distances(result, sized)
        for turn in range(2):  # the second time with the ball where the first one found it
            progress("measuring discs", 0.5 + 0.2 * turn)
            observed = _measured_discs(here, result, sized, discs)
            progress("adjusting", 0.6 + 0.2 * turn)
            result = _adjusted(views, observed, result.solution.block, sized, camera)
        return result

    try:
        return _moved_to_ball(found(1.0), views, device)
    except DistanceError:
        raise
    except CalibrationError as e:
        for size, what in ((0.5, "half"), (2.0, "twice")):  # a diameter given for a radius is what happens
            try:
                n = len(found(size).solution.block.points) - len(device.ids)
            except CalibrationError:
                continue
            raise CalibrationError(
                f"{n} discs are seen on the ball, but {what} as large as disc_radius says ({device.disc_radius:g} m): "
                "give their radius, not the diameter, in metres"
            ) from None
        raise e from None


def adjust_device(
    views: TargetViews, discs: DiscViews, block: Block, device: Device, camera: InteriorOrientation
) -> DeviceCalibration:
    """Calibrate a device from image points whose correspondence is known, from an approximate block.

    Raises what `calibrate_device` raises.
    """
    return _moved_to_ball(_adjusted(views, discs, block, device, camera), views, device)


@dataclass(frozen=True, slots=True)
class _Result:
    problem: Problem  # of the image points used
    everything: ImagePoints
    used: NDArray[np.bool_]
    solution: Solution
    sphere: Sphere
    factors: tuple[float, float]


def _spots(grey: Image, seen: TargetDetections, share: float, settings: DiscSettings) -> Detections:
    """Dark spots that may be discs: `share` of the targets' radius, nearer or further off, straight or aslant."""
    face = np.pi * (float(np.median(seen.radius)) * share) ** 2
    detector = BlobDetector(BlobSettings(masks=24, min_area=max(0.1 * face, 12.0), max_area=4.0 * face))
    return detector.detect(cv2.bitwise_not(grey) if settings.polarity == "light" else grey)


def _first_discs(
    photos: Sequence[tuple[Image, TargetDetections]],
    block: Block,
    device: Device,
    settings: DiscSettings,
    tolerance: float,
) -> DiscViews:
    """Dark spots that lie on one ball, numbered. Raises CalibrationError where there is none."""
    found = [_spots(grey, seen, device.disc_radius / device.target_radii[2], settings) for grey, seen in photos]
    spots = Spots(
        np.repeat(np.arange(len(found)), [len(f) for f in found]),
        np.concatenate([f.centre for f in found]),
        np.concatenate([f.area for f in found]),
    )
    K, R = near_sphere(spots, block.poses, block.camera, device.disc_radius, tolerance)
    covariance = np.broadcast_to(_SPOT_SIGMA**2 * np.eye(2), (len(spots), 2, 2))
    return _numbered_points(spots.photo, spots.centre, covariance, block, K, R, device.disc_radius)


def _measured_discs(
    photos: Sequence[tuple[Image, TargetDetections]], result: "_Result", device: Device, settings: DiscSettings
) -> DiscViews:
    """Discs measured as what they must look like on the ball found so far."""
    block, K, R = result.solution.block, result.sphere.centre, result.sphere.radius
    rig = ball_rig(block.camera, K, R, device.disc_radius)
    seen = [
        disc_detector(settings, rig, pose).detect(grey) for (grey, _), pose in zip(photos, block.poses, strict=True)
    ]
    photo = np.repeat(np.arange(len(seen)), [len(d) for d in seen])
    centre, covariance = np.concatenate([d.centre for d in seen]), np.concatenate([d.covariance for d in seen])
    return _numbered_points(photo, centre, covariance, block, K, R, 0.5 * device.disc_radius)


def _ray_tolerance(views: TargetViews, block: Block, device: Device, camera: InteriorOrientation) -> float:
    """m by which rays to one disc may pass each other while the poses rest on the targets alone.

    Three standard deviations of two rays where the targets are, by the covariance of the poses and of a spot.
    """
    rough = replace(views.image, covariance=4.0 * views.image.covariance)  # eccentricity of the circles, camera, print
    solution = solve_block(Problem(device, camera, rough, not device.distances, views.depth), block)
    middle = solution.block.points.mean(axis=0)
    worst = 0.0
    for i, pose in enumerate(solution.block.poses):
        columns = solution.columns.pose(i)
        across = np.eye(3) - np.outer(pose.rotation[:, 2], pose.rotation[:, 2])
        J = across @ np.concatenate([np.eye(3), -hat(middle - pose.position)], axis=1)
        spot = _SPOT_SIGMA * np.linalg.norm(middle - pose.position) / block.camera.fx
        C = J @ solution.covariance[np.ix_(columns, columns)] @ J.T
        worst = max(worst, float(np.sqrt(np.linalg.eigvalsh(C)[-1] + spot**2)))
    return 3.0 * np.sqrt(2.0) * worst


def _numbered_points(
    photo: NDArray[np.intp], centre: Array, covariance: Array, block: Block, K: Array, R: float, tolerance: float
) -> DiscViews:
    """Spots on the ball that are seen in two photos at least, `tolerance` m apart at most."""
    directions, index = on_ball(Spots(photo, centre, np.ones(len(photo))), block.poses, block.camera, K, R)
    number = numbered(photo[index], directions, tolerance / R)
    if number.max(initial=-1) + 1 < FEWEST:
        raise CalibrationError(
            f"{number.max(initial=-1) + 1} discs are seen in two photos or more, at least {FEWEST} are needed: take "
            "photos that overlap, and keep the ball still between them"
        )
    index, directions, number = index[number >= 0], directions[number >= 0], number[number >= 0]
    middle = np.stack([np.bincount(number, directions[:, j]) for j in range(3)], axis=1)
    middle *= R / np.linalg.norm(middle, axis=1, keepdims=True)
    return DiscViews(photo[index], number, centre[index], covariance[index], K + middle)


def _adjusted(
    views: TargetViews, discs: DiscViews, block: Block, device: Device, camera: InteriorOrientation
) -> _Result:
    """Bundle and sphere: robust, then without what is false, then with the variances that the residuals show."""
    n = len(device.ids)
    image = ImagePoints(
        np.concatenate([views.image.photo, discs.photo]),
        np.concatenate([views.image.point, n + discs.disc]),
        np.concatenate([views.image.centre, discs.centre]),
        np.concatenate([views.image.covariance, discs.covariance]),
    )
    is_disc = image.point >= n
    points = np.concatenate([block.points[:n], discs.position])
    used = np.ones(len(image), dtype=bool)
    factors, robust = np.ones(2), _HUBER
    for _ in range(40):
        used &= np.bincount(image.point, used, minlength=len(points))[image.point] >= 2
        kept, index = np.unique(image.point[used], return_inverse=True)
        _all_there(kept, device)
        factor = np.where(is_disc[used], factors[1], factors[0])[:, None, None]
        weighted = ImagePoints(image.photo[used], index, image.centre[used], factor * image.covariance[used])
        problem = Problem(device, camera, weighted, not device.distances)
        try:
            solution = solve_block(problem, replace(block, points=points[kept]), robust)
        except np.linalg.LinAlgError as e:
            used &= ~(image.point == _loose(e, problem, kept))
            continue
        block, points[kept], robust = solution.block, solution.block.points, None
        residual, cofactor = image_residuals(solution, len(weighted))
        number = np.diagonal(cofactor, axis1=1, axis2=2)
        groups = [~is_disc[used], is_disc[used]]
        now = variance_factors(residual, number, groups, factors)
        spread = now / factors
        off = snooped(residual, cofactor) / np.where(is_disc[used], spread[1], spread[0])
        worst = np.zeros(len(kept))
        np.maximum.at(worst, index, off)
        false = (off > _FALSE) & (off == worst[index])
        if np.any(false):
            used[np.flatnonzero(used)[false]] = False
        elif np.any(np.abs(np.log(spread)) > 0.02):
            factors = now
        else:
            sphere = _sphere(solution, n)
            outside = _outside(solution, sphere, n)
            if not np.any(outside):
                return _Result(problem, image, used, solution, sphere, (float(factors[0]), float(factors[1])))
            used &= ~np.isin(image.point, kept[n:][outside])
    raise CalibrationError(
        "the photos do not agree among themselves: are they all of this camera, in the mode of the camera file, and "
        "did the ball stay still between them?"
    )


def image_residuals(solution: Solution, n: int) -> tuple[Array, Array]:
    """Residuals of n image points over their standard deviations, (n, 2), and their cofactors, (n, 2, 2)."""
    free = solution.columns.free
    Q = solution.covariance[np.ix_(free, free)]
    rows = sparse.csr_array(solution.adjusted.jacobian[: 2 * n])
    return solution.adjusted.residual[: 2 * n].reshape(n, 2), redundancy(rows, Q, 2)


def _loose(error: np.linalg.LinAlgError, problem: Problem, kept: NDArray[np.intp]) -> int:
    """The disc that hangs in the air: rays nearly alike. Raises CalibrationError where it is something else."""
    columns = columns_of(problem, int(problem.image.photo.max()) + 1, len(kept))
    column = int(columns.free[error.args[0]]) - int(columns.point(0)[0])
    if column < 3 * problem.targets:
        raise CalibrationError("the photos do not fix the targets: take them from places further apart") from None
    return int(kept[column // 3])


def image_rms(problem: Problem, solution: Solution) -> float:
    """px, RMS per axis of the image points."""
    off = predicted(solution.block, problem.image, problem)[0] - problem.image.centre
    return float(np.sqrt(np.mean(off**2)))


def _all_there(kept: NDArray[np.intp], device: Device) -> None:
    lost = [c for i, c in enumerate(device.codes) if i not in kept]
    if lost:
        raise CalibrationError(
            f"target {', '.join(lost)} is not where the photos before say: it, or another, was moved between photos"
        )


def _sphere(solution: Solution, n: int) -> Sphere:
    """Through all points but the first n."""
    return fit_sphere(_vector(solution.block), solution.covariance, _where(solution, n))


def _where(solution: Solution, n: int) -> NDArray[np.intp]:
    return solution.columns.point(np.arange(n, len(solution.block.points)))


def _vector(block: Block) -> Array:
    """All columns as observations: interior orientation and rotations as what they are off, 0."""
    poses = [np.concatenate([pose.position, np.zeros(3)]) for pose in block.poses]
    return np.concatenate([np.zeros(INTERIOR), *poses, block.points.ravel()])


def _outside(solution: Solution, sphere: Sphere, n: int) -> NDArray[np.bool_]:
    """Which discs are none: bolts, dark spots of frame and room."""
    where = _where(solution, n)
    blocks = np.stack([solution.covariance[np.ix_(w, w)] for w in where])
    return off_sphere(solution.block.points[n:], blocks, sphere)


def _moved_to_ball(result: _Result, views: TargetViews, device: Device) -> DeviceCalibration:
    """Everything counted from the ball's centre (eq. 91, 92), with the joint covariance that it then has."""
    solution, sphere, columns = result.solution, result.sphere, result.solution.columns
    block, n = solution.block, len(device.ids)
    k, m = len(block.poses), len(block.points) - n
    unit = 1.0 if device.distances else sphere.radius
    joint = np.block(
        [
            [sphere.observation_covariance, sphere.cross_covariance],
            [sphere.cross_covariance.T, sphere.covariance],
        ]
    )
    l = sphere.observations
    centre_at = columns.all + np.arange(3)
    rows: list[tuple[NDArray[np.intp], bool]] = [(columns.point(i), True) for i in range(n)]
    rows.append((np.array([columns.all + 3]), False))
    for i in range(k):
        rows += [(columns.pose(i)[:3], True), (columns.pose(i)[3:], False)]
    rows += [(columns.point(n + i), True) for i in range(m)]
    J = np.zeros((3 * n + 1 + 6 * k + 3 * m, columns.all + 4))
    at = 0
    for which, length in rows:
        J[at + np.arange(len(which)), which] = 1.0
        if length:
            J[at + np.arange(3), centre_at] = -1.0
        at += len(which)
    turns = 3 * n + 1 + (np.arange(k)[:, None] * 6 + np.arange(3, 6)).ravel()
    lengths = np.setdiff1d(np.arange(len(J)), turns)
    if not device.distances:  # in radii: y = x / R
        values = np.concatenate([l, sphere.centre, [sphere.radius]])
        y = J[lengths] @ values
        J[lengths] /= unit
        J[lengths, columns.all + 3] -= y / unit**2
    covariance = J @ joint @ J.T
    covariance = 0.5 * (covariance + covariance.T)
    K = sphere.centre
    poses = []
    for i, pose in enumerate(block.poses):
        here = slice(3 * n + 1 + 6 * i, 3 * n + 7 + 6 * i)
        step = l[columns.pose(i)]
        poses.append(Pose(exp(step[3:]) @ pose.rotation, (step[:3] - K) / unit, covariance[here, here].copy()))
    points = l[columns.point(np.arange(n + m))]
    interior = solution.covariance[:INTERIOR, :INTERIOR]
    index = np.full(len(result.everything), -1)
    index[result.used] = np.unique(result.everything.point[result.used], return_inverse=True)[1]
    uv = predicted(block, result.problem.image, result.problem)[0]
    residual = np.full((len(result.everything), 2), np.nan)
    residual[result.used] = uv - result.problem.image.centre
    return DeviceCalibration(
        device=device,
        camera=replace(block.camera, covariance=interior),
        photos=views.photos,
        poses=tuple(poses),
        targets=(points[:n] - K) / unit,
        radius=sphere.radius / unit,
        discs=(points[n:] - K) / unit,
        sightings=np.bincount(result.problem.image.point, minlength=n + m)[n:],
        covariance=covariance,
        centre=K / unit,
        ball_covariance=sphere.covariance / unit**2,
        out_of_round=sphere.out_of_round / unit,
        measured=Measured(result.everything.photo, index, result.everything.centre, residual, result.used),
        rms_px=float(np.sqrt(np.mean(residual[result.used] ** 2))),
        variance_factors=result.factors,
        distance_residuals=distances(result.problem, points[:n])[0] - np.array([d.metres for d in device.distances]),
        ring_scale=_ring_scale(views, block),
        scale_free=not device.distances,
        unit=unit,
        skipped=views.skipped,
        problem=result.problem,
        solution=solution,
        sphere=sphere,
    )


def _ring_scale(views: TargetViews, block: Block) -> float:
    """Size of the rings in the photos over what device.yaml says of them; 1 but for a percent."""
    image = views.image
    R = np.array([p.rotation for p in block.poses])[image.photo]
    P = np.array([p.position for p in block.poses])[image.photo]
    z = np.einsum("ni,ni->n", R[:, :, 2], block.points[image.point] - P)
    return float(np.median(z / views.depth[:, 0])) * views.ring_scale


def _check_distances(result: _Result, device: Device) -> None:
    """Refuse a distance that the photos and the others contradict; raises DistanceError."""
    k, at = len(device.distances), 2 * len(result.problem.image)
    residual = result.solution.adjusted.residual[at : at + k]
    free = result.solution.columns.free
    Q = result.solution.covariance[np.ix_(free, free)]
    number = redundancy(sparse.csr_array(result.solution.adjusted.jacobian[at : at + k]), Q)[:, 0, 0]
    checked = number > 1e-3
    if not np.any(checked):
        return
    sigmas = np.where(checked, np.abs(residual) / np.sqrt(np.where(checked, number, 1.0)), 0.0)
    worst = int(np.argmax(sigmas))
    if sigmas[worst] <= _CONTRADICTS:
        return
    rms = image_rms(result.problem, result.solution)
    if rms > _BLURRED:
        raise CalibrationError(
            f"photos and distances contradict each other, and the photos themselves are {rms:.1f} px off: is the "
            "camera file of this camera, mode and focus?"
        )
    says = device.distances[worst].metres + residual[worst] / number[worst] * device.distances[worst].sigma
    raise DistanceError(device, worst, says, float(sigmas[worst]))
