"""Rotation to counts: nothing lost to rounding, the arc instead of the chord, signs as in the design."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from seats import LOOKS

from spheremouse.geometry.rotation import exp, rotation_between
from spheremouse.output import report_of
from spheremouse.output.counts import NO_REMAINDER, Counter, MotionSettings, OutputCounter, to_counts
from spheremouse.output.response import Response
from spheremouse.output.sample import Sample
from spheremouse.tracker import unknown

RADIUS = 0.6
steps = st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array), max_size=60)


def _turning(stamp, turn, rate=(0.0, 0.0, 0.0)):
    """Return a confirmed estimate with an increment of `turn`, (3,) rad, and a `rate`, (3,) rad/s."""
    increment, moving = np.array([*turn, 0.0, 0.0, 0.0]), np.array([*rate, 0.0, 0.0, 0.0])
    return unknown(stamp)._replace(increment=increment, rate=moving, confirmed=True)


@given(steps, st.floats(0.01, 2000.0), st.floats(1e-3, 1e3))
def test_the_sum_of_counts_is_the_integral_times_the_gain_within_one_count(rotations, per_radian, factor):
    counter = Counter(MotionSettings(counts_per_radian=per_radian).matrix(RADIUS))
    gain = OutputCounter(Response(gain=factor))
    plain, scaled = np.zeros(3), np.zeros(3)
    for k, rotation in enumerate(rotations):
        made = report_of((Sample(_turning(float(k), rotation)),), counter)
        assert all(isinstance(c, int) for c in made.counts)
        assert np.max(np.abs(made.fraction)) < 1.0
        assert all(abs(r) <= 0.5 for r, c in zip(made.fraction, made.counts, strict=True) if c)
        plain += made.counts
        scaled += gain.apply(made).counts
    integral = counter.matrix @ np.sum(rotations, axis=0) if rotations else np.zeros(3)
    assert np.max(np.abs(plain - integral)) <= 1.0 + 1e-6  # rounding of the sums
    assert np.max(np.abs(scaled - factor * integral)) <= 1.0 + 1e-6 * max(1.0, factor)


def test_a_ball_at_rest_on_the_boundary_between_two_counts_is_silent():
    """Half a count of play: what trembles by less, anywhere, sends nothing; what comes to rest there has arrived."""
    rng = np.random.default_rng(3)
    matrix = MotionSettings(counts_per_radian=1.0).matrix(RADIUS)
    for place in (0.5, -0.5, 1.5, 2.49, 7.0):
        counts, remainder = to_counts(np.full(3, place), matrix, NO_REMAINDER)
        assert_array_equal(np.abs(np.array(counts) - place * np.sum(matrix, axis=1)) <= 1.0, True)
        before = np.zeros(3)
        sent = []
        for tremble in rng.uniform(-0.24, 0.24, size=(500, 3)):
            counts, remainder = to_counts(tremble - before, matrix, remainder)
            sent.append(counts)
            before = tremble
        assert np.abs(sent).sum() <= 3  # at most the one that was due already, on each axis


# ---- motion that was withheld ----

DT = 1.0 / 30.0  # s
HAND = 2.0  # rad/s, a hand in ordinary play


def filmed(rates, confirmed, stamps):
    """The motions of a ball of `rates`, (n, 3) rad/s; frames that are not `confirmed` are made up for by the next."""
    motions, left, before = [], np.zeros(3), stamps[0]
    for rate, sure, stamp in zip(rates, confirmed, stamps, strict=True):
        left, before = left + (stamp - before) * np.asarray(rate), stamp
        if sure:
            motions.append(_turning(stamp, left, rate))
            left = np.zeros(3)
        else:
            motions.append(unknown(stamp))
    return motions


def counted(motions, settings):
    counter = Counter(settings.matrix(RADIUS))
    return np.array([counter.counts(m)[0] for m in motions])


def reported(motions):
    """Rotation vectors, (n, 3) rad, that reports stand for, to 1e-4 rad."""
    settings = MotionSettings(counts_per_radian=1e4)
    return counted(motions, settings) @ np.linalg.inv(settings.matrix(RADIUS)).T


frames = st.lists(
    st.tuples(st.booleans(), st.sampled_from((1, 1, 1, 2, 3, 6)), st.tuples(*[st.floats(-4.0, 4.0)] * 3)),
    min_size=1,
    max_size=40,
)


@given(frames)
def test_what_was_withheld_comes_at_a_hands_pace_and_none_of_it_is_lost(drawn):
    """With frames that are not confirmed and frames that are missing, in any order; then the ball rests."""
    stamps = DT * np.cumsum([steps for _, steps, _ in drawn])
    rates = [np.array(rate) for *_, rate in drawn]
    rest = int(np.ceil(np.sum([np.linalg.norm(r) for r in rates]) * 6 / HAND)) + 3
    motions = filmed(
        [*rates, *[np.zeros(3)] * rest],
        [*(sure for sure, *_ in drawn), *[True] * rest],
        [*stamps, *(stamps[-1] + DT * np.arange(1, rest + 1))],
    )
    sent = reported(motions)
    assert_allclose(sent.sum(axis=0), np.sum([m.increment[:3] for m in motions], axis=0), atol=2e-4)
    fastest = max(np.linalg.norm(r) for r in rates)
    interval = DT * max(steps for _, steps, _ in drawn)
    assert np.linalg.norm(sent, axis=1).max() <= (fastest + HAND) * interval + 5e-4


@given(st.lists(st.tuples(*[st.floats(-20.0, 20.0)] * 3), min_size=2, max_size=40), st.sampled_from((DT, DT / 2, 0.2)))
def test_ordinary_motion_passes_at_once_however_fast_it_is(rates, interval):
    motions = filmed(rates, [True] * len(rates), interval * np.arange(1, len(rates) + 1))
    assert_allclose(reported(motions), [m.increment[:3] for m in motions], atol=1.1e-4 * np.sqrt(3))


def test_a_dropped_frame_delays_nothing():
    stamps = DT * np.delete(np.arange(1, 40), [5, 11, 12 + 8])
    motions = filmed([(6.0, 1.0, 0.0)] * len(stamps), [True] * len(stamps), stamps)
    assert_allclose(reported(motions), [m.increment[:3] for m in motions], atol=1.1e-4 * np.sqrt(3))


@pytest.mark.parametrize("missing", [True, False])
def test_a_fifth_of_a_second_is_made_up_for_within_as_long_and_no_report_is_a_jump(missing):
    """A ball of 2 rad/s of which six frames show nothing, or never come."""
    rate, gap = np.array([2.0, 0.0, 0.0]), slice(10, 16)
    stamps, confirmed = DT * np.arange(1, 41), np.ones(40, dtype=bool)
    confirmed[gap] = False
    if missing:
        stamps, confirmed = stamps[confirmed], confirmed[confirmed]
    sent = reported(filmed([rate] * len(stamps), confirmed, stamps))
    back = 10 if missing else 16
    assert sent.max() < 2.01 * 2.0 * DT
    assert_allclose(sent[: back + 6].sum(axis=0), rate * (stamps[back + 5] - stamps[0]), atol=1e-3)
    assert_allclose(sent[back + 6 :, 0], 2.0 * DT, atol=2e-4)


def test_a_clock_that_starts_again_or_stands_still_loses_nothing():
    stamps = [100.0, 100.0 + DT, 100.0 + 2 * DT, 3.0, 3.0 + DT, 3.0 + DT, 3.0 + 2 * DT, *(4.0 + DT * np.arange(99))]
    turn = np.array([0.05, 0.0, 0.0])
    motions = [_turning(t, turn) for t in stamps]
    motions[1] = motions[4] = unknown(0.0)._replace(stamp=stamps[1])
    sent = reported(motions)
    assert np.all(np.isfinite(sent))
    assert_allclose(sent.sum(axis=0), turn * (len(stamps) - 2), atol=2e-4)


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
    assert_allclose(matrix @ UP, [0.0, 0.0, 1000.0 * RADIUS])  # counter-clockwise from above, for each player


@pytest.mark.parametrize("hz", [5, 10, 30, 240])
def test_the_arc_is_counted_not_its_chord(hz):
    """Two turns at 150 deg/s: the counts are the arc at any frame rate; the chord loses 5 % at 5 Hz."""
    turn = np.array([0.0, 0.0, 4 * np.pi])
    n = round(4 * np.pi / np.radians(150.0) * hz)
    attitudes = exp(np.linspace(0.0, 1.0, n + 1)[:, None] * turn)
    turns = [_turning(k / hz, rotation_between(a, b)) for k, (a, b) in enumerate(pairwise(attitudes))]
    assert_allclose(counted(turns, MotionSettings()).sum(axis=0), [4 * np.pi * 600.0, 0.0, 0.0], atol=0.5 + 1e-9)


def test_scales_and_inversions_are_of_their_own_axis():
    rho = np.array([1.0, 1.0, 1.0])
    signs = MotionSettings().directions() @ rho
    assert_allclose(MotionSettings(counts_per_mm=0.5).matrix(0.25) @ rho, 125.0 * signs)
    assert_allclose(MotionSettings(counts_per_radian=700.0).matrix(0.25) @ rho, 700.0 * signs)  # whatever the radius
    assert_allclose(MotionSettings(counts_per_radian=700.0).matrix(None) @ rho, 700.0 * signs)
    assert_allclose(MotionSettings(counts_per_mm=0.5).matrix(None) @ rho, 300.0 * signs)  # no metres: a ball of 0.6 m
    scaled = MotionSettings(counts_per_radian=1.0, scale_x=2.0, scale_y=3.0, scale_z=5.0).matrix(1.0)
    assert_allclose(scaled @ rho, [2.0, 3.0, 5.0] * signs)
    for axis, name in enumerate(("invert_x", "invert_y", "invert_z")):
        inverted = MotionSettings(counts_per_radian=1.0, **{name: True}).matrix(1.0)
        assert_allclose(inverted @ rho, signs * np.where(np.arange(3) == axis, -1.0, 1.0))
