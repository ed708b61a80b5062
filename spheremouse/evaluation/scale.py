"""Estimate rotation scale and drift of a run about each axis of `obj`, with confidence intervals.

The path about an axis is the sum of the rotation vectors from frame to frame. For the measured path p and the true path
q about the three axes, the model is

    p_i(t) = c_i + sum_j S_ij q_j(t) + d_i t + e_i(t).

S_ii is the scale about axis i, S_ij the misalignment of two axes, and d_i the drift. The error e_i is that of the
attitude, independent from node to node, plus a random walk of unknown share (the local level model, Harvey 1989,
chapter 4). The nodes are half a second apart. Two adjacent increments of the path share the attitude error between
them, with opposite signs, so their covariance is w² I + b² tridiag(-1, 2, -1). The discrete sine transform diagonalises
it. Generalised least squares is then weighted least squares on transformed increments.

The ratio w² : b² is averaged over its restricted likelihood (Patterson and Thompson 1971), so that the confidence
intervals contain its uncertainty.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import dst
from scipy.stats import t as student

from spheremouse.geometry.rotation import Array

_NODE_S = 0.5  # s: errors of attitudes that are nearer to each other correlate
_MIN_FREEDOM = 15  # intervals less unknowns; with fewer, the ratio of the variances is unknown
_MIN_PATH = np.radians(5.0)  # RMS of the path about an axis, apart from motion about the others
_MIN_UNSTEADINESS = 0.1  # part of the time that the paths do not explain, RMS
_RANK_TOLERANCE = 1e-12  # eigenvalues below this part of the largest are none
_MIN_RESIDUAL_RAD2 = 1e-30  # rad²
_CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class ScaleAndDrift:
    """Scale and drift about the axes of obj, (3,) each, with half widths of their 95 % confidence intervals.

    The scale is nan about an axis that the ball did not turn about, or only together with another axis. The drift is
    nan if the ball turned so steadily that scale and drift are inseparable. The scale then contains the drift.
    """

    scale: Array  # (3,) measured over true
    scale_width: Array  # (3,)
    drift: Array  # (3,) rad/s
    drift_width: Array  # (3,) rad/s


def scale_and_drift(seconds: Array, measured: Array, true: Array) -> ScaleAndDrift | None:
    """Return the statistics of n steps of `seconds` (n,) with `measured` and `true` rotation vectors, (n, 3) rad, obj.

    The steps are in order, but not necessarily contiguous. None if they take less than ten seconds.
    """
    ends = np.cumsum(np.append(0.0, seconds))
    nodes = np.unique(np.searchsorted(ends, np.arange(0.0, ends[-1], _NODE_S)))
    if len(nodes) < 2:
        return None
    p, q, dt = (np.add.reduceat(part[: nodes[-1]], nodes[:-1], axis=0) for part in (measured, true, seconds[:, None]))
    path, time = _deviation(q), _deviation(dt)
    moving = _rms(path) > _MIN_PATH
    steady = _rms(_apart(time, path[:, moving]))[0] < _MIN_UNSTEADINESS * _rms(time)[0]
    X = q[:, moving] if steady else np.hstack([q[:, moving], dt])
    if len(p) - X.shape[1] < _MIN_FREEDOM:
        return None
    value, width = _fit(X, p - q)
    scale, drift = np.full((2, 3), np.nan), np.full((2, 3), np.nan)
    for k, i in enumerate(np.flatnonzero(moving)):
        if _rms(_apart(path[:, [i]], path[:, moving & (np.arange(3) != i)]))[0] > _MIN_PATH:
            scale[:, i] = 1.0 + value[k, i], width[k, i]
    if not steady:
        drift[:] = value[-1], width[-1]
    return ScaleAndDrift(*scale, *drift)


def _fit(X: Array, y: Array) -> tuple[Array, Array]:
    """Return coefficients of increments y (m, 3) on X (m, k), and half widths of their confidence intervals, (k, 3)."""
    m, k = X.shape
    X, y = (np.asarray(dst(part, type=1, axis=0, norm="ortho")) for part in (X, y))
    bounded = 2.0 - 2.0 * np.cos(np.pi * np.arange(1, m + 1) / (m + 1))  # eigenvalues of tridiag(-1, 2, -1)
    ratios = np.geomspace(0.1 * bounded[0], 100.0, 40)  # w² : b²
    weight, value, variance = np.empty((40, 3)), np.empty((40, k, 3)), np.empty((40, k, 3))
    for j, ratio in enumerate(ratios):
        v = bounded + ratio
        power, axes = np.linalg.eigh(X.T @ (X / v[:, None]))
        power, axes = power[power > _RANK_TOLERANCE * power[-1]], axes[:, power > _RANK_TOLERANCE * power[-1]]
        inverse = axes / power @ axes.T
        value[j] = inverse @ X.T @ (y / v[:, None])
        residual = np.sum((y - X @ value[j]) ** 2 / v[:, None], axis=0) / (m - k)
        variance[j] = np.diag(inverse)[:, None] * residual
        weight[j] = -0.5 * ((m - k) * np.log(residual + _MIN_RESIDUAL_RAD2) + np.sum(np.log(v)) + np.sum(np.log(power)))
    weight = np.exp(weight - weight.max(axis=0))
    weight = (weight / weight.sum(axis=0))[:, None]
    mean = np.sum(weight * value, axis=0)
    spread = np.sum(weight * (variance + (value - mean) ** 2), axis=0)
    return mean, np.asarray(student.ppf(0.5 + 0.5 * _CONFIDENCE, m - k) * np.sqrt(spread))


def _deviation(increments: Array) -> Array:
    """Return the path of increments (m, k), less its mean."""
    path = np.cumsum(increments, axis=0)
    return np.asarray(path - path.mean(axis=0))


def _apart(path: Array, others: Array) -> Array:
    """Return the part of a path (m, 1) that others (m, k) do not explain."""
    return path - others @ np.linalg.lstsq(others, path)[0]


def _rms(path: Array) -> Array:
    return np.sqrt(np.mean(path**2, axis=0))
