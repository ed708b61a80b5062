"""Particle filter: weighted poses, motion, resampling, mean on SO(3), covariance, and draws near likelihood peaks.

A particle moves by one of a few Gaussian motions (Isard, Blake 1998, as Grzonka 2005 proposes), or it is born anywhere
with a small probability. The likelihood is a fiftieth as wide as the motion, so few of 350 particles drawn from the
motion alone (Grzonka 2005, table 3) hit it. Each particle is therefore drawn from the product of its own motion and the
likelihood's peaks, and weighted by

    w = p(x | parent) L(x) / q(x | parent),

which leaves the posterior unchanged (Doucet, Godsill, Andrieu 2000). Parents are resampled beforehand by their weight
under the peaks (Pitt, Shephard 1999). A fixed fraction of the particles is still drawn from the motion alone, because
the search can miss a peak.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, align, exp, exp_into, log, log_into

_LOG_2PI = float(np.log(2.0 * np.pi))
_MIN_EFFECTIVE = 0.5  # of the particles: below, they are resampled
_PRIOR_PARTICLES = 7.0  # weight of the expected covariance: the least for which an inverse Wishart prior has a mean


@dataclass(frozen=True, slots=True)
class Particles:
    """Weighted poses of a ball."""

    position: Array  # (n, 3) m, cam
    rotation: Array  # (n, 3, 3) R_cam_ball
    weight: Array  # (n,), sum 1


@dataclass(frozen=True, slots=True)
class MotionMixture:
    """Motion of a particle until the next frame: Gaussians, and birth anywhere in view."""

    shift: Array  # (m, 6) m, rad: position + d, exp(theta) @ rotation, cam axes
    covariance: Array  # (m, 6, 6) m, rad
    probability: Array  # (m,), sum 1 less that of birth
    birth: float  # probability of birth times its density, per m³ and rad³


@dataclass(frozen=True, slots=True)
class PeakMixture:
    """Likelihood near its peaks, as a sum of Gaussians."""

    position: Array  # (k, 3) m, cam
    rotation: Array  # (k, 3, 3) R_cam_ball
    covariance: Array  # (k, 6, 6) m, rad
    log_mass: Array  # (k,) logarithm of the likelihood's integral over each


def effective_number(weight: Array) -> float:
    """Return the effective number of particles, 1 / sum w², of normalised weights (n,)."""
    return float(1.0 / np.sum(weight * weight))


def low_variance_indices(weight: Array, n: int, start: float) -> NDArray[np.int64]:
    """Draw n particles at equal steps along the weights and return their indices, (n,) (Grzonka 2005, table 2).

    `start` in [0, 1) is the only random number: the skipped part of the first step.
    """
    edges = np.cumsum(weight)
    return np.searchsorted(edges / edges[-1], (start + np.arange(n)) / n, side="right").clip(0, len(weight) - 1)


def resample(particles: Particles, n: int, rng: np.random.Generator) -> Particles:
    """Draw n particles of equal weight by the weights."""
    i = low_variance_indices(particles.weight, n, rng.random())
    return Particles(particles.position[i], particles.rotation[i], np.full(n, 1.0 / n))


def resample_degenerate(particles: Particles, rng: np.random.Generator) -> Particles:
    """Resample particles if their effective number is less than half of them."""
    n = len(particles.weight)
    return resample(particles, n, rng) if effective_number(particles.weight) < _MIN_EFFECTIVE * n else particles


def mean_pose(particles: Particles) -> tuple[Array, Array, Array]:
    """Return mean position, (3,) m, mean rotation, (3, 3), and covariance, (6, 6) m, rad in cam axes.

    The rotation is the intrinsic mean, about which the weighted rotation vectors have sum zero (Moakher 2002).
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


def normalise(log_weight: Array) -> tuple[Array, float]:
    """Return weights with sum 1, (n,), and the logarithm of the sum before."""
    most = float(np.max(log_weight))
    w = np.exp(log_weight - most)
    total = float(np.sum(w))
    return w / total, most + float(np.log(total))


def regularised_covariance(sample: Array, count: float, expected: Array) -> Array:
    """Return a sample covariance of `count` effective particles drawn towards the `expected` one, (6, 6).

    It is the posterior mean under an inverse Wishart prior with the weight of seven particles.
    """
    return (count * sample + _PRIOR_PARTICLES * expected) / (count + _PRIOR_PARTICLES)


def scatter(position: Array, rotation: Array, covariance: Array, n: int, rng: np.random.Generator) -> Particles:
    """Draw n particles of equal weight about a pose, (3,) m in cam and R_cam_ball (3, 3), with covariance (6, 6)."""
    d = rng.standard_normal((n, 6)) @ np.linalg.cholesky(covariance).T
    return Particles(position + d[:, :3], exp(d[:, 3:]) @ rotation, np.full(n, 1.0 / n))


