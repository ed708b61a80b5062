"""Posterior Cramer-Rao bound: least error of attitude and rate that any filter can have with the discs measured.

The recursion of Tichavsky, Muravchik, Nehorai 1998 ("Posterior Cramer-Rao bounds for discrete-time nonlinear
filtering") along the true trajectory. The angular acceleration is a first-order Gauss-Markov process (Singer 1970,
"Estimating optimal tracking filter performance for manned maneuvering targets"). Its variance and correlation are those
of the true motion over the whole film. The places of the discs are unknown, and the attitude in the first frame is the
reference. A filter may have less error if the motion changes its kind, for example from rest to play.

A `Sight` is the measurement of a frame: detections of true discs, with centre errors by size.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth, Truth
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.matching import assign, distances
from spheremouse.geometry.rotation import Array, exp, hat, left_jacobian, log, tangent_basis

# px. A detection this near to a disc's centre is that disc: centres are good to a tenth of a pixel, or to one where a
# strut cuts the disc, while the next thing dark is at least a disc's radius away (7 px, thesis' cameras).
MATCH = 3.0
_MIN_SIGMA = 1e-4  # px: no picture shows a centre better, and a noise of 0 has no information matrix
_MIN_CLASS_SIZE = 20  # centres of a size class: their RMS is good to a tenth where errors are independent


@dataclass(frozen=True, slots=True)
class Sight:
    """Detections of k true discs in one frame."""

    disc: NDArray[np.intp]  # (k,) index of the disc
    sigma: Array  # (k,) px, standard deviation of its centre per axis


def semi_minor_axes(centre: Array, rig: Rig, pose: Pose) -> Array:
    """Return the semi-minor axes, (n,) px, of the images of discs with centres at the pixels `centre` (n, 2).

    They are nan if the limb cuts the disc, or if the pixel is not on the ball.
    """
    axes = np.full(len(centre), np.nan)
    directions, index = directions_at(centre, rig, pose)
    seen = appearance(directions, rig, pose)
    axes[index[seen.whole]] = np.sqrt(np.linalg.eigvalsh(seen.shape[seen.whole])[:, 0])
    return axes


def measured(frames: Iterable[int], detected: Iterable[Array], truth: DiscTruth) -> list[Sight]:
    """Return one `Sight` for each of `frames`: its detected true discs, with the noise of their centres.

    `frames` are indices into the recording, and `detected` has the centres, (k, 2) px, of each of them. The noise is
    the RMS error of all discs of the same class, systematic errors included. Classes are octaves of the area for whole
    discs, and one class for cut discs.
    """
    rows: list[DiscTruth] = []
    errors = [np.zeros((0, 2))]
    for frame, points in zip(frames, detected, strict=True):
        discs = truth.of_frame(frame)
        shown = np.flatnonzero((discs.state != HIDDEN) & np.isfinite(discs.centre).all(axis=1))
        i, j = assign(distances(discs.centre[shown], points), MATCH)
        found = shown[i]
        rows.append(DiscTruth(*(getattr(discs, name)[found] for name in DiscTruth.__slots__)))
        errors.append(points[j] - discs.centre[found])
    area = np.concatenate([np.where(r.state == VISIBLE, r.area, np.nan) for r in rows]) if rows else np.zeros(0)
    sigma = _sigma_by_class(area, np.mean(np.concatenate(errors) ** 2, axis=1))
    ends = np.cumsum([0, *(len(r) for r in rows)])
    return [Sight(r.disc, sigma[a:b]) for r, a, b in zip(rows, ends[:-1], ends[1:], strict=True)]


def _sigma_by_class(area: Array, squared_error: Array) -> Array:
    """Return the standard deviation of each centre, (n,) px per axis: the RMS error over its class.

    `squared_error` (n,) px² is the mean over both axes. `area` (n,) px² is nan for cut discs, which are one class. An
    octave with fewer than 20 centres joins the next larger octave; a rest at the top joins the last class. Fewer than
    20 cut discs get at least the largest value of the others.
    """
    whole = np.isfinite(area)
    octave = np.floor(np.log2(np.maximum(np.where(whole, area, 1.0), 1.0)))
    groups: list[NDArray[np.bool_]] = []
    pending = np.zeros(len(area), dtype=bool)
    for value in np.unique(octave[whole]):
        pending |= whole & (octave == value)
        if np.count_nonzero(pending) >= _MIN_CLASS_SIZE:
            groups.append(pending)
            pending = np.zeros(len(area), dtype=bool)
    if pending.any():
        groups = [*groups[:-1], groups[-1] | pending] if groups else [pending]
    sigma = np.zeros(len(area))
    for group in groups:
        sigma[group] = _rms(squared_error[group])
    cut = ~whole
    if cut.any():
        worst_whole = float(sigma.max(initial=0.0)) if np.count_nonzero(cut) < _MIN_CLASS_SIZE else 0.0
        sigma[cut] = max(worst_whole, _rms(squared_error[cut]))
    return sigma


def _rms(squared_error: Array) -> float:
    return max(float(np.sqrt(np.mean(squared_error))), _MIN_SIGMA)


# ---- the bound ----

_UNKNOWN_RATE_SIGMA = 100.0  # rad/s, standard deviation of an unknown rate
_MOTION_DIM = 9  # unknowns that are not a disc's


@dataclass(frozen=True, slots=True)
class Bound:
    """Least covariances of a filter, one per frame, given that frame and all before it."""

    attitude: Array  # (n, 3, 3) rad², rotation error in obj; zero in the first frame
    rate: Array  # (n, 3, 3) rad²/s², obj

    def take(self, index: NDArray[np.intp]) -> "Bound":
        """Return the entries of the frames in `index` (k,)."""
        return Bound(self.attitude[index], self.rate[index])


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Angular acceleration as a first-order Gauss-Markov process, constant between two frames."""

    sigma: Array  # (3,) rad/s², obj
    lasting: Array  # (3,) 0..1, correlation between one frame and the next


