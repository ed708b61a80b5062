"""A ball that rolls tells where it is: sightings of its discs in, the camera's place and the map of the discs out.

Discs fixed on a rigid sphere that turns about its centre are a bundle adjustment of their own: unknown are the
direction to the centre, its distance over the radius, the direction of every disc, the attitude in every frame, and
the time a rolling shutter takes. The length of the radius stays open, and so does the turn of the ball's own axes,
which is taken out (free network). Each frame's attitude is eliminated (Schur complement; Förstner, Wrobel 2016,
section 15.2), so that a minute of video costs no more than its discs.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spheremouse.calibrate.rolling.normal import Eliminated, adjusted
from spheremouse.calibrate.rolling.problem import (
    GLOBAL,
    RATES,
    READOUT,
    Rolled,
    Rolling,
    Sightings,
    whitening,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.least_squares.adjust import outlier_statistic, variance_factors
from spheremouse.geometry.rotation import Array, tangent_basis

_OUTLIER = 18.4  # squared normalised residual: of points with normal errors one in ten thousand goes beyond
_WORST = 0.25  # of the largest: what is set aside at a time
_KNEE = 2.0  # standard deviations beyond which a residual weighs less while outliers are still in
_MEDIAN = 1.386  # of chi-square with 2 degrees of freedom
_LEAST_SEEN = 5  # frames that must show a disc
_LEAST_DISCS = 5
_CELLS = 12  # the ball's image is parted into so many rows and columns, for errors that depend on the place


def adjust_rolling(
    sightings: Sightings,
    start: Rolling,
    camera: InteriorOrientation,
    readout_sigma: float = 0.0,
) -> Rolled:
    """Adjust all unknowns to all sightings; sightings that contradict the rest are set aside.

    `readout_sigma` s is how well the start's readout is known: 0 exactly. Frames and discs that say nothing are left
    out of the result. CalibrationError where too little is left.
    """
    known = start.readout, readout_sigma
    at, used = _compact(start, sightings)
    at, there = adjusted(at, used, camera, known, _KNEE)
    robust = True
    while True:
        test = outlier_statistic(there.equations.residual, there.residual_cofactors())
        limit = _OUTLIER * max(float(np.median(test)) / _MEDIAN, 1.0)
        # gross errors drag others along: the worst go first
        fits = test <= max(limit, _WORST * float(test.max()))
        if not robust and fits.all():
            break
        at, used = _compact(at, used.take(fits))
        at, there = adjusted(at, used, camera, known, None)
        robust = False
    return _result(at, used, len(sightings) - len(used), there, camera)


def _compact(at: Rolling, s: Sightings) -> tuple[Rolling, Sightings]:
    """Without discs seen too rarely, frames that show fewer than two, and what hangs together with neither the rest."""
    while True:
        seen = np.bincount(s.disc, minlength=len(at.discs))
        shown = np.bincount(s.frame, minlength=len(at.attitude))
        fine = (seen[s.disc] >= _LEAST_SEEN) & (shown[s.frame] >= 2) & _in_largest(at, s)
        if fine.all():
            break
        s = s.take(fine)
    frames, frame = np.unique(s.frame, return_inverse=True)
    discs, disc = np.unique(s.disc, return_inverse=True)
    if len(discs) < _LEAST_DISCS:
        raise CalibrationError(
            f"{len(discs)} discs were followed on the ball, at least {_LEAST_DISCS} are needed: "
            "stick on more discs, and roll the ball so that all of it is seen"
        )
    at = replace(at, discs=at.discs[discs], stamp=at.stamp[frames], attitude=at.attitude[frames])
    return at, Sightings(frame, disc, s.centre, s.covariance)


def _in_largest(at: Rolling, s: Sightings) -> NDArray[np.bool_]:
    """Which sightings belong to the largest set of frames and discs that are linked, (n,)."""
    f, m = len(at.attitude), len(at.discs)
    links = sparse.coo_array((np.ones(len(s)), (s.frame, f + s.disc)), shape=(f + m, f + m))
    _, label = connected_components(links, directed=False)
    mine = label[s.frame]
    return mine == np.bincount(mine).argmax() if len(s) else np.zeros(0, dtype=bool)


def _result(at: Rolling, s: Sightings, rejected: int, there: Eliminated, camera: InteriorOrientation) -> Rolled:
    equations = there.equations
    Q, J = there.cofactors, there.reduced()
    number = np.full(2 * len(s), 1.0 - (3.0 * len(at.attitude) + Q.shape[0] - 3.0) / (2.0 * len(s)))
    factor = float(variance_factors(equations.residual.ravel(), number, [np.ones(2 * len(s), dtype=bool)])[0])
    gradient = np.einsum("nik,ni->nk", J, equations.residual)
    correlation = max(1.0, *(_lasting(gradient, Q, group) / factor for group in (_passes(s), _places(s))))
    # the interior orientation is wrong by the same in every frame
    by_camera = np.einsum("nik,nij->kj", J, equations.camera)
    G = -Q @ by_camera
    # what the detector says of a centre holds what all frames share: a factor below 1 does not take that away
    C = max(factor, 1.0) * correlation * Q + G @ camera.covariance @ G.T
    T = np.zeros((4, len(C)))
    T[:3, :2] = tangent_basis(at.direction)
    T[3, 2] = at.ratio
    residual = np.einsum("nij,nj->ni", np.linalg.inv(whitening(s.covariance)), equations.residual)
    return Rolled(
        at,
        T @ C @ T.T,
        C[GLOBAL:, GLOBAL:],
        float(np.hypot(np.sqrt(C[READOUT, READOUT]), RATES * at.readout)),
        s,
        residual,
        rejected,
        factor,
        correlation,
        T @ G @ lens_root(camera),
    )


def lens_root(camera: InteriorOrientation) -> Array:
    """L with L L' the covariance of the interior orientation, (9, 9): columns are errors that nothing correlates."""
    sigma = np.sqrt(np.diag(camera.covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)  # units differ from row to row
    value, vector = np.linalg.eigh(camera.covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector * np.sqrt(np.maximum(value, 0.0)), dtype=float)


def _lasting(gradient: Array, Q: Array, group: NDArray[np.intp]) -> float:
    """Variance of direction and ratio, over that of white noise, where errors within a group last (White 1980).

    The sum of g g' over groups is what the normal matrix would be if errors were independent; the mean over the three
    is taken, since a hundred groups tell no more.
    """
    sums = np.zeros((int(group.max()) + 1, gradient.shape[1]))
    np.add.at(sums, group, gradient)
    influence = sums @ Q[:, :3]
    number = len(np.unique(group))
    return float(np.trace(np.linalg.solve(Q[:3, :3], influence.T @ influence))) / 3.0 * number / max(number - 1, 1)


def _passes(s: Sightings) -> NDArray[np.intp]:
    """Each sighting's pass, (n,): a disc comes into view, crosses the ball and leaves."""
    order = np.lexsort((s.frame, s.disc))
    new = (np.diff(s.disc[order]) != 0) | (np.diff(s.frame[order]) > 1)
    group = np.empty(len(s), dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(new)])
    return group


def _places(s: Sightings) -> NDArray[np.intp]:
    """Each sighting's cell of the ball's image, (n,)."""
    low, high = s.centre.min(axis=0), s.centre.max(axis=0)
    cell = np.minimum((s.centre - low) / np.maximum(high - low, 1e-9) * _CELLS, _CELLS - 1).astype(np.intp)
    return cell[:, 0] * _CELLS + cell[:, 1]