def move(particles: Particles, motions: MotionMixture, rng: np.random.Generator) -> Particles:
    """Move each particle by a random draw of the motions, without births."""
    n = len(particles.weight)
    which = rng.choice(len(motions.probability), n, p=motions.probability / motions.probability.sum())
    root = np.linalg.cholesky(motions.covariance)
    d = motions.shift[which, :3], exp(motions.shift[which, 3:])
    noise = np.einsum("nij,nj->ni", root[which], rng.standard_normal((n, 6)))
    return Particles(
        particles.position + d[0] + noise[:, :3], exp(noise[:, 3:]) @ d[1] @ particles.rotation, particles.weight
    )


def propose(
    particles: Particles, motions: MotionMixture, peaks: PeakMixture, blind: float, n: int, rng: np.random.Generator
) -> tuple[Particles, Array, NDArray[np.int64]]:
    """Draw n particles from the products of motions and peaks, the fraction `blind` of them from the motions alone.

    Return the particles of equal weight, the logarithm (n,) of the factor that corrects their weight, and the index
    (n,) of each one's nearest peak. The corrected weight is still to be multiplied by the likelihood. Parents are
    resampled by their weight under the peaks if fewer than half of them would be effective.
    """
    g = _products(motions, peaks)
    motion_R = exp(motions.shift[:, 3:])
    m, k = len(motions.probability), len(peaks.log_mass)
    score = np.empty((len(particles.weight), m * k + k))
    difference = np.empty((len(particles.weight), m * k, 6))
    _score_products(
        particles.position, particles.rotation, motions.shift, motion_R, peaks.position, peaks.rotation, *g.evidence,
        score, difference,
    )  # fmt: skip
    score[:, m * k :] = np.log(motions.birth) + peaks.log_mass
    most = np.max(score, axis=1)
    responsibility = np.exp(score - most[:, None])
    total = np.sum(responsibility, axis=1)
    responsibility /= total[:, None]
    log_weight = np.log(np.maximum(particles.weight, 1e-300))
    first_stage, _ = normalise(log_weight + most + np.log(total))
    correction = log_weight
    if effective_number(first_stage) < _MIN_EFFECTIVE * len(first_stage) or n != len(first_stage):
        parent = low_variance_indices(first_stage, n, rng.random())
        correction = correction[parent] - np.log(first_stage[parent])
    else:
        parent = np.arange(n)
    base = Particles(particles.position[parent], particles.rotation[parent], np.full(n, 1.0 / n))
    responsibility = responsibility[parent]
    chosen = np.argmax(np.cumsum(responsibility, axis=1) > rng.random(n)[:, None], axis=1)
    alone = rng.random(n) < blind
    drawn = move(Particles(base.position[alone], base.rotation[alone], base.weight[alone]), motions, rng)
    position, rotation = base.position.copy(), base.rotation.copy()
    position[alone], rotation[alone] = drawn.position, drawn.rotation
    normal = rng.standard_normal((n, 6))
    _draw(parent, difference, peaks.position, peaks.rotation, g.gain, g.root, chosen, alone, normal, position, rotation)
    ratio, nearest = np.empty(n), np.empty(n, dtype=np.int64)
    _log_ratios(
        parent, difference, base.position, base.rotation, motions.shift, motion_R, g.motion_inverse, g.motion_norm,
        np.log(motions.probability), motions.birth, peaks.position, peaks.rotation, g.gain, g.inverse, g.norm,
        responsibility, blind, position, rotation, ratio, nearest,
    )  # fmt: skip
    return Particles(position, rotation, base.weight), ratio + correction, nearest


@dataclass(frozen=True, slots=True)
class _Products:
    """Products of every motion (m) with every peak (k), then the peaks alone: c = m k + k components.

    An inverse is that of the Cholesky root of a covariance; a norm is the logarithm of a Gaussian's normalisation.
    """

    evidence: tuple[Array, Array]  # (m k, 6, 6) inverse of motion plus peak; (m k,) log of the factor before exp
    gain: Array  # (c, 6, 6): mean of the product, from the peak, per difference of motion and peak; 0 for births
    root: Array  # (c, 6, 6) Cholesky root of the product's covariance
    inverse: Array  # (c, 6, 6)
    norm: Array  # (c,)
    motion_inverse: Array  # (m, 6, 6)
    motion_norm: Array  # (m,)


def _products(motions: MotionMixture, peaks: PeakMixture) -> _Products:
    m, k = len(motions.probability), len(peaks.log_mass)
    Q, P = motions.covariance[:, None], peaks.covariance[None]
    S = (Q + P).reshape(m * k, 6, 6)
    P = np.broadcast_to(P, (m, k, 6, 6)).reshape(m * k, 6, 6)
    gain = P @ np.linalg.inv(S)
    C = P - gain @ P
    C = np.concatenate([0.5 * (C + C.transpose(0, 2, 1)), peaks.covariance])
    root: Array = np.linalg.cholesky(C).astype(float)
    outer, outer_norm = _inverse_roots(np.linalg.cholesky(S).astype(float))
    outer_norm = outer_norm + (np.log(motions.probability)[:, None] + peaks.log_mass[None]).ravel()
    gain = np.concatenate([gain, np.zeros((k, 6, 6))])
    motion_root = np.linalg.cholesky(motions.covariance).astype(float)
    return _Products((outer, outer_norm), gain, root, *_inverse_roots(root), *_inverse_roots(motion_root))