def manoeuvre(motion: Truth) -> Manoeuvre:
    """Return the model of a true motion of n >= 2 frames, from its rates. A negative correlation becomes 0."""
    a = np.diff(motion.rate, axis=0) / np.diff(motion.stamp)[:, None]
    total, next_to = np.sum(a**2, axis=0), np.sum(a[1:] * a[:-1], axis=0)  # next_to <= total, by Cauchy and Schwarz
    lasting = np.maximum(np.divide(next_to, total, out=np.zeros(3), where=total > 0.0), 0.0)
    return Manoeuvre(np.sqrt(total / len(a)), lasting)


def posterior_bound(motion: Truth, sights: Sequence[Sight], directions: Array, rig: Rig, pose: Pose) -> Bound:
    """Return the bound for a true motion of n frames, with n measurements `sights`.

    `directions` (m, 3) are unit vectors to the discs, in the frame `ball`. `pose` is the camera's true one. The state
    has the rotation error, rate and angular acceleration in `obj`, and two tangent coordinates of each disc seen so
    far. The recursion of the information matrix is J' = (F J^-1 F^T + Q)^-1 + H^T R^-1 H. This function computes the
    covariance P = J^-1 as a Kalman filter does, because the first attitude is exact and its information is infinite.
    The first detection of a disc adds its two coordinates, without a prior.
    """
    model = manoeuvre(motion)
    basis = tangent_basis(directions)
    index = np.full(len(directions), -1)  # of each disc's coordinates in the state; -1: not seen yet
    P = np.diag(np.concatenate([np.zeros(3), np.full(3, _UNKNOWN_RATE_SIGMA**2), model.sigma**2]))
    attitude, rate = np.empty((len(motion), 3, 3)), np.empty((len(motion), 3, 3))
    for k in range(len(motion)):
        if k:
            P = _predict(P, motion, k, model)
        discs, sigma = sights[k].disc, sights[k].sigma
        by_attitude, by_disc = _jacobians(motion.attitude[k], directions[discs], basis[discs], rig, pose)
        known = index[discs] >= 0
        P = _update(P, by_attitude[known], by_disc[known], index[discs[known]], sigma[known])
        index[discs[~known]] = len(P) + 2 * np.arange(np.count_nonzero(~known))
        P = _augment(P, by_attitude[~known], by_disc[~known], sigma[~known])
        attitude[k], rate[k] = P[:3, :3], P[3:6, 3:6]
    return Bound(attitude, rate)


