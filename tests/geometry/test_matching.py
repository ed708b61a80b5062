"""Matching of points by their distances."""

import numpy as np

from spheremouse.geometry.matching import mutual_nearest, suppress


def test_mutual_nearest_pairs_are_each_other_s_nearest():
    distance = np.random.default_rng(0).random((7, 9))
    distance[2] = np.inf
    rows, columns = mutual_nearest(distance)
    assert len(rows) > 2
    assert 2 not in rows
    for i, j in zip(rows, columns, strict=True):
        assert distance[i, j] == distance[i].min() == distance[:, j].min()
    assert len(mutual_nearest(distance[:0])[0]) == 0


def test_suppression_keeps_the_first_of_each_neighbourhood():
    points = np.random.default_rng(0).random((60, 2))
    radius = np.linspace(0.05, 0.2, 60)
    order = np.random.default_rng(1).permutation(60).tolist()
    kept = suppress(points, radius, order)
    for n, i in enumerate(order):
        before = [k for k in kept if order.index(k) < n]
        hidden = any(np.linalg.norm(points[i] - points[k]) <= radius[k] for k in before)
        assert (i in kept) != hidden
    assert suppress(points[:0], 0.1, []) == []
