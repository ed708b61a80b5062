"""Bundle adjustment: image points of targets and discs in, poses of all photos and coordinates of all points out.

Wittich 2017, sections 2.4.4 and 4.3. Lengths are in m, in the frame of the targets (`Axes`). Its first target keeps its
place, the second its direction, the third its plane (the weights of table 8, taken to their limit). The interior
orientation is an observation with the covariance of its calibration. Without distances the scale is free; then the
first two targets keep their distance.
"""

import contextlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spheremouse.ball.device import Device
from spheremouse.geometry.camera import (
    InteriorOrientation,
    Pose,
    interior_jacobian,
    interior_vector,
    project,
    project_rings,
    with_interior,
)
from spheremouse.geometry.least_squares.adjust import Jacobian, adjust, cofactors, redundancy
from spheremouse.geometry.rotation import Array, exp, hat

INTERIOR = 9  # fx, fy, cx, cy, k1, k2, p1, p2, k3
_EXACT = 2e-6  # of the radius, standard deviation of discs on a round ball: far below their measurement's


@dataclass(frozen=True, slots=True)
class ImagePoints:
    """Measurements in the photos: n points, targets and discs alike."""

    photo: NDArray[np.intp]  # (n,)
    point: NDArray[np.intp]  # (n,) targets come first, discs after them
    centre: Array  # (n, 2) px: of a target the mean centroid of its circles, of a disc its centre
    covariance: Array  # (n, 2, 2) px²

    def __len__(self) -> int:
        return len(self.photo)

    def take(self, keep: NDArray[np.bool_]) -> "ImagePoints":
        """Select by a mask (n,)."""
        return ImagePoints(self.photo[keep], self.point[keep], self.centre[keep], self.covariance[keep])


@dataclass(frozen=True, slots=True)
class Block:
    """Estimates of the bundle adjustment."""

    camera: InteriorOrientation
    poses: tuple[Pose, ...]  # of the photos, in the frame of the targets
    points: Array  # (m, 3) m: targets, then discs
    ball: Array | None = None  # (4,) m, centre and radius of a sphere that holds the discs; None: they are free


@dataclass(frozen=True, slots=True)
class Problem:
    """Observations, and the definition of the frame."""

    device: Device
    camera: InteriorOrientation  # as calibrated, with the covariance that lets it move
    image: ImagePoints
    scale_free: bool
    depth: Array | None = None  # (n, 2) m: depth of each point in cam and its standard deviation, if it is a guess
    out_of_round: float = 0.0  # m, standard deviation of the discs from the sphere

    @property
    def targets(self) -> int:
        """Number of points that are targets."""
        return len(self.device.ids)


@dataclass(frozen=True, slots=True)
class Columns:
    """Places of the unknowns: interior, 6 for each pose (position, rotation), 3 for each point, then the ball's 4."""

    photos: int
    points: int
    ball: int  # 4, or 0 without a ball
    free: NDArray[np.intp]  # (f,) indices of the adjusted ones

    @property
    def all(self) -> int:
        """Unknowns and those held."""
        return INTERIOR + 6 * self.photos + 3 * self.points + self.ball

    def pose(self, photo: NDArray[np.intp] | int) -> NDArray[np.intp]:
        """Return the columns of poses, (..., 6)."""
        return INTERIOR + 6 * np.asarray(photo)[..., None] + np.arange(6)

    def point(self, point: NDArray[np.intp] | int) -> NDArray[np.intp]:
        """Return the columns of points, (..., 3)."""
        return INTERIOR + 6 * self.photos + 3 * np.asarray(point)[..., None] + np.arange(3)


@dataclass(frozen=True, slots=True)
class Solution:
    """A block adjusted."""

    block: Block
    columns: Columns
    covariance: Array  # (all, all) of all columns at unit variance factor; 0 where they are held
    # (r,) of unit variance, in this order: two of each image point, one of each distance, a guessed depth of each image
    # point, the known part of the interior orientation, one of each disc on a ball
    residual: Array
    jacobian: Jacobian  # (r, f) of the residuals by the free unknowns


def columns_of(problem: Problem, block: Block) -> Columns:
    """Return the adjusted columns: all but those that define the frame."""
    device = problem.device
    row, axes = device.row, device.axes
    ball = 0 if block.ball is None else 4
    everything = Columns(len(block.poses), len(block.points), ball, np.zeros(0, dtype=np.intp))
    held = [*everything.point(row[axes.origin]), *everything.point(row[axes.up])[[0, 2]]]
    held.append(everything.point(row[axes.plane])[2])
    if problem.scale_free:
        held.append(everything.point(row[axes.up])[1])
    held += np.flatnonzero(np.diag(problem.camera.covariance) == 0.0).tolist()
    return replace(everything, free=np.setdiff1d(np.arange(everything.all), held))


