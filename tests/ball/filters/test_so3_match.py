"""Pairs of points and discs, against their equations in NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import linear_sum_assignment
from scipy.stats import multivariate_normal

from spheremouse.ball.filters.so3_motion import KINEMATIC_DIM, MAP_OFFSET
from spheremouse.geometry.rotation import exp, hat
from spheremouse.native import kernels
from tests.ball.filters.twins import GATE, HORIZON, TOWARDS, drawn, linear, place, process, seen_with_rig


def innovation(body, points, pairs, added):
    """Twin of `kernels.innovation`: omitted terms grow with the turn, and with the part that a disc does not share."""
    z, H, noise = (np.array(a) for a in zip(*(linear(body, points, i, j) for i, j in pairs), strict=True))
    H = H.reshape(-1, H.shape[2])
    S, turning = H @ body[5] @ H.T, H[:, :KINEMATIC_DIM]
    turned = min(np.trace(body[5][:3, :3] + added[:3, :3]) / 3.0, 0.01)
    own = np.diag(S + turning @ added @ turning.T).reshape(-1, 2).mean(axis=1)
    S = S + np.diag(np.repeat(turned * np.clip(own, 0.0, turned), 2))
    for k, N in enumerate(noise):
        S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += N
    return turning, H @ body[5], z.ravel(), S


def distances(body, points, which, added, allowance):
    """Return squared distances, (n, k), without errors that frames have in common, or with them if beyond the gate."""
    P, result = body[5], np.full((len(points[0]), len(which)), np.inf)
    for i in range(len(points[0])):
        b = seen_with_rig(body, points, i)
        for k, j in enumerate(which):
            z, H, noise = linear(body, points, i, j)
            p, E, _ = place(body, j, points[2][i] + body[6] * points[3][i])
            p_stamp, E_stamp, _ = place(body, j, 0.0)
            alone = H.copy()
            alone[:, :MAP_OFFSET], alone[:, :3] = 0.0, -E_stamp.T @ hat(p_stamp)
            for J, turning in ((alone, alone[:, :3]), (H, -E.T @ hat(p))):
                C = J @ P @ J.T + turning @ added[:3, :3] @ turning.T + noise + allowance * np.eye(2)
                if p @ b > 0.99 and result[i, k] >= GATE:
                    result[i, k] = z @ np.linalg.solve(C, z)
    return result


def consistent(z, S, limit):
    """Return a mask of the pairs that remain when the one that contradicts the others most goes, again and again."""
    at = np.arange(len(z) // 2)
    while len(at) > 1:
        index = (2 * at[:, None] + [0, 1]).ravel()
        Q = np.linalg.inv(S[np.ix_(index, index)])
        v = (Q @ z[index]).reshape(-1, 2)
        value = [v[i] @ np.linalg.solve(Q[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], v[i]) for i in range(len(at))]
        if max(value) < limit:
            break
        at = np.delete(at, np.argmax(value))
    return np.isin(np.arange(len(z) // 2), at)


def nearest_pairs(body, points, added, horizon=HORIZON):
    """Return the pairs with the process noise `added`, at the livelier of two levels."""
    pending = added, 1.0 / 30.0, np.array([0.0, 1.0]), None
    activity = GATE, 0.2, 1.0, np.array([1.0, 2.0]), np.zeros(2), np.full(2, 0.5)
    return kernels.nearest_pairs(body, points, (TOWARDS, horizon), pending, activity)


def assert_innovations_agree(got, expected):
    scale = np.sqrt(np.diag(expected[3]))
    assert_allclose(got[0], expected[0], atol=1e-13)
    assert_allclose(got[1], expected[1], atol=1e-12 * np.abs(expected[1]).max(initial=0.0))
    assert_allclose(got[2], expected[2], atol=1e-15)
    assert_allclose(got[3] / np.outer(scale, scale), expected[3] / np.outer(scale, scale), atol=1e-12)


@pytest.mark.parametrize("sigma", [1e-4, 3e-3, 0.1])
def test_the_innovations_of_pairs_are_their_linear_model(sigma):
    body, points = drawn(1, sigma)
    rows, columns = np.arange(len(points[0])), np.arange(len(points[0])) % len(body[3])
    added = process(sigma)
    expected = innovation(body, points, list(zip(rows, columns, strict=True)), added)
    assert_innovations_agree(kernels.innovation(body, points, rows, columns, added), expected)
    assert [len(a) for a in kernels.innovation(body, points, rows[:0], columns[:0], added)] == [0, 0, 0, 0]


@pytest.mark.parametrize("sigma", [3e-3, 1e-2])
@pytest.mark.parametrize("common", [False, True])
def test_distances_are_exact_below_the_gate(sigma, common):
    pairs = 0
    for seed in range(10):
        body, points = drawn(seed, sigma)
        if not common:  # and no delay
            body[5][KINEMATIC_DIM:MAP_OFFSET] = body[5][:, KINEMATIC_DIM:MAP_OFFSET] = 0.0
            points = (*points[:2], 0.0 * points[2], 0.0 * points[3], *points[4:])
        which = np.arange(1, len(body[3]))
        expected = distances(body, points, which, process(sigma), 1e-6)
        got = kernels.distances(body, points, which, process(sigma), 1e-6, GATE)
        below = expected < GATE
        assert_array_equal(got < GATE, below)
        assert_allclose(got[below], expected[below], rtol=1e-9, atol=1e-12)
        pairs += below.sum()
    assert pairs > 20


@pytest.mark.parametrize(("sigma", "more"), [(3e-3, ()), (1e-2, (64, 78))])  # there a pair contradicts the others
def test_the_pairs_have_the_least_total_distance_and_agree(sigma, more):
    disagree = 0
    for seed in (*range(20), *more):
        body, points = drawn(seed, sigma)
        attitude, discs, P = body[0], body[3], body[5]
        added = process(sigma)
        which = np.flatnonzero(discs @ attitude.T @ TOWARDS > HORIZON)
        allowance = min(np.trace(P[:3, :3] + added[:3, :3]) / 3.0, 0.01) ** 2
        distance = distances(body, points, which, added, allowance)
        worth = np.maximum(GATE - distance, 0.0)
        rows, at = linear_sum_assignment(worth, maximize=True)
        rows, at = rows[worth[rows, at] > 0.0], at[worth[rows, at] > 0.0]
        H, _, z, S = innovation(body, points, list(zip(rows, which[at], strict=True)), added)
        keep = consistent(z, S + H @ added @ H.T, 1.5 * GATE)
        got = nearest_pairs(body, points, added)
        assert_array_equal(got[0], rows[keep])
        assert_array_equal(got[1], which[at][keep])
        in_place = keep.all() and distance[rows, at].sum() < 4.0 * len(rows) + 10.0
        assert got[2:] == (in_place and len(rows) == min(distance.shape), 2.0 if keep.all() else 1.0)
        disagree += not keep.all()
    assert disagree >= len(more)


def test_without_a_visible_disc_there_is_no_pair():
    body, points = drawn(1)
    rows, columns, complete, noise_scale = nearest_pairs(body, points, process(1.0), horizon=2.0)
    assert (len(rows), len(columns), complete, noise_scale) == (0, 0, True, 2.0)


def test_the_pairs_are_those_of_the_most_likely_level():
    """In a frame that shows a push, more points pair at a lively level, unless a wide gate finds them by chance."""
    levels, weights, chosen = np.array([1.0, 16.0, 256.0, 4096.0]), np.array([0.9, 0.07, 0.02, 0.01]), set()
    for seed in range(20):
        body, points = drawn(seed, 1e-3)
        push = exp(8e-3 * np.random.default_rng(seed).normal(size=3))
        points = points[0] @ push.T, *points[1:]
        noise, expected = 0.02 * process(1e-3), weights @ levels
        foreign = len(points[0]) / (2.0 * np.pi * (1.0 - HORIZON))
        best, most = None, -np.inf
        for square, probability in [(expected, 1.0), *zip(levels, weights, strict=True)]:
            if (best is not None and best[2]) or (best is not None and square <= expected):
                continue
            added = (square - 1.0) * noise
            rows, columns, complete, scale = nearest_pairs(body, points, added)
            pairs = list(zip(rows, columns, strict=True))
            value = np.log(probability)
            if pairs:
                H, _, z, S = innovation(body, points, pairs, added if scale != 1.0 else 0.0 * added)
                value += multivariate_normal.logpdf(z, cov=S + H @ added @ H.T) + len(pairs) * np.log(4.0 / foreign)
            if value > most:
                best, most = (rows, columns, complete, square if scale != 1.0 else 1.0), value
        pending = noise, 1.0 / 30.0, weights, None
        activity = GATE, 0.2, 1.0, levels, np.zeros(4), np.full(4, 0.25)
        got = kernels.nearest_pairs(body, points, (TOWARDS, HORIZON), pending, activity)
        assert best is not None
        assert_array_equal(got[0], best[0])
        assert_array_equal(got[1], best[1])
        assert got[2:] == pytest.approx(best[2:])
        chosen.add(round(got[3], 6))
    assert len(chosen) > 1


def test_the_standard_deviation_of_a_place_is_that_of_its_worse_axis():
    body, _ = drawn(2)
    which, added = np.array([3, 0]), process(3e-3)
    for sigma, j in zip(kernels.place_sigma(body, which, added), which, strict=True):
        p, E, _ = place(body, j, 0.0)
        H = np.zeros((2, len(body[5])))
        H[:, :3], H[:, MAP_OFFSET + 2 * j : MAP_OFFSET + 2 * j + 2] = -E.T @ hat(p), np.eye(2)
        S = H @ body[5] @ H.T + H[:, :3] @ added[:3, :3] @ H[:, :3].T
        assert_allclose(sigma, np.sqrt(np.linalg.eigvalsh(S)[1]), rtol=1e-12)


def test_a_wrong_argument_is_named():
    body, points = drawn(1)
    n, pair = len(points[0]), (np.arange(1), np.arange(1))
    for at in range(5):
        with pytest.raises(TypeError, match="one length"):
            kernels.innovation(body, (*points[:at], points[at][:-1], *points[at + 1 :]), *pair, process(1.0))
    for rows, columns, name in ((np.array([n]), np.array([0]), "rows"), (np.array([0]), np.array([-1]), "columns")):
        with pytest.raises(IndexError, match=name):
            kernels.innovation(body, points, rows, columns, process(1.0))
