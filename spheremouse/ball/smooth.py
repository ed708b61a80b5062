"""Fixed-interval smoother of the default filter: each state given all frames of a film, also the later ones.

The smoother of Rauch, Tung and Striebel (1965) for rotation, rate and acceleration, with rotation errors on the left as
in Barfoot 2017, section 7.2. The motion is that of the default filter. Its map, the camera's pose and the ball are the
same in all frames. Thus their errors do not average out: each smoothed covariance keeps the part that they explain.

A player pushes the ball and leaves it alone. So the density of the jerk differs from frame to frame. The levels of the
default filter are a Markov chain. Filters for each level that interact (Blom, Bar-Shalom 1988) give their likelihoods,
and the posterior given all frames (Rabiner 1989, section III) gives the mean density.

The detector's covariances also cover errors of a disc's centre that last, which the map bears. The part that is new in
each frame follows from the residuals within the frames, as a variance factor.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_motion import CLONE_DIM, KINEMATIC_DIM
from spheremouse.ball.filters.so3_settings import (
    DWELL_S,
    PERSISTENCE_S,
    UNKNOWN_RATE_FACTOR,
    So3Settings,
    activity_of,
    prior_of_levels,
    usual_acceleration,
)
from spheremouse.ball.filters.so3_state import PLACED, So3State
from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import Array, exp, left_jacobian, rotation_between
from spheremouse.native import kernels
from spheremouse.tracker import Estimate, Status

_EXACT_AXES_SIGMA_RAD = 1e-6  # rad: the axes of a map without error
_RIDGE_RAD2 = 1e-18  # rad²: parameters that are known exactly have no variance to invert
_STATED_FREEDOM = 8.0  # degrees of freedom of the stated noise as prior: its variance is right within a half
# Block of an estimate's covariance: rotation and its rate
_ROTATION_AND_RATE = np.ix_((0, 1, 2, 6, 7, 8), (0, 1, 2, 6, 7, 8))


class Observation(NamedTuple):
    """Information of one frame alone about rotation, rate and acceleration, linear about the filter's estimate.

    The errors are those of the default filter: rotation (3, rad, obj), rate (3, rad/s), acceleration (3, rad/s²). An
    error x of the estimate has the log likelihood `score @ x - x @ information @ x / 2`.
    """

    estimate: Estimate
    acceleration: Array  # (3,) rad/s², angular, obj
    information: Array  # (9, 9); zero without discs in their places
    score: Array  # (9,)
    shared: Array  # (6, 6) covariance of rotation and rate due to map, pose, ball and readout
    squared_residual: float = 0.0  # chi-square of the residuals after a rotation of all discs in common
    expected_residual: float = 0.0  # of that, if the stated noise is right


def observe(
    estimate: Estimate, state: So3State, points: SpherePoints, filter_: So3Filter, ambiguous: bool = False
) -> Observation:
    """Return the information of a frame's `points` about the motion, given the filter's state and estimate after it.

    A frame that is `ambiguous`, since other attitudes are possible, informs only if it confirms the estimate.
    The residuals have the covariance of the image noise and of each disc's place relative to the other discs.
    """
    J, score, residual = np.zeros((KINEMATIC_DIM, KINEMATIC_DIM)), np.zeros(KINEMATIC_DIM), (0.0, 0.0)
    rows = state.used
    if len(rows) and (estimate.confirmed or not ambiguous):
        cosine = points.direction[rows] @ state.attitude @ state.discs.T
        near = cosine.max(axis=1) > np.cos(filter_.disc_angle)
        rows, columns = rows[near], cosine.argmax(axis=1)[near]
        exact = state._replace(joint=np.zeros_like(state.joint))
        H, _, z, S = kernels.innovation(
            exact.body, points.measurement(filter_.station.radius), rows, columns, np.zeros_like(J)
        )
        by_map = np.repeat(state.map_sigma()[columns] ** 2, 2)
        white = np.linalg.inv(np.linalg.cholesky(S + np.diag(by_map)))
        H, z = white @ H, white @ z
        J, score, residual = H.T @ H, H.T @ z, _residual(H, z, white @ np.diag(by_map) @ white.T)
    return Observation(estimate, state.acceleration, J, score, _constant_part(state.joint), *residual)


def _residual(H: Array, z: Array, by_map: Array) -> tuple[float, float]:
    """Return the squared residual and its expectation after a rotation, from whitened H (n, 9) and z (n,).

    The filter has corrected the discs by these points. So the covariance of z is the image noise less that of the
    discs' places, `by_map` (n, n), whitened.
    """
    Q, _ = np.linalg.qr(H[:, :3])
    rest = np.eye(len(z)) - Q @ Q.T
    return float(z @ rest @ z), max(float(np.trace(rest) - 2.0 * np.sum(rest * by_map)), 0.0)


def _constant_part(joint: Array) -> Array:
    """Return the part of the covariance of rotation and rate, (6, 6), that the constant parameters explain."""
    constant = joint[KINEMATIC_DIM:-CLONE_DIM, KINEMATIC_DIM:-CLONE_DIM]
    cross = joint[:6, KINEMATIC_DIM:-CLONE_DIM]
    shared = cross @ np.linalg.solve(constant + _RIDGE_RAD2 * np.eye(len(constant)), cross.T)
    return 0.5 * (shared + shared.T)


class Motion(NamedTuple):
    """Normal distribution of rotation, rate and acceleration."""

    attitude: Array  # (3, 3) R_obj_ball
    rate: Array  # (3,) rad/s, obj
    acceleration: Array  # (3,) rad/s², obj
    covariance: Array  # (9, 9) of the errors of `Observation`

    def moved(self, x: Array, covariance: Array) -> "Motion":
        """Return the distribution moved by the errors x, (9,), with another covariance."""
        return Motion(exp(x[:3]) @ self.attitude, self.rate + x[3:6], self.acceleration + x[6:], covariance)

    def to(self, attitude: Array, rate: Array, acceleration: Array) -> Array:
        """Return the errors, (9,), that move the mean to another motion."""
        turn = rotation_between(self.attitude, attitude)
        return np.concatenate([turn, rate - self.rate, acceleration - self.acceleration])


def smooth(observations: Iterable[Observation], settings: So3Settings) -> list[Estimate]:
    """Return one estimate for each frame, in its order, given all frames.

    Frames of a ball that is not tracked keep their estimate. They end an interval, and so does a clock that starts
    again. Within an interval, frames without information are bridged.
    """
    result: list[Estimate] = []
    for interval in _intervals(observations):
        if interval[0].estimate.status is Status.TRACKING:
            informed = _with_reference(_with_variance_factor(interval))
            motions, gains = smooth_interval(informed, jerk_densities(informed, settings), settings)
            result += _estimates(informed, motions, gains)
        else:
            result += [o.estimate for o in interval]
    return result


def _intervals(observations: Iterable[Observation]) -> list[list[Observation]]:
    intervals: list[list[Observation]] = []
    for observation in observations:
        now = observation.estimate
        before = intervals[-1][-1].estimate if intervals else None
        found_again = now.confirmed and not now.increment_covariance.any()
        if before is None or now.status is not before.status or now.stamp <= before.stamp or found_again:
            intervals.append([])
        intervals[-1].append(observation)
    return intervals


def _with_variance_factor(interval: list[Observation]) -> list[Observation]:
    """Return the interval with the noise that its residuals show: the stated one times a variance factor."""
    squares = _STATED_FREEDOM + sum(o.squared_residual for o in interval)
    factor = squares / (_STATED_FREEDOM + sum(o.expected_residual for o in interval))
    return [o._replace(information=o.information / factor, score=o.score / factor) for o in interval]


def _is_reference(observation: Observation) -> bool:
    """Return whether the attitude is exact, since the frame defines the axes of the ball."""
    return not observation.estimate.covariance[:3, :3].any()


def _with_reference(interval: list[Observation]) -> list[Observation]:
    """Return the interval with the information of the frame that defines the axes of the ball, if it has one.

    Relative to the map of a later frame, the exact attitude has the error of that map's axes. The covariance of this
    error is the shared one of the frame at which the map is known best.
    """
    first, *others = interval
    shared = [o.shared[:3, :3] for o in others if o.information.any()]
    if not _is_reference(first) or not shared:
        return interval
    J = np.zeros((KINEMATIC_DIM, KINEMATIC_DIM))
    J[:3, :3] = np.linalg.inv(min(shared, key=np.trace) + _EXACT_AXES_SIGMA_RAD**2 * np.eye(3))
    return [first._replace(information=J, score=np.zeros(KINEMATIC_DIM)), *others]


def jerk_densities(observations: Sequence[Observation], settings: So3Settings) -> Array:
    """Return the mean density of the white jerk, (n - 1,) (rad/s³)² s per axis, between n frames of one interval.

    A jerk turns the ball seven times as much in the next interval as in its own. So the level that a frame shows counts
    for both.
    """
    dt = np.diff([o.estimate.stamp for o in observations])
    densities = 2.0 * activity_of(settings).variances / PERSISTENCE_S
    prior, stay = prior_of_levels(settings.levels), np.exp(-dt / DWELL_S)
    changes = stay[:, None, None] * np.eye(len(prior)) + (1.0 - stay[:, None, None]) * prior
    weights, likelihoods = _levels(observations, densities, changes, settings)
    backward = np.ones(len(prior))
    for k in range(len(dt) - 1, -1, -1):
        backward = changes[k] @ (likelihoods[k + 1] * backward)
        backward /= backward.sum()
        weights[k] *= backward
    weights /= weights.sum(axis=1, keepdims=True)
    weights[:-1] = 0.5 * (weights[:-1] + weights[1:])
    return weights[1:] @ densities


def _levels(
    observations: Sequence[Observation], densities: Array, changes: Array, settings: So3Settings
) -> tuple[Array, Array]:
    """Return probabilities of l levels given the frames so far, and likelihoods of each frame, both (n, l).

    Each level's filter starts a frame from the mixture of all filters that may have changed to it (Blom, Bar-Shalom
    1988). `changes` (n - 1, l, l) are probabilities from row to column.
    """
    start, _ = _update(_start(observations[0], settings), observations[0])
    modes, weights = [start] * len(densities), np.tile(prior_of_levels(settings.levels), (len(observations), 1))
    likelihoods = np.ones_like(weights)
    for k, observation in enumerate(observations[1:], 1):
        dt = observation.estimate.stamp - observations[k - 1].estimate.stamp
        joint, informed = weights[k - 1][:, None] * changes[k - 1], bool(observation.information.any())
        logarithms = np.empty(len(densities))
        for level, mixed in enumerate(_mix(modes, joint / joint.sum(axis=0))):
            predicted, _ = _predict(mixed, dt, densities[level], informed)
            modes[level], logarithms[level] = _update(predicted, observation)
        likelihoods[k] = np.exp(logarithms - logarithms.max())
        weights[k] = joint.sum(axis=0) * likelihoods[k]
        weights[k] /= weights[k].sum()
    return weights, likelihoods


def _mix(modes: Sequence[Motion], weights: Array) -> list[Motion]:
    """Return the moments of l mixtures of m modes with `weights` (m, l)."""
    centre = modes[0]
    apart = np.array([centre.to(*mode[:3]) for mode in modes])
    P = np.array([mode.covariance for mode in modes])
    result = []
    for w in weights.T:
        mean = w @ apart
        off = apart - mean
        result.append(centre.moved(mean, np.tensordot(w, P, 1) + (w * off.T) @ off))
    return result


def smooth_interval(
    observations: Sequence[Observation], densities: Array, settings: So3Settings
) -> tuple[list[Motion], list[Array]]:
    """Return the smoothed motion at each of n frames, and the n - 1 gains, (9, 9), with white jerk of `densities`.

    With prediction p and filtered motion f the recursion is, from the last frame back,
    G = P_f F' P_p^-1, x = x_f + G (x' - x_p), P = P_f + G (P' - P_p) G', where a dash marks the frame after
    (Rauch, Tung, Striebel 1965, eq. 3.30; on a manifold x' - x_p is the logarithm of the rotation between them).
    The covariance of two successive states is P' G'.
    """
    filtered, predictions = _filter(observations, densities, settings)
    motions, gains = [filtered[-1]], []
    for before, (predicted, cross) in zip(filtered[-2::-1], predictions[::-1], strict=True):
        after = motions[-1]
        G = np.linalg.solve(predicted.covariance, cross).T
        P = before.covariance + G @ (after.covariance - predicted.covariance) @ G.T
        motions.append(before.moved(G @ predicted.to(*after[:3]), 0.5 * (P + P.T)))
        gains.append(G)
    return motions[::-1], gains[::-1]


def _start(observation: Observation, settings: So3Settings) -> Motion:
    """Return the motion before the first frame of an interval."""
    sigma = np.repeat([PLACED, UNKNOWN_RATE_FACTOR * settings.start_rate_sigma, usual_acceleration(settings)], 3)
    return Motion(observation.estimate.rotation, np.zeros(3), np.zeros(3), np.diag(sigma**2))


def _filter(
    observations: Sequence[Observation], densities: Array, settings: So3Settings
) -> tuple[list[Motion], list[tuple[Motion, Array]]]:
    """Return n filtered motions, and the n - 1 predictions with F P, (9, 9)."""
    predicted = _start(observations[0], settings)
    motions, predictions = [], []
    for k, observation in enumerate(observations):
        if k:
            dt = observation.estimate.stamp - observations[k - 1].estimate.stamp
            predicted, cross = _predict(motions[-1], dt, densities[k - 1], bool(observation.information.any()))
            predictions.append((predicted, cross))
        motions.append(_update(predicted, observation)[0])
    return motions, predictions


def _predict(motion: Motion, dt: float, density: float, informed: bool) -> tuple[Motion, Array]:
    """Return the motion after `dt` s, and its covariance with the motion before, F P, (9, 9), by stochastic cloning.

    The acceleration decays exponentially (Singer 1970), unless a frame with discs (`informed`) soon corrects it, as in
    the default filter. `density` is that of the white jerk, (rad/s³)² s.
    """
    time_constant = np.inf if informed and dt <= 0.5 * PERSISTENCE_S else PERSISTENCE_S
    tiled = np.tile(motion.covariance, (2, 2))
    attitude, rate, acceleration, P = kernels.predict_motion(*motion[:3], tiled, dt, time_constant, density)
    return Motion(attitude, rate, acceleration, P[:KINEMATIC_DIM, :KINEMATIC_DIM]), P[:KINEMATIC_DIM, KINEMATIC_DIM:]


def _update(prior: Motion, observation: Observation) -> tuple[Motion, float]:
    """Return the motion given a frame, in information form, and its log likelihood up to a constant."""
    J, estimate = observation.information, observation.estimate
    d = prior.to(estimate.rotation, estimate.rate[:3], observation.acceleration)
    A = np.eye(KINEMATIC_DIM) + J @ prior.covariance
    P, v = np.linalg.solve(A.T, prior.covariance), observation.score + J @ d
    P = 0.5 * (P + P.T)
    square = d @ (J @ d + 2.0 * observation.score) - v @ P @ v
    return prior.moved(P @ v, P), -0.5 * float(square + np.linalg.slogdet(A)[1])


def _estimates(interval: Sequence[Observation], motions: Sequence[Motion], gains: Sequence[Array]) -> list[Estimate]:
    """Return the estimates of one interval with their smoothed motions, and increments between the confirmed ones.

    A frame that defines the axes of the ball keeps its attitude. All attitudes take the axes that this frame defines.
    """
    result: list[Estimate] = []
    exact, last = _is_reference(interval[0]), 0  # the last confirmed frame; the first frame starts the motion
    axes = motions[0].attitude.T @ interval[0].estimate.rotation if exact else np.eye(3)
    cross = np.eye(KINEMATIC_DIM)  # product of the gains since that frame
    for k, (observation, motion) in enumerate(zip(interval, motions, strict=True)):
        cross = cross @ gains[k - 1] if k else cross
        rate, covariance = np.zeros(6), np.zeros((12, 12))
        increment, increment_covariance = np.zeros(6), np.zeros((6, 6))
        rate[:3], covariance[_ROTATION_AND_RATE] = motion.rate, motion.covariance[:6, :6] + observation.shared
        if k == 0 and exact:
            covariance[:3], covariance[:, :3] = 0.0, 0.0
        if k and observation.estimate.confirmed:
            before = motions[last]
            turn = rotation_between(before.attitude, motion.attitude)
            increment[:3] = turn
            increment_covariance[:3, :3] = _turn_covariance(turn, before.covariance, motion.covariance, cross)
            last, cross = k, np.eye(KINEMATIC_DIM)
        result.append(
            observation.estimate._replace(
                rotation=motion.attitude @ axes,
                rate=rate,
                covariance=covariance,
                increment=increment,
                increment_covariance=increment_covariance,
            )
        )
    return result


def _turn_covariance(turn: Array, before: Array, after: Array, gain: Array) -> Array:
    """Return the covariance, (3, 3), of the rotation vector between two states; shared errors cancel."""
    R, across = exp(turn), (gain @ after)[:3, :3]  # of the errors before and after
    J = np.linalg.inv(left_jacobian(turn))
    return J @ (after[:3, :3] - R @ across - (R @ across).T + R @ before[:3, :3] @ R.T) @ J.T
