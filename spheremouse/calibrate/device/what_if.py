"""Expected accuracy of a calibrated device with further photos or distances, from the design alone.

The covariance comes from the bundle's Jacobian with rows for further photos, through the sphere to the ball. It gives a
number to the advice of Wittich 2017, section 4.3, to photograph from all sides.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.device import Distance
from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, design
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.least_squares.adjust import cofactors
from spheremouse.geometry.least_squares.sphere import fit_sphere
from spheremouse.geometry.rotation import Array, fibonacci_sphere

# Cosines of the largest slant of rings and discs that are found, and of the least angle between rays to a disc.
_TARGET_SLANT, _DISC_SLANT, _RAY_ANGLE = np.cos(np.radians([70.0, 65.0, 10.0]))
_SAMPLES = 2000  # places on the ball, for areas to some percent


@dataclass(frozen=True, slots=True)
class Sigmas:
    """Standard deviations in `obj`, m, or radii of the ball if the scale is free."""

    ball: Array  # (4,) centre X, Y, Z against the targets, radius
    targets: float  # of a coordinate, root mean square
    disc: float  # of the worst known disc, along its worst axis


@dataclass(frozen=True, slots=True)
class Network:
    """The design of a calibration in the frame of the bundle, m: geometry, and variances of image points."""

    problem: Problem
    block: Block  # discs on the ball
    centre: Array  # (3,)
    radius: float
    roughness: float  # out of round, standard deviation
    unit: float  # m, as in `DeviceCalibration`
    target_variance: float  # px², of a coordinate
    disc_variance: float  # px², over the share of discs that are found
    density: float  # discs per steradian where the photos show the ball

    @property
    def targets(self) -> Array:
        """(n, 3)"""
        return self.block.points[: self.problem.targets]

    @property
    def discs(self) -> Array:
        """(m, 3)"""
        return self.block.points[self.problem.targets :]

    @property
    def aim(self) -> Array:
        """Point between ball and targets that photos aim at, (3,)."""
        return 0.5 * (self.centre + self.targets.mean(axis=0))


def network(calibration: DeviceCalibration) -> Network:
    """Return the design of a calibration."""
    solution, sphere, problem = calibration.solution, calibration.sphere, calibration.problem
    n, m = problem.targets, len(solution.block.points)
    points = sphere.observations[solution.columns.point(np.arange(m))]
    is_disc = problem.image.point >= n
    variance = 0.5 * np.trace(problem.image.covariance, axis1=1, axis2=2)
    seen = problem.image.take(is_disc)
    bare = Network(
        problem,
        replace(solution.block, points=points),
        sphere.centre,
        sphere.radius,
        sphere.out_of_round,
        calibration.unit,
        float(np.median(variance[~is_disc])),
        float(np.median(variance[is_disc])),
        0.0,
    )
    rule = np.array([visible_discs(bare, pose, points[n:]) for pose in solution.block.poses])
    found = np.zeros_like(rule)
    found[seen.photo, seen.point - n] = True
    share = np.count_nonzero(found & rule) / max(np.count_nonzero(rule), 1)
    places = sphere.centre + sphere.radius * fibonacci_sphere(_SAMPLES)
    twice = np.sum([visible_discs(bare, pose, places) for pose in solution.block.poses], axis=0) >= 2
    area = 4.0 * np.pi * max(float(np.mean(twice)), 1.0 / _SAMPLES)
    return replace(bare, disc_variance=bare.disc_variance / max(share, 0.05), density=(m - n) / area)


def with_photos(net: Network, stations: tuple[Pose, ...]) -> Network:
    """Return the design with photos from further stations, and with the discs that they add."""
    problem, block = net.problem, net.block
    k, n, m = len(block.poses), problem.targets, len(block.points)
    poses = (*block.poses, *stations)
    new = _new_discs(net, poses)
    points = np.concatenate([block.points, new])
    photo, point = [], []
    for i, pose in enumerate(poses):
        sees = np.concatenate(
            [visible_targets(net, pose), visible_discs(net, pose, points[n:])] if i >= k
            else [np.zeros(m, dtype=bool), visible_discs(net, pose, new)]
        )  # fmt: skip
        photo.append(np.full(np.count_nonzero(sees), i))
        point.append(np.flatnonzero(sees))
    point = np.concatenate(point)
    variance = np.where(point < n, net.target_variance, net.disc_variance)
    image = ImagePoints(
        np.concatenate([problem.image.photo, *photo]),
        np.concatenate([problem.image.point, point]),
        np.concatenate([problem.image.centre, np.zeros((len(point), 2))]),
        np.concatenate([problem.image.covariance, variance[:, None, None] * np.eye(2)]),
    )
    return replace(net, problem=replace(problem, image=image), block=Block(block.camera, poses, points))


def with_distances(net: Network, pairs: tuple[tuple[int, int], ...], sigma: float) -> Network:
    """Return the design with distances between targets of these ids, to sigma m."""
    row = net.problem.device.row
    more = tuple(
        Distance(a, b, float(np.linalg.norm(net.targets[row[a]] - net.targets[row[b]])), sigma) for a, b in pairs
    )
    device = net.problem.device
    return replace(net, problem=replace(net.problem, device=replace(device, distances=(*device.distances, *more))))


def sigmas(net: Network, known: int) -> Sigmas:
    """Return the standard deviations of a design for the first `known` discs; LinAlgError if it is not determined."""
    J, columns = design(net.problem, net.block)
    n, m = net.problem.targets, len(net.block.points)
    where = columns.point(np.arange(m)).ravel()
    free = np.isin(where, columns.free)
    C = np.zeros((3 * m, 3 * m))
    C[np.ix_(free, free)] = cofactors(J, np.searchsorted(columns.free, where[free]))
    normal = (net.discs - net.centre) / net.radius
    for i, u in enumerate(normal):
        here = slice(3 * (n + i), 3 * (n + i) + 3)
        C[here, here] += net.roughness**2 * np.outer(u, u)
    sphere = fit_sphere(net.block.points.ravel(), C, np.arange(3 * n, 3 * m).reshape(-1, 3))
    last = 3 * (n + known)
    by_ball = np.zeros((last, 4))  # d of points counted from the centre by centre and radius; by themselves: 1
    by_ball[:, :3] = -np.tile(np.eye(3), (n + known, 1))
    if net.problem.scale_free:
        by_ball[:, 3] = -(net.block.points[: n + known] - net.centre).ravel() / net.radius
    mixed = sphere.cross_covariance[:last] @ by_ball.T
    D = sphere.observation_covariance[:last, :last] + mixed + mixed.T + by_ball @ sphere.covariance @ by_ball.T
    worst = max(float(np.linalg.eigvalsh(D[i : i + 3, i : i + 3])[-1]) for i in range(3 * n, last, 3))
    return Sigmas(
        np.sqrt(np.diag(sphere.covariance)) / net.unit,
        float(np.sqrt(np.mean(np.diag(D)[: 3 * n]))) / net.unit,
        float(np.sqrt(worst)) / net.unit,
    )


def visible_targets(net: Network, pose: Pose) -> NDArray[np.bool_]:
    """Return True for targets in a photo from a pose, (n,): in the picture, not behind the ball, and not too oblique.

    The line of sight must be within 70° of the targets' normal.
    """
    points = net.targets
    away = pose.position - points
    distance = np.linalg.norm(away, axis=1)
    faces = away[:, 2] > _TARGET_SLANT * distance
    u = away / distance[:, None]
    way = net.centre - points
    along = np.einsum("ni,ni->n", way, u)
    hidden = (along > 0.0) & (np.sum(way**2, axis=1) - along**2 < net.radius**2)
    return faces & ~hidden & _in_picture(net, pose, points, float(net.problem.device.target_radii[2]))


def visible_discs(net: Network, pose: Pose, points: Array) -> NDArray[np.bool_]:
    """Return True for discs at `points` on the ball in a photo from a pose, (m,), without obstacles."""
    away = pose.position - points
    cosine = np.einsum("ni,ni->n", away, points - net.centre) / np.linalg.norm(away, axis=1) / net.radius
    return (cosine > _DISC_SLANT) & _in_picture(net, pose, points, net.problem.device.disc_radius)


def camera_towards(net: Network, direction: Array, distance: float) -> Pose:
    """Return a camera at `distance` m from the aim, in the unit `direction` (3,) of the bundle's frame.

    It is rotated about its line of sight like the nearest pose.
    """
    towards = np.array([pose.position - net.aim for pose in net.block.poses])
    near = int(np.argmax(towards @ direction / np.linalg.norm(towards, axis=1)))
    z = -direction
    x = net.block.poses[near].rotation[:, 0]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), net.aim + distance * direction)


def _in_picture(net: Network, pose: Pose, points: Array, radius: float) -> NDArray[np.bool_]:
    camera = net.block.camera
    cam = pose.to_cam(points)
    uv, _ = project(cam, camera)
    z = np.where(cam[:, 2] > 0.0, cam[:, 2], np.nan)
    r2 = np.sum((cam[:, :2] / z[:, None]) ** 2, axis=1)
    margin = (camera.fx * radius / z)[:, None]
    with np.errstate(invalid="ignore"):
        inside = (uv > margin) & (uv < np.array([camera.width, camera.height]) - 1.0 - margin)
        return np.all(inside, axis=1) & (r2 < camera.fold_r2)  # beyond the fold the lens model is not unique


def _new_discs(net: Network, poses: tuple[Pose, ...]) -> Array:
    """Expected new discs, (k, 3): at the density of the known ones, where two photos now see the ball at an angle."""
    places = net.centre + net.radius * fibonacci_sphere(max(round(4.0 * np.pi * net.density), 1))
    seen = np.array([visible_discs(net, pose, places) for pose in poses])
    away = np.array([pose.position for pose in poses])[:, None] - places
    away /= np.linalg.norm(away, axis=2, keepdims=True)
    apart = np.einsum("amj,bmj->abm", away, away) < _RAY_ANGLE
    fixed = np.any(apart & seen[:, None] & seen[None], axis=(0, 1))
    return places[fixed & (np.sum(seen[: len(net.block.poses)], axis=0) < 2)]
