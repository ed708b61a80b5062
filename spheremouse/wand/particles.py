"""Particles: poses with weights, their motion, resampling, mean on SO(3), covariance, and proposals from the picture.

A particle moves by one of a few Gaussian motions (rest, go on, free: Isard and Blake 1998, which Grzonka 2005 names) or
is born anywhere with a small probability. Drawn from that motion alone (Grzonka 2005, table 3), few of 350 particles
hit a likelihood that is a fiftieth as wide. So each is drawn where the product of its own motion and the likelihood's
peaks lies, and weighted by

    w = p(x | parent) L(x) / q(x | parent),

which leaves the posterior what it is (Doucet, Godsill, Andrieu 2000); parents are resampled by what the picture makes
of them beforehand (Pitt, Shephard 1999). Part of the particles is drawn from the motion alone all the same: a peak that
was not found does not exist otherwise.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, align, exp, exp_into, log, log_into

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True)
class Particles:
    """Weighted poses of a ball."""

    position: Array  # (n, 3) m, cam
    rotation: Array  # (n, 3, 3) R_cam_ball
    weight: Array  # (n,), sum 1


@dataclass(frozen=True, slots=True)
class Motions:
    """What a particle may do until the next frame: Gaussians, and birth anywhere in view."""

    shift: Array  # (m, 6) m, rad: position + d, exp(theta) @ rotation, cam axes
    covariance: Array  # (m, 6, 6) m, rad
    probability: Array  # (m,), sum 1 less that of birth
    birth: float  # probability of birth times its density, per m³ and rad³


@dataclass(frozen=True, slots=True)
class Peaks:
    """Where the likelihood is high: a sum of Gaussians."""

    position: Array  # (k, 3) m, cam
    rotation: Array  # (k, 3, 3)
    covariance: Array  # (k, 6, 6)
    log_mass: Array  # (k,) logarithm of the likelihood's integral over each


def effective(weight: Array) -> float:
    """Effective number of particles, 1 / sum w² of normalised weights."""
    return float(1.0 / np.sum(weight * weight))


def low_variance(weight: Array, n: int, start: float) -> NDArray[np.int64]:
    """Indices of n particles drawn at equal steps along the weights, (n,) (Grzonka 2005, table 2).

    `start` in [0, 1) is the one random number: which part of the first step is skipped.
    """
    edges = np.cumsum(weight)
    return np.searchsorted(edges / edges[-1], (start + np.arange(n)) / n, side="right").clip(0, len(weight) - 1)


def estimate(particles: Particles) -> tuple[Array, Array, Array]:
    """Weighted mean position, (3,), mean rotation, (3, 3), and covariance, (6, 6) m, rad in cam axes.

    The rotation is the intrinsic mean: where the weighted logarithms of the differences vanish (Moakher 2002).
    """
    w = particles.weight
    p = w @ particles.position
    R = align(np.eye(3), np.einsum("n,nij->ji", w, particles.rotation))
    theta = log(particles.rotation @ R.T)
    for _ in range(3):
        mean = w @ theta
        if mean @ mean < 1e-16:
            break
        R = exp(mean) @ R
        theta = log(particles.rotation @ R.T)
    d = np.concatenate([particles.position - p, theta], axis=1)
    return p, R, (d * w[:, None]).T @ d


def normalised(log_weight: Array) -> tuple[Array, float]:
    """Weights with sum 1, (n,), and the logarithm of their sum before."""
    most = float(np.max(log_weight))
    w = np.exp(log_weight - most)
    total = float(np.sum(w))
    return w / total, most + float(np.log(total))


def steadied(sample: Array, count: float, expected: Array) -> Array:
    """Covariance of a sample of so many effective particles, where few of them say little of it, (6, 6).

    The posterior mean of a covariance under an inverse Wishart prior about `expected`, of the least weight that has a
    mean: that of seven particles.
    """
    return (count * sample + 7.0 * expected) / (count + 7.0)


def scatter(position: Array, rotation: Array, covariance: Array, n: int, rng: np.random.Generator) -> Particles:
    """n particles about a pose, of equal weight."""
    d = rng.standard_normal((n, 6)) @ np.linalg.cholesky(covariance).T
    return Particles(position + d[:, :3], exp(d[:, 3:]) @ rotation, np.full(n, 1.0 / n))


def moved(particles: Particles, motions: Motions, rng: np.random.Generator) -> Particles:
    """Particles after one of the motions each, drawn at random."""
    n = len(particles.weight)
    which = rng.choice(len(motions.probability), n, p=motions.probability / motions.probability.sum())
    root = np.linalg.cholesky(motions.covariance)
    d = motions.shift[which, :3], exp(motions.shift[which, 3:])
    noise = np.einsum("nij,nj->ni", root[which], rng.standard_normal((n, 6)))
    return Particles(
        particles.position + d[0] + noise[:, :3], exp(noise[:, 3:]) @ d[1] @ particles.rotation, particles.weight
    )


def proposed(
    particles: Particles, motions: Motions, peaks: Peaks, blind: float, n: int, rng: np.random.Generator
) -> tuple[Particles, Array, NDArray[np.int64]]:
    """n particles drawn by motion and peaks, with log p(x | parent) / q(x | parent) beside the parents' weights.

    The part `blind` is drawn from the motions alone. Parents are resampled by their weight times what the picture makes
    of them where fewer than half of them would count. Gives particles with weights still to be multiplied by
    exp(log ratio) and the likelihood, the log ratio, (n,), and each one's nearest peak, (n,).
    """
    g = _products(motions, peaks)
    turn = exp(motions.shift[:, 3:])
    m, k = len(motions.probability), len(peaks.log_mass)
    score = np.empty((len(particles.weight), m * k + k))
    ahead_by = np.empty((len(particles.weight), m * k, 6))
    _scores(
        particles.position, particles.rotation, motions.shift, turn, peaks.position, peaks.rotation, *g.evidence, score,
        ahead_by,
    )  # fmt: skip
    score[:, m * k :] = np.log(motions.birth) + peaks.log_mass
    most = np.max(score, axis=1)
    share = np.exp(score - most[:, None])
    total = np.sum(share, axis=1)
    share /= total[:, None]
    ahead, _ = normalised(np.log(np.maximum(particles.weight, 1e-300)) + most + np.log(total))
    correction = np.log(np.maximum(particles.weight, 1e-300))
    if effective(ahead) < 0.5 * len(ahead) or n != len(ahead):
        parent = low_variance(ahead, n, rng.random())
        correction = correction[parent] - np.log(ahead[parent])
    else:
        parent = np.arange(n)
    base = Particles(particles.position[parent], particles.rotation[parent], np.full(n, 1.0 / n))
    share = share[parent]
    chosen = np.argmax(np.cumsum(share, axis=1) > rng.random(n)[:, None], axis=1)
    alone = rng.random(n) < blind
    drawn = moved(Particles(base.position[alone], base.rotation[alone], base.weight[alone]), motions, rng)
    position, rotation = base.position.copy(), base.rotation.copy()
    position[alone], rotation[alone] = drawn.position, drawn.rotation
    normal = rng.standard_normal((n, 6))
    _draw(parent, ahead_by, peaks.position, peaks.rotation, g.gain, g.root, chosen, alone, normal, position, rotation)
    ratio, nearest = np.empty(n), np.empty(n, dtype=np.int64)
    _densities(
        parent, ahead_by, base.position, base.rotation, motions.shift, turn, g.still, g.still_log,
        np.log(motions.probability), motions.birth, peaks.position, peaks.rotation, g.gain, g.inverse, g.inverse_log,
        share, blind, position, rotation, ratio, nearest,
    )  # fmt: skip
    return Particles(position, rotation, base.weight), ratio + correction, nearest


@dataclass(frozen=True, slots=True)
class _Products:
    """Products of every motion (m) with every peak (k), then the peaks alone: c = m k + k components."""

    evidence: tuple[Array, Array]  # inverse Cholesky root (m k, 6, 6), log of the factor before the exponential (m k,)
    gain: Array  # (c, 6, 6): mean of the product, from the peak, per difference of motion and peak; 0 for births
    root: Array  # (c, 6, 6) Cholesky root of the product's covariance
    inverse: Array  # (c, 6, 6) inverse of it
    inverse_log: Array  # (c,) log of the product's normalisation
    still: Array  # (m, 6, 6) inverse root of the motions' covariance
    still_log: Array  # (m,)


def _products(motions: Motions, peaks: Peaks) -> _Products:
    m, k = len(motions.probability), len(peaks.log_mass)
    Q, P = motions.covariance[:, None], peaks.covariance[None]
    S = (Q + P).reshape(m * k, 6, 6)
    P = np.broadcast_to(P, (m, k, 6, 6)).reshape(m * k, 6, 6)
    gain = P @ np.linalg.inv(S)
    C = P - gain @ P
    C = np.concatenate([0.5 * (C + C.transpose(0, 2, 1)), peaks.covariance])
    root: Array = np.linalg.cholesky(C).astype(float)
    inverse, inverse_log = _inverse_roots(root)
    outer, outer_log = _inverse_roots(np.linalg.cholesky(S).astype(float))
    outer_log = outer_log + (np.log(motions.probability)[:, None] + peaks.log_mass[None]).ravel()
    still, still_log = _inverse_roots(np.linalg.cholesky(motions.covariance).astype(float))
    gain = np.concatenate([gain, np.zeros((k, 6, 6))])
    return _Products((outer, outer_log), gain, root, inverse, inverse_log, still, still_log)


def _inverse_roots(root: Array) -> tuple[Array, Array]:
    """Inverse Cholesky roots and logarithms of the Gaussians' normalisation."""
    log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.linalg.inv(root).astype(float), -3.0 * _LOG_2PI - log_det


