"""The state of the default filter: attitude, rate, acceleration and the map of discs, with one covariance for all.

How errors move it. `so3_map` has how discs enter and leave it, `so3_camera` how the camera and the ball's place change
it, and `so3` the filter itself.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.filters.so3_motion import (
    AXES,
    CAMERA_DIM,
    CLONE_DIM,
    KINEMATIC_DIM,
    MAP_OFFSET,
    READOUT,
    RIG_DIM,
    RIG_ROW,
)
from spheremouse.ball.filters.so3_settings import HIDDEN_SHARE
from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import Array, hat
from spheremouse.native import kernels

PLACED = kernels.PLACED  # rad, standard deviation: a third of the way between neighbours of fifty discs
WANDER_S = 0.25  # s, after which a centre that moves is as likely to come back as to move on
ECCENTRICITY = slice(KINEMATIC_DIM, RIG_ROW)
RIG = slice(RIG_ROW, AXES)  # errors of focal length and centre
CENTRE = slice(RIG_ROW + 1, AXES)  # errors of the centre
COMMON = slice(RIG_ROW, READOUT)  # errors of rig and axes
_NONE = np.zeros(0, dtype=np.intp)
_NO_PROCESS = np.zeros((KINEMATIC_DIM, KINEMATIC_DIM))


# Hypotheses about a recent step of the acceleration, none or one at each level: mean (j, 6), rad/s and rad/s², of rate
# and acceleration less those of the state, covariance (j, 6, 6), probability with each level (j, l).
Modes = tuple[Array, Array, Array]


class OtherCamera(NamedTuple):
    """Means of a camera that does not show this frame. Their errors are in `joint`."""

    rig_error: Array  # (4,) of this camera's rig, as `So3State` has it
    readout: float  # s, by which its rolling shutter takes longer than its rig says
    hidden: Array  # (m,) probability that a disc is not to be seen from there


class So3State(NamedTuple):
    """Attitude, rate and map with their joint covariance."""

    stamp: float  # s
    attitude: Array  # (3, 3) R_obj_ball
    rate: Array  # (3,) rad/s, w_obj
    acceleration: Array  # (3,) rad/s², angular, obj
    landmarks: Array  # (l, 3) unit vectors, ball: m discs, then c candidates, which no point corrects
    basis: Array  # (l, 3, 2) tangent vectors of the landmarks: axes of their errors, ball
    joint: Array  # (23 + 8p + 2l, 23 + 8p + 2l) of the errors in the order of `so3_motion`, with p other cameras
    hits: NDArray[np.intp] = _NONE  # (m,) sightings
    missed: NDArray[np.intp] = _NONE  # (m,) in a row
    hidden: Array = np.zeros(0)  # (m,) probability that it is not to be seen
    used: NDArray[np.intp] = _NONE  # (k,) of the last points
    weights: Array = np.zeros(0)  # (l,) probability of each level; empty: as usual
    process: Array = _NO_PROCESS  # (9, 9) noise of the last prediction, at the first level
    manoeuvre_level: float = 1.0  # factor on the acceleration of a ball left alone that the last step was made at, rms
    nis: float = 0.0  # normalised innovation squared of the last update, chi-square with 2 len(used) degrees
    readout: float = 0.0  # s, by which the rolling shutter takes longer than the rig says
    rig_error: Array = np.zeros(RIG_DIM)  # (4,) of focal length and pivot
    eccentricity: Array = np.zeros(3)  # (3,) m, ball, from pivot to centre
    centre_noise: float = 0.0  # m²/s per axis, by which the centre moves at random; 0 in a good bearing
    holds_rig: bool = False  # no update changes `rig_error`
    known_seen: int = 0  # discs beyond their trial that took part in the last update
    known_missed: float = 0.0  # discs beyond their trial that should have been detected and were not, expected number
    interval: float = 0.0  # s, of the last prediction, where no update has used it yet
    modes: Modes | None = None  # of which attitude, rate, acceleration and joint are the moments; None: one
    candidates: NDArray[np.intp] = _NONE  # (c,) their numbers as look-alikes
    others: tuple[OtherCamera, ...] = ()  # (p,); fields without a camera are of the one that shows this frame

    @property
    def speed(self) -> float:
        """rad/s, magnitude of `rate`."""
        return math.hypot(*self.rate.tolist())

    @property
    def centre(self) -> Array:
        """(3,) m, obj, of the ball from its calibrated place."""
        return self.pivot + self.attitude @ self.eccentricity

    @property
    def pivot(self) -> Array:
        """(3,) m, obj, of the point that the ball turns about from its calibrated place."""
        return self.rig_error[1:]

    @property
    def centre_covariance(self) -> Array:
        """Covariance of `centre`, (3, 3) m²."""
        J = np.hstack([self.attitude, np.zeros((3, 1)), np.eye(3)])
        rows = slice(ECCENTRICITY.start, CENTRE.stop)
        return J @ self.joint[rows, rows] @ J.T

    @property
    def seen_rig(self) -> Array:
        """(4,) error of focal length and centre at this attitude, about which `SpherePoints` is linear.

        An eccentricity that is not significant does not count.
        """
        return np.append(self.rig_error[:1], self.centre) if self.is_off_centre else self.rig_error

    @property
    def is_off_centre(self) -> bool:
        """Return whether the eccentricity is significant."""
        return float(self.eccentricity @ self.eccentricity) >= sum(self.joint.diagonal()[ECCENTRICITY].tolist())

    @property
    def map_row(self) -> int:
        """Row of `joint` with the first error of the first disc; the errors before it are those of all cameras."""
        return MAP_OFFSET + CAMERA_DIM * len(self.others)

    @property
    def discs(self) -> Array:
        """(m, 3) unit vectors in `ball`."""
        return self.landmarks[: len(self.landmarks) - len(self.candidates)] if len(self.candidates) else self.landmarks

    @property
    def places_of_candidates(self) -> Array:
        """(c, 3) unit vectors in `ball`."""
        return self.landmarks[len(self.discs) :]

    @property
    def is_placed(self) -> bool:
        """Return whether the attitude predicts each disc unambiguously: no other disc is as near."""
        P = self.joint
        if P[0, 0] + P[1, 1] + P[2, 2] < PLACED**2:  # the sum of the eigenvalues: faster than they are
            return True
        return bool(np.linalg.eigvalsh(P[:3, :3])[-1] < PLACED**2)

    @property
    def is_roughly_known(self) -> bool:
        """Return whether the attitude is better than a guess."""
        return bool(np.linalg.eigvalsh(self.joint[:3, :3])[-1] < 1.0)

    @property
    def body(self) -> tuple[Array, Array, Array, Array, Array, Array, float, Array, int, bool, int, Array]:
        """The fields that predict where the camera sees each landmark, as `kernels` takes them."""
        motion = self.attitude, self.rate, self.acceleration
        known = len(self.landmarks) - len(self.candidates)
        return (
            *motion,
            self.landmarks,
            self.basis,
            self.joint,
            self.readout,
            self.rig_error,
            known,
            self.holds_rig,
            len(self.others),
            self.eccentricity,
        )

    @property
    def pending(self) -> tuple[Array, float, Array, Modes | None]:
        """The prediction that no update has used, as `kernels` takes it."""
        return self.process, self.interval, self.weights, self.modes

    @property
    def sightings(self) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Sightings, misses in a row and hiding of each disc, as `kernels` takes them."""
        return self.hits, self.missed, self.hidden

    @property
    def covariance(self) -> Array:
        """(6, 6) of rotation error and rate."""
        return self.joint[:6, :6]

    @property
    def readout_sigma(self) -> float:
        """s, standard deviation of `readout`; 0 if the rig gives the readout."""
        return float(self.joint[self.map_row - 1, self.map_row - 1]) ** 0.5

    def map_sigma(self) -> Array:
        """Standard deviation, (m,) rad, along the worse axis, of each disc's place relative to the other discs.

        The rotation that all discs have in common drops out, since it changes no constellation: the S-transformation
        of Baarda 1973, with the discs' own variances as weights.
        """
        discs, m = self.discs, len(self.discs)
        if m < 2:
            return np.zeros(m)
        of_discs = slice(self.map_row, self.map_row + 2 * m)
        P = self.joint[of_discs, of_discs]
        A = -(self.basis[:m].transpose(0, 2, 1) @ hat(discs)).reshape(2 * m, 3)  # by a common rotation, ball
        weighted = A / np.maximum(np.diag(P), 1e-12)[:, None]
        B = np.linalg.solve(weighted.T @ A, weighted.T)  # (3, 2m), common rotation from the discs' errors
        BP, A = (B @ P).reshape(3, m, 2).transpose(1, 0, 2), A.reshape(m, 2, 3)
        ABP = A @ BP
        own = P.reshape(m, 2, m, 2)[np.arange(m), :, np.arange(m)]
        relative = own - ABP - ABP.transpose(0, 2, 1) + A @ (B @ P @ B.T) @ A.transpose(0, 2, 1)
        return np.sqrt(np.maximum(np.linalg.eigvalsh(relative)[:, 1], 0.0))

    def clone_attitude(self) -> "So3State":
        """Return the state with its current attitude as the reference of the next increment."""
        joint = self.joint.copy()
        joint[-CLONE_DIM:] = joint[:3]
        joint[:, -CLONE_DIM:] = joint[:, :3]
        return self._replace(joint=joint)

    def with_reference_of(self, other: "So3State") -> "So3State":
        """Return the state with the error of the reference of `other`, which is independent of this state's errors.

        It has the other cameras and the estimate of the rig of that state. The rig is as uncertain as in this state,
        and its centre moves as in that one.
        """
        joint = self.joint.copy()
        joint[-CLONE_DIM:] = joint[:, -CLONE_DIM:] = 0.0
        joint[-CLONE_DIM:, -CLONE_DIM:] = other.joint[-CLONE_DIM:, -CLONE_DIM:]
        joint[CENTRE, CENTRE] += other.centre_noise * WANDER_S * np.eye(3)
        placed = self._replace(joint=joint, rig_error=other.rig_error, centre_noise=other.centre_noise)
        return placed.with_cameras_of(other)

    def with_cameras_of(self, other: "So3State") -> "So3State":
        """Return the state, of one camera, with the other cameras of `other`. Their errors keep their covariance."""
        added = slice(READOUT, READOUT + CAMERA_DIM * len(other.others))
        return _with_others(self, other.joint[added, added], other.others)

    def with_camera(self, prior: Array) -> "So3State":
        """Return the state with one more camera.

        `prior` (16 + 8p, 16 + 8p) is the covariance that rig, axes and readout of all cameras have before any frame: of
        the camera that shows this frame, of the others, and of the new one. The new errors are the part that those
        of the present cameras determine, and an independent rest. So frames that have corrected the present cameras
        correct the new one.
        """
        n, hidden, k = self.map_row - 1, np.full(len(self.discs), HIDDEN_SHARE), len(prior) - CAMERA_DIM
        present = np.r_[RIG_ROW:READOUT, n, READOUT:n]
        G = prior[k:, :k] @ np.linalg.pinv(prior[:k, :k], hermitian=True)
        known = G @ (self.joint[np.ix_(present, present)] - prior[:k, :k]) @ G.T
        cross = self.joint[:, present] @ G.T
        means = [np.r_[each.rig_error, np.zeros(3), each.readout] for each in (self, *self.others)]
        mean = G @ np.concatenate(means)
        other = OtherCamera(mean[:RIG_DIM], float(mean[-1]), hidden)
        state = _with_others(self, prior[k:, k:] + 0.5 * (known + known.T), (*self.others, other))
        new, old = slice(n, n + CAMERA_DIM), np.r_[:n, n + CAMERA_DIM : len(state.joint)]
        state.joint[old, new], state.joint[new, old] = cross, cross.T
        return state

    def facing(self, which: int) -> "So3State":
        """Return the state for a frame of the camera `which` of the others; the present one takes its place there."""
        other = self.others[which]
        theirs = READOUT + CAMERA_DIM * which + np.arange(CAMERA_DIM)
        ours, order = np.r_[RIG_ROW:READOUT, self.map_row - 1], np.arange(len(self.joint))
        order[ours], order[theirs] = theirs, ours
        others = list(self.others)
        others[which] = OtherCamera(self.rig_error, self.readout, self.hidden)
        return self._replace(
            joint=self.joint[np.ix_(order, order)],
            rig_error=other.rig_error,
            readout=other.readout,
            hidden=other.hidden,
            others=tuple(others),
        )

    def increment_covariance(self, turn: Array) -> Array:
        """Return the covariance, (6, 6), of the rotation vector `turn`, (3,) rad, since the reference, and of the rate.

        The state includes the error of the reference (stochastic cloning: Roumeliotis, Burdick 2002). Thus errors of
        the map and the camera's pose that two attitudes share cancel.
        """
        return kernels.since_reference(self.joint, turn)

    @property
    def statistics(self) -> dict[str, float]:
        """The normalised innovation squared of the last update."""
        return {"nis": self.nis}


