"""The default filter: attitude on SO(3), angular velocity and acceleration in `obj`, and the map of discs in one state.

An error-state extended Kalman filter (Sola 2017, "Quaternion kinematics for the error-state Kalman filter", left
errors in `obj`) with an angular acceleration that lasts until the hand changes it, and discs as landmarks with their
full correlations (Smith, Self, Cheeseman 1990). No angle is a coordinate, so nothing is singular; a disc out of view
stays known and closes the loop. Pose and ball, wrong in every frame alike, are considered, not estimated (Schmidt
1966).
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from spheremouse.ball.filters import so3_match, so3_predict, so3_visibility
from spheremouse.ball.filters import so3_update as kernel
from spheremouse.ball.filters.so3_predict import CLONE_DIM, CONSIDERED_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.ball.filters.so3_settings import (
    DWELL_S,
    ESTABLISHED_HITS,
    MAX_MISSES_PER_HIT,
    MAX_TRIAL_MISSES,
    PERSISTENCE_S,
    So3Settings,
    prior_of_levels,
    squared_levels,
    usual_acceleration,
    variances,
)
from spheremouse.ball.filters.so3_state import So3State, augment, delays, drop, inject
from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array

_LONGEST = 10.0  # s: after a longer gap nothing is known of the attitude anyhow, and the covariance must stay finite
_LINEAR = 0.02  # rad: a correction larger than that is made again about where it led
_NONE = np.zeros(0, dtype=np.intp)
_RARE = 1e-3  # probability per frame below which chance does not explain the pairs
_LARGE_TWIST = 6.0  # rad/s: a third of `loss.fastest`, it counts by its logarithm
_POINT_SIGMA = 2e-3  # rad, of a seen direction: a tenth of a pixel on a ball 200 px across
_STILL = np.zeros((KINEMATIC_DIM, KINEMATIC_DIM))
_DETECTED = 0.8  # probability that a disc in view is seen: hands and struts hide some
_WIDE = 0.1  # rad: an attitude known worse than that is not linear in any sense; the allowance for it grows no more


@dataclass(frozen=True, slots=True)
class Pairing:
    """Points taken for discs."""

    rows: NDArray[np.intp]  # into the points
    columns: NDArray[np.intp]  # into the discs
    complete: bool  # all that could pair does
    fits: bool  # and all pairs lie within their standard deviations
    innovation: tuple[Array, Array, Array, Array] | None = None  # of _innovation, where it is known


@dataclass(frozen=True, slots=True)
class So3Filter:
    """Settings, and the camera's place, which determines the visible discs."""

    settings: So3Settings
    towards_camera: Array  # (3,) unit vector from the ball's centre, obj
    horizon: float  # least cosine with it of a disc that can be seen
    disc_angle: float  # rad, angular radius of a disc
    radius: float  # m, of the ball
    considered: Array = field(default_factory=lambda: np.zeros(2 * (CONSIDERED_DIM,)))  # of pose, centre and radius
    readout_sigma: float = 0.0  # s, of the rolling shutter's time

    def initial(self, stamp: float, attitude: Array) -> So3State:
        """At rest at `attitude`, (3, 3), which is the reference: without error. No disc is known."""
        joint = np.zeros((MAP_OFFSET + CLONE_DIM, MAP_OFFSET + CLONE_DIM))
        joint[3:6, 3:6] = self.settings.start_rate_sigma**2 * np.eye(3)
        joint[6:KINEMATIC_DIM, 6:KINEMATIC_DIM] = usual_acceleration(self.settings) ** 2 * np.eye(3)
        joint[KINEMATIC_DIM:READOUT, KINEMATIC_DIM:READOUT] = self.considered
        joint[READOUT, READOUT] = self.readout_sigma**2
        return So3State(stamp, attitude, np.zeros(3), np.zeros(3), np.zeros((0, 3)), np.zeros((0, 3, 2)), joint)

    def predict(self, state: So3State, stamp: float) -> So3State:
        """Carried on to `stamp`, by up to 10 s, with an acceleration that has made no step since.

        The covariance is that of a ball left alone; `process` and `weights` say what a more lively player adds. Of a
        longer interval than half the mean time between two steps, all but the last part goes without that distinction:
        there the acceleration fades (Singer 1970), which is what steps do on the average.
        """
        s = self.settings
        dt = float(min(max(stamp - state.stamp, 0.0), _LONGEST))
        last = min(dt, 0.5 * PERSISTENCE_S)
        usual = prior_of_levels(s.levels)
        weights = state.weights if len(state.weights) else usual
        density = 2.0 * variances(s)[0] / PERSISTENCE_S
        attitude, rate, acceleration, joint = state.attitude, state.rate, state.acceleration, state.joint
        F, process = np.empty((KINEMATIC_DIM, KINEMATIC_DIM)), np.empty((KINEMATIC_DIM, KINEMATIC_DIM))
        if dt > last:
            density_of_all = density * float(weights @ squared_levels(s.levels))
            attitude, rate, acceleration, joint = so3_predict.predict(
                attitude, rate, acceleration, joint, dt - last, PERSISTENCE_S, density_of_all, F, process
            )
        attitude, rate, acceleration, joint = so3_predict.predict(
            attitude, rate, acceleration, joint, last, np.inf, density, F, process
        )
        stay = math.exp(-dt / DWELL_S)
        return So3State(
            stamp,
            attitude,
            rate,
            acceleration,
            state.discs,
            state.basis,
            joint,
            state.hits,
            state.missed,
            so3_visibility.carry_hidden(attitude, rate, state.discs, state.hidden, dt, self.disc_angle),
            _NONE,
            stay * weights + (1.0 - stay) * usual,
            process,
            readout=state.readout,
            interval=last,
        )

    def adopt(self, state: So3State, before: "So3Filter") -> So3State:
        """Return the state of the filter `before`. If the levels changed, they start at their prior."""
        return state if self.settings.levels == before.settings.levels else replace(state, weights=np.zeros(0))

    def visible(self, state: So3State) -> NDArray[np.intp]:
        """Indices of the discs that face the camera."""
        return np.flatnonzero(state.discs @ (self.towards_camera @ state.attitude) > self.horizon)

    def detection_probability(self, state: So3State) -> Array:
        """Return the probability, (m,), that each disc is detected at a predicted state."""
        return so3_visibility.detection_probability(
            state.attitude, state.discs, state.hidden, self.towards_camera, self.horizon
        )

    def is_significant(self, predicted: So3State, used: int, points: int) -> bool:
        """Return whether chance explains so many pairs in less than one frame of a thousand.

        Each point lies in each disc's gate by chance with that gate's share of what the camera sees of the ball.
        """
        sigma = self.place_sigma(predicted, self.visible(predicted))
        return bool(pdtrc(used - 1, self._expected_by_chance(sigma, points)) < _RARE)

    def _expected_by_chance(self, sigma: Array, points: int) -> float:
        """Return how many of the points fall by chance into the gates of discs known to `sigma`, (k,) rad."""
        areas = self.settings.gate * np.pi * (sigma**2 + _POINT_SIGMA**2)
        return points * float(np.sum(areas)) / (2.0 * np.pi * (1.0 - self.horizon))

    def place_sigma(self, state: So3State, which: NDArray[np.intp]) -> Array:
        """Standard deviation, (k,) rad, along its worse axis, of where each of the discs `which` is predicted."""
        return _place_sigma(state, which, (self._expected(state) - 1.0) * state.process[:3, :3])

    def update(
        self, state: So3State, points: SpherePoints, may_start_landmark: NDArray[np.bool_] | None = None
    ) -> So3State:
        """Associate, correct, and keep the map: points of `may_start_landmark` (n,) may found a new disc (None: all).

        The innovations tell how lively the player is: the levels are states of a Markov chain, and at each the
        acceleration makes steps of another size (`so3_steps`). Steps and levels are weighed by the likelihood of all
        pairs together.
        """
        ordinary = self._update_ordinary(state, points, may_start_landmark)
        if ordinary is not None:
            return ordinary
        corrected, pairs = self._correct_and_pair_again(state, points, self.nearest_pairs(state, points))
        return self._keep_map(corrected, points, pairs, may_start_landmark)

    def nearest_pairs(self, state: So3State, points: SpherePoints) -> Pairing:
        """The pairs of least total distance, at the most likely level of process noise at which most points pair."""
        noise_scales = squared_levels(self.settings.levels)
        expected = self._expected(state)
        best = self._pair(state, points, expected)
        best_score = self._log_likelihood(state, points, best, expected)
        if not best.complete and state.process[3, 3] > 0.0:
            for noise_scale in noise_scales[noise_scales > expected]:
                pairing = self._pair(state, points, float(noise_scale))
                score = self._log_likelihood(state, points, pairing, float(noise_scale))
                if score > best_score:
                    best, best_score = pairing, score
                if best.complete:
                    break
        return best

    def update_if_certain(
        self, state: So3State, points: SpherePoints, may_start_landmark: NDArray[np.bool_]
    ) -> So3State | None:
        """`update` of a frame whose pairs are beyond doubt; None of any other.

        They are if two discs pair and one of three holds. The attitude is known well and most points pair. Chance does
        not explain so many pairs. Two pairs fix the attitude, and chance does not explain the others about it.
        """
        ordinary = self._update_ordinary(state, points, may_start_landmark)
        if ordinary is not None:
            return ordinary
        nearest = self.nearest_pairs(state, points)
        pairs = len(nearest.rows)
        most = state.is_placed and 2 * pairs >= len(points)
        if pairs < 2:
            return None
        corrected, nearest = self._correct_and_pair_again(state, points, nearest)
        if not (most or self.is_significant(state, pairs, len(points)) or self._others_agree(corrected, len(points))):
            return None
        return self._keep_map(corrected, points, nearest, may_start_landmark)

    def _correct_and_pair_again(
        self, state: So3State, points: SpherePoints, pairing: Pairing
    ) -> tuple[So3State, Pairing]:
        """Return the state corrected by the pairs, and by those that lie in their places only after the correction."""
        corrected, _ = self._correct(state, points, pairing)
        if pairing.complete:
            return corrected, pairing
        again = self._pair(corrected, points, 1.0)
        if len(again.rows) <= len(pairing.rows):
            return corrected, pairing
        again = replace(again, innovation=None)  # that is one from the corrected state
        return self._correct(state, points, again)[0], again

    def _others_agree(self, corrected: So3State, points: int) -> bool:
        """Return whether chance does not explain that the pairs beyond two lie where those two put them.

        Any two points may be taken for any two discs.
        """
        which = self.visible(corrected)
        others = self._expected_by_chance(_place_sigma(corrected, which, _STILL[:3, :3]), points)
        ways = 0.5 * points * (points - 1) * len(which) * (len(which) - 1)
        return ways * pdtrc(len(corrected.used) - 3, others) < _RARE

    def _update_ordinary(
        self, state: So3State, points: SpherePoints, may_start_landmark: NDArray[np.bool_] | None
    ) -> So3State | None:
        """`update` of a frame that shows each disc where it was expected and leaves no choice; None of any other."""
        noise_scales = squared_levels(self.settings.levels)
        weights, joint, s = self._level_probabilities(state).copy(), state.joint.copy(), self.settings
        ordinary, rows, columns, dx, level, nis = kernel.update(
            state.attitude,
            state.rate,
            state.acceleration,
            state.discs,
            state.basis,
            joint,
            state.process,
            noise_scales,
            self._steps(state),
            weights,
            self.visible(state),
            s.gate,
            _WIDE,
            points.direction,
            points.image_covariance,
            delays(points, state),
            points.row,
            points.dposition_dpose,
            points.dposition_dball,
            self.radius,
        )
        if not ordinary or abs(dx[:3]).max() > _LINEAR:
            return None
        updated = inject(state, dx, joint, weights, level, rows, float(nis))
        return self._keep_map(updated, points, Pairing(rows, columns, True, True), may_start_landmark)

    def correct(
        self, state: So3State, points: SpherePoints, rows: tuple[int, ...], columns: tuple[int, ...]
    ) -> tuple[So3State, float]:
        """Correct a predicted state by points `rows` taken for the discs `columns`.

        Also the log likelihood of their directions, rad^-2 each, over all levels of process noise.
        """
        pairing = Pairing(np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp), True, True)
        return self._correct(state, points, pairing)

    def keep_map(
        self,
        state: So3State,
        points: SpherePoints,
        rows: tuple[int, ...],
        columns: tuple[int, ...],
        may_start_landmark: NDArray[np.bool_] | None = None,
    ) -> So3State:
        """The corrected state with sightings counted, and landmarks for the points left over that may start one."""
        pairing = Pairing(np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp), True, True)
        return self._keep_map(state, points, pairing, may_start_landmark)

    def candidate_distances(
        self, state: So3State, points: SpherePoints, gate: float, widest: bool = False
    ) -> tuple[Array, NDArray[np.intp]]:
        """Squared Mahalanobis distances, (n, k), of the points to the discs that may be in view, and which those are.

        They are exact below `gate`. `widest`: with the process noise of the liveliest level.
        """
        slack = 2.0 * self.place_sigma(state, np.arange(len(state.discs)))
        cosine = state.discs @ (self.towards_camera @ state.attitude)
        which = np.flatnonzero(cosine > self.horizon - np.minimum(slack, 0.5))
        if len(points) == 0 or len(which) == 0:
            return np.full((len(points), len(which)), np.inf), which
        scale = max(squared_levels(self.settings.levels)) if widest else 1.0
        added_process_noise = (scale - 1.0) * state.process
        spread = float(np.trace(state.joint[:3, :3] + added_process_noise[:3, :3]))
        distance, _ = self._distances(state, points, which, gate, added_process_noise, min(spread, 0.25) ** 2)
        return distance, which

    def _distances(
        self,
        state: So3State,
        points: SpherePoints,
        which: NDArray[np.intp],
        gate: float,
        added_process_noise: Array,
        curvature: float,
    ) -> tuple[Array, bool]:
        """Squared Mahalanobis distances, (n, k), of points to the discs `which`, exact below `gate`.

        Also whether no point and no disc has two partners below it. `curvature` is in rad².
        """
        distance = np.empty((len(points), len(which)))
        distance[0, 0] = gate
        plain = so3_match.distances(
            state.attitude,
            state.rate,
            state.acceleration,
            state.discs,
            state.basis,
            state.joint,
            which,
            added_process_noise[:3, :3],
            curvature,
            points.direction,
            points.image_covariance / self.radius**2,
            delays(points, state),
            points.row,
            points.dposition_dpose,
            points.dposition_dball,
            self.radius,
            distance,
        )
        return distance, plain

    def _log_likelihood(self, state: So3State, points: SpherePoints, pairing: Pairing, noise_scale: float) -> float:
        """Log likelihood ratio of a pairing at a level of process noise, to that of no pair at the expected level.

        A point that is no disc lies anywhere on the visible cap. A wide gate finds pairs by chance, and a low density
        weighs them accordingly (Reid 1979, eq. 16).
        """
        expected = self._expected(state)
        level = 0.0
        if noise_scale > expected:
            nearest = np.argmin(np.abs(squared_levels(self.settings.levels) - noise_scale))
            level = math.log(max(float(self._level_probabilities(state)[nearest]), 1e-12))
        k = len(pairing.rows)
        if k == 0:
            return level
        H, _, z, S = pairing.innovation or self._innovation(state, points, pairing.rows, pairing.columns, _STILL)
        density = _log_density(z, S + (noise_scale - 1.0) * H @ state.process @ H.T)
        foreign = len(points) / (2.0 * math.pi * (1.0 - self.horizon))  # 1/rad², density of points that are no disc
        return level + density + k * math.log(_DETECTED / ((1.0 - _DETECTED) * foreign))

    def _pair(self, state: So3State, points: SpherePoints, noise_scale: float) -> Pairing:
        """Pairs within the gate when the density is that of the level whose noise scale is given."""
        visible = self.visible(state)
        if len(points) == 0 or len(visible) == 0:
            return Pairing(_NONE, _NONE, True, True)
        added_process_noise = (noise_scale - 1.0) * state.process
        distance, plain = self._distances(
            state,
            points,
            visible,
            self.settings.gate,
            added_process_noise,
            self._curvature(state, added_process_noise),
        )
        if plain:
            rows, columns = np.nonzero(distance < self.settings.gate)
        else:
            rows, columns = assign(distance, self.settings.gate)
        innovation, agree = None, True
        if len(rows):
            innovation = self._innovation(state, points, rows, visible[columns], added_process_noise)
            H, _, z, S = innovation
            keep = so3_match.consistent(z, S + H @ added_process_noise @ H.T, 1.5 * self.settings.gate)
            agree = bool(keep.all())
            if not agree:
                rows, columns, innovation = rows[keep], columns[keep], None
        fits = float(distance[rows, columns].sum()) < 4.0 * max(len(rows), 1) + 10.0
        complete = len(rows) == min(len(points), len(visible)) and fits and agree
        return Pairing(rows, visible[columns], complete, fits, innovation)

    def _expected(self, state: So3State) -> float:
        """Mean square of the level, before the innovations are seen."""
        return float(state.weights @ squared_levels(self.settings.levels)) if len(state.weights) else 1.0

    def _level_probabilities(self, state: So3State) -> Array:
        """Probability of each level, (l,), before the innovations are seen."""
        return state.weights if len(state.weights) else prior_of_levels(self.settings.levels)

    def _steps(self, state: So3State) -> tuple[float, float, Array]:
        """Return the arguments of `so3_steps`: the interval, s, the persistence, s, and the variance of each level."""
        return state.interval, PERSISTENCE_S, variances(self.settings)

    def _correct(self, state: So3State, points: SpherePoints, pairing: Pairing) -> tuple[So3State, float]:
        """The state corrected by pairs, and their log likelihood, 1/rad² each."""
        rows, columns = pairing.rows, pairing.columns
        if len(rows) == 0:
            return self._coasted(state), 0.0
        joint, weights, dx = state.joint.copy(), self._level_probabilities(state).copy(), np.empty(len(state.joint))
        H, HP, z, S = pairing.innovation or self._innovation(state, points, rows, columns, _STILL)
        learn = kernel.rate_is_significant(state.rate, joint)
        log_likelihood, nis, level = kernel.correct(
            joint, H, HP, S, z, state.acceleration, self._steps(state), weights, learn, dx
        )
        updated = inject(state, dx, joint, weights, level, rows, float(nis))
        if float(np.abs(dx[:3]).max()) > _LINEAR:
            updated, log_likelihood = self._again(state, updated, dx, points, columns)
        return (_twist_as_swing(updated, columns[0]) if len(columns) == 1 else updated), log_likelihood

    def _coasted(self, state: So3State) -> So3State:
        """The state of a frame without pairs: nothing tells of steps. On the average they let the acceleration fade."""
        noise_scale, mean = self._expected(state), np.zeros(len(state.joint))
        joint = state.joint.copy()
        joint[:KINEMATIC_DIM, :KINEMATIC_DIM] += (noise_scale - 1.0) * state.process
        t, tau = state.interval, PERSISTENCE_S
        gain, reach = so3_predict.integrals(t, tau)
        mean[:KINEMATIC_DIM] = np.outer(
            [reach - 0.5 * t * t, gain - t, math.expm1(-t / tau)], state.acceleration
        ).ravel()
        return inject(state, mean, joint, state.weights, float(np.sqrt(noise_scale)), _NONE, 0.0)

    def _again(
        self, state: So3State, updated: So3State, dx: Array, points: SpherePoints, columns: NDArray[np.intp]
    ) -> tuple[So3State, float]:
        """A large correction, made again about where it led (iterated Kalman filter, Bell and Cathey 1993).

        The state, and the log likelihood of the pairs (Laplace's approximation).
        """
        rows, log_likelihood = updated.used, 0.0
        at = (MAP_OFFSET + 2 * columns[:, None] + np.arange(2)).ravel()
        for _ in range(3):
            about = dx.copy()
            about[READOUT] = 0.0  # the innovation is linear in it, and what is added back below leaves it out
            there = inject(state, about, state.joint)
            H, HP, z, S = self._innovation(there, points, rows, columns, _STILL)
            joint, weights, step = state.joint.copy(), self._level_probabilities(state).copy(), np.empty(len(dx))
            learn = kernel.rate_is_significant(state.rate, joint)
            log_likelihood, nis, level = kernel.correct(
                joint,
                H,
                HP,
                S,
                z + H @ dx[:KINEMATIC_DIM] + dx[at],
                state.acceleration,
                self._steps(state),
                weights,
                learn,
                step,
            )
            moved = float(np.abs(step[:3] - dx[:3]).max())
            dx = step
            updated = inject(state, dx, joint, weights, level, rows, float(nis))
            if moved < 0.1 * _LINEAR:
                break
        return updated, log_likelihood

    def _innovation(
        self,
        state: So3State,
        points: SpherePoints,
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        added_process_noise: Array,
    ) -> tuple[Array, Array, Array, Array]:
        """Return for k pairs H, (2k, 9), H @ joint, (2k, 23 + 2m), the innovation, (2k,) rad, and its covariance.

        `added_process_noise` (9, 9) of the core, which is not in the covariances, counts for the curvature alone.
        """
        k = len(rows)
        H, HP, z, S = (
            np.empty((2 * k, KINEMATIC_DIM)),
            np.empty((2 * k, len(state.joint))),
            np.empty(2 * k),
            np.empty((2 * k, 2 * k)),
        )
        kernel.innovation(
            state.attitude,
            state.rate,
            state.acceleration,
            state.discs,
            state.basis,
            state.joint,
            columns,
            self._curvature(state, added_process_noise),
            points.direction[rows],
            points.image_covariance[rows] / self.radius**2,
            delays(points, state)[rows],
            points.row[rows],
            points.dposition_dpose[rows],
            points.dposition_dball[rows],
            self.radius,
            H,
            HP,
            z,
            S,
        )
        return H, HP, z, S

    @staticmethod
    def _curvature(state: So3State, added_process_noise: Array) -> float:
        """Variance, rad², of what the linear model leaves out: a turn e moves p by e x p + e (e . p) / 2 + ...

        At the start, with the rate unknown, that exceeds the image noise many times; once tracking it is nothing.
        """
        P = state.joint
        spread = (
            P[0, 0]
            + P[1, 1]
            + P[2, 2]
            + added_process_noise[0, 0]
            + added_process_noise[1, 1]
            + added_process_noise[2, 2]
        ) / 3.0
        return min(float(spread), _WIDE**2) ** 2

    def _keep_map(
        self, state: So3State, points: SpherePoints, pairing: Pairing, may_start_landmark: NDArray[np.bool_] | None
    ) -> So3State:
        """Count sightings, drop what did not last its trial, and take up new discs."""
        m, n = len(state.discs), len(points)
        hits, missed, keep = np.empty(m, dtype=np.intp), np.empty(m, dtype=np.intp), np.empty(m, dtype=np.bool_)
        found = np.empty(n, dtype=np.intp)
        s, probability = self.settings, self.detection_probability(state)
        dropped, new, known_seen, known_missed = kernel.keep_map(
            state.attitude,
            state.discs,
            self.towards_camera,
            self.horizon,
            state.hits,
            state.missed,
            probability,
            pairing.columns,
            ESTABLISHED_HITS,
            MAX_TRIAL_MISSES,
            MAX_MISSES_PER_HIT,
            points.direction,
            pairing.rows,
            np.ones(n, dtype=np.bool_) if may_start_landmark is None else may_start_landmark,
            math.cos(2.0 * self.disc_angle),
            hits,
            missed,
            keep,
            found,
        )
        hidden = so3_visibility.update_hidden(state.hidden, probability, pairing.columns)
        state = replace(
            state, hits=hits, missed=missed, hidden=hidden, known_seen=known_seen, known_missed=known_missed
        )
        if dropped:
            state = drop(state, keep)
        room = max(s.most_discs - len(state.discs), 0)
        return augment(state, points, found[: min(new, room)], self.radius) if new and room else state


