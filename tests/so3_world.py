"""A ball as the default filter sees it: directions with noise, and motion as the filter assumes it."""

from dataclasses import replace
from functools import cache

import numpy as np
from conftest import directions
from scipy.linalg import expm

from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_motion import CLONE_DIM, KINEMATIC_DIM
from spheremouse.ball.filters.so3_rig import Station
from spheremouse.ball.filters.so3_settings import PERSISTENCE_S, So3Settings
from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import exp
from spheremouse.native import kernels

RADIUS = 0.6
HORIZON = 0.25
DT = 1.0 / 30.0
SIGMA = 3e-4  # rad, of a direction per axis: 0.07 px of the far camera
SETTINGS = So3Settings()
FILTER = So3Filter(SETTINGS, Station(np.array([0.0, 0.0, 1.0]), HORIZON, RADIUS), 0.02 / RADIUS)
OWN = replace(FILTER, settings=replace(SETTINGS, levels=(1.0,)))  # assumes what `own_motion` does
DISCS = directions(26, 4, 0.3)
LAST = slice(-CLONE_DIM - 2, -CLONE_DIM)  # of the newest disc in the joint covariance


def with_errors(filter_, **errors):
    """The filter with other fields of its station."""
    return replace(filter_, station=replace(filter_.station, **errors))


def points_at(direction, sigma=SIGMA, rng=None):
    """SpherePoints at directions (n, 3) in obj, with isotropic noise in the tangent plane if `rng` is given."""
    d = np.ascontiguousarray(direction, dtype=float).reshape(-1, 3)
    if rng is not None:
        noise = sigma * rng.normal(size=d.shape)
        d = d + noise - d * np.sum(noise * d, axis=1, keepdims=True)
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
    n = len(d)
    C = (RADIUS * sigma) ** 2 * (np.eye(3) - d[:, :, None] * d[:, None, :])
    none = np.zeros(n)
    by_rig = np.tile(np.column_stack([np.zeros(3), -np.eye(3) / RADIUS]), (n, 1, 1))  # of a camera far away
    return SpherePoints(RADIUS * d, C, d, C, by_rig, none, none, np.arange(n))


def innovation(state, points, columns):
    """H, H P, z and the covariance of z of the points, in their order, as the discs `columns`."""
    rows, added = np.arange(len(columns)), np.zeros((KINEMATIC_DIM, KINEMATIC_DIM))
    return kernels.innovation(state.body, points.measurement(RADIUS), rows, columns, added)


def seen(R, discs=DISCS):
    p = discs @ R.T
    return p[p[:, 2] > HORIZON + 0.1]


def follow(filter_, state, attitudes, stamps, rng, discs=DISCS):
    """States after each frame of a ball with these attitudes."""
    states = []
    for R, t in zip(attitudes, stamps, strict=True):
        state = filter_.update(filter_.predict(state, t), points_at(seen(R, discs), rng=rng))
        states.append(state)
    return states


def film(filter_, attitudes, stamps, rng, discs=DISCS):
    return follow(filter_, filter_.initial(stamps[0], attitudes[0]), attitudes, stamps, rng, discs)


def rolling(rate, n):
    """Attitudes and stamps of a constant rate (3,) rad/s in obj."""
    t = np.arange(n) * DT
    return exp(np.asarray(rate) * t[:, None]), t


@cache
def settled(rate=(0.3, -0.2, 0.4), n=30):
    """A state with discs, correlations and a rate, and its attitude."""
    R, t = rolling(rate, n)
    return film(FILTER, R, t, np.random.default_rng(0))[-1], R[-1]


def draw(covariance, rng, n):
    """Samples (n, k) of a zero-mean Gaussian whose covariance may be singular."""
    w, V = np.linalg.eigh(covariance)
    return rng.normal(size=(n, len(w))) @ (V * np.sqrt(np.maximum(w, 0.0))).T


def squared(e, P):
    """Squared Mahalanobis distance of an error."""
    return e @ np.linalg.solve(P, e)


def white_jerk(dt, sigma, tau=PERSISTENCE_S, fade=0.0):
    """F and Q of angle, rate and acceleration over a step, (3, 3), for one axis, by Van Loan's method.

    `fade` in 1/s: 0 of an acceleration that lasts, 1 / tau of one that fades with tau (Singer 1970).
    """
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -fade]])
    G = np.diag([0.0, 0.0, 2.0 * sigma**2 / tau])
    E = expm(np.block([[-A, G], [np.zeros((3, 3)), A.T]]) * dt)
    F = E[3:, 3:].T
    return F, F @ E[:3, 3:]


def own_motion(rng, frames, rate_sigma=SETTINGS.start_rate_sigma, mean_rate=0.0):
    """Attitude, rate and acceleration, frame by frame, of a ball that moves as `OWN` assumes."""
    F, Q = white_jerk(DT, SETTINGS.acceleration_sigma)
    jerk = np.linalg.cholesky(Q)
    R, w = np.eye(3), mean_rate + rate_sigma * rng.normal(size=3)
    a = SETTINGS.acceleration_sigma * rng.normal(size=3)
    for k in range(frames):
        if k:
            now = F @ np.stack([np.zeros(3), w, a]) + jerk @ rng.normal(size=(3, 3))
            R, w, a = exp(now[0]) @ R, now[1], now[2]
        yield R, w, a
