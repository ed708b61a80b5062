"""Adjustment of a rolling ball: observations, unknowns, residuals, Jacobian, and the minimum."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spheremouse.ball.filters.so3_eccentric import ECCENTRIC_SIGMA
from spheremouse.geometry.camera import InteriorOrientation, interior_jacobian, project, row_of
from spheremouse.geometry.least_squares.adjust import Jacobian, adjust
from spheremouse.geometry.rotation import Array, exp, hat, log, tangent_basis
from spheremouse.geometry.statistics import is_nonzero

RATES = 0.005  # relative error of rates from differences of attitudes, when a hand pushes
GLOBAL, READOUT, ECCENTRICITY = 7, 3, slice(4, 7)  # unknowns before the discs: direction 2, log ratio, and these
_MIN_READOUT_SIGMA = 1e-7  # s, for a readout that is known exactly


@dataclass(frozen=True, slots=True)
class Sightings:
    """Measured discs, each with its frame and its disc."""

    frame: NDArray[np.intp]  # (n,) 0 .. f - 1
    disc: NDArray[np.intp]  # (n,) 0 .. m - 1
    centre: Array  # (n, 2) px
    covariance: Array  # (n, 2, 2) px²

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, keep: NDArray[np.bool_]) -> "Sightings":
        """Select by a mask (n,); frame and disc keep their numbers."""
        return Sightings(self.frame[keep], self.disc[keep], self.centre[keep], self.covariance[keep])


@dataclass(frozen=True, slots=True)
class Rolling:
    """Geometry of ball, camera and discs, in units of the ball's radius."""

    direction: Array  # (3,) unit vector in cam, to the point that the ball turns about
    ratio: float  # distance of that point over the radius
    discs: Array  # (m, 3) unit vectors in ball
    stamp: Array  # (f,) s
    attitude: Array  # (f, 3, 3) R_cam_ball at the stamps
    readout: float = 0.0  # s, time a rolling shutter takes over all rows
    eccentricity: Array = field(default_factory=lambda: np.zeros(3))  # (3,) ball, from where it turns to its centre


@dataclass(frozen=True, slots=True)
class RollingAdjustment:
    """An adjusted `Rolling` with its covariances, and the sightings used."""

    rolling: Rolling
    covariance: Array  # (4, 4) of direction (3 along its tangent plane, rad) and ratio
    disc_covariance: Array  # (2m, 2m) rad², of errors along rotation.tangent_basis(discs), free network
    eccentricity_covariance: Array  # (3, 3) radii²
    readout_sigma: float  # s
    sightings: Sightings
    residual: Array  # (n, 2) px
    rejected: int  # sightings that contradict the others, or are of discs and frames with too few
    variance_factor: float  # of the sightings, over the assumed variance
    correlation: float  # factor on the variances of the result for errors that are correlated in time or place
    by_lens: Array  # (4, 9) errors of direction and ratio per standard deviation along `lens_root`

    @property
    def is_eccentric(self) -> bool:
        """Return whether the ball's centre is significantly off the point that it turns about."""
        return is_nonzero(self.rolling.eccentricity, self.eccentricity_covariance)

    @property
    def rms(self) -> float:
        """px per axis."""
        return float(np.sqrt(np.mean(self.residual**2)))


@dataclass(frozen=True, slots=True)
class Equations:
    """Residuals and Jacobians of unit variance.

    All frames share direction 2, log ratio, readout, eccentricity 3 and discs 2 each. Each has its own attitude 3.
    """

    residual: Array  # (n, 2)
    jacobian: Jacobian  # (2n, 7 + 2m + 3f)
    turn: Array  # (n, 2, 3) by the frame's attitude, left error in cam
    camera: Array  # (n, 2, 9) by the interior orientation


