"""Layouts: numbers in view against brute force, symmetric solids and their groups, turns that change nothing."""

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from spheremouse.calibrate.layout.coincidence import nearest_doubles
from spheremouse.calibrate.layout.search import (
    CLEAR,
    alike,
    evenly_spread,
    in_order,
    judge,
    least_in_view,
    misplaced,
    recognised,
    search,
    spacing,
)
from spheremouse.calibrate.layout.search import _pairs as pairs_of

VIEW = np.radians(70.0)


def unit(v):
    v = np.array(v, dtype=float)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
CUBE = unit([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
TETRAHEDRON = unit([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
G = (1 + np.sqrt(5)) / 2
ICOSAHEDRON = unit([np.roll([0, a, b * G], k) for a in (-1, 1) for b in (-1, 1) for k in range(3)])


@pytest.mark.parametrize("n", [4, 12, 26])
@pytest.mark.parametrize("angle", [40.0, 70.0, 89.0])
def test_the_least_number_in_view_is_that_of_the_barest_of_many_directions(n, angle):
    for seed in range(5):
        d = directions(n, seed)
        found = least_in_view(d, np.radians(angle))
        many = np.random.default_rng(seed).standard_normal((40_000, 3))
        many /= np.linalg.norm(many, axis=1, keepdims=True)
        tried = int(np.min(np.sum(many @ d.T > np.cos(np.radians(angle)), axis=1)))
        assert found <= tried  # a small patch may escape the directions, but not the corners
        assert tried - found <= 1


def test_spread_directions_share_the_sphere():
    d = evenly_spread(1000)
    assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    assert_allclose(d.mean(axis=0), 0.0, atol=1e-2)
    assert_allclose(spacing(1000) ** 2 * 1000, 4 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize(("solid", "group"), [(TETRAHEDRON, 12), (OCTAHEDRON, 24), (CUBE, 24), (ICOSAHEDRON, 60)])
def test_a_solid_has_the_symmetries_of_its_rotation_group(solid, group):
    judged = judge(solid, np.radians(89.0), 100)
    assert len(judged.symmetries) == group - 1
    assert judged.separability == pytest.approx(0.0, abs=1e-9)
    assert judged.unclear == 1.0
    for turn in judged.symmetries:
        assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert_allclose(np.linalg.det(turn), 1.0)
        distance = np.linalg.norm((solid @ turn.T)[:, None] - solid, axis=2)
        assert_allclose(distance.min(axis=1), 0.0, atol=1e-6)


def test_two_equal_halves_are_found_and_named():
    """A constellation and the same on the other side: the turn is the symmetry, the twins are mistaken."""
    half = directions(40, 1, 0.25)
    half = half[half[:, 2] > 0.1]
    turn = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_matrix()
    judged = judge(np.concatenate([half, half @ turn.T]), VIEW)
    assert_allclose(judged.symmetries, [turn], atol=1e-6)
    assert judged.separability == pytest.approx(0.0, abs=1e-9)
    here, there = judged.worst
    assert len(here) >= judged.in_view
    assert_allclose((here + len(half)) % (2 * len(half)), there)


def test_contradictions_are_those_counted_one_by_one():
    """The double's turn applied in plain NumPy: the weights of what is in view before and after."""
    d = directions(14, 3)
    axes, near, c = evenly_spread(50), alike(14), np.cos(VIEW)
    found = nearest_doubles(d, pairs_of(d, near, VIEW), axes, c, near)
    scale = 2.0 - 2.0 * np.cos(near)
    for axis, turn, told in zip(axes, found.turns, found.contradictions, strict=True):
        off = np.minimum(np.sum(((d @ turn.T)[:, None] - d) ** 2, axis=2) / scale, 1.0)
        here = off.min(axis=1)[d @ axis > c].sum()
        there = off.min(axis=0)[d @ (turn @ axis) > c].sum()
        assert_allclose(told, here + there, atol=1e-9)
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) > np.degrees(2 * near) - 1e-6


def test_a_turned_ball_is_worth_the_same():
    d = directions(16, 5)
    turned = d @ Rotation.random(random_state=1).as_matrix().T
    a, b = judge(d, VIEW), judge(turned, VIEW)
    assert a.in_view == b.in_view
    assert a.closest == b.closest
    assert_allclose(a.apart, b.apart)
    assert_allclose(np.median(a.contradictions), np.median(b.contradictions), rtol=0.05)  # other views are tried


def test_a_search_improves_keeps_its_promises_and_repeats():
    apart = 0.3
    steps = list(search(18, VIEW, apart, 3, 60))
    scores = [s.score for s in steps]
    assert scores == sorted(scores)
    assert scores[-1] > scores[0] + 0.2
    assert [s.done for s in steps] == list(range(1, 61))
    d = steps[-1].directions
    judged = judge(d, VIEW)
    assert judged.apart >= apart - 1e-12
    assert judged.in_view >= judge(steps[0].directions, VIEW).in_view >= 3
    assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    *_, again = search(18, VIEW, apart, 3, 60)
    assert np.array_equal(again.directions, d)


def test_too_many_discs_are_refused():
    with pytest.raises(ValueError, match="do not fit"):
        next(search(60, VIEW, 1.0, 0, 1))


def test_the_order_for_a_person_begins_at_the_pole_and_is_only_a_turn():
    d = directions(20, 6)
    ordered = in_order(d)
    assert_allclose(ordered[0], [0, 0, 1], atol=1e-12)
    assert_allclose(ordered[1, 1], 0.0, atol=1e-12)
    assert ordered[1, 0] > 0.0
    assert np.all(np.diff(ordered[:, 2]) <= 0.0)
    # a turn keeps the triple products, a mirror would not
    triples = [
        np.sort([np.linalg.det(v[[i, j, k]]) for i in range(20) for j in range(i) for k in range(j)])
        for v in (d, ordered)
    ]
    assert_allclose(np.sort(np.abs(triples[0])), np.sort(np.abs(triples[1])), atol=1e-9)
    rotation, rest = Rotation.align_vectors(ordered, d[_matching(d, ordered)])
    assert rest < 1e-6
    assert_allclose(rotation.as_matrix() @ rotation.as_matrix().T, np.eye(3), atol=1e-9)


def _matching(d, ordered):
    """Which of `d` became which of `ordered`, by their sorted angles to all others."""
    a, b = (np.sort(v @ v.T, axis=1) for v in (d, ordered))
    return np.argmin(np.abs(a[None] - b[:, None]).sum(axis=2), axis=1)


def test_misplacement_has_the_standard_deviation_it_says():
    rng = np.random.default_rng(0)
    d = directions(40, 7, 0.1)
    off = np.concatenate([np.arccos(np.sum(d * misplaced(d, 0.02, rng), axis=1)) for _ in range(200)])
    assert_allclose(np.sqrt(np.mean(off**2) / 2), 0.02, rtol=0.02)


def test_what_is_distinct_is_recognised_and_what_is_regular_is_not():
    rng = np.random.default_rng(1)
    good = recognised(directions(26, 8), VIEW, np.radians(0.1), 0.1, 60, rng)
    assert good.found > 0.9
    assert good.wrong == 0.0
    assert good.found + good.refused + good.wrong == pytest.approx(1.0)
    assert recognised(ICOSAHEDRON, VIEW, np.radians(0.1), 0.0, 20, rng).found == 0.0


def test_a_clear_layout_stays_clear_by_the_judgement_it_was_searched_for():
    *_, last = search(26, VIEW, 0.1, 1, 40)
    assert judge(last.directions, VIEW).separability > CLEAR