def _log_density(z: Array, S: Array) -> float:
    """Log of the normal density of an innovation z, (2k,), with covariance S."""
    L = np.linalg.cholesky(S)
    white = np.linalg.solve(L, z)
    return float(-0.5 * white @ white - np.log(L.diagonal()).sum() - 0.5 * len(z) * math.log(2.0 * math.pi))


def relocate(
    state: So3State, attitude: Array, sigma: float, settings: So3Settings, stamp: float, rate: Array | None = None
) -> So3State:
    """Return the map with a new attitude of `sigma` rad per axis, at `stamp`, for an update.

    `rate` (3,) rad/s is the expected rate, to within a sudden change by a hand; None: unknown.
    Attitude and map lose their correlation: what was found knows nothing of how the map came to be.
    """
    joint = state.joint.copy()
    considered = joint[KINEMATIC_DIM:MAP_OFFSET, KINEMATIC_DIM:MAP_OFFSET].copy()
    joint[:MAP_OFFSET] = 0.0
    joint[:, :MAP_OFFSET] = 0.0
    joint[KINEMATIC_DIM:MAP_OFFSET, KINEMATIC_DIM:MAP_OFFSET] = considered
    joint[:3, :3] = sigma**2 * np.eye(3)
    spread = settings.start_rate_sigma if rate is None else 0.4 * settings.start_rate_sigma
    joint[3:6, 3:6] = (2.5 * spread) ** 2 * np.eye(3)
    joint[6:KINEMATIC_DIM, 6:KINEMATIC_DIM] = usual_acceleration(settings) ** 2 * np.eye(3)
    return replace(
        state,
        stamp=stamp,
        attitude=attitude,
        rate=np.zeros(3) if rate is None else rate,
        acceleration=np.zeros(3),
        joint=joint,
        weights=np.zeros(0),
        process=np.zeros((KINEMATIC_DIM, KINEMATIC_DIM)),
    )


