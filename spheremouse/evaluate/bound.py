"""Posterior Cramer-Rao bound: how well any filter can know attitude and rate from the discs that were measured.

The recursion of Tichavsky, Muravchik, Nehorai 1998 ("Posterior Cramer-Rao bounds for discrete-time nonlinear
filtering") along the true trajectory: the angular acceleration is a first-order Gauss-Markov process (Singer 1970,
"Estimating optimal tracking filter performance for manned maneuvering targets") as strong and as lasting as the true
one over the whole film, the discs are at unknown places, the ball's attitude in the first frame is the reference.
A filter may go below it where the motion is of several kinds, as rest is before play.

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
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array, exp, hat, left_jacobian, log, tangent_basis

# px. A detection this near to a disc's centre is that disc: centres are good to a tenth of a pixel, or to one where a
# strut cuts the disc, while the next thing dark is at least a disc's radius away (7 px, thesis' cameras).
MATCH = 3.0
_FINEST = 1e-4  # px: no picture shows a centre better, and a noise of 0 has no information matrix
_LEAST = 20  # centres of a size class: their RMS is good to a tenth where errors are independent


@dataclass(frozen=True, slots=True)
class Sight:
    """Discs measured in a frame."""

    disc: NDArray[np.intp]  # (k,) index of the disc
    sigma: Array  # (k,) px, standard deviation of its centre per axis


def semi_minor_axes(centre: Array, rig: Rig, pose: Pose) -> Array:
    """Semi-minor axes, (n,) px, of the images of discs whose centres project to pixels (n, 2).

    nan for a disc that the limb cuts, and for a pixel beside the ball.
    """
    axes = np.full(len(centre), np.nan)
    directions, index = directions_at(centre, rig, pose)
    seen = appearance(directions, rig, pose)
    axes[index[seen.whole]] = np.sqrt(np.linalg.eigvalsh(seen.shape[seen.whole])[:, 0])
    return axes


def distances(a: Array, b: Array) -> Array:
    """px, (n, m), between points (n, 2) and (m, 2)."""
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def measured(frames: Iterable[int], detected: Iterable[Array], truth: DiscTruth) -> list[Sight]:
    """Detections of the true discs in each frame, with the noise that such centres have in these frames.

    `detected` (k, 2) px by frame. The noise of a class is the RMS of its errors, systematic ones included: classes are
    whole discs by octaves of their area, and those that something cuts.
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
    sigma = _by_class(area, np.mean(np.concatenate(errors) ** 2, axis=1))
    ends = np.cumsum([0, *(len(r) for r in rows)])
    return [Sight(r.disc, sigma[a:b]) for r, a, b in zip(rows, ends[:-1], ends[1:], strict=True)]


def _by_class(area: Array, square: Array) -> Array:
    """Root of the mean of `square` over centres of the same class; areas (n,) px², nan: something cuts them.

    An octave with too few goes with the next larger one, the largest with the next smaller. What is cut is a class of
    its own; where too few are, they are no better than the worst of the others.
    """
    whole = np.isfinite(area)
    octave = np.floor(np.log2(np.maximum(np.where(whole, area, 1.0), 1.0)))
    groups: list[NDArray[np.bool_]] = []
    few = np.zeros(len(area), dtype=bool)
    for value in np.unique(octave[whole]):
        few |= whole & (octave == value)
        if np.count_nonzero(few) >= _LEAST:
            groups.append(few)
            few = np.zeros(len(area), dtype=bool)
    if few.any():
        groups = [*groups[:-1], groups[-1] | few] if groups else [few]
    sigma = np.zeros(len(area))
    for group in groups:
        sigma[group] = _rms(square[group])
    cut = ~whole
    if cut.any():
        worst = float(sigma.max(initial=0.0))
        sigma[cut] = _rms(square[cut]) if np.count_nonzero(cut) >= _LEAST else max(worst, _rms(square[cut]))
    return sigma


def _rms(square: Array) -> float:
    return max(float(np.sqrt(np.mean(square))), _FINEST)


# ---- the bound ----

_UNKNOWN = 100.0  # rad/s, standard deviation of a rate of which nothing is known
_FREE = 9  # unknowns that are not a disc's


