"""Bundle adjustment of a rolling ball: sightings of its discs in; the ball in the camera and the map of its discs out.

The discs lie on a rigid sphere that rotates about a fixed point near its centre. Unknown are the direction to that
point, its distance over the radius, the centre's place in the ball's axes, the direction of each disc, the attitude in
each frame, and the readout time of a rolling shutter. The radius stays open. So does the rotation of the ball's own
axes, which inner constraints remove (free network). Only the covariance is computed without each frame's attitude
(Schur complement; Förstner, Wrobel 2016, section 15.2).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spheremouse.calibrate.rolling.problem import (
    ECCENTRICITY,
    GLOBAL,
    RATES,
    READOUT,
    Eliminated,
    Rolling,
    RollingAdjustment,
    Sightings,
    minimise,
    whitening,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.least_squares.adjust import outlier_statistic, variance_factors
from spheremouse.geometry.rotation import Array, tangent_basis

_OUTLIER_CHI2 = 18.4  # with 2 degrees of freedom: one normal error in ten thousand exceeds it
_OUTLIER_SHARE = 0.25  # of the largest statistic; smaller outliers wait for the next round
_HUBER_KNEE = 2.0  # standard deviations, while outliers are still in
_CHI2_MEDIAN = 1.386  # with 2 degrees of freedom
_MIN_FRAMES, _MIN_DISCS = 5, 5  # frames that show a disc; discs
_CELLS_PER_SIDE = 12  # rows and columns of the ball's image, for errors that depend on the place


def adjust_rolling(
    sightings: Sightings, start: Rolling, camera: InteriorOrientation, readout_sigma: float = 0.0
) -> RollingAdjustment:
    """Adjust all unknowns to the sightings: first by Huber's function, then by least squares without outliers.

    The start's readout is an observation with a standard deviation of `readout_sigma` s; with 0 it is fixed. The
    interior orientation is fixed, but its covariance enters that of the result, and so does the correlation of errors
    in time and place. Discs and frames with too few sightings are not in the result. Raises CalibrationError if fewer
    than five discs are left, or if there is no minimum.
    """
    readout = start.readout, readout_sigma
    at, used = _without_weak(start, sightings)
    at, eliminated = minimise(at, used, camera, readout, knee=_HUBER_KNEE)
    robust = True
    while True:
        test = outlier_statistic(eliminated.equations.residual, eliminated.residual_cofactors())
        limit = _OUTLIER_CHI2 * max(float(np.median(test)) / _CHI2_MEDIAN, 1.0)
        # gross errors enlarge other residuals: the largest go first
        fits = test <= max(limit, _OUTLIER_SHARE * float(test.max()))
        if not robust and fits.all():
            break
        at, used = _without_weak(at, used.take(fits))
        at, eliminated = minimise(at, used, camera, readout, knee=np.inf)
        robust = False
    return _result(at, used, len(sightings) - len(used), eliminated, camera)


def _without_weak(at: Rolling, s: Sightings) -> tuple[Rolling, Sightings]:
    """Remove discs seen in fewer than five frames, frames with fewer than two discs, and all not linked with the rest.

    Raises CalibrationError if fewer than five discs are left.
    """
    while True:
        seen = np.bincount(s.disc, minlength=len(at.discs))
        shown = np.bincount(s.frame, minlength=len(at.attitude))
        fine = (seen[s.disc] >= _MIN_FRAMES) & (shown[s.frame] >= 2) & _in_largest(at, s)
        if fine.all():
            break
        s = s.take(fine)
    frames, frame = np.unique(s.frame, return_inverse=True)
    discs, disc = np.unique(s.disc, return_inverse=True)
    if len(discs) < _MIN_DISCS:
        raise CalibrationError(
            f"{len(discs)} discs were followed on the ball, at least {_MIN_DISCS} are needed: "
            "stick on more discs, and roll the ball so that all of it is seen"
        )
    at = replace(at, discs=at.discs[discs], stamp=at.stamp[frames], attitude=at.attitude[frames])
    return at, Sightings(frame, disc, s.centre, s.covariance)


def _in_largest(at: Rolling, s: Sightings) -> NDArray[np.bool_]:
    """Return True for sightings in the largest connected set of frames and discs, (n,)."""
    f, m = len(at.attitude), len(at.discs)
    links = sparse.coo_array((np.ones(len(s)), (s.frame, f + s.disc)), shape=(f + m, f + m))
    _, label = connected_components(links, directed=False)
    mine = label[s.frame]
    return mine == np.bincount(mine).argmax() if len(s) else np.zeros(0, dtype=bool)


def _result(
    at: Rolling, s: Sightings, rejected: int, eliminated: Eliminated, camera: InteriorOrientation
) -> RollingAdjustment:
    """Return the adjusted ball with its covariance: of image noise, enlarged for correlated errors, and of the lens."""
    equations = eliminated.equations
    Q, J = eliminated.cofactors, eliminated.reduced()
    number = np.full(2 * len(s), 1.0 - (3.0 * len(at.attitude) + Q.shape[0] - 3.0) / (2.0 * len(s)))
    factor = float(variance_factors(equations.residual.ravel(), number, [np.ones(2 * len(s), dtype=bool)])[0])
    gradient = np.einsum("nik,ni->nk", J, equations.residual)
    correlation = max(1.0, *(_correlation_factor(gradient, Q, group) / factor for group in (_passes(s), _places(s))))
    # the error of the interior orientation is the same in every frame
    by_camera = np.einsum("nik,nij->kj", J, equations.camera)
    G = -Q @ by_camera
    # the covariance of a centre includes errors that all frames share: a factor below 1 does not reduce them
    C = max(factor, 1.0) * correlation * Q + G @ camera.covariance @ G.T
    T = np.zeros((4, len(C)))
    T[:3, :2] = tangent_basis(at.direction)
    T[3, 2] = at.ratio
    residual = np.einsum("nij,nj->ni", np.linalg.inv(whitening(s.covariance)), equations.residual)
    return RollingAdjustment(
        at,
        T @ C @ T.T,
        C[GLOBAL:, GLOBAL:],
        C[ECCENTRICITY, ECCENTRICITY],
        float(np.hypot(np.sqrt(C[READOUT, READOUT]), RATES * at.readout)),
        s,
        residual,
        rejected,
        factor,
        correlation,
        T @ G @ lens_root(camera),
    )


def lens_root(camera: InteriorOrientation) -> Array:
    """Return L, (9, 9), with L L' the covariance of the interior orientation; its columns are uncorrelated errors."""
    sigma = np.sqrt(np.diag(camera.covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)  # units differ from row to row
    value, vector = np.linalg.eigh(camera.covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector * np.sqrt(np.maximum(value, 0.0)), dtype=float)


def _correlation_factor(gradient: Array, Q: Array, group: NDArray[np.intp]) -> float:
    """Variance of direction and ratio over that of white noise, if errors within a group are correlated (White 1980).

    For independent errors the sum of g g' over groups equals the normal matrix. The factor is the mean over the three
    unknowns: a hundred groups are too few for one each.
    """
    sums = np.zeros((int(group.max()) + 1, gradient.shape[1]))
    np.add.at(sums, group, gradient)
    influence = sums @ Q[:, :3]
    number = len(np.unique(group))
    return float(np.trace(np.linalg.solve(Q[:3, :3], influence.T @ influence))) / 3.0 * number / max(number - 1, 1)


def _passes(s: Sightings) -> NDArray[np.intp]:
    """Number of each sighting's pass, (n,), from a disc's entry into view to its exit."""
    order = np.lexsort((s.frame, s.disc))
    new = (np.diff(s.disc[order]) != 0) | (np.diff(s.frame[order]) > 1)
    group = np.empty(len(s), dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(new)])
    return group


def _places(s: Sightings) -> NDArray[np.intp]:
    """Each sighting's cell of the ball's image, (n,)."""
    low, high = s.centre.min(axis=0), s.centre.max(axis=0)
    cell = np.minimum((s.centre - low) / np.maximum(high - low, 1e-9) * _CELLS_PER_SIDE, _CELLS_PER_SIDE - 1).astype(
        np.intp
    )
    return cell[:, 0] * _CELLS_PER_SIDE + cell[:, 1]
