"""Assignment against brute force; identification against random attitudes, symmetric maps and chance."""

from itertools import combinations, permutations

import numpy as np
import pytest
from conftest import directions
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from spheremouse.associate import assign, common_rotation, identify
from spheremouse.rotation import exp, log

CAMERA = np.array([0.0, 0.0, 1.0])
HORIZON = 0.25
SIGMA = np.deg2rad(0.1)
NONE_SEEN = np.zeros((0, 3))


def anywhere(n, rng):
    """Directions on the near side, where detections can be."""
    z, a = rng.uniform(HORIZON + 0.1, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


def seen(discs, R, rng, missing=0.0, spurious=0):
    """Directions of a map at attitude R with noise, some missing, some spurious, in random order."""
    p = discs @ R.T
    p = p[p[:, 2] > HORIZON + 0.1]
    p = p[rng.random(len(p)) >= missing]
    p = p + SIGMA * rng.normal(size=p.shape)
    p = np.concatenate([p, anywhere(spurious, rng)])
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return p[rng.permutation(len(p))]


def identified(points, discs):
    return identify(points, discs, sigma=SIGMA, view_axis=CAMERA, horizon=HORIZON)


# --- assignment ------------------------------------------------------------------------------------------------------


def best_total(cost, gate):
    """Least sum of costs where each of the shorter side's members may stay alone for `gate`, by trying everything."""
    if cost.shape[0] > cost.shape[1]:
        cost = cost.T
    n, m = cost.shape
    best = n * gate
    for k in range(1, n + 1):
        for rows in combinations(range(n), k):
            for columns in permutations(range(m), k):
                best = min(best, sum(cost[i, j] for i, j in zip(rows, columns, strict=True)) + (n - k) * gate)
    return best


costs = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=4).flatmap(
    lambda shape: hnp.arrays(float, shape, elements=st.one_of(st.floats(0.0, 10.0), st.just(np.inf)))
)


@settings(deadline=None, max_examples=150)
@given(costs, st.floats(0.5, 8.0))
def test_assignment_is_the_best_of_all(cost, gate):
    rows, columns = assign(cost, gate)
    assert len(set(rows)) == len(rows) == len(columns) == len(set(columns))
    assert np.all(cost[rows, columns] < gate)
    total = cost[rows, columns].sum() + (min(cost.shape) - len(rows)) * gate
    assert_allclose(total, best_total(cost, gate), atol=1e-9)


def test_nothing_to_assign():
    for cost in (np.zeros((0, 3)), np.zeros((3, 0)), np.full((2, 2), 9.0), np.full((2, 2), np.inf)):
        rows, columns = assign(cost, 5.0)
        assert len(rows) == len(columns) == 0


def test_a_cost_that_is_no_number_is_no_pair():
    cost = np.array([[np.nan, 1.0], [np.nan, np.nan]])
    rows, columns = assign(cost, 5.0)
    assert list(zip(rows, columns, strict=True)) == [(0, 1)]


# --- identification --------------------------------------------------------------------------------------------------


def test_random_attitudes_are_found_and_never_mistaken():
    """26 discs, a fifth of the visible ones missing, one spurious: 250 trials."""
    rng = np.random.default_rng(1)
    trials = 250
    found = 0
    for i in range(trials):
        discs = directions(26, i % 25)
        R = Rotation.random(random_state=i).as_matrix()
        points = seen(discs, R, rng, missing=0.2, spurious=1)
        result = identified(points, discs)
        if result is None:
            continue
        found += 1
        assert np.linalg.norm(log(result.rotation @ R.T)) < 5 * SIGMA
        assert 0.0 <= result.false_alarm <= 1e-3
        a, b = result.pairs.T
        assert len(a) >= 3
        assert len(set(a)) == len(a) == len(set(b))
        assert_allclose(discs[b] @ result.rotation.T, points[a], atol=6 * SIGMA)
    assert found > 0.85 * trials


