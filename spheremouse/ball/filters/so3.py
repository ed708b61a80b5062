"""The default filter: attitude on SO(3), angular velocity and acceleration in `obj`, and the map of discs in one state.

An error-state extended Kalman filter (Sola 2017, "Quaternion kinematics for the error-state Kalman filter", left
errors in `obj`) with an angular acceleration that lasts until the hand changes it, and discs as landmarks with their
full correlations (Smith, Self, Cheeseman 1990). No angle is a coordinate, so nothing is singular; a disc out of view
stays known and closes the loop. The camera's axes, wrong in every frame alike, are considered, not estimated (Schmidt
1966). So are focal length and the ball's centre while they are known well and the ball rests in its place. A centre
that moves, and lengths that a tape measured, are estimated. `so3_eccentric` has a ball that is not centred.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.filters.so3_camera import move_centres, with_rig_uncertainty
from spheremouse.ball.filters.so3_eccentric import ROUND_SIGMA
from spheremouse.ball.filters.so3_map import augment, drop, promote, with_candidates, without_candidates
from spheremouse.ball.filters.so3_motion import (
    CLONE_DIM,
    KINEMATIC_DIM,
    MAP_OFFSET,
)
from spheremouse.ball.filters.so3_rig import Station
from spheremouse.ball.filters.so3_settings import (
    DWELL_S,
    PERSISTENCE_S,
    UNKNOWN_RATE_FACTOR,
    Activity,
    So3Settings,
    activity_of,
    squared_levels,
    usual_acceleration,
)
from spheremouse.ball.filters.so3_state import COMMON, ECCENTRICITY, RIG, WANDER_S, So3State, inject, omitted_variance
from spheremouse.ball.points import Measurement, SpherePoints
from spheremouse.geometry.matching import are_among, assign, suppress
from spheremouse.geometry.rotation import Array, rotation_between
from spheremouse.geometry.statistics import poisson_tail
from spheremouse.native import kernels

_MAX_GAP_S = 10.0  # s: after a longer gap nothing is known of the attitude anyhow, and the covariance must stay finite
_NONE = np.zeros(0, dtype=np.intp)
_RARE = kernels.RARE  # probability per frame below which chance does not explain the pairs
_LARGE_TWIST = 6.0  # rad/s: a third of `loss.fastest`, it counts by its logarithm
_POINT_SIGMA = kernels.POINT_SIGMA  # rad, of a seen direction: a tenth of a pixel on a ball 200 px across
_MAX_CANDIDATES = 6  # as many points are searched for each attitude; more points show the rotation without them
_NO_PATH = np.zeros(3)  # m, of a centre whose way is unknown
_CENTRE_NOISE = 0.02  # radii/sqrt(s), of a centre that begins to move: it sinks by 10 mm in 0.2 s
_KNOWN_RIG = 0.002  # relative, and in radii: standard deviation of lengths that photos measured: they stay considered
_STILL_S = 1.0  # s of views of a still scene that count as one view
_NO_NOISE = np.zeros((KINEMATIC_DIM, KINEMATIC_DIM))


class CandidatePoints(NamedTuple):
    """Points that are candidates for discs."""

    rows: NDArray[np.intp]  # (k,) indices into the points
    numbers: NDArray[np.intp]  # (k,) of the candidates
    turning: NDArray[np.bool_]  # (k,) proven to turn with the ball


class Pairing(NamedTuple):
    """Points taken for discs."""

    rows: NDArray[np.intp]  # (k,) indices into the points
    columns: NDArray[np.intp]  # (k,) indices into the discs
    complete: bool = True  # all that could pair does, each in its place
    noise_scale: float = 1.0  # of the level at which they pair


@dataclass(frozen=True, slots=True)
class So3Filter:
    """Settings, the camera's station, and the size of a disc."""

    settings: So3Settings
    station: Station
    disc_angle: float  # rad, angular radius of a disc

    def initial(self, stamp: float, attitude: Array) -> So3State:
        """Return the state at rest at `attitude`, (3, 3), the reference without error; the map is empty."""
        joint = np.zeros((MAP_OFFSET + CLONE_DIM, MAP_OFFSET + CLONE_DIM))
        joint[3:6, 3:6] = self.settings.start_rate_sigma**2 * np.eye(3)
        joint[6:KINEMATIC_DIM, 6:KINEMATIC_DIM] = usual_acceleration(self.settings) ** 2 * np.eye(3)
        joint[ECCENTRICITY, ECCENTRICITY] = (ROUND_SIGMA * self.station.radius) ** 2 * np.eye(3)
        state = So3State(stamp, attitude, np.zeros(3), np.zeros(3), np.zeros((0, 3)), np.zeros((0, 3, 2)), joint)
        return self.with_station(state)

    def with_station(self, state: So3State) -> So3State:
        """Return the state with the rig error of this station and its covariance.

        No frame of this camera may have corrected the state.
        """
        joint, ours = state.joint.copy(), np.r_[COMMON, state.map_row - 1]
        joint[ours], joint[:, ours] = 0.0, 0.0
        joint[np.ix_(ours, ours)] = self.station.covariance()
        return state._replace(joint=joint, rig_error=self.station.size_error * self.station.common_by_size())

    def predict(self, state: So3State, stamp: float) -> So3State:
        """Predict the state for `stamp`, by up to 10 s, with an acceleration that drifts but makes no step.

        `process` and `weights` describe the additional variance by steps.
        """
        dt = float(min(max(stamp - state.stamp, 0.0), _MAX_GAP_S))
        attitude, rate, acceleration, joint, weights, process, interval, modes = kernels.predict(
            state.body, state.pending, dt, activity_of(self.settings)
        )
        if state.centre_noise > 0.0:
            move_centres(joint, min(dt, WANDER_S) * state.centre_noise * np.eye(3), len(state.others))
        focal, *centre = joint.diagonal()[RIG].tolist()
        known = focal + sum(centre) / self.station.radius**2 < _KNOWN_RIG**2

        def carried(hidden: Array) -> Array:
            return kernels.carry_hidden(attitude, rate, state.discs, hidden, dt, self.disc_angle)

        return So3State(
            stamp,
            attitude,
            rate,
            acceleration,
            state.landmarks,
            state.basis,
            joint,
            state.hits,
            state.missed,
            carried(state.hidden),
            _NONE,
            weights,
            process,
            readout=state.readout,
            rig_error=state.rig_error,
            eccentricity=state.eccentricity,
            centre_noise=state.centre_noise,
            holds_rig=bool(known and state.centre_noise == 0.0),
            interval=interval,
            modes=modes,
            candidates=state.candidates,
            others=tuple(other._replace(hidden=carried(other.hidden)) for other in state.others),
        )

    def let_centre_move(self, state: So3State, path: Array = _NO_PATH) -> So3State:
        """Return the state with a ball whose centre has left its place, perhaps by `path`, (3,) m, and moves on."""
        noise, joint = (_CENTRE_NOISE * self.station.radius) ** 2, state.joint.copy()
        move_centres(joint, noise * WANDER_S * np.eye(3) + np.outer(path, path), len(state.others))
        return state._replace(joint=joint, centre_noise=max(state.centre_noise, noise), holds_rig=False)

    def with_rig_uncertainty(self, state: So3State, size_sigma: float) -> So3State:
        """Return the state with a covariance that has the errors of a radius and focal length measured by tape.

        `size_sigma` is the relative standard deviation of the radius by the ball's outline.
        """
        return with_rig_uncertainty(state, self.station.covariance_by_tape(size_sigma))._replace(holds_rig=False)

    def with_unseen_turn(self, state: So3State, axis: Array, duration: float) -> So3State:
        """Return the state as uncertain as a turn about `axis`, (3,) obj, makes it that no disc has shown of late.

        The acceleration is that of a player of whom nothing is known (Singer 1970), and the rate at most that of a
        start. `duration` is in s.
        """
        density = 2.0 * PERSISTENCE_S * usual_acceleration(self.settings) ** 2
        variance, joint = min(density * duration, self.settings.start_rate_sigma**2), state.joint.copy()
        growth = np.array([[duration**2 / 3.0, 0.5 * duration], [0.5 * duration, 1.0]])  # of turn and rate
        joint[:6, :6] += variance * np.kron(growth, np.outer(axis, axis))
        return state._replace(joint=joint)

    def without_unseen_axes(self, state: So3State, predicted: So3State, seen: Array) -> So3State:
        """Return the update of `predicted` so that it takes nothing from motion about axes that the frame did not show.

        `seen` (3, 3) projects vectors in `obj` to the other axes. The components of attitude, rate and acceleration
        about unseen axes are considered, not estimated (Schmidt 1966). Rate and acceleration tend to those of an
        unknown player, as Singer (1970) has it for the acceleration.
        """
        unseen, joint, kinematic = np.eye(3) - seen, state.joint.copy(), slice(KINEMATIC_DIM)
        every = np.kron(np.eye(3), unseen)
        before = predicted.joint[kinematic, kinematic] + self._added_noise(predicted, self._expected(predicted))
        taken, axes = np.linalg.eigh(every @ (before - joint[kinematic, kinematic]) @ every)
        joint[kinematic, kinematic] += axes * np.maximum(taken, 0.0) @ axes.T  # a step at a level adds some
        kept = np.exp(-predicted.interval / np.array([np.inf, DWELL_S, PERSISTENCE_S]))
        sigma = np.array([0.0, self.settings.start_rate_sigma, usual_acceleration(self.settings)])
        fade = np.eye(KINEMATIC_DIM) - np.kron(np.diag(1.0 - kept), unseen)
        joint[kinematic] = fade @ joint[kinematic]
        joint[:, kinematic] = joint[:, kinematic] @ fade.T
        joint[kinematic, kinematic] += np.kron(np.diag((1.0 - kept**2) * sigma**2), unseen)
        dx = np.zeros(len(joint))
        dx[:3] = unseen @ rotation_between(state.attitude, predicted.attitude)
        dx[3:6] = unseen @ (kept[1] * predicted.rate - state.rate)
        dx[6:9] = unseen @ (kept[2] * predicted.acceleration - state.acceleration)
        return inject(state, dx, joint, state.weights, state.manoeuvre_level, state.used, state.nis)

    def is_beyond_a_tape(self, state: So3State, size_sigma: float) -> bool:
        """Return whether the centre is farther off than by three standard deviations of lengths by tape.

        `size_sigma` is as in `with_rig_uncertainty`.
        """
        return bool(state.pivot @ state.pivot > 9.0 * np.trace(self.station.covariance_by_tape(size_sigma)[1:, 1:]))

    def adopt(self, state: So3State, before: "So3Filter") -> So3State:
        """Return the state of the filter `before`. If the levels changed, they start at their prior."""
        same = self.settings.levels == before.settings.levels
        return state if same else state._replace(weights=np.zeros(0), modes=None)

    def visible(self, state: So3State) -> NDArray[np.intp]:
        """Indices, (k,), of the discs that face the camera."""
        return (state.discs @ (self.station.towards @ state.attitude) > self.station.horizon).nonzero()[0]

    def detection_probability(self, state: So3State) -> Array:
        """Return the probability, (m,), that each disc is detected at a predicted state."""
        return kernels.detection_probability(state.attitude, state.discs, state.hidden, self._viewer(state))

    def _viewer(self, state: So3State) -> tuple[Array, float, Array]:
        """Return the camera as `kernels` takes it, with the covariance of the attitude that it sees."""
        return self.station.towards, self.station.horizon, state.joint[:3, :3].copy()

    def gate_radius(self, state: So3State, which: NDArray[np.intp], interval: float) -> Array:
        """Return the radius, (k,) rad, of the gates of discs in `interval` s, along the worse axis of each."""
        sigma = self.place_sigma(self.predict(state, state.stamp + interval), which)
        return np.sqrt(self.settings.gate * (sigma**2 + _POINT_SIGMA**2))

    def is_significant(self, predicted: So3State, used: int, points: int) -> bool:
        """Return whether chance explains so many pairs in under a thousandth of the frames.

        A point lies in a disc's gate by chance with a probability: the gate's share of the visible part of the ball.
        """
        sigma = self.place_sigma(predicted, self.visible(predicted))
        return bool(poisson_tail(used - 1, self._expected_by_chance(sigma, points)) < _RARE)

    def _expected_by_chance(self, sigma: Array, points: int) -> float:
        """Return how many of the points fall by chance into the gates of discs known to `sigma`, (k,) rad."""
        areas = self.settings.gate * np.pi * (sigma**2 + _POINT_SIGMA**2)
        return points * float(np.sum(areas)) / (2.0 * np.pi * (1.0 - self.station.horizon))

    def place_sigma(self, state: So3State, which: NDArray[np.intp]) -> Array:
        """Return the standard deviation, (k,) rad, of the predicted places of the discs `which`, on the worse axis."""
        return kernels.place_sigma(state.body, which, self._added_noise(state, self._expected(state)))

    def update(
        self, state: So3State, points: SpherePoints, may_start_landmark: NDArray[np.bool_] | None = None
    ) -> So3State:
        """Associate, correct, and keep the map: points of `may_start_landmark` (n,) may start a new disc (None: all).

        The innovations show how active the player is. The levels are states of a Markov chain. At each level the
        acceleration makes steps of a different size (`so3_motion`). The joint likelihood of all pairs weights the steps
        and levels.
        """
        corrected, pairing, _ = self._corrected_by_frame(state, points)
        return self.keep_map(corrected, points, pairing, may_start_landmark)

    def update_if_certain(
        self, state: So3State, points: SpherePoints, may_start_landmark: NDArray[np.bool_]
    ) -> So3State | None:
        """Return the result of `update` for a frame with certain pairs; None for any other frame.

        `may_start_landmark` is as in `keep_map`. Pairs are certain if one of three conditions holds:
        - the pairs are ordinary, or their discs known well, as `kernels.update_by_frame` describes,
        - chance does not explain so many pairs, three or more,
        - two pairs fix the attitude, and chance does not explain the other pairs.
        """
        corrected, pairing, certain = self._corrected_by_frame(state, points)
        pairs = len(pairing.rows)
        if not certain and pairs > 2:
            certain = self.is_significant(state, pairs, len(points)) or self._others_agree(corrected, len(points))
        return self.keep_map(corrected, points, pairing, may_start_landmark) if certain else None

    def _corrected_by_frame(self, state: So3State, points: SpherePoints) -> tuple[So3State, Pairing, bool]:
        """Return the state corrected by the nearest pairs of a frame, the pairs, and whether the first are certain.

        If the first are not complete, pairs that lie in their places only after the correction take part, too.
        """
        given, pairs, certain = kernels.update_by_frame(*self._frame(state, points))
        pairing = Pairing(*pairs)
        corrected = _with_twist(_state_from_kernel(state, given, pairing), pairing)
        if pairing.complete:
            return corrected, pairing, certain
        again = self.nearest_pairs(corrected, points)
        if len(again.rows) <= len(pairing.rows):
            return corrected, pairing, certain
        again = again._replace(noise_scale=1.0)  # the other is for the corrected state
        return self.correct(state, points, again)[0], again, certain

    def nearest_pairs(self, state: So3State, points: SpherePoints) -> Pairing:
        """Return the pairs of least total distance, at the most likely level at which most points pair."""
        return Pairing(*kernels.nearest_pairs(*self._frame(state, points)))

    def _frame(self, state: So3State, points: SpherePoints) -> tuple[Any, Any, tuple[Array, float], Any, Activity]:
        """Return state, points, camera and settings as `kernels` pairs them."""
        camera, activity = (self.station.towards, self.station.horizon), activity_of(self.settings)
        return state.body, self._measurement(state, points), camera, state.pending, activity

    def _others_agree(self, corrected: So3State, points: int) -> bool:
        """Return whether the pairs beyond the first two are significant, given the attitude from those two.

        The first two are no evidence, because any two points may pair with any two discs.
        """
        which = self.visible(corrected)
        sigma = kernels.place_sigma(corrected.body, which, _NO_NOISE)
        ways = 0.5 * points * (points - 1) * len(which) * (len(which) - 1)
        return ways * poisson_tail(len(corrected.used) - 3, self._expected_by_chance(sigma, points)) < _RARE

    def distances_to_discs(
        self, state: So3State, points: SpherePoints, gate: float, highest: bool = False
    ) -> tuple[Array, NDArray[np.intp]]:
        """Return squared Mahalanobis distances, (n, k), of the points to the discs that may be in view, and those.

        They are exact below `gate`. `highest`: with the noise of a step at the highest level, at any instant since the
        last frame. The process noise is the mean over all intervals, and few of them have a step.
        """
        slack = 2.0 * self.place_sigma(state, np.arange(len(state.discs)))
        cosine = state.discs @ (self.station.towards @ state.attitude)
        which = np.flatnonzero(cosine > self.station.horizon - np.minimum(slack, 0.5))
        steps = max(0.5 * PERSISTENCE_S / max(state.interval, 1e-3), 1.0)  # noise of one over the mean
        added = self._added_noise(state, steps * max(squared_levels(self.settings.levels)) if highest else 1.0)
        allowance = _omitted_variance(state, added)
        return kernels.distances(state.body, self._measurement(state, points), which, added, allowance, gate), which

    def _measurement(self, state: So3State, points: SpherePoints) -> Measurement:
        """Return the points as `kernels` takes them, with noise for the omitted terms of an uncertain rig.

        Views of a ball at rest have the same omitted terms. So a second of them counts as one view.
        """
        measurement = points.measurement(self.station.radius)
        if state.holds_rig or state.centre_noise > 0.0:
            return measurement
        J = points.ddirection_drig
        variance = omitted_variance(J @ state.joint[RIG, RIG] @ J.transpose(0, 2, 1))
        added = self.station.radius**2 * variance[:, None, None] * np.eye(3)
        if not _turns(state.rate, state.joint[3:6, 3:6]):
            added = added * max(_STILL_S / max(state.interval, 1e-3), 1.0)
        return measurement._replace(noise=measurement.noise + added)

    @staticmethod
    def _added_noise(state: So3State, noise_scale: float) -> Array:
        """Return the process noise, (9, 9), of a level, that the prediction has not added."""
        return (noise_scale - 1.0) * state.process

    def _expected(self, state: So3State) -> float:
        """Mean square of the level, before the innovations are seen."""
        return float(state.weights @ squared_levels(self.settings.levels)) if len(state.weights) else 1.0

    def correct(self, state: So3State, points: SpherePoints, pairing: Pairing) -> tuple[So3State, float]:
        """Return the state corrected by pairs, and their log likelihood, 1/rad² each, over all levels.

        A large correction is made again about the state it leads to.
        """
        corrected, log_likelihood = self._correct(state, points, pairing)
        return _with_twist(corrected, pairing), log_likelihood

    def _correct(self, state: So3State, points: SpherePoints, pairing: Pairing) -> tuple[So3State, float]:
        rows, columns = pairing.rows, pairing.columns
        pairs = rows, columns, self._added_noise(state, pairing.noise_scale)
        given, log_likelihood = kernels.correct(
            state.body, self._measurement(state, points), pairs, state.pending, activity_of(self.settings)
        )
        return _state_from_kernel(state, given, pairing), log_likelihood

    def keep_map(
        self,
        state: So3State,
        points: SpherePoints,
        pairing: Pairing,
        may_start_landmark: NDArray[np.bool_] | None = None,
    ) -> So3State:
        """Count sightings, drop discs that were missed too often in a row, and add points as new discs.

        `may_start_landmark` is a mask (n,) of the points that may become discs; None: all. A new point in a candidate's
        gate makes that candidate a disc.
        """
        (hits, missed, hidden), keep, known_seen, known_missed = kernels.count_sightings(
            state.attitude,
            state.discs,
            state.sightings,
            self._viewer(state),
            pairing.columns,
            len(points) > 0,
            self.disc_angle,
        )
        state = state._replace(
            hits=hits, missed=missed, hidden=hidden, known_seen=known_seen, known_missed=known_missed
        )
        free = np.ones(len(points), dtype=np.bool_) if may_start_landmark is None else may_start_landmark
        new = self._new_discs(state, points, free, pairing.rows)
        state = drop(state, keep)
        new = new[: self._room(state)]
        if len(new) and len(state.candidates) and state.is_placed:  # else no place identifies a candidate
            squared = self._distances_to_candidates(state, points, new, np.arange(len(state.candidates)))
            rows, which = assign(squared, self.settings.gate)
            state = self._promote(state, points, new[rows], which)
            new = np.delete(new, rows)
        return augment(state, points, new, self.station.radius)

    def follow_candidates(self, state: So3State, points: SpherePoints, seen: CandidatePoints) -> So3State:
        """Return the state after a frame's candidates. Those that turn with the ball become discs.

        The state includes a candidate from its first sighting on. Once it is a disc, both sightings correct the state.
        A candidate outside of the gate about its predicted place does not turn with the ball.
        """
        turning = are_among(seen.rows, self._free(state, points, seen.rows[seen.turning]))
        known = are_among(seen.numbers, state.candidates)
        if (turning & known).any():
            rows = seen.rows[turning & known]
            which = np.argmax(state.candidates == seen.numbers[turning & known, None], axis=1)
            in_place = self._distances_to_candidates(state, points, rows, which).diagonal() < self.settings.gate
            state = self._promote(state, points, rows[in_place], which[in_place])
        state = augment(state, points, seen.rows[turning & ~known], self.station.radius)
        new = np.flatnonzero(~seen.turning & ~known)[: max(_MAX_CANDIDATES - len(state.candidates), 0)]
        return with_candidates(state, points, seen.rows[new], seen.numbers[new], self.station.radius)

    def _distances_to_candidates(
        self, state: So3State, points: SpherePoints, rows: NDArray[np.intp], which: NDArray[np.intp]
    ) -> Array:
        """Return squared Mahalanobis distances, (k, c), of the points `rows` to the candidates `which`."""
        measurement = self._measurement(state, points.take(rows))
        columns, allowance = len(state.discs) + which, _omitted_variance(state, _NO_NOISE)
        return kernels.distances(state.body, measurement, columns, _NO_NOISE, allowance, self.settings.gate)

    def _promote(
        self, state: So3State, points: SpherePoints, rows: NDArray[np.intp], which: NDArray[np.intp]
    ) -> So3State:
        """Return the state with the candidates `which`, (k,), as discs, corrected by their points `rows`, (k,)."""
        if len(rows) == 0:
            return state
        promoted = promote(state, which)
        corrected, _ = self._correct(promoted, points, Pairing(rows, len(state.discs) + np.arange(len(rows))))
        return corrected._replace(
            used=np.concatenate([state.used, corrected.used]),
            manoeuvre_level=state.manoeuvre_level,
            nis=state.nis + corrected.nis,
        )

    def _free(self, state: So3State, points: SpherePoints, which: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return those of the points `which`, (k,), that can become discs."""
        free = np.zeros(len(points), dtype=np.bool_)
        free[which] = True
        return self._new_discs(state, points, free, _NONE)[: self._room(state)]

    def _new_discs(
        self, state: So3State, points: SpherePoints, free: NDArray[np.bool_], rows: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """Return the points, (k,), of a mask `free` (n,) that are no disc of the map; `rows` are paired with discs.

        Two discs do not overlap. A point that close to a known disc is a poor measurement of that disc. Of two points
        that close to each other, the first counts.
        """
        unpaired = free.copy()
        unpaired[rows] = False
        new = unpaired.nonzero()[0]
        if len(new) == 0:
            return new
        cosine = points.direction[new] @ state.attitude @ state.discs.T
        new = new[cosine.max(axis=1, initial=-1.0) < math.cos(2.0 * self.disc_angle)]
        return new[suppress(points.direction[new], np.full(len(new), 2.0 * math.sin(self.disc_angle)))]

    def _room(self, state: So3State) -> int:
        return max(self.settings.most_discs - len(state.discs), 0)


def relocate(
    state: So3State, attitude: Array, covariance: Array, settings: So3Settings, stamp: float, rate: Array | None = None
) -> So3State:
    """Return the map at a new `attitude` R_obj_ball with `covariance` (3, 3) rad², at `stamp` (s), for an update.

    `rate` (3,) rad/s, obj, is the expected rate, with `start_rate_sigma` as a hand may have changed it; None: unknown.
    Attitude and map become uncorrelated, because the new attitude does not depend on the history of the map.
    """
    state = without_candidates(state)  # their places depend on the attitude before
    joint = state.joint.copy()
    joint[:KINEMATIC_DIM] = joint[:, :KINEMATIC_DIM] = 0.0
    joint[:3, :3] = covariance
    rate_sigma = UNKNOWN_RATE_FACTOR * settings.start_rate_sigma if rate is None else settings.start_rate_sigma
    joint[3:6, 3:6] = rate_sigma**2 * np.eye(3)
    joint[6:KINEMATIC_DIM, 6:KINEMATIC_DIM] = usual_acceleration(settings) ** 2 * np.eye(3)
    return state._replace(
        stamp=stamp,
        attitude=attitude,
        rate=np.zeros(3) if rate is None else rate,
        acceleration=np.zeros(3),
        joint=joint,
        weights=np.zeros(0),
        process=np.zeros((KINEMATIC_DIM, KINEMATIC_DIM)),
        modes=None,
    )


def _state_from_kernel(state: So3State, given: tuple[Any, ...], pairing: Pairing) -> So3State:
    """Return the state with the fields that a correction by pairs changes."""
    motion, joint, weights, figures, modes = given
    Q, sightings, rows = _NO_NOISE, state.sightings, pairing.rows
    at_frame: Any = *motion, joint, *sightings, rows, weights, Q, *figures, state.centre_noise, state.holds_rig
    others, candidates = state.others, state.candidates
    return So3State(state.stamp, *at_frame, modes=modes, candidates=candidates, others=others)


def _with_twist(corrected: So3State, pairing: Pairing) -> So3State:
    """Return the state after a frame's pairs. If they are one, it has a twist about that disc."""
    return _twist_as_swing(corrected, pairing.columns[0]) if len(pairing.columns) == 1 else corrected


def _omitted_variance(state: So3State, added: Array) -> float:
    """Return the variance, rad², of a place by terms that the linear model omits, with `added` noise of the motion."""
    return float(omitted_variance((state.joint[:3, :3] + added[:3, :3])[None])[0])


def _turns(rate: Array, covariance: Array) -> bool:
    """Return whether a rate, (3,), is five standard deviations from zero."""
    return bool(rate @ np.linalg.solve(covariance, rate) > 25.0)


def _twist_as_swing(state: So3State, column: int) -> So3State:
    """Return the state after a frame of one disc, `column`, with a twist about that disc as large as the swing.

    One disc determines the swing, the two components of the rate across its direction, but not the twist. All
    directions of the rotation axis are equally likely. So the twist is the swing times the cotangent of an angle with a
    uniform cosine, up to a large turn by hand. Thus a ball is at rest if its one visible disc is at rest. The density
    of such twists falls as slowly as a power of the twist. So it bounds the variance of a twist that two discs showed
    before by the square of that twist, too.
    """
    axis = state.attitude @ state.discs[column]
    along = state.joint[:, 3:6] @ axis
    twist, variance = float(axis @ state.rate), float(axis @ along[3:6])
    swing = float(state.rate @ state.rate) - twist**2 + float(np.trace(state.joint[3:6, 3:6])) - variance
    most = _LARGE_TWIST / math.sqrt(max(swing, 1e-12))
    expected = swing * (math.asinh(most) - most / math.hypot(1.0, most)) + twist**2
    if variance <= expected:
        return state
    gain = along * (1.0 - expected / variance) / variance  # leaves the twist with the expected variance
    joint = state.joint - np.outer(gain, along)
    considered = slice(KINEMATIC_DIM, state.map_row - 1)
    joint[considered, considered] = state.joint[considered, considered]
    gain[considered] = 0.0  # considered parameters stay (Schmidt 1966)
    return inject(state, -gain * twist, joint, state.weights, state.manoeuvre_level, state.used, state.nis)
