"""Sizes, places, hands: layouts are what they are called; tiny films."""

import numpy as np
import pytest
from experiments import discs
from experiments.discs import LAYOUTS, directions_of, in_rows


@pytest.mark.parametrize("kind", list(LAYOUTS))
def test_layouts_are_unit_vectors_without_overlap(kind):
    d = directions_of(kind, 3)
    assert d.shape == (discs.DISCS, 3)
    assert np.linalg.norm(d, axis=1) == pytest.approx(np.ones(len(d)))
    apart = np.arccos(np.clip(d @ d.T - 2.0 * np.eye(len(d)), -1.0, 1.0))
    assert np.min(apart) > 2.0 * 0.02 / 0.6  # two radii: they do not touch
    if kind != "cluster":
        assert np.linalg.norm(d.mean(axis=0)) < 0.35  # all over the ball
    else:
        assert np.all(d[:, 2] > np.cos(np.radians(75.0)))


def test_rows_are_symmetric_under_half_a_turn_upside_down():
    d = in_rows()
    turned = d * (1.0, -1.0, -1.0)  # half a turn about x
    assert np.max(np.min(np.linalg.norm(turned[:, None] - d[None], axis=2), axis=1)) < 1e-9


def test_an_irregular_layout_is_recognised_and_a_regular_one_is_not():
    recognised, mistaken = discs.recognition(directions_of("designed", 1))
    assert recognised > 0.98
    assert mistaken == 0.0
    g = (1 + np.sqrt(5)) / 2
    icosahedron = np.array([np.roll([0, a, b * g], k) for a in (-1, 1) for b in (-1, 1) for k in range(3)])
    assert discs.recognition(icosahedron / np.hypot(1, g))[0] == 0.0
