"""A simulated trackball under the ball. It converts the ball's rotation to a mouse log, in the format of `log-mouse`.

Its reports come at uneven times, late by an unknown lag, with stamps of a separate clock. They have whole counts, and
there is no report without counts. The sensor may slip when the ball is jerked, and reports get lost. Source: Wittich
2017, section 4.1.1 and figure 28, a recording of a real trackball.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from spheremouse.ball.truth import Truth
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array

_STEP = 1e-3  # s, of the integration

Rate = Callable[[Array], Array]  # times (n,) s -> w_obj (n, 3) rad/s, as `Profile.rate`


@dataclass(frozen=True, slots=True)
class Trackball:
    """The trackball under the ball."""

    matrix: Array  # (2, 3) counts/rad of w_obj
    slowest: float = 80.0  # Hz; the time between two reports is drawn between this and `fastest`
    fastest: float = 125.0  # Hz
    lag: float = 0.0  # s, of the log's stamps, other clock included
    drift: float = 0.0  # -, by which the log's clock is faster
    stamp_sigma: float = 0.0  # s, noise of the stamps
    grip: float = np.inf  # rad/s², angular acceleration of the ball that its wheels or its own ball can follow
    dropouts: float = 0.0  # 1/s, how often reports are lost
    dropout_seconds: float = 0.1  # s, for how long, at the mean


def trackball_matrix(scale_x: float, scale_y: float, turned: float = 0.0, tilt: float = 0.0) -> Array:
    """Counts per radian, (2, 3), of a trackball that touches the ball from below.

    Its axes are turned by `turned` rad about Y, and it is moved from the lowest point by `tilt` rad towards +X.
    """
    c, s = np.cos(turned), np.sin(turned)
    below = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # (d_x, -d_z) of the lowest point
    ct, st = np.cos(tilt), np.sin(tilt)
    Rz = np.array([[ct, -st, 0.0], [st, ct, 0.0], [0.0, 0.0, 1.0]])
    return np.diag([scale_x, scale_y]) @ np.array([[c, s], [-s, c]]) @ below @ Rz.T


def rate_of(truth: Truth) -> Rate:
    """Angular velocity between the frames of a recording, by a spline. Outside it is that of the nearest frame."""
    spline = CubicSpline(truth.stamp, truth.rate)
    first, last = truth.stamp[0], truth.stamp[-1]
    return lambda t: spline(np.clip(t, first, last))


def simulate_log(rate: Rate, begin: float, end: float, trackball: Trackball, seed: int = 0) -> MouseLog:
    """Log of the trackball while the ball turns with `rate` from `begin` to `end`, s."""
    rng = np.random.default_rng([seed, 0x7B])
    steps = max(1, round((end - begin) / _STEP))
    t = np.linspace(begin, end, steps + 1)
    turned = _travel(rate, t, trackball)
    n = int((end - begin) * trackball.fastest) + 2
    interval = rng.uniform(1.0 / trackball.fastest, 1.0 / trackball.slowest, n)
    polled = begin + np.cumsum(interval)
    polled = polled[polled < end]
    path = np.stack([np.interp(polled, t, turned[:, k]) for k in range(2)], axis=1)
    counts = np.diff(np.floor(path + rng.random(2)), axis=0, prepend=0.0)
    counts[:1] = 0.0
    kept = np.any(counts != 0.0, axis=1) & ~_dropped(polled, trackball, rng)
    stamp = np.concatenate([[begin], polled[kept], [end]])
    stamp = stamp + trackball.lag + trackball.drift * (stamp - begin)
    if trackball.stamp_sigma > 0.0:
        stamp[1:-1] += trackball.stamp_sigma * rng.standard_normal(len(stamp) - 2)
        stamp = np.maximum.accumulate(stamp)
    listened = np.zeros((1, 2))
    counts = np.concatenate([listened, counts[kept], listened])
    return MouseLog(stamp, counts)


def _travel(rate: Rate, t: Array, trackball: Trackball) -> Array:
    """Counts at times t, (n, 2), not rounded."""
    w = rate(t)
    if np.isfinite(trackball.grip):
        w = _followed(w, np.diff(t), trackball.grip)
    speed = w @ trackball.matrix.T
    return np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t)[:, None], axis=0)])


def _followed(w: Array, dt: Array, grip: float) -> Array:
    """The rate as something feels it that cannot be sped up or slowed down faster than `grip`."""
    u = w.copy()
    for k in range(1, len(w)):
        change, most = w[k] - u[k - 1], grip * dt[k - 1]
        size = float(np.sqrt(change @ change))
        u[k] = w[k] if size <= most else u[k - 1] + change * (most / size)
    return u


def _dropped(polled: Array, trackball: Trackball, rng: np.random.Generator) -> NDArray[np.bool_]:
    lost = np.zeros(len(polled), dtype=bool)
    if trackball.dropouts <= 0.0 or not len(polled):
        return lost
    t = float(polled[0])
    while (t := t + rng.exponential(1.0 / trackball.dropouts)) < polled[-1]:
        lost |= (polled >= t) & (polled < t + rng.exponential(trackball.dropout_seconds))
    return lost