def _predict(P: Array, motion: Truth, k: int, model: Manoeuvre) -> Array:
    """Return the covariance predicted for frame k >= 1, F P F^T + Q, from that of the frame before."""
    dt = motion.stamp[k] - motion.stamp[k - 1]
    turn = log(motion.attitude[k] @ motion.attitude[k - 1].T)
    F = np.eye(_MOTION_DIM)
    F[:3, :3] = exp(turn)
    F[:3, 3:6] = left_jacobian(turn) * dt
    F[:3, 6:] = 0.5 * dt * F[:3, 3:6]
    F[3:6, 6:] = dt * np.eye(3)
    F[6:, 6:] = np.diag(model.lasting)
    P = P.copy()
    P[:_MOTION_DIM] = F @ P[:_MOTION_DIM]
    P[:, :_MOTION_DIM] = P[:, :_MOTION_DIM] @ F.T
    P[6:_MOTION_DIM, 6:_MOTION_DIM] += np.diag(model.sigma**2 * (1.0 - model.lasting**2))
    return P


def _jacobians(R: Array, directions: Array, basis: Array, rig: Rig, pose: Pose) -> tuple[Array, Array]:
    """Return the Jacobians of the projected centres by rotation error, (k, 2, 3), and place, (k, 2, 2), px/rad.

    `R` is R_obj_ball, `directions` (k, 3) are the discs in `ball`, and `basis` (k, 3, 2) their tangents.
    """
    arm = rig.ball.radius * directions @ R.T
    _, duv_dcam = project(pose.to_cam(rig.ball.centre + arm), rig.camera)
    duv = duv_dcam @ pose.rotation.T
    return -duv @ hat(arm), rig.ball.radius * duv @ R @ basis


def _update(P: Array, by_attitude: Array, by_disc: Array, index: NDArray[np.intp], sigma: Array) -> Array:
    """Return the covariance after k discs of the state were measured, with `sigma` (k,) px per axis.

    `by_attitude` and `by_disc` are from `_jacobians`; `index` (k,) is that of a disc's coordinates in the state.
    """
    k = len(index)
    H = np.zeros((k, 2, len(P)))
    H[:, :, :3] = by_attitude
    for i in range(k):
        H[i, :, index[i] : index[i] + 2] = by_disc[i]
    H = H.reshape(2 * k, len(P))
    HP = H @ P
    P = P - HP.T @ np.linalg.solve(HP @ H.T + np.diag(np.repeat(sigma**2, 2)), HP)
    return 0.5 * (P + P.T)


def _augment(P: Array, by_attitude: Array, by_disc: Array, sigma: Array) -> Array:
    """Return the covariance with k discs added that are seen for the first time, with `sigma` (k,) px per axis."""
    k, n = len(by_disc), len(P)
    inverse = np.linalg.inv(by_disc)
    G = np.zeros((2 * k, n))
    G[:, :3] = -(inverse @ by_attitude).reshape(2 * k, 3)
    augmented = np.empty((n + 2 * k, n + 2 * k))
    augmented[:n, :n] = P
    augmented[n:, :n] = G @ P
    augmented[:n, n:] = augmented[n:, :n].T
    augmented[n:, n:] = G @ P @ G.T
    for i in range(k):
        at = slice(n + 2 * i, n + 2 * i + 2)
        augmented[at, at] += sigma[i] ** 2 * inverse[i] @ inverse[i].T
    return augmented