def inject(
    state: So3State,
    dx: Array,
    joint: Array | None = None,
    weights: Array | None = None,
    manoeuvre_level: float = 1.0,
    used: NDArray[np.intp] | None = None,
    nis: float = 0.0,
) -> So3State:
    """Move the state by an error vector, (23 + 8p + 2l,); then no prediction is pending.

    `joint` is the covariance of the errors before the move, and `weights` (l,) the probability of the levels. None
    keeps the old one. `used` (k,) are indices of the points in the update.
    """
    body = state.body if joint is None else (*state.body[:5], joint, *state.body[6:])
    motion, moved, readout, rig_error, eccentricity = kernels.move(body, dx)
    return So3State(
        state.stamp,
        *motion,
        moved,
        *state.sightings,
        state.used if used is None else used,
        state.weights if weights is None else weights,
        _NO_PROCESS,
        manoeuvre_level,
        nis,
        readout,
        rig_error,
        eccentricity,
        state.centre_noise,
        state.holds_rig,
        candidates=state.candidates,
        others=state.others,
    )


def delays(points: SpherePoints, state: So3State) -> Array:
    """Return the delay of each point's exposure, (n,) s after the stamp, with the estimated rolling shutter."""
    return points.delay + state.readout * points.row if state.readout != 0.0 else points.delay


def omitted_variance(covariance: Array) -> Array:
    """Return the variances, (k,) rad², of places by omitted terms, from covariances to first order, (k, d, d) rad²."""
    return np.minimum(np.trace(covariance, axis1=1, axis2=2), kernels.MAX_PLACE_VARIANCE) ** 2


def _with_others(state: So3State, covariance: Array, others: tuple[OtherCamera, ...]) -> So3State:
    """Return the state with errors of further cameras, of a `covariance` (8k, 8k), before the readout's error."""
    k, n = len(covariance), state.map_row - 1
    joint, old = np.zeros((len(state.joint) + k, len(state.joint) + k)), np.r_[:n, n + k : len(state.joint) + k]
    joint[np.ix_(old, old)], joint[n : n + k, n : n + k] = state.joint, covariance
    hidden = np.full(len(state.discs), HIDDEN_SHARE)
    others = tuple(o if len(o.hidden) == len(hidden) else o._replace(hidden=hidden) for o in others)
    return state._replace(joint=joint, others=others)