def solve_block(problem: Problem, block: Block, knee: float = np.inf) -> Solution:
    """Adjust a block from an approximation; LinAlgError if an unknown is not determined.

    `knee` is that of Huber's function in standard deviations; infinite: least squares.
    """
    columns = columns_of(problem, block)
    block = adjust(
        lambda block: evaluate(problem, block, columns),
        block,
        lambda block, step: apply_step(block, columns, step),
        "some observation belongs to something else",
        knee,
    )
    residual, jacobian = evaluate(problem, block, columns)
    covariance = np.zeros((columns.all, columns.all))
    covariance[np.ix_(columns.free, columns.free)] = cofactors(jacobian)
    return Solution(block, columns, covariance, residual, jacobian)


def distance_residuals(problem: Problem, solution: Solution) -> tuple[Array, Array]:
    """Return the normalised residuals of the tape distances, (k,), and their redundancy numbers, (k,).

    A redundancy number goes from 0, unchecked, to 1, wholly checked.
    """
    first = 2 * len(problem.image)
    rows = slice(first, first + len(problem.device.distances))
    residual, cofactor = checked_residuals(solution, rows, 1)
    return residual[:, 0], cofactor[:, 0, 0]


def checked_residuals(solution: Solution, rows: slice, size: int) -> tuple[Array, Array]:
    """Return normalised residuals of n observations of a `size`, (n, size), and their cofactors, (n, size, size)."""
    free = solution.columns.free
    Q, J = solution.covariance[np.ix_(free, free)], sparse.csr_array(solution.jacobian[rows])
    return solution.residual[rows].reshape(-1, size), redundancy(J, Q, size)


def image_rms(problem: Problem, solution: Solution) -> float:
    """Return the RMS per axis of the image points, px."""
    residual = predicted(solution.block, problem.image, problem)[0] - problem.image.centre
    return float(np.sqrt(np.mean(residual**2)))


def predicted(block: Block, image: ImagePoints, problem: Problem) -> tuple[Array, Array, Array, Array]:
    """Return image points, (n, 2) px, Jacobians by points in cam, (n, 2, 3), and interior, (n, 2, 9), and those points.

    A target's image point is the mean centroid of its circles, which face Z, eccentricity included.
    """
    R, _, cam = _points_in_frames(block, image)
    uv, J = project(cam, block.camera)
    ring = np.flatnonzero(image.point < problem.targets)
    xy = cam[:, :2] / cam[:, 2:]
    if len(ring) and np.all(np.isfinite(uv[ring])):
        normal = R[ring, 2]
        uv = uv.copy()
        with contextlib.suppress(np.linalg.LinAlgError):  # edge-on: take its centre until the pose is better
            uv[ring] = project_rings(cam[ring], normal, problem.device.target_radii, block.camera)
    return uv, J, interior_jacobian(xy, block.camera), cam


def _points_in_frames(block: Block, image: ImagePoints) -> tuple[Array, Array, Array]:
    """R_obj_cam of each image point's photo, (n, 3, 3), vector from camera to point in obj, and point in cam."""
    R = np.array([p.rotation for p in block.poses])[image.photo]
    way = block.points[image.point] - np.array([p.position for p in block.poses])[image.photo]
    return R, way, np.einsum("nji,nj->ni", R, way)


def _eccentricity_slopes(problem: Problem, block: Block) -> Array:
    """Return the derivative of (centroid - projected centre) by place and normal in cam, (n, 2, 6), by differences.

    It is a percent of the Jacobian. Without it, convergence is slow along the least determined unknowns.
    """
    slopes = np.zeros((len(problem.image), 2, 6))
    ring = problem.image.point < problem.targets
    R, _, cam = _points_in_frames(block, problem.image.take(ring))
    normal = R[:, 2]
    if not np.all(cam[:, 2] > 0.0):
        return slopes
    step = np.concatenate([np.eye(6), -np.eye(6)])[:, None] * 1e-4  # of the depth; of a unit vector
    places = (cam + step[..., :3] * cam[:, 2:]).reshape(-1, 3)
    normals = (normal + step[..., 3:]).reshape(-1, 3)
    try:
        offset = (
            project_rings(places, normals, problem.device.target_radii, block.camera) - project(places, block.camera)[0]
        )
        ahead, behind = offset.reshape(2, 6, -1, 2)
        depth = np.concatenate([np.tile(cam[:, 2:], (1, 3)), np.ones((len(cam), 3))], axis=1)
        slopes[ring] = (ahead - behind).transpose(1, 2, 0) / (2e-4 * depth[:, None])
    except np.linalg.LinAlgError:
        slopes[:] = 0.0
    return slopes


def apply_step(block: Block, columns: Columns, x: Array) -> Block:
    """Apply a step x, (f,), of the free unknowns, in the order of `Columns.free`."""
    full = np.zeros(columns.all)
    full[columns.free] = x
    camera = with_interior(block.camera, interior_vector(block.camera) + full[:INTERIOR])
    steps = full[INTERIOR : INTERIOR + 6 * columns.photos].reshape(-1, 6)
    poses = tuple(
        Pose(exp(s[3:]) @ pose.rotation, pose.position + s[:3]) for pose, s in zip(block.poses, steps, strict=True)
    )
    points = full[columns.point(np.arange(columns.points))]
    return Block(camera, poses, block.points + points, None if block.ball is None else block.ball + full[-4:])


