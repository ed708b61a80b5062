"""Posterior Cramer-Rao bound: how well any filter can know attitude and rate from the discs that were measured.

The recursion of Tichavsky, Muravchik, Nehorai 1998 ("Posterior Cramer-Rao bounds for discrete-time nonlinear
filtering") along the true trajectory: the angular acceleration is a first-order Gauss-Markov process (Singer 1970,
"Estimating optimal tracking filter performance for manned maneuvering targets") as strong and as lasting as the true
one over the whole film, the discs are at unknown places, the ball's attitude in the first frame is the reference.
A filter may go below it where the motion is of several kinds, as rest is before play.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import Truth
from spheremouse.evaluate.centres import Sight
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import Array, exp, hat, left_jacobian, log, tangent_basis

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