@dataclass(frozen=True, slots=True)
class Bound:
    """Least covariances, one per frame, given that frame and all before it."""

    attitude: Array  # (n, 3, 3) rad², rotation error in obj; zero in the first frame
    rate: Array  # (n, 3, 3) rad²/s², obj

    def take(self, index: NDArray[np.intp]) -> "Bound":
        """Return the entries of some frames."""
        return Bound(self.attitude[index], self.rate[index])


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Angular acceleration as a first-order Gauss-Markov process, constant between two frames."""

    sigma: Array  # (3,) rad/s², obj
    lasting: Array  # (3,) 0..1, correlation between one frame and the next


def manoeuvre(motion: Truth) -> Manoeuvre:
    """Return the model of a true motion of n >= 2 frames, from its rates; white if it reverses in every frame."""
    a = np.diff(motion.rate, axis=0) / np.diff(motion.stamp)[:, None]
    total, next_to = np.sum(a**2, axis=0), np.sum(a[1:] * a[:-1], axis=0)  # next_to <= total, by Cauchy and Schwarz
    lasting = np.maximum(np.divide(next_to, total, out=np.zeros(3), where=total > 0.0), 0.0)
    return Manoeuvre(np.sqrt(total / len(a)), lasting)


def posterior_bound(motion: Truth, sights: Sequence[Sight], directions: Array, rig: Rig, pose: Pose) -> Bound:
    """The bound for n frames of true motion and of what was measured in each of them.

    `directions` (m, 3) unit vectors in `ball`, `pose` the true one. The state is (rotation error, rate, acceleration,
    two tangent coordinates of each disc seen so far). The recursion is carried in covariance form,
    (F J^-1 F^T + Q)^-1 + H^T R^-1 H by Woodbury's identity, since the first attitude is known exactly and has no
    finite information. A disc's first sight enters as the limit of an infinite prior.
    """
    model = manoeuvre(motion)
    basis = tangent_basis(directions)
    place = np.full(len(directions), -1)  # of a disc's coordinates in the state
    P = np.diag(np.concatenate([np.zeros(3), np.full(3, _UNKNOWN**2), model.sigma**2]))
    attitude, rate = np.empty((len(motion), 3, 3)), np.empty((len(motion), 3, 3))
    for k in range(len(motion)):
        if k:
            P = _predicted(P, motion, k, model)
        discs, sigma = sights[k].disc, sights[k].sigma
        on_attitude, on_disc = _jacobians(motion.attitude[k], directions[discs], basis[discs], rig, pose)
        known = place[discs] >= 0
        P = _measured(P, on_attitude[known], on_disc[known], place[discs[known]], sigma[known])
        place[discs[~known]] = len(P) + 2 * np.arange(np.count_nonzero(~known))
        P = _augmented(P, on_attitude[~known], on_disc[~known], sigma[~known])
        attitude[k], rate[k] = P[:3, :3], P[3:6, 3:6]
    return Bound(attitude, rate)


def _predicted(P: Array, motion: Truth, k: int, model: Manoeuvre) -> Array:
    """Covariance before frame k: F P F^T + Q."""
    dt = motion.stamp[k] - motion.stamp[k - 1]
    turn = log(motion.attitude[k] @ motion.attitude[k - 1].T)
    F = np.eye(_FREE)
    F[:3, :3] = exp(turn)
    F[:3, 3:6] = left_jacobian(turn) * dt
    F[:3, 6:] = 0.5 * dt * F[:3, 3:6]
    F[3:6, 6:] = dt * np.eye(3)
    F[6:, 6:] = np.diag(model.lasting)
    P = P.copy()
    P[:_FREE] = F @ P[:_FREE]
    P[:, :_FREE] = P[:, :_FREE] @ F.T
    P[6:_FREE, 6:_FREE] += np.diag(model.sigma**2 * (1.0 - model.lasting**2))
    return P


def _jacobians(R: Array, directions: Array, basis: Array, rig: Rig, pose: Pose) -> tuple[Array, Array]:
    """Return the Jacobians of the projected centres: by rotation error, (k, 2, 3), and place, (k, 2, 2), px/rad."""
    arm = rig.ball.radius * directions @ R.T
    _, duv_dcam = project(pose.to_cam(rig.ball.centre + arm), rig.camera)
    duv = duv_dcam @ pose.rotation.T
    return -duv @ hat(arm), rig.ball.radius * duv @ R @ basis


def _measured(P: Array, on_attitude: Array, on_disc: Array, place: NDArray[np.intp], sigma: Array) -> Array:
    """Covariance after discs already in the state were measured, (k,) px per axis."""
    k = len(place)
    H = np.zeros((k, 2, len(P)))
    H[:, :, :3] = on_attitude
    for i in range(k):
        H[i, :, place[i] : place[i] + 2] = on_disc[i]
    H = H.reshape(2 * k, len(P))
    HP = H @ P
    P = P - HP.T @ np.linalg.solve(HP @ H.T + np.diag(np.repeat(sigma**2, 2)), HP)
    return 0.5 * (P + P.T)


def _augmented(P: Array, on_attitude: Array, on_disc: Array, sigma: Array) -> Array:
    """Covariance with discs seen for the first time: their places follow from the attitude and what was measured."""
    k, n = len(on_disc), len(P)
    inverse = np.linalg.inv(on_disc)
    G = np.zeros((2 * k, n))
    G[:, :3] = -(inverse @ on_attitude).reshape(2 * k, 3)
    out = np.empty((n + 2 * k, n + 2 * k))
    out[:n, :n] = P
    out[n:, :n] = G @ P
    out[:n, n:] = out[n:, :n].T
    out[n:, n:] = G @ P @ G.T
    for i in range(k):
        at = slice(n + 2 * i, n + 2 * i + 2)
        out[at, at] += sigma[i] ** 2 * inverse[i] @ inverse[i].T
    return out