@njit(cache=True, fastmath=True, error_model="numpy")
def _difference(c, R, shift, turn, to_c, to_R, spare, spare2, d):
    """The pose (c, R) moved by shift and turn, less (to_c, to_R), into d, (6,)."""
    for i in range(3):
        d[i] = c[i] + shift[i] - to_c[i]
        for j in range(3):
            spare[i, j] = turn[i, 0] * R[0, j] + turn[i, 1] * R[1, j] + turn[i, 2] * R[2, j]
    for i in range(3):
        for j in range(3):
            spare2[i, j] = spare[i, 0] * to_R[j, 0] + spare[i, 1] * to_R[j, 1] + spare[i, 2] * to_R[j, 2]
    log_into(spare2, d[3:])


@njit(cache=True, fastmath=True, error_model="numpy")
def _square(inverse_root, d):
    """|L^-1 d|² of a lower triangular L^-1."""
    total = 0.0
    for i in range(6):
        x = 0.0
        for j in range(i + 1):
            x += inverse_root[i, j] * d[j]
        total += x * x
    return total


@njit(cache=True, fastmath=True, error_model="numpy")
def _log_haar(d):
    """Logarithm of the volume of rotations per rad³ at a rotation vector d[3:]: 2 (1 - cos a) / a²."""
    square = d[3] * d[3] + d[4] * d[4] + d[5] * d[5]
    if square < 1e-4:
        return -square / 12.0
    return np.log(max(2.0 * (1.0 - np.cos(np.sqrt(square))) / square, 1e-6))


