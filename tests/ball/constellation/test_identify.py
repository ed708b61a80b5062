"""Identification: pairs, matches and adjustment compared with brute force; the probability of error by sampling."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.special import gammaln, logsumexp
from scipy.stats import multivariate_normal

from spheremouse.ball.constellation.identify import IdentificationPrior, attitude, posterior_error
from spheremouse.geometry.rotation import align, exp, log, tangent_basis
from spheremouse.native import kernels

CAMERA = np.array([0.0, 0.0, 1.0])
HORIZON = 0.25
MODEL = IdentificationPrior()
AREA = 2.0 * np.pi * (1.0 - HORIZON)
EDGE = HORIZON + MODEL.limb_cosine
RATIO = MODEL.sigma_scales[-1] ** 2 / MODEL.sigma_scales[0]  # of two neighbours of the grid of standard deviations


def observation(hidden=MODEL.miss_probabilities, scales=MODEL.sigma_scales):
    hidden, scales = np.array(hidden), np.array(scales)
    return kernels.ObservationModel(CAMERA, EDGE, MODEL.limb_width, 0.8, hidden, scales, MODEL.false_mean, AREA)


def refined(R, seen, known, variance, model=None):
    """Adjust one attitude: rotation, column, information and log evidence."""
    model = model or observation()
    return (a[0] for a in model.refine_attitudes(R[None].copy(), seen, known, variance, 2.5))


def visibility(cosine):
    return 1.0 / (1.0 + np.exp((EDGE - cosine) / MODEL.limb_width))


def scattered(p, sigma, rng):
    """Return directions with noise of `sigma` rad per axis, a number or (n, 1)."""
    e = tangent_basis(p) @ (np.broadcast_to(sigma, (len(p), 1)) * rng.normal(size=(len(p), 2)))[:, :, None]
    p = p + e[:, :, 0]
    return p / np.linalg.norm(p, axis=1, keepdims=True)


def any_attitude(rng):
    return exp(rng.uniform(0.0, np.pi) * directions(1, rng.integers(1 << 30))[0])


def anywhere(n, least, rng):
    """Return directions, (n, 3), with a cosine to the camera's of at least `least`."""
    z, a = rng.uniform(least, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


def seen_by_model(rng, p, sigma, ratios=()):
    """Return directions drawn from the model: discs at p, (m, 3), one of `ratios` times as exact, and false ones."""
    p = p[rng.random(len(p)) < (1.0 - rng.choice(MODEL.miss_probabilities)) * visibility(p[:, 2])]
    cosine = np.clip(p[:, 2:], 0.3, 1.0)
    more = np.sqrt(1.0 + 0.5 * MODEL.pixel_noise_fraction * (1.0 / cosine**2 - 1.0))
    scale = rng.choice(MODEL.sigma_scales) * (rng.choice(ratios) if ratios else 1.0)
    p = scattered(p, scale * sigma * more, rng)
    return np.vstack([p, anywhere(rng.geometric(1.0 / (1.0 + MODEL.false_mean)) - 1, HORIZON, rng)])


@pytest.mark.parametrize(("n", "groups"), [(3, 1), (7, 1), (8, 2), (11, 3), (13, 4)])
def test_more_directions_than_groups_contain_a_pair(n, groups):
    origins = kernels.Hypotheses(directions(n, 1), directions(4, 2), groups, 4.0, 9999).origins
    pairs = {frozenset(p) for p in origins[:, :2]}
    assert all(any(frozenset(p) in pairs for p in combinations(some, 2)) for some in combinations(range(n), groups + 1))
    sizes = [n // groups + (g < n % groups) for g in range(groups)]
    assert len(pairs) == sum(k * (k - 1) // 2 for k in sizes)  # the least possible (Turan 1941)


@pytest.mark.parametrize("seed", range(5))
def test_every_true_pair_gives_the_true_attitude(seed):
    known, R = directions(12, seed), Rotation.random(random_state=seed).as_matrix()
    seen = known[:5] @ R.T
    found = kernels.Hypotheses(seen, known, 1, 1e-6, 1000)
    rotations, origins = found.rotations, found.origins
    truth = [h for h in range(len(rotations)) if np.allclose(rotations[h], R, atol=1e-6)]
    assert {frozenset(origins[h, :2]) for h in truth} == {frozenset(p) for p in combinations(range(5), 2)}
    assert np.array_equal(origins[truth, :2], origins[truth, 2:])
    for Q, (i, j, a, b) in zip(rotations, origins, strict=True):
        assert_allclose(Q @ known[a] + Q @ known[b], seen[i] + seen[j], atol=1e-5)
        assert_allclose(np.linalg.det(Q), 1.0)
    assert len(kernels.Hypotheses(seen, known, 1, 1.0, 7).rotations) == 7


def cosines(R, seen, known):
    return np.einsum("hij,ni,mj->hnm", R, seen, known)


@pytest.mark.parametrize("seed", range(5))
def test_the_best_hypotheses_match_the_most_directions_best(seed):
    rng = np.random.default_rng(seed)
    sigma, gain, margin = 0.02, 5.0, 12.0
    known, R = directions(26, seed), Rotation.random(random_state=seed).as_matrix()
    p = known @ R.T
    seen = scattered(p[p[:, 2] > 0.4], sigma, rng)
    found = kernels.Hypotheses(seen, known, 1, 0.08, 5000)
    i, j = found.origins[:, :2].T
    half = (1.0 - np.abs(np.sum(seen[i] * seen[j], axis=1))) / 2.0
    weight = 1.0 / (sigma**2 * (1.0 + 0.5 / half))
    nearest = cosines(found.rotations, seen, known).max(axis=2)
    score = np.maximum(0.0, gain - (1.0 - nearest) * weight[:, None]).sum(axis=1)
    best = found.best(sigma, gain, margin, 64)
    assert 1 < len(best) < 64
    assert_allclose(best[0], found.rotations[np.argmax(score)])
    place = np.argmax(np.einsum("kij,hij->kh", best, found.rotations), axis=1)
    assert np.all(np.diff(score[place]) <= 0.0)
    assert score[place[-1]] > score.max() - margin
    good = score > score.max() - margin
    traces = np.einsum("kij,hij->kh", best, found.rotations[good])
    assert np.all(traces.max(axis=0) > 1.0 + 2.0 * np.cos(6.0 * sigma))  # each good one has one of the best nearby
    few = found.best(sigma, gain, margin, 3)
    assert_allclose(few[0], best[0])
    assert len(few) == min(3, len(best))


@pytest.mark.parametrize("seed", range(5))
def test_the_most_common_rotation_matches_the_most_directions(seed):
    rng = np.random.default_rng(seed)
    known, R = directions(20, seed), Rotation.random(random_state=seed).as_matrix()
    seen = scattered((known @ R.T)[:12], 0.02, rng)
    found = kernels.Hypotheses(seen, known, 2, 0.1, 20_000)
    met = cosines(found.rotations, seen, known) > np.cos(0.1)
    number = np.minimum(met.any(axis=2).sum(axis=1), met.any(axis=1).sum(axis=1))
    trace = np.where(number == number.max(), np.trace(found.rotations, axis1=1, axis2=2), -np.inf)
    best, agreed = found.most_common(np.cos(0.1))
    assert agreed == number.max() > 8
    assert_allclose(best, found.rotations[np.argmax(trace)])


@pytest.mark.parametrize("seed", range(10))
def test_adjustment_equals_wahbas_solution(seed):
    rng = np.random.default_rng(seed)
    known, R = directions(26, seed), Rotation.random(random_state=seed).as_matrix()
    p = known @ R.T
    seen = scattered(p[p[:, 2] > 0.45], 0.01, rng)
    variance = 1e-4 * rng.uniform(0.5, 2.0, size=len(seen))
    start = exp(0.01 * rng.normal(size=3)) @ R
    rotation, column, information, _ = refined(start, seen, known, variance)
    assert_allclose(p[column], seen, atol=0.06)
    assert_allclose(rotation, align(known[column], seen, 1.0 / variance), atol=1e-9)
    q = known[column] @ rotation.T
    expected = sum((np.eye(3) - np.outer(a, a)) / v for a, v in zip(q, variance, strict=True))
    assert_allclose(information, expected, rtol=1e-6, atol=1e-3)


def test_evidence_is_the_integral_over_attitudes():
    """Monte Carlo sum of the densities over attitudes about the best one."""
    rng = np.random.default_rng(2)
    sigma, hidden = 0.01, 0.2
    known, R = directions(26, 5), Rotation.random(random_state=5).as_matrix()
    p = known @ R.T
    seen = np.vstack([scattered(p[p[:, 2] > 0.5][:4], sigma, rng), [[0.6, 0.0, 0.8], [0.0, -0.28, 0.96]]])
    best, column, _, value = refined(R, seen, known, np.full(6, sigma**2), observation((hidden,), (1.0,)))
    assert np.sum(column >= 0) == 4

    half = 0.05  # ten standard deviations, half the side of the cube of sampled rotation vectors
    turns = rng.uniform(-half, half, size=(40_000, 3))
    turned = np.einsum("hij,kj->hki", exp(turns) @ best, known)
    rows = np.flatnonzero(column >= 0)
    total = np.zeros(len(turns))
    for i in rows:
        off = np.einsum("ab,ha->hb", tangent_basis(seen[i]), turned[:, column[i]] - seen[i])
        total += multivariate_normal([0.0, 0.0], sigma**2).logpdf(off)
    chance = (1.0 - hidden) * visibility(turned[:, :, 2])
    met = np.isin(np.arange(26), column[rows])
    total += np.where(met, np.log(chance), np.log(1.0 - chance)).sum(axis=1)
    geometric = np.log(1.0 / 3.0 * (2.0 / 3.0) ** 2)
    total += geometric + np.log(2.0) - 2.0 * np.log(AREA)  # two false ones in any order
    direct = np.log(np.mean(np.exp(total - total.max()))) + total.max() + np.log((2 * half) ** 3 / (8 * np.pi**2))
    assert_allclose(value, direct, atol=0.15)


def log_evidence(R, column, seen, known, variance, hidden, scales):
    """Twin of the evidence of an attitude and its matches: the mean over equal alternatives."""
    rows, k = np.flatnonzero(column >= 0), np.sum(column >= 0)
    p, v = known @ R.T, variance[rows]
    q = p[column[rows]]
    information = np.einsum("n,nij->ij", 1.0 / v, np.eye(3) - q[:, :, None] * q[:, None, :])
    width = 1.5 * np.log(2.0 * np.pi) - 0.5 * np.log(np.linalg.det(information)) - np.log(8.0 * np.pi**2)
    square = np.sum((seen[rows] - q) ** 2 / v[:, None])
    log_scale, chance = np.log(scales), (1.0 - np.array(hidden)[:, None]) * visibility(p[:, 2])
    noise = np.minimum(0.0, width + 3.0 * log_scale) - 2.0 * k * log_scale - 0.5 * square / np.square(scales)
    matched = np.isin(np.arange(len(known)), column)
    visible = np.where(matched, np.log(chance), np.log(1.0 - chance))[:, visibility(p[:, 2]) > 1e-4].sum(axis=1)
    false = np.log(1.0 / 3.0) + (len(seen) - k) * np.log(2.0 / 3.0 / AREA) + gammaln(len(seen) - k + 1.0)
    alternatives = logsumexp(noise) + logsumexp(visible) - np.log(len(scales) * len(hidden))
    return alternatives - np.sum(np.log(2.0 * np.pi * v)) + false


def test_evidence_of_two_matches_is_the_sum_over_the_hypotheses():
    known, R = directions(20, 4), Rotation.random(random_state=4).as_matrix()
    p = known @ R.T
    seen = scattered(p[p[:, 2] > 0.4], 0.02, np.random.default_rng(4))
    variance = 0.02**2 * np.linspace(1.0, 2.0, len(seen))
    found = kernels.Hypotheses(seen, known, 1, 0.05, 500)
    terms = []
    for Q, origin in zip(found.rotations, found.origins, strict=True):
        column = np.full(len(seen), -1)
        column[origin[:2]] = origin[2:]
        terms.append(log_evidence(Q, column, seen, known, variance, MODEL.miss_probabilities, MODEL.sigma_scales))
    assert_allclose(observation().two_match_log_evidence(found, variance, 10_000), logsumexp(terms), rtol=1e-10)
    rotation, column, _, value = refined(R, seen, known, variance)
    twin = log_evidence(rotation, column, seen, known, variance, MODEL.miss_probabilities, MODEL.sigma_scales)
    assert_allclose(value, twin, atol=1e-6)  # the information is that before the last step


def test_posterior_error_sums_over_other_attitudes():
    R = np.stack([np.eye(3), exp(np.array([0.0, 0.0, 0.02])), exp(np.array([0.0, np.pi, 0.0]))])
    A = np.broadcast_to(np.eye(3) / 0.01**2, (3, 3, 3)).copy()
    # the second counts as the first
    best, wrong = posterior_error(R, A, np.log([6.0, 2.0, 1.0]), np.log(1.0), 25.0)
    assert best == 0
    assert_allclose(wrong, 0.2)
    assert_allclose(posterior_error(R, A, np.log([6.0, 2.0, 1.0]), np.log(1.0), 1.0)[1], 0.4)


def test_three_exact_directions_suffice_though_their_sigma_is_uncertain():
    """Three of twelve discs among ten false directions: found by their small residuals, and never wrong."""
    sigma, right, coarse = 3e-3, 0, 0
    for seed in range(60):
        rng = np.random.default_rng([11, seed])
        known, R = directions(12, seed), any_attitude(rng)
        p = known @ R.T
        p = p[np.argsort(-p[:, 2])[:3]]
        seen = np.vstack([scattered(p, 3e-4, rng), anywhere(10, EDGE, rng)])
        for least in (3e-4, sigma):
            found = attitude(seen, known, sigma, CAMERA, HORIZON, min_sigma=least)
            if found is not None and found.error_probability < 1e-3:
                assert np.linalg.norm(log(found.rotation @ R.T)) < 5e-3
                right, coarse = right + (least < sigma), coarse + (least == sigma)
    assert right >= 0.8 * 60
    assert coarse < 0.1 * 60


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratios", "limits"), [((), (0.0, 0.05, 0.3, 0.7, 1.0)), ((1.0, 1.0 / RATIO), (0.0, 0.05, 0.5, 1.0))]
)
def test_probability_of_error_equals_the_frequency_of_errors(ratios, limits):
    """Balls drawn from the model, with noise of 4 degrees, known or not to a third, in classes of the probability."""
    rng = np.random.default_rng(7)
    said, wrong = [], []
    sigma = np.deg2rad(4.0)
    for i in range(1000):
        known, R = directions(20, i % 30, least=0.35), Rotation.random(random_state=i).as_matrix()
        p = seen_by_model(rng, known @ R.T, sigma, ratios)
        least = sigma / RATIO if ratios else None
        found = attitude(p, known, sigma, CAMERA, HORIZON, min_sigma=least) if len(p) >= 3 else None
        if found is not None:
            said.append(found.error_probability)
            wrong.append(np.linalg.norm(log(found.rotation @ R.T)) > 0.35)
    said, wrong = np.array(said), np.array(wrong)
    for low, high in pairwise(limits):
        these = (said >= low) & (said < high)
        n, expected = np.sum(these), np.sum(said[these])
        assert n > 30
        spread = np.sqrt(np.sum(said[these] * (1.0 - said[these])))
        assert np.sum(wrong[these]) < expected + 4.0 * spread, (low, high)
        assert np.sum(wrong[these]) > 0.4 * expected - 4.0 * spread, (low, high)
