"""The bundle adjustment of a board's views: unknowns, residuals, Jacobian.

No print is exact and no plate is flat, so the board's shape is unknown, too: a stretch of its columns against its rows
(Strobl, Hirzinger 2011), and a second-order bow (the deformation of mrcal, Kogan 2021).
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spheremouse.geometry.camera import InteriorOrientation, interior_jacobian, interior_vector, project, with_interior
from spheremouse.geometry.least_squares.adjust import Jacobian, adjust
from spheremouse.geometry.rotation import Array, exp, hat, log
from spheremouse.geometry.statistics import mad_sigma

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
INTERIOR = len(PARAMETERS)
SHAPE = 4  # unknowns of the board: stretch of its columns against its rows, and its bow by x², x y and y²
SHARED = INTERIOR + SHAPE  # unknowns that all views have in common
# Standard deviations before any photo. A printer that is 0.2 % off passes the check by a ruler of 100 mm, and a stiff
# plate bows by half a percent: the corners of an A4 sheet by 0.7 mm.
SHAPE_SIGMA = np.array([0.002, 0.005, 0.005, 0.005])
MIN_SIGMA = 0.01  # px; of an edge 20 px long and 100 grey values high in 8 bits
UNDETERMINED = (
    "the views leave the focal length open: the board faces the camera the same way in all of them; tilt it by 20 to "
    "45 degrees, to the left, right, up and down in turn"
)
HUBER_KNEE = 2.5  # standard deviations


@dataclass(frozen=True, slots=True)
class View:
    """Corners in one image."""

    points: Array  # (n, 3) m, in the board's frame
    uv: Array  # (n, 2) px

    def take(self, mask: NDArray[np.bool_]) -> "View":
        """Select corners by a mask (n,)."""
        return View(self.points[mask], self.uv[mask])


@dataclass(frozen=True, slots=True)
class Plate:
    """The extent of a board's corners."""

    middle: Array  # (3,) m, in the board's frame
    half: float  # m, half of the diagonal

    @classmethod
    def of(cls, points: Array) -> "Plate":
        """Return the extent of corners (n, 3) m."""
        low, high = points.min(axis=0), points.max(axis=0)
        return cls(0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-9))

    def by_shape(self, points: Array) -> Array:
        """Return how far corners (n, 3) m move by the four unknowns of the shape, (n, 3, 4) m."""
        x, y, _ = (points - self.middle).T / self.half
        moves = np.zeros((len(points), 3, SHAPE))
        moves[:, 1, 0] = y
        moves[:, 2, 1:] = np.stack([x * x, x * y, y * y], axis=1)
        return self.half * moves


@dataclass(frozen=True, slots=True)
class BoardAdjustment:
    """The camera and its views, in the order in which they were given."""

    camera: InteriorOrientation  # with the covariance of the nine, widened by `contradiction`
    rotations: Array  # (v, 3, 3) R_cam_board
    translations: Array  # (v, 3) m, the board's origin in cam
    residuals: tuple[Array, ...]  # (n, 2) px each, seen minus computed, unused ones included
    used: NDArray[np.bool_]  # (v,) views that took part
    kept: tuple[NDArray[np.bool_], ...]  # (n,) each, corners that took part in a used view
    sigma: Array  # (v,) px, standard deviation of a corner's coordinate in each view
    covariance: Array  # (9 + 6 u, 9 + 6 u) of the nine, then rotation (rad, in cam) and translation of each used view
    contradiction: float  # factor on the variances for views that contradict each other; 1: they do not
    free: NDArray[np.bool_]  # (9,) unknowns that were estimated
    bow: tuple[float, float]  # m, how far the corner farthest from the middle lies off the board's plane, and its sigma
    stretch: tuple[float, float]  # of the columns against the rows, relative, and its sigma

    @property
    def rms(self) -> float:
        """Root mean square distance, px, of the used corners from their computed places."""
        used = [r[k] for r, k, u in zip(self.residuals, self.kept, self.used, strict=True) if u]
        return rms_of(np.concatenate(used))

    def view_rms(self) -> Array:
        """RMS of each view, (v,) px; of unused views over all their corners."""
        return np.array(
            [rms_of(r[k] if u else r) for r, k, u in zip(self.residuals, self.kept, self.used, strict=True)]
        )

    @property
    def deviations(self) -> Array:
        """Standard deviations of the nine, (9,)."""
        return np.sqrt(np.diag(self.camera.covariance))

    def camera_positions(self) -> Array:
        """Projection centres, (v, 3) m, in the board's frame."""
        return -np.einsum("vji,vj->vi", self.rotations, self.translations)

    def tilts(self) -> Array:
        """Angle between the board's normal and the line of sight to its middle corner, (v,) rad."""
        return np.arccos(np.clip(np.abs(self.rotations[:, 2, 2]), 0.0, 1.0))


