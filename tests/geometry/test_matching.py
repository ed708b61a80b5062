"""Matching of points by their distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose
from scipy.optimize import linear_sum_assignment

from spheremouse.geometry.matching import assign, mutual_nearest, suppress
from spheremouse.native import kernels


@pytest.mark.parametrize("seed", range(40))
def test_matching_maximises_the_total(seed):
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 9, size=2)
    worth = rng.normal(size=(n, m)) + (1.0 if seed % 2 else -0.5)
    if seed % 3 == 0:
        worth = np.round(worth)  # ties
    column = kernels.match(worth)
    rows = np.flatnonzero(column >= 0)
    assert len(set(column[rows])) == len(rows)
    gain = np.maximum(worth, 0.0)
    i, j = linear_sum_assignment(gain, maximize=True)
    assert_allclose(worth[rows, column[rows]].sum(), gain[i, j].sum(), atol=1e-12)
    assert np.all(worth[rows, column[rows]] > 0.0)


costs = hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=5).flatmap(
    lambda shape: hnp.arrays(float, shape, elements=st.floats(0.0, 10.0) | st.sampled_from([np.inf, np.nan]))
)


@given(costs, st.floats(0.5, 8.0))
def test_assignment_minimises_the_cost_if_each_row_may_stay_alone_for_the_gate(cost, gate):
    rows, columns = assign(cost, gate)
    assert len(set(rows)) == len(rows) == len(columns) == len(set(columns))
    assert np.all(cost[rows, columns] < gate)
    least = np.minimum(np.nan_to_num(cost, nan=np.inf), gate)
    total = cost[rows, columns].sum() + (min(cost.shape) - len(rows)) * gate
    assert_allclose(total, least[linear_sum_assignment(least)].sum(), atol=1e-9)


def test_mutual_nearest_pairs_are_each_other_s_nearest():
    distance = np.random.default_rng(0).random((7, 9))
    distance[2] = np.inf
    columns = mutual_nearest(distance)
    for i, j in np.ndindex(distance.shape):
        assert (columns[i] == j) == (i != 2 and distance[i, j] == distance[i].min() == distance[:, j].min())
    assert np.count_nonzero(columns >= 0) > 2
    assert len(mutual_nearest(distance[:0])) == 0
    assert np.all(mutual_nearest(distance[:, :0]) == -1)


@pytest.mark.parametrize("norm", [2.0, np.inf])
def test_suppression_keeps_the_first_of_each_neighbourhood(norm):
    points = np.random.default_rng(0).random((60, 2))
    radius = np.linspace(0.05, 0.2, 60)
    kept = suppress(points, radius, norm).tolist()
    assert 10 < len(kept) < 60
    for i in range(60):
        hidden = any(np.linalg.norm(points[i] - points[k], norm) <= radius[k] for k in kept if k < i)
        assert (i in kept) != hidden
    assert len(suppress(points[:0], radius[:0])) == 0