def evaluate(problem: Problem, block: Block, columns: Columns) -> tuple[Array, Jacobian]:
    """Return normalised residuals, (r,), predicted minus measured, and their Jacobian by the free unknowns, (r, f)."""
    image, slopes = problem.image, _eccentricity_slopes(problem, block)
    uv, by_cam, by_interior, cam = predicted(block, image, problem)
    uv = np.where(np.isfinite(uv), uv, image.centre + 1e3)  # behind the camera: a large residual rejects the step
    by_cam = np.where(np.isfinite(by_cam), by_cam, 0.0)
    by_interior = np.where(np.isfinite(by_interior), by_interior, 0.0)
    R, way, _ = _points_in_frames(block, image)
    by_point = (by_cam + slopes[:, :, :3]) @ R.transpose(0, 2, 1)
    by_turn = by_point @ hat(way)
    by_turn += slopes[:, :, 3:] @ R.transpose(0, 2, 1) @ hat(np.array([0.0, 0.0, 1.0]))  # the normal, seen from cam
    L = np.linalg.inv(np.linalg.cholesky(image.covariance))
    blocks = np.concatenate([by_interior, -by_point, by_turn, by_point], axis=2)
    interior = np.broadcast_to(np.arange(INTERIOR), (len(image), INTERIOR))
    where = np.hstack([interior, columns.pose(image.photo), columns.point(image.point)])
    parts = [(np.einsum("nij,nj->ni", L, uv - image.centre).ravel(), _rows(L @ blocks, where, columns))]
    parts.append(_distances(problem, block, columns))
    if problem.depth is not None:
        z, sigma = problem.depth.T
        axis = R[:, :, 2]
        towards = np.concatenate([-axis, np.cross(axis, way), axis], axis=1)
        J = _rows((towards / sigma[:, None])[:, None], where[:, INTERIOR:], columns)
        parts.append(((cam[:, 2] - z) / sigma, J))
    if np.any(problem.camera.covariance):
        parts.append(_prior(block.camera, problem.camera, columns))
    if block.ball is not None:
        parts.append(_on_sphere(problem, block, block.ball, columns))
    J = sparse.csr_array(sparse.vstack([J for _, J in parts]))
    return np.concatenate([residual for residual, _ in parts]), sparse.csr_array(J[:, columns.free])


def _rows(blocks: Array, where: NDArray[np.intp], columns: Columns) -> Jacobian:
    """Return the Jacobian, (n k, all), of blocks (n, k, c) with their columns, (n, c)."""
    n, k, c = blocks.shape
    row = np.repeat(np.arange(n * k), c)
    return sparse.csr_array((blocks.ravel(), (row, np.repeat(where, k, axis=0).ravel())), shape=(n * k, columns.all))


def distances(device: Device, points: Array) -> Array:
    """Return the measured distances by the targets' coordinates, (k,) m."""
    return np.linalg.norm(_ways(device, points), axis=1)


def _ways(device: Device, points: Array) -> Array:
    """From start to end of each distance, (k, 3) m."""
    ends = device.ends
    return points[ends[:, 1]] - points[ends[:, 0]]


def _distances(problem: Problem, block: Block, columns: Columns) -> tuple[Array, Jacobian]:
    """Tape distances (Wittich 2017, eq. 90)."""
    device = problem.device
    length = distances(device, block.points)
    along = _ways(device, block.points) / np.maximum(length, 1e-12)[:, None]
    sigma = np.array([d.sigma for d in device.distances])
    measured = np.array([d.metres for d in device.distances])
    where = columns.point(device.ends).reshape(-1, 6)
    J = np.concatenate([-along, along], axis=1)
    return (length - measured) / sigma, _rows((J / sigma[:, None])[:, None], where, columns)


def _on_sphere(problem: Problem, block: Block, ball: Array, columns: Columns) -> tuple[Array, Jacobian]:
    """The discs' distances from the sphere as observations (Wittich 2017, section 3.7, has them as conditions)."""
    discs = np.arange(problem.targets, len(block.points))
    way = block.points[discs] - ball[:3]
    length = np.linalg.norm(way, axis=1)
    sigma = max(problem.out_of_round, _EXACT * ball[3])
    normal = way / length[:, None]
    J = np.column_stack([normal, -normal, -np.ones(len(discs))]) / sigma
    of_ball = np.broadcast_to(columns.all + np.arange(-4, 0), (len(discs), 4))
    return (length - ball[3]) / sigma, _rows(J[:, None], np.hstack([columns.point(discs), of_ball]), columns)


def _prior(camera: InteriorOrientation, prior: InteriorOrientation, columns: Columns) -> tuple[Array, Jacobian]:
    """The calibrated interior orientation as an observation."""
    known = np.flatnonzero(np.diag(prior.covariance))
    size = np.sqrt(np.diag(prior.covariance))[known]
    value, vector = np.linalg.eigh(prior.covariance[np.ix_(known, known)] / np.outer(size, size))
    whiten = (vector / np.sqrt(np.maximum(value, 1e-12))).T / size
    deviation = (interior_vector(camera) - interior_vector(prior))[known]
    return whiten @ deviation, _rows(whiten[:, None], np.tile(known, (len(known), 1)), columns)