def _place_sigma(state: So3State, which: NDArray[np.intp], added_process_noise: Array) -> Array:
    """Return the standard deviation, (k,) rad, along its worse axis, of where each of the discs `which` lies."""
    sigma = np.empty(len(which))
    so3_match.places(state.attitude, state.discs, state.basis, state.joint, which, added_process_noise, sigma)
    return sigma


def _twist_as_swing(state: So3State, column: int) -> So3State:
    """Return the state after a frame of one disc, `column`, with a twist about that disc as large as the swing.

    One disc tells the swing, the two components of the rate across its direction, and nothing of the twist. The axis of
    a turn is no likelier to point at the disc than elsewhere. So the twist is the swing times the cotangent of an angle
    whose cosine is uniform, up to a large turn by hand. A ball whose one disc stands still is thus at rest. A
    twist that is known better is left alone.
    """
    axis = state.attitude @ state.discs[column]
    along = state.joint[:, 3:6] @ axis
    twist, variance = float(axis @ state.rate), float(axis @ along[3:6])
    swing = float(state.rate @ state.rate) - twist**2 + float(np.trace(state.joint[3:6, 3:6])) - variance
    most = _LARGE_TWIST / math.sqrt(max(swing, 1e-12))
    expected = swing * (math.asinh(most) - most / math.hypot(1.0, most))
    if variance <= expected:
        return state
    gain = along * (1.0 - expected / variance) / variance  # leaves the twist with the expected variance
    joint = state.joint - np.outer(gain, along)
    joint[KINEMATIC_DIM:READOUT, KINEMATIC_DIM:READOUT] = state.joint[KINEMATIC_DIM:READOUT, KINEMATIC_DIM:READOUT]
    gain[KINEMATIC_DIM:READOUT] = 0.0  # considered parameters stay (Schmidt 1966)
    return inject(state, -gain * twist, joint, state.weights, state.manoeuvre_level, state.used, state.nis)