def equations_of(at: Rolling, s: Sightings, camera: InteriorOrientation) -> Equations:
    """Residuals and Jacobians of points p = ratio c + R (e + d), with R = exp(readout row w) R_cam_ball."""
    n, m = len(s), len(at.discs)
    row = row_of(s.centre[:, 1], camera.height)
    rate = angular_rates(at)[s.frame]
    row_rotation = exp(rate * (at.readout * row)[:, None])
    R = row_rotation @ at.attitude[s.frame]
    d = np.einsum("nij,nj->ni", R, at.eccentricity + at.discs[s.disc])
    points = at.ratio * at.direction + d
    uv, by_point = project(points, camera)
    W = whitening(s.covariance)
    residual = np.einsum("nij,nj->ni", W, s.centre - uv)
    A = W @ by_point
    basis = tangent_basis(at.discs)[s.disc]
    by_disc = A @ R @ basis
    turned = np.einsum("nij,nj->ni", row_rotation.transpose(0, 2, 1), d)  # at the frame's stamp
    by_turn = A @ row_rotation @ -hat(turned)
    by_global = np.concatenate(
        [
            at.ratio * A @ tangent_basis(at.direction),
            at.ratio * (A @ at.direction)[:, :, None],
            np.einsum("nij,nj->ni", A, np.cross(rate, d) * row[:, None])[:, :, None],
            A @ R,
        ],
        axis=2,
    )
    shared = GLOBAL + 2 * m
    columns = np.hstack(
        [
            np.broadcast_to(np.arange(GLOBAL), (n, GLOBAL)),
            GLOBAL + 2 * s.disc[:, None] + np.arange(2),
            shared + 3 * s.frame[:, None] + np.arange(3),
        ]
    )
    values = np.concatenate([by_global, by_disc, by_turn], axis=2)
    rows = np.arange(2 * n + 1) * columns.shape[1]
    jacobian = sparse.csr_array(
        (values.ravel(), np.repeat(columns, 2, axis=0).ravel(), rows), shape=(2 * n, shared + 3 * len(at.attitude))
    )
    return Equations(residual, jacobian, by_turn, W @ interior_jacobian(points[:, :2] / points[:, 2:], camera))


def angular_rates(at: Rolling) -> Array:
    """Return angular velocities in cam, (f, 3) rad/s, from the attitudes around each frame; 0 beside a gap.

    Fourth-order differences over four frames; second-order ones over two if one of the four is missing.
    """
    f = len(at.stamp)
    rate = np.zeros((f, 3))
    if f < 3:
        return rate
    usual = float(np.median(np.diff(at.stamp)))
    mean, fine = np.zeros((f, 2, 3)), np.zeros((f, 2), dtype=bool)
    for k in (1, 2):
        span = at.stamp[2 * k :] - at.stamp[: -2 * k]
        turn = log(at.attitude[2 * k :] @ at.attitude[: -2 * k].transpose(0, 2, 1))
        mean[k:-k, k - 1] = turn / np.maximum(span, 1e-9)[:, None]
        fine[k:-k, k - 1] = (span > 0.0) & (span < (2.0 * k + 1.0) * usual)
    rate[fine[:, 0]] = mean[fine[:, 0], 0]
    both = fine.all(axis=1)
    rate[both] = (4.0 * mean[both, 0] - mean[both, 1]) / 3.0
    rate[0], rate[-1] = rate[1], rate[-2]
    return rate


def whitening(covariance: Array) -> Array:
    """Return W, (n, 2, 2), with W' W the inverse covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=float)


class Eliminated:
    """Cofactors of the shared unknowns at the minimum, with the attitudes eliminated by the Schur complement.

    Inner constraints remove the rotation of the ball's axes, which no observation fixes.
    """

    def __init__(self, at: Rolling, s: Sightings, equations: Equations, readout: tuple[float, float]) -> None:
        """`readout` is the expected one and its standard deviation, s."""
        J, shared = _observations(at, equations, readout)[1], GLOBAL + 2 * len(at.discs)
        own = np.zeros((len(at.attitude), 3, 3))
        np.add.at(own, s.frame, equations.turn.transpose(0, 2, 1) @ equations.turn)
        own += 1e-9 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        cross = (J[:, shared:].T @ J[:, :shared]).toarray().reshape(len(own), 3, shared)
        self.equations, self.frame, self.free = equations, s.frame, _free(at)
        self._inverse = np.linalg.inv(own)
        self._gain = self._inverse @ cross
        N = (J[:, :shared].T @ J[:, :shared]).toarray() - np.einsum("fik,fil->kl", cross, self._gain)
        scale = 1.0 / np.sqrt(np.diag(N))
        Q = np.linalg.inv(N * np.outer(scale, scale)) * np.outer(scale, scale)
        # remove the weight that held the rotation of the axes
        P = np.eye(len(Q)) - self.free @ self.free.T
        Q = P @ Q @ P
        self.cofactors = 0.5 * (Q + Q.T)  # of the shared unknowns, (7 + 2m, 7 + 2m)

    def reduced(self) -> Array:
        """Return the Jacobian by the shared unknowns with the attitudes eliminated, (n, 2, 7 + 2m)."""
        turn, shared = self.equations.turn, len(self.cofactors)
        J = self.equations.jacobian[:, :shared].toarray().reshape(len(turn), 2, shared)
        return J - turn @ self._gain[self.frame]

    def residual_cofactors(self) -> Array:
        """Return I - A Q A' of each sighting, (n, 2, 2)."""
        J, turn = self.reduced(), self.equations.turn
        own = turn @ self._inverse[self.frame] @ turn.transpose(0, 2, 1)
        return np.eye(2) - own - (J.reshape(-1, J.shape[2]) @ self.cofactors).reshape(J.shape) @ J.transpose(0, 2, 1)


