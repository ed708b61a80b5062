"""Attitude of a map of directions from seen directions, with the probability of error.

This is a star tracker on a ball. Pairs of directions give hypotheses (Mortari et al. 2004). The search ranks them and
adjusts the best ones. Their evidence from all seen and unseen discs, and that of another object, gives the posterior
probability by Bayes' rule.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, log
from spheremouse.native import kernels

_SHARED_GROUP_SIZE = 6  # directions of a group of `shared_rotation`, within which pairs are formed
_MAX_SHARED_HYPOTHESES = 20_000  # of `shared_rotation`; further ones are not tried


@dataclass(frozen=True, slots=True)
class IdentificationPrior:
    """Prior of the detections, wide enough for every detector, and bounds of the search.

    `pixel_noise_fraction` and `max_attitudes` were chosen on simulated balls (docs/identification.md). No value was
    fitted to a recording.
    """

    miss_probabilities: tuple[float, ...] = (0.05, 0.2, 0.5)  # of a disc in the middle: faint, behind a strut, hand
    sigma_scales: tuple[float, ...] = (2.0 / 3.0, 1.0, 1.5)  # true standard deviation over the given one
    false_mean: float = 2.0  # false directions; their number is geometric, so that ten are possible
    limb_cosine: float = 0.1  # above the horizon, where half of all discs are seen: foreshortened to a tenth
    limb_width: float = 0.06  # cosine over which that changes: 3.5 degrees of error of view axis or horizon
    pixel_noise_fraction: float = 0.5  # of the directions' noise, which grows with 1 / cosine
    other_probability: float = 0.1  # of another object: another ball, a wall of false detections
    pair_sigmas: float = 3.0  # tolerance of a pair's angle: one true pair in 370 is missed
    score_margin: float = 25.0  # nats: odds of 1e6, squared because the score is approximate
    first_variance: float = 2.5  # of the first matches over that of the last: two directions gave the attitude
    group_size: int = 6  # an attitude with more than one match in six directions is always found
    max_attitudes: int = 64  # that are adjusted: an icosahedron has 60 equal ones
    max_hypotheses: int = 5000  # a millisecond
    sample_size: int = 16  # of hypotheses, for the evidence that only two directions match
    max_directions: int = 60  # the nearest to the view axis: half of 120 discs
    same_gate: float = 25.0  # squared standard deviations within which two attitudes are one


@dataclass(frozen=True, slots=True)
class Attitude:
    """Most probable attitude of a map."""

    rotation: Array  # (3, 3), seen ~ known @ rotation.T
    pairs: NDArray[np.intp]  # (k, 2) of (index into seen, index into known)
    error_probability: float  # of another attitude or another map


class _Refined(NamedTuple):
    """Attitudes that directions of the same standard deviation match best."""

    rotation: Array  # (h, 3, 3)
    columns: NDArray[np.intp]  # (h, n) index of the known direction of each seen one, or -1
    information: Array  # (h, 3, 3) 1/rad²
    log_evidence: Array  # (h,)
    two_match_log_evidence: float  # of all attitudes with two matches


def attitude(
    seen: Array,
    known: Array,
    sigma: float,
    view_axis: Array,
    horizon: float,
    model: IdentificationPrior = IdentificationPrior(),
    min_sigma: float | None = None,
) -> Attitude | None:
    """Return the most probable rotation of `known`, (m, 3) unit vectors, to `seen`, (n, 3); None without three matches.

    `sigma` is rad per axis. With `min_sigma`, the logarithm of the standard deviation has a uniform prior between both.
    `view_axis` (3,) points to the camera, in the frame of `seen`, and `horizon` is the least cosine with it of a
    visible disc. The probability is exact if the model holds.
    """
    central = np.sort(np.argsort(-(seen @ view_axis), kind="stable")[: model.max_directions])
    points = np.ascontiguousarray(seen[central])
    n = len(points)
    observation = kernels.ObservationModel(
        view_axis,
        horizon + model.limb_cosine,
        model.limb_width,
        1.0 - float(np.median(model.miss_probabilities)),
        np.array(model.miss_probabilities),
        np.array(model.sigma_scales),
        model.false_mean,
        2.0 * math.pi * (1.0 - horizon),
    )
    sigmas = _sigma_grid(sigma if min_sigma is None else min_sigma, sigma, model)
    tried = [_refine(points, known, each, view_axis, observation, model) for each in sigmas]
    found = [refined for refined in tried if refined is not None]
    if not any(len(refined.rotation) for refined in found):
        return None
    discs_in_sight = 0.5 * len(known) * (1.0 - horizon)  # another ball has as many discs
    other = observation.false_log_density(n, discs_in_sight) + math.log(
        model.other_probability / (1.0 - model.other_probability)
    )
    two = np.logaddexp.reduce([refined.two_match_log_evidence for refined in found])
    R, columns, information, value = (np.concatenate(part) for part in list(zip(*found, strict=True))[:4])
    null = float(np.logaddexp(other, two - math.log(len(sigmas))))
    best, error = posterior_error(R, information, value - math.log(len(sigmas)), null, model.same_gate)
    rows = np.flatnonzero(columns[best] >= 0)
    if len(rows) < 3 or not math.isfinite(value[best]):
        return None
    return Attitude(R[best].copy(), np.stack([central[rows], columns[best][rows]], axis=1), error)


def _sigma_grid(least: float, most: float, model: IdentificationPrior) -> Array:
    """Return standard deviations, (k,), from `least` to `most` rad, with no gap between their `sigma_scales`."""
    low, *_, high = model.sigma_scales
    steps = math.ceil(math.log(most / least) / math.log(high**2 / low) - 1e-9)
    return np.geomspace(most, least, steps + 1)


def _refine(
    points: Array,
    known: Array,
    sigma: float,
    view_axis: Array,
    observation: kernels.ObservationModel,
    model: IdentificationPrior,
) -> _Refined | None:
    """Return the attitudes of `known` that directions with an error of `sigma` rad match best.

    Returns None if a false direction explains as much as a disc.
    """
    gain = observation.max_log_likelihood_ratio(sigma * sigma)
    if gain <= 0.0:
        return None
    n = len(points)
    groups = max(1, n // model.group_size)
    tolerance = model.pair_sigmas * math.sqrt(2.0) * sigma
    hypotheses = kernels.Hypotheses(points, known, groups, tolerance, model.max_hypotheses)
    starts = hypotheses.best(sigma, gain, model.score_margin, model.max_attitudes)
    cosine = np.clip(points @ view_axis, 0.3, 1.0)  # nearer the limb a disc is a line, without noise of pixels
    variance = sigma * sigma * (1.0 + 0.5 * model.pixel_noise_fraction * (1.0 / cosine**2 - 1.0))
    R, columns, information, value = observation.refine_attitudes(starts, points, known, variance, model.first_variance)
    size, larger = divmod(n, groups)
    pairs = groups * size * (size - 1) // 2 + larger * size  # within the groups
    two = observation.two_match_log_evidence(hypotheses, variance, model.sample_size)
    two += math.log(n * (n - 1) / 2 / pairs)
    return _Refined(R, columns, information, value, two)


def posterior_error(
    R: Array, information: Array, log_evidence: Array, null_log_evidence: float, gate: float
) -> tuple[int, float]:
    """Return the index of the best attitude and the posterior probability that it is wrong.

    R (h, 3, 3) are h >= 1 attitudes of equal prior probability. Their information, (h, 3, 3) 1/rad², has the axes of
    the frame of `seen`. `log_evidence`, (h,), is -inf for a repeated attitude, which would count twice. The other
    explanations together have `null_log_evidence`. An attitude counts as the best one if its squared Mahalanobis
    distance from that is below `gate`, by the information of either.
    """
    best = int(np.argmax(log_evidence))
    error = log(R @ R[best].T)
    of_best, own = (np.einsum("hi,hij,hj->h", error, A, error) for A in (information[best, None], information))
    same = np.minimum(of_best, own) < gate
    same[best] = True
    weight = np.exp(np.append(log_evidence, null_log_evidence) - max(log_evidence[best], null_log_evidence))
    return best, float((weight[-1] + weight[:-1][~same].sum()) / weight.sum())


def shared_rotation(before: Array, after: Array, sigma: float) -> tuple[Array, int]:
    """Return the rotation R, (3, 3), with which most directions match, after = R before, and the number of matches.

    `before` (m, 3) and `after` (n, 3) are unit vectors, and `sigma` is rad per axis of one direction. A hypothesis
    comes from two directions of `before` and two of `after` at the same angle to each other. Directions match within
    5.25 sigma, which includes the error of the hypothesis. Among equal numbers the smallest rotation wins. Without a
    hypothesis the result is the identity and 0.
    """
    tolerance = 3.5 * math.sqrt(2.0) * sigma  # of the angle between two directions
    groups = max(1, len(after) // _SHARED_GROUP_SIZE)
    hypotheses = kernels.Hypotheses(after, before, groups, tolerance, _MAX_SHARED_HYPOTHESES)
    return hypotheses.most_common(math.cos(5.25 * sigma))
