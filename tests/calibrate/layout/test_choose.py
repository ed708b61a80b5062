"""Layouts: discs in view against many directions, an order that is a rotation, recognition of regular solids."""

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from spheremouse.calibrate.layout.choose import assess, choose_directions, min_in_view, misplaced, recognition
from spheremouse.geometry.rotation import fibonacci_sphere

VIEW = np.radians(70.0)
G = (1 + np.sqrt(5)) / 2
ICOSAHEDRON = np.array([np.roll([0, a, b * G], k) for a in (-1, 1) for b in (-1, 1) for k in range(3)]) / np.hypot(1, G)


@pytest.mark.parametrize("n", [4, 12, 26])
def test_the_number_in_view_is_that_of_the_barest_direction(n):
    d = directions(n, 1)
    many = np.random.default_rng(1).standard_normal((20_000, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    assert abs(min_in_view(d, VIEW) - np.sum(many @ d.T > np.cos(VIEW), axis=1).min()) <= 1


def test_the_fibonacci_sphere_is_even():
    d = fibonacci_sphere(1000)
    assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    assert_allclose(d.mean(axis=0), 0.0, atol=1e-2)
    apart = np.arccos(np.clip(np.max(d @ d.T - 3.0 * np.eye(1000), axis=1), -1.0, 1.0))
    assert apart.min() > 0.8 * apart.max()


@pytest.mark.parametrize("n", [8, 26])
def test_chosen_places_are_distinct_spread_and_the_same_for_the_same_seed(n):
    d = choose_directions(n, VIEW, 0.1, 1)
    assert_allclose(d, choose_directions(n, VIEW, 0.1, 1))
    assert np.abs(d - choose_directions(n, VIEW, 0.1, 2)).max() > 0.1
    found = assess(d, VIEW)
    assert found.distance > 0.5 * np.sqrt(4.0 * np.pi / n)
    if n == 26:
        assert found.in_view >= 5
        assert found.recognised > 0.98
        assert found.mistaken == 0.0


def test_the_order_starts_at_the_pole_and_is_a_rotation():
    d = choose_directions(26, VIEW, 0.1, 3)
    assert_allclose(d[0], [0, 0, 1], atol=1e-12)
    assert np.all(np.diff(d[:, 2]) <= 0.0)
    neighbour = d[np.argmax(d[1:] @ d[0]) + 1]
    assert_allclose(neighbour[1], 0.0, atol=1e-9)
    assert neighbour[0] > 0.0
    assert_allclose(np.linalg.norm(d, axis=1), 1.0)


def test_discs_that_do_not_fit_are_rejected():
    with pytest.raises(ValueError, match="do not fit"):
        choose_directions(100, VIEW, 1.0, 0)


def test_misplacement_has_its_standard_deviation():
    rng = np.random.default_rng(0)
    d = directions(40, 7, 0.1)
    off = np.concatenate([np.arccos(np.sum(d * misplaced(d, 0.02, rng), axis=1)) for _ in range(200)])
    assert_allclose(np.sqrt(np.mean(off**2) / 2), 0.02, rtol=0.02)


def test_an_irregular_layout_is_recognised_and_a_regular_one_is_not():
    recognised, mistaken = recognition(directions(26, 8), VIEW)
    assert recognised > 0.9
    assert mistaken == 0.0
    assert recognition(ICOSAHEDRON, VIEW)[0] == 0.0


def test_a_turned_ball_has_the_same_properties():
    d = directions(16, 5)
    a, b = assess(d, VIEW), assess(d @ Rotation.random(random_state=1).as_matrix().T, VIEW)
    assert a.nearest == b.nearest
    assert_allclose(a.distance, b.distance)
    assert abs(a.in_view - b.in_view) <= 1