def test_many_missing_and_spurious_points_make_it_silent_not_wrong():
    rng = np.random.default_rng(2)
    answers = 0
    for i in range(150):
        discs = directions(26, i % 25)
        R = Rotation.random(random_state=1000 + i).as_matrix()
        result = identified(seen(discs, R, rng, missing=0.5, spurious=5), discs)
        if result is not None:
            answers += 1
            assert np.linalg.norm(log(result.rotation @ R.T)) < 5 * SIGMA
    assert answers > 10


def test_random_directions_are_nothing():
    rng = np.random.default_rng(3)
    assert all(identified(anywhere(8, rng), directions(26, i % 10)) is None for i in range(100))


def octahedron():
    return np.concatenate([np.eye(3), -np.eye(3)])


def cube():
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)


def icosahedron():
    g = (1 + np.sqrt(5)) / 2
    v = [(0, a, b * g) for a in (-1, 1) for b in (-1, 1)]
    v = np.array([np.roll(p, k) for p in v for k in range(3)], dtype=float)
    return v / np.linalg.norm(v[0])


@pytest.mark.parametrize("solid", [cube, octahedron, icosahedron])
def test_symmetric_layouts_are_ambiguous(solid):
    rng = np.random.default_rng(4)
    for i in range(25):
        R = Rotation.random(random_state=i).as_matrix()
        assert identified(seen(solid(), R, rng), solid()) is None


def test_the_far_side_of_the_ball_does_not_count():
    """A map whose two halves hold the same constellation: only what can be seen may decide."""
    rng = np.random.default_rng(5)
    half = directions(10, 6)
    half = half[half[:, 2] > 0.1]
    turn = exp(np.array([np.pi, 0.0, 0.0]))
    twice = np.concatenate([half, half @ turn.T])
    for R in (np.eye(3), turn.T):
        result = identified(seen(twice, R, rng), twice)
        assert result is None or np.linalg.norm(log(result.rotation @ R.T)) < 5 * SIGMA


@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_tell_nothing(n):
    discs = directions(26, 7)
    assert identified(discs[:n], discs) is None
    assert identified(discs, discs[:n]) is None
    assert common_rotation(discs[:n], discs, SIGMA) is None
    assert common_rotation(discs, discs[:n], SIGMA) is None


def test_degenerate_points_are_no_constellation():
    discs = directions(26, 8)
    same = np.tile([0.0, 0.0, 1.0], (6, 1))
    opposite = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    for points in (same, opposite, np.full((4, 3), np.nan)):
        assert identified(points, discs) is None
        assert identified(discs, points) is None


# --- the first motion ------------------------------------------------------------------------------------------------


def test_common_rotation_of_two_sights():
    rng = np.random.default_rng(9)
    for i in range(60):
        discs = directions(26, i)
        before = seen(discs, np.eye(3), rng)
        R = exp(rng.normal(size=3) * 0.05)
        after = seen(discs, R, rng, missing=0.2, spurious=2)
        result = common_rotation(before, after, SIGMA)
        assert result is not None
        rotation, pairs = result
        assert np.linalg.norm(log(rotation @ R.T)) < 6 * SIGMA
        assert_allclose(before[pairs[:, 0]] @ rotation.T, after[pairs[:, 1]], atol=7 * SIGMA)


def test_of_equal_agreements_the_smallest_rotation_is_common():
    """A ring of discs, turned by a third of its spacing: it could have come from either side, or farther."""
    angle = np.arange(8) * (2 * np.pi / 8)
    ring = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(8, 0.8)], axis=1)
    R = exp(np.array([0.0, 0.0, 2 * np.pi / 24]))
    result = common_rotation(ring, ring @ R.T, SIGMA)
    assert result is not None
    assert_allclose(result[0], R, atol=1e-9)


def test_unrelated_sights_share_at_most_chance():
    rng = np.random.default_rng(10)
    for _ in range(30):
        result = common_rotation(anywhere(4, rng), anywhere(4, rng), 1e-5)
        assert result is None


def test_no_points_at_all():
    assert identified(NONE_SEEN, NONE_SEEN) is None
    assert common_rotation(NONE_SEEN, NONE_SEEN, SIGMA) is None