def minimise(
    at: Rolling, s: Sightings, camera: InteriorOrientation, readout: tuple[float, float], *, knee: float
) -> tuple[Rolling, Eliminated]:
    """Minimise the sum of Huber's function with its `knee`, in standard deviations; infinite: the sum of squares.

    `readout` is the expected one and its standard deviation, s. Raises CalibrationError if there is no minimum.
    """
    at = adjust(
        lambda at: _observations(at, equations_of(at, s, camera), readout),
        at,
        apply_step,
        "roll the ball longer, and about more axes",
        knee,
    )
    return at, Eliminated(at, s, equations_of(at, s, camera), readout)


def _observations(at: Rolling, equations: Equations, readout: tuple[float, float]) -> tuple[Array, Jacobian]:
    """Return residuals, computed minus measured, (2n + 7,), and their Jacobian by all unknowns.

    The last rows are of the readout, of the eccentricity, and of the rotation of the ball's axes, which is held. The
    residuals are nan if the camera is within the ball.
    """
    J, free = equations.jacobian, _free(at)
    weight = np.sqrt(np.median(np.asarray(J.power(2).sum(axis=0)).ravel()[GLOBAL : len(free)]))
    sigma = max(readout[1], _MIN_READOUT_SIGMA)
    expected = np.eye(4, len(free), READOUT) / np.array([[sigma], *[[ECCENTRIC_SIGMA]] * 3])
    rows = sparse.hstack([np.vstack([expected, weight * free.T]), sparse.csr_array((7, 3 * len(at.attitude)))])
    off = [(at.readout - readout[0]) / sigma, *at.eccentricity / ECCENTRIC_SIGMA]
    residual = np.concatenate([-equations.residual.ravel(), off, np.zeros(3)])
    return residual if at.ratio > 1.0 else np.nan * residual, sparse.csr_array(sparse.vstack([J, rows]))


def _free(at: Rolling) -> Array:
    """Orthonormal basis, (7 + 2m, 3), of the rotations of the ball's axes: a vector v moves by w x v."""
    free = np.zeros((GLOBAL + 2 * len(at.discs), 3))
    free[ECCENTRICITY] = -hat(at.eccentricity)
    free[GLOBAL:] = -(tangent_basis(at.discs).transpose(0, 2, 1) @ hat(at.discs)).reshape(-1, 3)
    return np.linalg.qr(free)[0]


def apply_step(at: Rolling, step: Array) -> Rolling:
    """Apply a step of the shared unknowns and of the attitudes, (7 + 2m + 3f,)."""
    dx, de = np.split(step, [GLOBAL + 2 * len(at.discs)])
    c = at.direction + tangent_basis(at.direction) @ dx[:2]
    d = at.discs + np.einsum("mij,mj->mi", tangent_basis(at.discs), dx[GLOBAL:].reshape(-1, 2))
    return replace(
        at,
        direction=c / np.linalg.norm(c),
        ratio=at.ratio * float(np.exp(np.clip(dx[2], -0.5, 0.5))),
        readout=at.readout + float(dx[READOUT]),
        eccentricity=at.eccentricity + dx[ECCENTRICITY],
        discs=d / np.linalg.norm(d, axis=1, keepdims=True),
        attitude=exp(de.reshape(-1, 3)) @ at.attitude,
    )
