"""A ball whose centre is not the point that it turns about: whether frames show that, and the state that has it.

The centre of such a ball moves round the point that the bearings hold, at a fixed place in the axes of the ball. A
state holds this eccentricity with a negligible standard deviation, so it costs a good ball nothing. But its covariances
have the information of all frames about it, and its effect on all other errors (Friedland 1969, "Treatment of bias in
recursive filtering"). So its standard deviation can become that of an eccentric ball at any time, as if it had been so
from the start.
"""

from typing import NamedTuple

import numpy as np

from spheremouse.ball.filters.so3_motion import AXES, CLONE_DIM
from spheremouse.ball.filters.so3_state import ECCENTRICITY, RIG, So3State, inject
from spheremouse.geometry.rotation import Array

ROUND_SIGMA = 1e-5  # radii, negligible standard deviation along each axis
ECCENTRIC_SIGMA = 2e-3  # radii, standard deviation for an eccentric ball: a millimetre on a ball of a metre
_MIN_LOG_ODDS = 3.0  # nats, odds of 20 to 1 for an eccentric ball
_MAX_SIGMAS = 6.0  # of that standard deviation: a larger estimate has another cause
_ROUND_SIGMAS = 10.0  # of the negligible one: the frames show a larger estimate of a round ball to be eccentric before


class _Shown(NamedTuple):
    """Information of the frames about the eccentricity, without a prior."""

    score: Array  # (3,) 1/m, along the axes
    information: Array  # (3,) 1/m², along the axes
    axes: Array  # (3, 3) columns, ball

    def estimate(self, sigma: float) -> tuple[Array, Array]:
        """Return mean, (3,) m, and covariance, (3, 3) m², with a prior of the standard deviation `sigma`, m."""
        variance = 1.0 / (self.information + sigma**-2)
        return self.axes @ (variance * self.score), (self.axes * variance) @ self.axes.T

    def log_odds(self, sigma: float) -> float:
        """Return the log of the odds, nats, of an eccentric ball with that prior against a round one."""
        ratio = self.information + sigma**-2
        return float(0.5 * np.sum(self.score**2 / ratio) - 0.5 * np.sum(np.log(sigma**2 * ratio)))


def as_eccentric(state: So3State, radius: float) -> So3State | None:
    """Return the state of an eccentric ball of `radius` m; None unless frames show for the first time that it is one.

    A ball that moves in its bearings is none. What a correction holds (`So3State.holds_rig`) keeps its value.
    """
    P, prior, sigma = state.joint[ECCENTRICITY, ECCENTRICITY], ROUND_SIGMA * radius, ECCENTRIC_SIGMA * radius
    is_eccentric = np.trace(P) > 4.0 * prior**2 or np.linalg.norm(state.eccentricity) > _ROUND_SIGMAS * prior
    if is_eccentric or state.centre_noise > 0.0:
        return None
    variance, axes = np.linalg.eigh(P)
    shown = _Shown(axes.T @ state.eccentricity / variance, np.maximum(1.0 / variance - prior**-2, 0.0), axes)
    if shown.log_odds(sigma) < _MIN_LOG_ODDS:
        return None
    mean, covariance = shown.estimate(sigma)
    if mean @ mean > (_MAX_SIGMAS * sigma) ** 2:
        return None
    effect = _effect(state)
    joint = state.joint + effect @ (covariance - P) @ effect.T
    dx = effect @ (mean - state.eccentricity)
    reference = slice(-CLONE_DIM, None)  # keeps its estimate, since its increment was sent
    joint[reference, reference] += np.outer(dx[reference], dx[reference])
    dx[reference] = 0.0
    return inject(state, dx, joint, state.weights, state.manoeuvre_level, state.used, state.nis)


def _effect(state: So3State) -> Array:
    """Return the effect, (n, 3), of an error of the eccentricity on all errors, given those that are held."""
    held = np.r_[ECCENTRICITY, RIG.start if state.holds_rig else AXES : state.map_row - 1]
    by_held, *_ = np.linalg.lstsq(state.joint[np.ix_(held, held)], state.joint[held])
    return np.asarray(by_held[:3].T, dtype=float)
