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
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, align, exp, log
from spheremouse.native import kernels

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
    """Draw n particles from the products of motions and peaks. With probability `blind`, one is from motions alone.

    Return the particles, of equal weight, log p(x | parent) / q(x | parent) of each, (n,), and the index (n,) of its
    nearest peak. The caller adds the log-likelihood. There must be a peak.

    The first stage (Pitt, Shephard 1999) weighs each particle by the mass of its products with the peaks. If fewer than
    half of the particles are effective in it, or n is another number, it resamples the parents; the returned logarithm
    compensates for that.
    """
    proposal = kernels.Proposal(
        motions.shift, motions.covariance, motions.probability, motions.birth,
        peaks.position, peaks.rotation, peaks.covariance, peaks.log_mass,
    )  # fmt: skip
    products, from_peak = proposal.score(particles.position, particles.rotation)  # pose differences (N, m k, 6)
    births = np.broadcast_to(np.log(motions.birth) + peaks.log_mass, (len(products), len(peaks.log_mass)))
    score = np.concatenate([products, births], axis=1)
    highest = np.max(score, axis=1)
    responsibility = np.exp(score - highest[:, None])
    total = np.sum(responsibility, axis=1)
    responsibility /= total[:, None]
    log_weight = np.log(np.maximum(particles.weight, 1e-300))
    first_stage, _ = normalise(log_weight + highest + np.log(total))
    correction = log_weight
    if effective_number(first_stage) < _MIN_EFFECTIVE * len(first_stage) or n != len(first_stage):
        parent = low_variance_indices(first_stage, n, rng.random())
        correction = correction[parent] - np.log(first_stage[parent])
    else:
        parent = np.arange(n)
    base = Particles(particles.position[parent], particles.rotation[parent], np.full(n, 1.0 / n))
    responsibility, from_peak = responsibility[parent], from_peak[parent]
    component = np.argmax(np.cumsum(responsibility, axis=1) > rng.random(n)[:, None], axis=1)
    blindly = rng.random(n) < blind
    moved = move(Particles(base.position[blindly], base.rotation[blindly], base.weight[blindly]), motions, rng)
    position, rotation = proposal.draw(component, from_peak, rng.standard_normal((n, 6)))
    position[blindly], rotation[blindly] = moved.position, moved.rotation
    ratio, nearest = proposal.log_ratio(
        base.position, base.rotation, position, rotation, from_peak, responsibility, blind
    )
    return Particles(position, rotation, base.weight), ratio + correction, nearest
