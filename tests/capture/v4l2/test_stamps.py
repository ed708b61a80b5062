"""Stamps: the formulas against rows exposed one by one, and drivers that give none, wrong ones, or another clock's."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.capture.v4l2.stamps import Arrival, Count, Moment, Stamps, Timing, correct_stamp, unwrap_count

FPS = 30.0
REAL = 1.7e9  # s, realtime less monotonic
TRANSFER = 0.004  # s, from the last row read to its arrival


def arrival(clock, waited=True, real=REAL):
    return Arrival(clock, clock + real, waited)


def run(frames, timing):
    """Stamps and words for (raw, Arrival) one after another."""
    state, stamps, words = Stamps(), [], []
    for raw, came in frames:
        state, stamp, said = correct_stamp(state, raw, came, timing)
        stamps.append(stamp)
        words += [said] if said else []
    return np.array(stamps), words


def shutter(exposure, readout, n=40, start=100.0):
    """What a rolling shutter does, row by row: when exposure begins, the first row is read, the last row is read, and
    the mean over the exposure of the middle row; (n,) s each.
    """
    begin = start + np.arange(n) / FPS
    rows = np.arange(481) / 480.0 * readout  # of 480 rows, the middle one is row 240
    middle = begin + rows[240] + np.linspace(0.0, exposure, 1001).mean()
    return begin, begin + exposure, begin + rows[-1] + exposure, middle


@pytest.mark.parametrize(
    ("exposure", "readout", "shift"),
    [(0.01, 0.0, 0.0), (0.002, 0.025, 0.0), (0.02, 0.012, 0.0), (0.01, 0.01, -0.02), (0.01, 0.01, 0.02)],
)
def test_whatever_moment_the_driver_stamps_mid_exposure_of_the_middle_row_comes_out(exposure, readout, shift):
    """And a measured shift moves every stamp by itself, if the frames arrive later than that."""
    begin, first, end, middle = shutter(exposure, readout)
    for moment, raw in ((Moment.EXPOSURE_BEGINS, begin), (Moment.FIRST_PACKET, first), (Moment.END_OF_FRAME, end)):
        timing = Timing(moment, 1 / FPS, exposure, readout, shift)
        stamps, words = run([(r, arrival(e + TRANSFER + abs(shift))) for r, e in zip(raw, end, strict=True)], timing)
        np.testing.assert_allclose(stamps, middle + shift, rtol=0, atol=1e-9)
        assert words == []


@pytest.mark.parametrize("moment", Moment)
@pytest.mark.parametrize("exposure", [0.0005, 0.016, 1 / FPS])
def test_an_unknown_exposure_costs_a_quarter_of_the_interval_at_most_and_always_the_same(moment, exposure):
    begin, first, end, middle = shutter(exposure, 0.01)
    raw = dict(zip(Moment, (begin, first, end), strict=True))[moment]
    timing = Timing(moment, 1 / FPS, None, 0.01)
    stamps, words = run([(r, arrival(e + TRANSFER)) for r, e in zip(raw, end, strict=True)], timing)
    error = stamps - middle
    assert np.ptp(error) < 1e-9
    assert abs(error[0]) <= timing.max_error + 1e-9
    assert timing.max_error == pytest.approx(0.25 / FPS)
    assert words == []


def test_stamps_ahead_of_the_clock_are_taken_back_together():
    """As vivid does: the nominal schedule, which the frames themselves keep badly."""
    rng = np.random.default_rng(2)
    nominal = 50.0 + np.arange(600) / FPS
    came = nominal - 0.028 * rng.random(600)
    stamps, words = run(
        [(r, arrival(c)) for r, c in zip(nominal, came, strict=True)], Timing(Moment.END_OF_FRAME, 1 / FPS, 0.0)
    )
    assert np.all(stamps <= came)
    settled = stamps[60:]
    np.testing.assert_allclose(np.diff(settled), 1 / FPS, rtol=0, atol=2e-3)  # regular, though arrivals are not
    assert np.diff(came).std() > 8e-3
    assert np.all(came[60:] - settled < 0.029)
    assert len(words) == 1
    assert "ahead of the clock" in words[0]


def test_one_wild_stamp_ahead_is_forgotten():
    frames = [(10 + k / FPS, arrival(10 + k / FPS + TRANSFER)) for k in range(600)]
    frames[100] = (frames[100][0] + 0.2, frames[100][1])
    stamps, words = run(frames, Timing(Moment.END_OF_FRAME, 1 / FPS, 0.01))
    raw = np.array([r for r, _ in frames])
    np.testing.assert_allclose(stamps[:100], raw[:100] - 0.005, rtol=0, atol=1e-9)
    np.testing.assert_allclose(stamps[450:], raw[450:] - 0.005, rtol=0, atol=1e-9)  # 10 s at most
    assert "ahead" in words[0]


@pytest.mark.parametrize(
    ("raw", "said"),
    [(0.0, "no stamps"), (-1.0, "no stamps"), (math.nan, "no stamps"), (7.5, "not known"), (4e9, "not known")],
)
def test_without_usable_stamps_the_arrival_less_the_min_delay_is_taken(raw, said):
    came = 5000.0 + np.arange(100) / FPS
    stamps, words = run([(raw, arrival(c)) for c in came], Timing(Moment.END_OF_FRAME, 1 / FPS, 0.01, 0.02))
    np.testing.assert_allclose(stamps, came - 0.015, rtol=0, atol=1e-9)
    assert len(words) == 1
    assert said in words[0]
    assert "15.0 ms" in words[0]


def test_where_stamps_stop_the_delay_learnt_before_goes_on():
    timing = Timing(Moment.END_OF_FRAME, 1 / FPS, 0.01)
    _, _, end, middle = shutter(0.01, 0.0, n=200)
    frames = [(e if k < 150 else 0.0, arrival(e + 0.012)) for k, e in enumerate(end)]
    stamps, words = run(frames, timing)
    np.testing.assert_allclose(stamps, middle, rtol=0, atol=1e-6)
    assert len(words) == 1
    assert "less 17.0 ms" in words[0]  # 12 ms of transfer and half the exposure
    assert "leaves out" not in words[0]


def test_stamps_of_the_realtime_clock_are_carried_over_and_follow_when_that_is_set():
    timing = Timing(Moment.END_OF_FRAME, 1 / FPS, 0.0)
    frames = []
    for k in range(200):
        real = REAL + (3600.0 if k >= 100 else 0.0)
        t = 20 + k / FPS
        frames.append((t + real, arrival(t + TRANSFER, real=real)))
    stamps, words = run(frames, timing)
    np.testing.assert_allclose(stamps, 20 + np.arange(200) / FPS, rtol=0, atol=1e-6)  # floats of 1e9 s
    assert len(words) == 1
    assert "realtime clock" in words[0]


def test_the_same_stamp_twice_and_a_stamp_that_jumps_back():
    timing = Timing(Moment.END_OF_FRAME, 1 / FPS, 0.0)
    t = 20 + np.arange(60) / FPS
    raw = t.copy()
    raw[30], raw[40], raw[50] = raw[29], raw[40] - 0.5, raw[48]
    stamps, words = run([(r, arrival(c + TRANSFER)) for r, c in zip(raw, t, strict=True)], timing)
    np.testing.assert_allclose(stamps, t, rtol=0, atol=1e-4)
    assert [w.partition(";")[0] for w in words] == [
        "the driver gave two frames the same stamp",
        "a stamp of the driver jumped back",
    ]


def test_frames_that_lay_in_the_queue_keep_their_stamps_and_teach_no_delay():
    timing = Timing(Moment.END_OF_FRAME, 1 / FPS, 0.0)
    t = 20 + np.arange(60) / FPS
    frames = [(x, arrival(x + TRANSFER)) for x in t[:30]]
    frames += [(x, arrival(t[30] + 3.0 + 1e-4 * k, waited=False)) for k, x in enumerate(t[30:36])]
    frames += [(0.0, arrival(t[30] + 3.1))]
    stamps, _ = run(frames, timing)
    np.testing.assert_allclose(stamps[:36], t[:36], rtol=0, atol=1e-9)
    assert stamps[36] == pytest.approx(t[30] + 3.1 - TRANSFER, abs=1e-9)


def test_a_frame_waited_for_that_says_it_is_a_second_old_is_not_believed():
    timing = Timing(Moment.END_OF_FRAME, 1 / FPS, 0.0)
    t = 20 + np.arange(90) / FPS
    raw = np.where(np.arange(90) < 30, t, t - 5.0)  # the driver's clock was set back
    stamps, words = run([(r, arrival(c + TRANSFER)) for r, c in zip(raw, t, strict=True)], timing)
    np.testing.assert_allclose(stamps, t, rtol=0, atol=1e-4)
    assert len(words) == 1


def test_a_frame_cannot_have_come_before_its_last_row_was_read():
    """A driver that claims the start of exposure, and stamps when all is there."""
    came = 20 + np.arange(60) / FPS
    timing = Timing(Moment.EXPOSURE_BEGINS, 1 / FPS, 0.01, 0.02)
    stamps, words = run([(c, arrival(c)) for c in came], timing)
    np.testing.assert_allclose(stamps, came - 0.015, rtol=0, atol=1e-9)
    assert len(words) == 1


raws = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-0.5, 0.5).map(lambda x: 10.0 + x))


@given(
    st.lists(st.tuples(raws, st.floats(1e-6, 0.2), st.booleans()), min_size=1, max_size=60),
    st.sampled_from(Moment),
    st.one_of(st.none(), st.floats(1e-4, 0.5)),
    st.floats(0.0, 0.05),
    st.floats(-1.0, 1.0),
)
def test_whatever_a_driver_says_stamps_increase_and_are_never_ahead_of_the_clock(
    frames, moment, exposure, readout, shift
):
    clock, given_frames = 10.0, []
    for raw, step, waited in frames:
        clock += step
        given_frames.append((raw, arrival(clock, waited)))
    stamps, words = run(given_frames, Timing(moment, 1 / FPS, exposure, readout, shift))
    assert np.all(np.isfinite(stamps))
    assert np.all(np.diff(stamps) > 0)
    assert np.all(stamps <= [a.clock for _, a in given_frames])
    assert len(words) == len({w[:24] for w in words})


def numbers(raw):
    state, out = Count(), []
    for r in raw:
        state, n = unwrap_count(state, r)
        out.append(n)
    return out


def test_numbers_have_the_driver_s_gaps_but_go_on_by_one_if_it_stands_still_or_begins_anew():
    assert numbers([7, 8, 9, 12, 13]) == [0, 1, 2, 5, 6]
    assert numbers([2**32 - 2, 2**32 - 1, 1, 2]) == [0, 1, 3, 4]
    assert numbers([0, 0, 0]) == [0, 1, 2]
    assert numbers([500, 501, 0, 1]) == [0, 1, 2, 3]


@given(st.lists(st.integers(0, 2**32 - 1), min_size=2))
def test_numbers_always_increase(raw):
    assert all(a < b for a, b in itertools.pairwise(numbers(raw)))
