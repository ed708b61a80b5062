"""Rotation to counts: nothing lost to rounding, the arc instead of the chord, signs as in the design."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from seats import LOOKS

from spheremouse.geometry.rotation import exp, rotation_between
from spheremouse.output.counts import MotionSettings, Remainder, to_counts

RADIUS = 0.6
steps = st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array), max_size=60)


def total_counts(rotations, matrix):
    remainder = Remainder()
    total = np.zeros(3)
    for rotation in rotations:
        counts, remainder = to_counts(rotation, matrix, remainder)
        assert all(isinstance(c, int) for c in counts)
        assert np.max(np.abs(remainder.value)) < 1.0
        assert all(abs(r) <= 0.5 for r, c in zip(remainder.value, counts, strict=True) if c)
        total += counts
    return total


@given(steps, st.floats(0.01, 2000.0))
def test_sum_of_counts_is_the_integral_within_one_count(rotations, per_radian):
    matrix = MotionSettings(counts_per_radian=per_radian).matrix(RADIUS)
    integral = matrix @ np.sum(rotations, axis=0) if rotations else np.zeros(3)
    assert np.max(np.abs(total_counts(rotations, matrix) - integral)) <= 1.0 + 1e-6  # 1e-6: rounding of the sums


def test_slow_motion_is_not_lost():
    """A thousandth of a count per frame, both ways."""
    matrix = MotionSettings(counts_per_radian=1.0).matrix(RADIUS)
    assert_allclose(total_counts([np.full(3, 1e-3)] * 10_000, matrix), 10.0 * np.sum(matrix, axis=1))
    assert_allclose(total_counts([np.full(3, -1e-3)] * 10_000, matrix), -10.0 * np.sum(matrix, axis=1))


def test_a_ball_at_rest_on_the_boundary_between_two_counts_is_silent():
    """Half a count of play: what trembles by less, anywhere, sends nothing; what comes to rest there has arrived."""
    rng = np.random.default_rng(3)
    matrix = MotionSettings(counts_per_radian=1.0).matrix(RADIUS)
    for place in (0.5, -0.5, 1.5, 2.49, 7.0):
        counts, remainder = to_counts(np.full(3, place), matrix, Remainder())
        assert_array_equal(np.abs(np.array(counts) - place * np.sum(matrix, axis=1)) <= 1.0, True)
        before = np.zeros(3)
        sent = []
        for tremble in rng.uniform(-0.24, 0.24, size=(500, 3)):
            counts, remainder = to_counts(tremble - before, matrix, remainder)
            sent.append(counts)
            before = tremble
        assert np.abs(sent).sum() <= 3  # at most the one that was due already, on each axis


# ---- directions ----

UP = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize("player", LOOKS)
@given(st.floats(-np.pi, np.pi), st.floats(1e-3, 0.5))
def test_the_pointer_goes_where_the_hand_goes_that_pushes_the_top_of_the_ball(player, way, angle):
    """By pushing it, with no sign of our own: the top goes the hand's way, and the pointer on the screen as well."""
    ahead = np.array(LOOKS[player], dtype=float)
    right = np.cross(ahead, UP)
    hand = np.cos(way) * right + np.sin(way) * ahead
    rotation = angle * np.cross(UP, hand)  # about the horizontal axis across the hand's way
    assert (exp(rotation) @ UP) @ hand == pytest.approx(np.sin(angle))
    matrix = MotionSettings(player=player).matrix(RADIUS)
    travel = 1000.0 * RADIUS * angle
    assert_allclose(matrix @ rotation, travel * np.array([np.cos(way), -np.sin(way), 0.0]), atol=1e-9 * travel)


def test_every_seat_has_the_handedness_of_a_trackball():
    """Right, down, and counter-clockwise from above are left-handed; no seat is a mirror image of another."""
    for player in LOOKS:
        assert np.linalg.det(MotionSettings(player=player).directions()) == pytest.approx(-1.0)
    assert_array_equal(MotionSettings().directions() @ UP, [0.0, 0.0, 1.0])


def test_counts_of_the_far_side_are_those_of_the_touching_point():
    """d = rho x C with C = (0, -c, 0); counts (d_x, d_z), per millimetre; the third axis is rho_y."""
    matrix = MotionSettings().matrix(RADIUS)
    for rho in np.random.default_rng(1).normal(size=(20, 3)):
        d = np.cross(rho, [0.0, -RADIUS, 0.0])
        assert_allclose(matrix @ rho, 1000.0 * np.array([d[0], d[2], RADIUS * rho[1]]), rtol=1e-12)


def test_nobody_stands_nowhere():
    with pytest.raises(KeyError):
        MotionSettings(player="above").matrix(RADIUS)


def test_rotation_between_is_in_obj_not_in_the_ball():
    before = exp(np.array([0.4, -1.0, 2.0]))
    rho = np.array([0.1, 0.2, -0.3])
    assert_allclose(rotation_between(before, exp(rho) @ before), rho, atol=1e-14)


@pytest.mark.parametrize("hz", [5, 10, 30, 240])
def test_the_arc_is_counted_not_its_chord(hz):
    """Two turns at 150 deg/s: the counts are the arc at any frame rate; the chord loses 5 % at 5 Hz."""
    turn = np.array([0.0, 0.0, 4 * np.pi])
    n = round(4 * np.pi / np.radians(150.0) * hz)
    attitudes = exp(np.linspace(0.0, 1.0, n + 1)[:, None] * turn)
    rotations = [rotation_between(a, b) for a, b in pairwise(attitudes)]
    total = total_counts(rotations, MotionSettings().matrix(RADIUS))
    assert_allclose(total, [4 * np.pi * 600.0, 0.0, 0.0], atol=0.5 + 1e-9)


def test_scales():
    rho = np.array([1.0, 1.0, 1.0])
    signs = MotionSettings().directions() @ rho
    assert_allclose(MotionSettings(counts_per_mm=0.5).matrix(0.25) @ rho, 125.0 * signs)
    assert_allclose(MotionSettings(counts_per_radian=700.0).matrix(0.25) @ rho, 700.0 * signs)  # whatever the radius
    assert_allclose(MotionSettings(counts_per_radian=700.0).matrix(None) @ rho, 700.0 * signs)
    assert_allclose(MotionSettings(counts_per_mm=0.5).matrix(None) @ rho, 300.0 * signs)  # no metres: a ball of 0.6 m
    scaled = MotionSettings(counts_per_radian=1.0, scale_x=2.0, scale_y=3.0, scale_z=5.0).matrix(1.0)
    assert_allclose(scaled @ rho, [2.0, 3.0, 5.0] * signs)


def test_each_inversion_reverses_its_own_axis():
    rho = np.array([1.0, 2.0, 3.0])
    plain = MotionSettings().matrix(1.0) @ rho
    assert_allclose(MotionSettings(invert_x=True).matrix(1.0) @ rho, plain * [-1, 1, 1])
    assert_allclose(MotionSettings(invert_y=True).matrix(1.0) @ rho, plain * [1, -1, 1])
    assert_allclose(MotionSettings(invert_z=True).matrix(1.0) @ rho, plain * [1, 1, -1])