def _inverse_roots(root: Array) -> tuple[Array, Array]:
    """Return inverse Cholesky roots, (n, 6, 6), and the logarithms of the Gaussians' normalisation, (n,)."""
    log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.linalg.inv(root).astype(float), -3.0 * _LOG_2PI - log_det


@njit(cache=True, fastmath=True, error_model="numpy")
def _pose_difference(c, R, shift, motion_R, to_c, to_R, spare, spare2, d):
    """Write the pose (c, R) moved by shift and rotation, less (to_c, to_R), to d, (6,)."""
    for i in range(3):
        d[i] = c[i] + shift[i] - to_c[i]
        for j in range(3):
            spare[i, j] = motion_R[i, 0] * R[0, j] + motion_R[i, 1] * R[1, j] + motion_R[i, 2] * R[2, j]
    for i in range(3):
        for j in range(3):
            spare2[i, j] = spare[i, 0] * to_R[j, 0] + spare[i, 1] * to_R[j, 1] + spare[i, 2] * to_R[j, 2]
    log_into(spare2, d[3:])


@njit(cache=True, fastmath=True, error_model="numpy")
def _mahalanobis_squared(inverse_root, d):
    """Return |L^-1 d|² for a lower triangular L^-1."""
    total = 0.0
    for i in range(6):
        x = 0.0
        for j in range(i + 1):
            x += inverse_root[i, j] * d[j]
        total += x * x
    return total


@njit(cache=True, fastmath=True, error_model="numpy")
def _log_haar(d):
    """Return the logarithm of the Haar measure per rad³ at the rotation vector d[3:]: 2 (1 - cos a) / a²."""
    square = d[3] * d[3] + d[4] * d[4] + d[5] * d[5]
    if square < 1e-4:
        return -square / 12.0
    return np.log(max(2.0 * (1.0 - np.cos(np.sqrt(square))) / square, 1e-6))


@njit(cache=True, fastmath=True, error_model="numpy")
def _score_products(position, rotation, shift, motion_R, peak_c, peak_R, outer, outer_norm, score, difference):
    m, k = len(shift), len(peak_c)
    spare, spare2, d = np.empty((3, 3)), np.empty((3, 3)), np.empty(6)
    for n in range(len(position)):
        for a in range(m):
            for b in range(k):
                _pose_difference(
                    position[n], rotation[n], shift[a], motion_R[a], peak_c[b], peak_R[b], spare, spare2, d
                )
                at = a * k + b
                difference[n, at] = d
                score[n, at] = outer_norm[at] - 0.5 * _mahalanobis_squared(outer[at], d)


@njit(cache=True, fastmath=True, error_model="numpy")
def _draw(parent, difference, peak_c, peak_R, gain, root, chosen, alone, normal, to_c, to_R):
    k = len(peak_c)
    mk = difference.shape[1]
    spare, x = np.empty((3, 3)), np.empty(6)
    for n in range(len(parent)):
        if alone[n]:
            continue
        at = chosen[n]
        b = at % k
        x[:] = 0.0
        if at < mk:
            d = difference[parent[n], at]
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
def _log_ratios(
    parent, difference, position, rotation, shift, motion_R, motion_inverse, motion_norm, log_p, birth, peak_c, peak_R,
    gain, inverse, norm, responsibility, blind, to_c, to_R, ratio, nearest,
):  # fmt: skip
    """Write log p(x | parent) - log q(x | parent) to ratio, and the index of the nearest peak to nearest, (n,)."""
    m, k = len(shift), len(peak_c)
    spare, spare2, d, e = np.empty((3, 3)), np.empty((3, 3)), np.empty(6), np.empty(6)
    none, same = np.zeros(6), np.eye(3)
    x = np.empty((k, 6))
    haar = np.empty(k)
    for n in range(len(position)):
        p = 0.0
        for a in range(m):
            _pose_difference(position[n], rotation[n], shift[a], motion_R[a], to_c[n], to_R[n], spare, spare2, d)
            p += np.exp(log_p[a] + motion_norm[a] - 0.5 * _mahalanobis_squared(motion_inverse[a], d) - _log_haar(d))
        for b in range(k):
            _pose_difference(to_c[n], to_R[n], none, same, peak_c[b], peak_R[b], spare, spare2, x[b])
            haar[b] = _log_haar(x[b])
        most, best, q = -1e300, 0, 0.0
        for a in range(m + 1):
            for b in range(k):
                at = a * k + b
                e[:] = x[b]
                if a < m:
                    by = difference[parent[n], at]
                    for i in range(6):
                        for j in range(6):
                            e[i] -= gain[at, i, j] * by[j]
                gap = _mahalanobis_squared(inverse[at], e)
                fit = norm[at] - 0.5 * gap
                if responsibility[n, at] > 0.0:
                    q += responsibility[n, at] * np.exp(fit - haar[b])
                if fit > most:
                    most, best = fit, b
        q = (1.0 - blind) * q + blind * p
        ratio[n] = np.log(max(p + birth, 1e-300)) - np.log(max(q, 1e-300))
        nearest[n] = best