@njit(cache=True, fastmath=True, error_model="numpy")
def _scores(position, rotation, shift, turn, peak_c, peak_R, outer, outer_log, score, ahead_by):
    m, k = len(shift), len(peak_c)
    spare, spare2, d = np.empty((3, 3)), np.empty((3, 3)), np.empty(6)
    for n in range(len(position)):
        for a in range(m):
            for b in range(k):
                _difference(position[n], rotation[n], shift[a], turn[a], peak_c[b], peak_R[b], spare, spare2, d)
                at = a * k + b
                ahead_by[n, at] = d
                score[n, at] = outer_log[at] - 0.5 * _square(outer[at], d)


@njit(cache=True, fastmath=True, error_model="numpy")
def _draw(parent, ahead_by, peak_c, peak_R, gain, root, chosen, alone, normal, to_c, to_R):
    k = len(peak_c)
    mk = ahead_by.shape[1]
    spare, x = np.empty((3, 3)), np.empty(6)
    for n in range(len(parent)):
        if alone[n]:
            continue
        at = chosen[n]
        b = at % k
        x[:] = 0.0
        if at < mk:
            d = ahead_by[parent[n], at]
            for i in range(6):
                for j in range(6):
                    x[i] += gain[at, i, j] * d[j]
        for i in range(6):
            for j in range(i + 1):
                x[i] += root[at, i, j] * normal[n, j]
        exp_into(x[3:], spare)
        for i in range(3):
            to_c[n, i] = peak_c[b, i] + x[i]
            for j in range(3):
                to_R[n, i, j] = (
                    spare[i, 0] * peak_R[b, 0, j] + spare[i, 1] * peak_R[b, 1, j] + spare[i, 2] * peak_R[b, 2, j]
                )


@njit(cache=True, fastmath=True, error_model="numpy")
def _densities(
    parent, ahead_by, position, rotation, shift, turn, still, still_log, log_p, birth, peak_c, peak_R, gain, inverse,
    inverse_log, share, blind, to_c, to_R, ratio, nearest,
):  # fmt: skip
    """log p(x | parent) - log q(x | parent), and the peak each x lies nearest to."""
    m, k = len(shift), len(peak_c)
    spare, spare2, d, e = np.empty((3, 3)), np.empty((3, 3)), np.empty(6), np.empty(6)
    none, same = np.zeros(6), np.eye(3)
    x = np.empty((k, 6))
    haar = np.empty(k)
    for n in range(len(position)):
        p = 0.0
        for a in range(m):
            _difference(position[n], rotation[n], shift[a], turn[a], to_c[n], to_R[n], spare, spare2, d)
            p += np.exp(log_p[a] + still_log[a] - 0.5 * _square(still[a], d) - _log_haar(d))
        for b in range(k):
            _difference(to_c[n], to_R[n], none, same, peak_c[b], peak_R[b], spare, spare2, x[b])
            haar[b] = _log_haar(x[b])
        most, best, q = -1e300, 0, 0.0
        for a in range(m + 1):
            for b in range(k):
                at = a * k + b
                e[:] = x[b]
                if a < m:
                    by = ahead_by[parent[n], at]
                    for i in range(6):
                        for j in range(6):
                            e[i] -= gain[at, i, j] * by[j]
                gap = _square(inverse[at], e)
                fit = inverse_log[at] - 0.5 * gap
                if share[n, at] > 0.0:
                    q += share[n, at] * np.exp(fit - haar[b])
                if fit > most:
                    most, best = fit, b
        q = (1.0 - blind) * q + blind * p
        ratio[n] = np.log(max(p + birth, 1e-300)) - np.log(max(q, 1e-300))
        nearest[n] = best
