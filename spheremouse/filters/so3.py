"""The default filter: attitude on SO(3), angular velocity and acceleration in `obj`, and the map of discs in one state.

An error-state extended Kalman filter (Sola 2017, "Quaternion kinematics for the error-state Kalman filter", left
errors in `obj`) with an angular acceleration that lasts for a while (Singer 1970), and discs as landmarks with their
full correlations (Smith, Self, Cheeseman 1990). No angle is a coordinate, so nothing is singular; a disc out of view
stays known and closes the loop.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.associate import assign
from spheremouse.filters.so3_state import CORE, So3State, augment, drop, inject
from spheremouse.intersect import SpherePoints
from spheremouse.rotation import Array, exp, hat, left_jacobian
from spheremouse.settings import param

_LONGEST = 10.0  # s: after a longer gap nothing is known of the attitude anyhow, and the covariance must stay finite
_NODES = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])  # Gauss-Legendre on [0, 1]
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
_WIDE = 0.1  # rad: an attitude known worse than that is not linear in any sense; the allowance for it grows no more


@dataclass(frozen=True, slots=True)
class So3Settings:
    """Motion model, gates and map."""

    acceleration_sigma: float = param(
        0.1,
        "rad/s²",
        "standard deviation of the angular acceleration per axis at the quiet level: a ball left to roll",
        gt=0,
        le=100,
    )
    persistence: float = param(
        0.2,
        "s",
        "time over which an acceleration lasts: a hand's push takes a tenth to a few tenths of a second",
        ge=0.01,
        le=10,
    )
    start_rate_sigma: float = param(
        2.0,
        "rad/s",
        "standard deviation of the rate at the start, about zero: the ball may be rolling by then",
        gt=0,
        le=100,
    )
    gate: float = param(13.8, "-", "squared Mahalanobis distance of a pair: 99.9 % of chi-square with 2 degrees", gt=0)
    levels: tuple[float, ...] = param(
        (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0),
        "-",
        "factors on that acceleration that the player may be at, each as rare as it is large: roll, turn, push, flick, "
        "and a stop by hand (100 rad/s²)",
    )
    dwell: float = param(0.3, "s", "mean time the player stays at a level: a push takes a few tenths of a second", gt=0)
    keep_share: float = param(
        0.6, "-", "part of the discs that must fit before the next level is not tried", gt=0, le=1
    )
    trial: int = param(3, "frames", "sightings until a disc is kept for good", ge=1)
    misses: int = param(3, "frames", "a disc on trial is dropped when it is not seen where it should be", ge=1)
    patience: float = param(
        5.0, "-", "a kept disc is dropped when missed in a row so many times as often as seen: no disc after all", gt=0
    )
    most_discs: int = param(120, "discs", "the map grows no larger: the time per frame stays bounded", ge=4)

    def __post_init__(self) -> None:
        if (
            not self.levels
            or list(self.levels) != sorted(self.levels)
            or not 1.0 <= self.levels[0] <= self.levels[-1] <= 1e4
        ):
            raise ValueError("levels: factors from 1 to 10000 in rising order")


@dataclass(frozen=True, slots=True)
class _Pairing:
    rows: NDArray[np.intp]  # into the points
    columns: NDArray[np.intp]  # into the discs
    complete: bool  # enough of what should pair does
    fits: bool  # and what pairs does so within its standard deviations


@dataclass(frozen=True, slots=True)
class So3Filter:
    """Settings and the camera's place: what decides which discs can be seen."""

    settings: So3Settings
    towards_camera: Array  # (3,) unit vector from the ball's centre, obj
    horizon: float  # least cosine with it of a disc that can be seen
    disc_angle: float  # rad, angular radius of a disc

    def initial(self, stamp: float, attitude: Array) -> So3State:
        """At rest at `attitude`, (3, 3), which is the reference: without error. No disc is known."""
        joint = np.zeros((CORE, CORE))
        joint[3:6, 3:6] = self.settings.start_rate_sigma**2 * np.eye(3)
        joint[6:, 6:] = usual_acceleration(self.settings) ** 2 * np.eye(3)
        return So3State(stamp, attitude, np.zeros(3), np.zeros(3), np.zeros((0, 3)), np.zeros((0, 3, 2)), joint)

    def predict(self, state: So3State, stamp: float) -> So3State:
        """Carried on with an acceleration that fades, to `stamp`; a longer step is a larger one, up to 10 s.

        The covariance is that of the quiet level; `process` and `weights` say what a more lively player adds.
        """
        dt = min(max(stamp - state.stamp, 0.0), _LONGEST)
        tau = self.settings.persistence
        fade = np.exp(-dt / tau)
        turn = state.rate * dt + tau * (dt - tau * (1.0 - fade)) * state.acceleration
        R = exp(turn)
        J = left_jacobian(turn)
        F = np.zeros((CORE, CORE))
        i = np.arange(3)
        F[:3, :3] = R
        F[:3, 3:6] = J * dt
        F[:3, 6:] = J * (tau * (dt - tau * (1.0 - fade)))
        F[i + 3, i + 3] = 1.0
        F[i + 3, i + 6] = tau * (1.0 - fade)
        F[i + 6, i + 6] = fade
        P = state.joint.copy()
        P[:CORE] = F @ P[:CORE]
        P[:, :CORE] = P[:, :CORE] @ F.T
        Q = self._process(dt, turn)
        P[:CORE, :CORE] += Q
        usual = 1.0 / np.asarray(self.settings.levels)  # the livelier the rarer
        usual /= usual.sum()
        weights = state.weights if len(state.weights) == len(usual) else usual
        stay = np.exp(-dt / self.settings.dwell)
        return replace(
            state,
            stamp=stamp,
            attitude=R @ state.attitude,
            rate=state.rate + tau * (1.0 - fade) * state.acceleration,
            acceleration=fade * state.acceleration,
            joint=P,
            weights=stay * weights + (1.0 - stay) * usual,
            process=Q,
            used=np.zeros(0, dtype=np.intp),
        )

    def _process(self, dt: float, turn: Array) -> Array:
        """Covariance, (9, 9), of what white jerk adds over a step, at level 1: integrated over the step.

        Jerk s before the end has faded to g_a by then, made a rate g_w of it, and turned the ball by Jl(turn s/dt) g_t.
        """
        tau = self.settings.persistence
        s = _NODES * dt
        g_a = np.exp(-s / tau)
        g_w = tau * (1.0 - g_a)
        g_t = tau * (s - g_w)
        J = left_jacobian(_NODES[:, None] * turn)
        G = np.concatenate(
            [g_t[:, None, None] * J, g_w[:, None, None] * np.eye(3), g_a[:, None, None] * np.eye(3)], axis=1
        )
        q = 2.0 * self.settings.acceleration_sigma**2 / tau
        return q * dt * np.einsum("k,kij,klj->il", _WEIGHTS, G, G)

    def update(self, state: So3State, points: SpherePoints, fresh: NDArray[np.bool_] | None = None) -> So3State:
        """Associate, correct, and keep the map: `fresh` points (n,) may found a new disc (None: all).

        How lively the player is, the innovations say: the levels of process noise are hypotheses of a Markov chain,
        each weighed by the likelihood of all pairs together, and the update takes their mean (Bar-Shalom, Li,
        Kirubarajan 2001, section 11.6, with one filter for all of them).
        """
        squares = np.square(np.asarray(self.settings.levels))
        expected = self._expected(state)
        best = self._pair(state, points, expected)
        for square in squares[squares > expected]:
            if best.complete or not np.any(state.process):
                break
            pairing = self._pair(state, points, float(square))
            more = len(pairing.rows) - len(best.rows)
            if more > 0 or (more == 0 and pairing.fits and not best.fits):
                best = pairing
        return self._keep_map(self._correct(state, points, best), points, best, fresh)

    def _pair(self, state: So3State, points: SpherePoints, square: float) -> _Pairing:
        """Pairs within the gate when the density is that of the level whose square is given."""
        none = np.zeros(0, dtype=np.intp)
        if len(points) == 0 or len(state.discs) == 0:
            return _Pairing(none, none, True, True)
        p = state.discs @ state.attitude.T
        visible = np.flatnonzero(p @ self.towards_camera > self.horizon)
        if len(visible) == 0:
            return _Pairing(none, none, True, True)
        lively = replace(state, joint=self._livelier(state, square))
        E, S_disc = self._predicted(lively, visible, p)
        z = np.einsum("mij,ni->nmj", E, points.direction)
        S = S_disc[None] + self._noise(points, E) + self._curvature(lively) * np.eye(2)
        inverse = np.linalg.inv(S)
        distance = np.einsum("nmi,nmij,nmj->nm", z, inverse, z)
        distance[points.direction @ p[visible].T < 0.0] = np.inf
        rows, columns = assign(distance, self.settings.gate)
        keep = self._agreeing(lively, points, rows, visible[columns])
        rows, columns = rows[keep], columns[keep]
        fits = float(distance[rows, columns].sum()) < 4.0 * max(len(rows), 1) + 10.0
        expected = min(len(points), len(visible))
        complete = len(rows) >= self.settings.keep_share * expected and fits
        return _Pairing(rows, visible[columns], complete, fits)

    def _expected(self, state: So3State) -> float:
        """Mean square of the level, before the innovations are seen."""
        return float(state.weights @ np.square(self.settings.levels)) if len(state.weights) else 1.0

    @staticmethod
    def _livelier(state: So3State, square: float) -> Array:
        """The predicted covariance at another level than the quiet one."""
        joint = state.joint.copy()
        joint[:CORE, :CORE] += (square - 1.0) * state.process
        return joint

    def _agreeing(
        self, state: So3State, points: SpherePoints, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """Indices of the pairs that agree with one another: each by itself may pass the gate, not all together.

        The pair that contradicts the others and the prediction most is left out until none does (data snooping,
        Baarda 1968, for pairs of coordinates): a look-alike beside the place of a hidden disc, above all after a gap.
        """
        keep = np.arange(len(rows))
        if len(rows) < 2:
            return keep
        _, _, z, S = self._innovation(state, points, rows, columns)
        while len(keep) > 1:
            at = (2 * keep[:, None] + np.arange(2)).ravel()
            inverse = np.linalg.inv(S[np.ix_(at, at)])
            i = np.arange(len(keep))
            v = (inverse @ z[at]).reshape(-1, 2)
            own = inverse.reshape(len(keep), 2, len(keep), 2)[i, :, i]
            contradiction = np.einsum("ki,kij,kj->k", v, np.linalg.inv(own), v)
            worst = int(np.argmax(contradiction))
            if contradiction[worst] < 1.5 * self.settings.gate:
                break
            keep = np.delete(keep, worst)
        return keep

    def _weigh(self, state: So3State, z: Array, H: Array) -> Array:
        """Probabilities of the levels, (l,), after innovations z, (2k,), and their Jacobian H, (2k, 3), whitened.

        Another level adds D = (level² - 1) Q to the attitude's covariance: by the matrix inversion lemma its likelihood
        needs nothing larger than 3x3.
        """
        A, v = H.T @ H, H.T @ z
        D = (np.square(self.settings.levels) - 1.0)[:, None, None] * state.process[:3, :3]
        M = np.eye(3) + A @ D
        gain = np.einsum("i,lij,lj->l", v, D, np.linalg.solve(M, np.broadcast_to(v[:, None], (len(D), 3, 1)))[:, :, 0])
        log = 0.5 * (gain - np.linalg.slogdet(M)[1]) + np.log(np.maximum(state.weights, 1e-12))
        weights = np.exp(log - log.max())
        return weights / weights.sum()

    def _predicted(self, state: So3State, which: NDArray[np.intp], p: Array) -> tuple[Array, Array]:
        """Tangent axes in obj, (k, 3, 2), and covariance of the predicted place without image noise, (k, 2, 2)."""
        E = state.attitude @ state.basis[which]
        H = self._attitude_jacobian(E, p[which])
        P = state.joint
        at = CORE + 2 * which[:, None] + np.arange(2)
        cross = H @ P[:3][:, at].transpose(1, 0, 2)
        own = P[at[:, :, None], at[:, None, :]]
        return E, H @ P[:3, :3] @ H.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1) + own

    @staticmethod
    def _attitude_jacobian(E: Array, p: Array) -> Array:
        """d z / d rotation error, (k, 2, 3): a turn e moves p by e x p."""
        return -E.transpose(0, 2, 1) @ hat(p)

    @staticmethod
    def _noise(points: SpherePoints, E: Array) -> Array:
        """Image noise of each point in each disc's axes, (n, m, 2, 2) rad²."""
        radius2 = np.sum(points.position[0] ** 2) if len(points) else 1.0
        return np.einsum("mia,nij,mjb->nmab", E, points.image_covariance / radius2, E)

    def _correct(self, state: So3State, points: SpherePoints, pairing: _Pairing) -> So3State:
        rows, columns = pairing.rows, pairing.columns
        weights, square = state.weights, self._expected(state)
        none = np.zeros((CORE, CORE))
        if len(rows) == 0:
            joint = self._livelier(state, square)
            return replace(state, joint=joint, process=none, level=float(np.sqrt(square)), used=rows, nis=0.0)
        HP, H, z, S = self._innovation(state, points, rows, columns)
        if np.any(state.process):
            L = np.linalg.cholesky(S)
            white = np.asarray(np.linalg.solve(L, np.column_stack([z, H])), dtype=np.float64)
            weights = self._weigh(state, white[:, 0], white[:, 1:])
            square = float(weights @ np.square(self.settings.levels))
            more = (square - 1.0) * state.process
            HP[:, :CORE] += H @ more[:3]
            S = S + H @ more[:3, :3] @ H.T
        L = np.linalg.cholesky(S)
        white = np.linalg.solve(L, np.column_stack([z, HP]))
        y, W = white[:, 0], white[:, 1:]
        updated = replace(
            state,
            joint=self._livelier(state, square) - W.T @ W,
            weights=weights,
            process=none,
            level=float(np.sqrt(square)),
            used=rows,
            nis=float(y @ y),
        )
        return inject(updated, W.T @ y)

    def _innovation(
        self, state: So3State, points: SpherePoints, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> tuple[Array, Array, Array, Array]:
        """Of k pairs H @ joint, (2k, 9 + 2m), H's part for the attitude, (2k, 3), innovation, (2k,) rad, covariance."""
        k = len(rows)
        p = state.discs[columns] @ state.attitude.T
        E = state.attitude @ state.basis[columns]
        b = points.direction[rows]
        z = np.einsum("kij,ki->kj", E, b).ravel()
        P = state.joint
        H = self._attitude_jacobian(E, p).reshape(2 * k, 3)
        at = (CORE + 2 * columns[:, None] + np.arange(2)).ravel()
        HP = H @ P[:3] + P[at]  # each disc moves its own place one to one
        S = HP[:, :3] @ H.T + HP[:, at]
        radius2 = float(np.mean(np.sum(points.position[rows] ** 2, axis=1)))
        noise = E.transpose(0, 2, 1) @ (points.image_covariance[rows] / radius2) @ E
        for i in range(k):
            S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += noise[i]
        return HP, H, z, 0.5 * (S + S.T) + self._curvature(state) * np.eye(2 * k)

    @staticmethod
    def _curvature(state: So3State) -> float:
        """Variance, rad², of what the linear model leaves out: a turn e moves p by e x p + e (e . p) / 2 + ...

        At the start, with the rate unknown, that exceeds the image noise many times; once tracking it is nothing.
        """
        return min(float(np.trace(state.joint[:3, :3])) / 3.0, _WIDE**2) ** 2

    def _keep_map(
        self, state: So3State, points: SpherePoints, pairing: _Pairing, fresh: NDArray[np.bool_] | None
    ) -> So3State:
        """Count sightings, drop what did not last its trial, and take up new discs."""
        m = len(state.discs)
        p = state.discs @ state.attitude.T
        hits, missed = state.hits.copy(), state.missed.copy()
        hits[pairing.columns] += 1
        # a disc near the horizon is often too thin to be detected: only the well visible are missed
        well = p @ self.towards_camera > self.horizon + 0.5 * (1.0 - self.horizon)
        well[pairing.columns] = False
        missed[well] += 1
        missed[pairing.columns] = 0
        on_trial = hits < self.settings.trial
        keep = missed < np.where(on_trial, self.settings.misses, self.settings.patience * hits)
        new = np.ones(len(points), dtype=bool) if fresh is None else fresh.copy()
        new[pairing.rows] = False
        if m and np.any(new):
            # two discs do not overlap: a point that close to a known one is that one, badly seen
            new &= np.max(points.direction @ p.T, axis=1) < np.cos(2.0 * self.disc_angle)
        found = np.flatnonzero(new)
        overlap = points.direction[found] @ points.direction[found].T >= np.cos(2.0 * self.disc_angle)
        found = found[~np.tril(overlap, -1).any(axis=1)]  # nor do two new ones: the first counts
        state = drop(replace(state, hits=hits, missed=missed), keep)
        room = self.settings.most_discs - len(state.discs)
        index = found[: max(room, 0)]
        return augment(state, points, index) if len(index) else state


def usual_acceleration(settings: So3Settings) -> float:
    """Standard deviation per axis, rad/s², before anything is seen: the levels' mean square."""
    usual = 1.0 / np.asarray(settings.levels)
    return settings.acceleration_sigma * float(np.sqrt(np.square(settings.levels) @ usual / usual.sum()))


def relocate(  # noqa: PLR0917
    state: So3State, attitude: Array, sigma: float, settings: So3Settings, stamp: float, rate: Array | None = None
) -> So3State:
    """The map as it is, the attitude found anew with `sigma` rad per axis, at `stamp`, for an update.

    `rate` (3,) rad/s is what the ball is thought to turn at, to within what a hand changes at once; None: unknown.
    Attitude and map lose their correlation: what was found knows nothing of how the map came to be.
    """
    joint = state.joint.copy()
    joint[:CORE] = 0.0
    joint[:, :CORE] = 0.0
    joint[:3, :3] = sigma**2 * np.eye(3)
    spread = settings.start_rate_sigma if rate is None else 0.4 * settings.start_rate_sigma
    joint[3:6, 3:6] = (2.5 * spread) ** 2 * np.eye(3)
    joint[6:CORE, 6:CORE] = usual_acceleration(settings) ** 2 * np.eye(3)
    return replace(
        state,
        stamp=stamp,
        attitude=attitude,
        rate=np.zeros(3) if rate is None else rate,
        acceleration=np.zeros(3),
        joint=joint,
        weights=np.zeros(0),
        process=np.zeros((CORE, CORE)),
    )