def resect_views(
    views: Sequence[View], camera: InteriorOrientation, shape: Array | None = None, plate: Plate | None = None
) -> tuple[Array, Array, tuple[Array, ...]]:
    """Return R_cam_board, (v, 3, 3), and t_cam_board, (v, 3) m, of a known camera, and residuals, (n, 2) px a view.

    `shape` (4,) is that of the board on its `plate`; None: as printed. A view without a finite result keeps its start.
    """
    bundle = Bundle(views, (camera.width, camera.height), np.zeros(SHARED, bool), plate)
    shape, poses = np.zeros(SHAPE) if shape is None else shape, poses_of(views, camera)
    for view, start in zip(views, poses, strict=True):
        points = view.points + bundle.plate.by_shape(view.points) @ shape
        with contextlib.suppress(cv2.error):
            pose = cv2.solvePnPRefineLM(points, view.uv, camera.matrix, camera.distortion, *start.copy())
            if np.all(np.isfinite(pose)):  # else large residuals show it
                start[:] = np.reshape(pose, (2, 3))
    x = np.concatenate([interior_vector(camera), shape, poses.ravel()])
    return exp(poses[:, 0]), poses[:, 1], bundle.residuals(x)


def rms_of(residual: Array) -> float:
    """Return the root mean square length of residuals (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


class Bundle:
    """Residuals and Jacobian of some views.

    The unknowns x, (13 + 6v,), are the nine `PARAMETERS`, the four of the board's shape, then each view's rotation
    vector (rad) and translation (m). `free` (13,) selects those that are estimated. The shape is observed as 0 with
    `SHAPE_SIGMA`. Corners of `plate` define its unit; None: those of the views.
    """

    def __init__(
        self, views: Sequence[View], size: tuple[int, int], free: NDArray[np.bool_], plate: Plate | None = None
    ) -> None:
        self.views, self.size, self.free = views, size, free
        self.points = np.concatenate([v.points for v in views])
        self.uv = np.concatenate([v.uv for v in views])
        self.counts = np.array([len(v.uv) for v in views])
        self.of = np.repeat(np.arange(len(views)), self.counts)
        self.plate = plate or Plate.of(self.points)
        self._by_shape = self.plate.by_shape(self.points)
        self._weight = free[INTERIOR:] / SHAPE_SIGMA  # of the observed shape

    @property
    def groups(self) -> list[NDArray[np.bool_]]:
        """Rows of each view in `jacobian`, a mask (2n + 4,) each."""
        of = np.append(np.repeat(self.of, 2), np.full(SHAPE, -1))
        return [of == v for v in range(len(self.views))]

    def only(self, used: NDArray[np.bool_]) -> "Bundle":
        """Return the adjustment of the views in a mask (v,)."""
        return Bundle([v for v, u in zip(self.views, used, strict=True) if u], self.size, self.free, self.plate)

    def linear(self, x: Array) -> tuple[Array, Array]:
        """Return computed minus measured, (n, 2) px, and its Jacobian, (n, 2, 19), by the shared and the view's six."""
        camera = camera_of(x, self.size)
        r, t = split_poses(x)
        R = exp(r)[self.of]
        turned = np.einsum("nij,nj->ni", R, self.points + self._by_shape @ x[INTERIOR:SHARED])
        cam = turned + t[self.of]
        uv, duv = project(cam, camera)
        if not np.all(np.isfinite(uv)):  # behind the camera: the largest residual
            uv, duv = np.nan_to_num(uv, nan=1e7), np.nan_to_num(duv)
        J = np.empty((len(uv), 2, SHARED + 6))
        z = np.where(cam[:, 2] > 0.0, cam[:, 2], 1.0)
        J[:, :, :INTERIOR] = interior_jacobian(cam[:, :2] / z[:, None], camera)
        J[:, :, INTERIOR:SHARED] = duv @ R @ self._by_shape
        J[:, :, :SHARED] *= self.free
        J[:, :, SHARED : SHARED + 3] = duv @ -hat(turned)
        J[:, :, SHARED + 3 :] = duv
        return uv - self.uv, J

    def solve(self, x: Array, sigma: Array, knee: float = np.inf) -> Array:
        """Return the unknowns (13 + 6v,) at the minimum of squares, from the start x; fixed ones keep their value.

        `sigma` (v,) px is that of a coordinate in each view. With a finite `knee`, in sigmas, Huber's function replaces
        the square. Raises CalibrationError if it does not converge.
        """
        hint = "is a photo of another zoom or board among them?"
        return adjust(lambda x: self.jacobian(x, sigma), x, self.retract, hint, knee)

    def retract(self, x: Array, step: Array) -> Array:
        """Apply a step of the estimated unknowns, (e,), to the unknowns; that of a rotation is a small one in cam."""
        full = np.zeros(len(x))
        full[self.estimated(len(x))] = step
        moved = x + full
        split_poses(moved)[0] = log(exp(split_poses(full)[0]) @ exp(split_poses(x)[0]))
        return moved

    def estimated(self, unknowns: int) -> NDArray[np.intp]:
        """Return the indices of those of the unknowns that are estimated, (e,)."""
        return np.flatnonzero(np.append(self.free, np.ones(unknowns - SHARED, bool)))

    def jacobian(self, x: Array, sigma: Array) -> tuple[Array, Jacobian]:
        """Return the residuals and the Jacobian.

        The residuals are those of the views divided by their `sigma` (v,), px, then those of the shape, (2n + 4,). The
        Jacobian is (2n + 4, e), with a column for each of the e estimated unknowns.
        """
        residual, J = self.linear(x)
        weight, n = 1.0 / sigma[self.of], len(residual)
        shared = np.broadcast_to(np.arange(SHARED), (n, SHARED))
        where = np.hstack([shared, SHARED + 6 * self.of[:, None] + np.arange(6)])
        data = (J * weight[:, None, None]).ravel(), np.repeat(where, 2, axis=0).ravel()
        views = sparse.csr_array((*data, np.arange(2 * n + 1) * (SHARED + 6)), shape=(2 * n, len(x)))
        observed = sparse.csr_array((self._weight, (np.arange(SHAPE), np.arange(INTERIOR, SHARED))), (SHAPE, len(x)))
        every = sparse.csr_array(sparse.vstack([views, observed]).tocsc()[:, self.estimated(len(x))])
        return np.concatenate([(residual * weight[:, None]).ravel(), self._weight * x[INTERIOR:SHARED]]), every

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Return measured minus computed, (n, 2) px of each view."""
        return tuple(np.split(-self.linear(x)[0], np.cumsum(self.counts)[:-1]))

    def spread(self, x: Array) -> Array:
        """Return the median absolute residual of each view, (v,) px."""
        return np.array([np.median(np.abs(r)) for r in self.residuals(x)])


def unknowns_of(used: NDArray[np.bool_]) -> NDArray[np.intp]:
    views = np.flatnonzero(used)
    return np.concatenate([np.arange(SHARED), (SHARED + 6 * views[:, None] + np.arange(6)).ravel()])


def split_poses(x: Array) -> Array:
    """Return rotation vectors and translations, (2, v, 3), of the unknowns of a `Bundle`."""
    return x[SHARED:].reshape(-1, 2, 3).transpose(1, 0, 2)


def camera_of(x: Array, size: tuple[int, int]) -> InteriorOrientation:
    return with_interior(InteriorOrientation(*size, 1.0, 1.0, 0.0, 0.0), x[:INTERIOR])


def robust_sigma(residual: Array) -> float:
    return max(float(mad_sigma(residual.ravel())), MIN_SIGMA)


def poses_of(views: Sequence[View], camera: InteriorOrientation) -> Array:
    """Return rotation vector and translation of each view, (v, 2, 3)."""
    found = np.empty((len(views), 2, 3))
    for i, view in enumerate(views):
        try:
            good, r, t = cv2.solvePnP(view.points, view.uv, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
        except cv2.error:
            good, r, t = False, np.zeros(3), np.array([0.0, 0.0, 1.0])
        if not good or not np.all(np.isfinite(r)) or not np.all(np.isfinite(t)):
            r, t = np.zeros(3), np.array([0.0, 0.0, 10.0 * np.ptp(view.points)])
        found[i] = np.ravel(r), np.ravel(t)
    return found
