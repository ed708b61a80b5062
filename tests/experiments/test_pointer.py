"""The resampled pointer: what it is measured by against independent truth, and pages from given results."""

import numpy as np
import pytest
from experiments import pointer
from experiments.kit.job import Request
from experiments.pointer import (
    DEFAULT,
    EXACT,
    MORE,
    NEXT,
    NONE,
    STOPPED,
    WAYS,
    ZERO,
    Path,
    jobs,
    latency,
    settings,
)
from experiments.report.page import said
from experiments.report.plot import save
from experiments.report.pointer import page

from spheremouse.output.counts import MotionSettings
from spheremouse.output.pointer import PointerSettings
from spheremouse.simulate.ball.profile import Gestures, play, stroke

WHOLE = Request(False, None)
MATRIX = MotionSettings().matrix(0.6)


@pytest.fixture(scope="module")
def motion():
    return play(9.0, np.random.default_rng(3))


@pytest.fixture(scope="module")
def told(motion):
    """At 30 Hz, without a tracker's errors."""
    return pointer.exact(motion, np.arange(1.0, 270.0) / 30.0, MATRIX)


@pytest.fixture(scope="module")
def true(motion):
    return pointer.ball(motion, 8.9, MATRIX)


def shifted(true, seconds):
    return np.stack([np.interp(true.t - seconds, true.t, true.place[:, k]) for k in range(3)], axis=1)


def test_the_path_is_that_of_the_counts(motion, told, true):
    sums = np.cumsum(told.counts, axis=0)
    at = np.stack([np.interp(told.stamp, true.t, true.place[:, k]) for k in range(3)], axis=1)
    kept = told.stamp < true.t[-1]
    turned = np.array([[0.5, 0.5, 0.5]])  # half a count of rounding, and turns that do not commute
    assert np.all(np.abs(sums - at)[kept] < turned + 0.01 * np.abs(at).max())


@pytest.mark.parametrize("late", [0.0, 0.0137, 0.08])
def test_a_delay_is_found_to_a_millisecond(true, late):
    assert pointer.delay(shifted(true, late), true) == pytest.approx(1e3 * late, abs=1.0)


def test_no_motion_has_no_delay(true):
    still = Path(true.t, np.zeros_like(true.place))
    assert pointer.delay(still.place, still) is None


def test_without_resampling_counts_come_as_frames_arrive(told, true):
    shown = pointer.pointer(told, 30.0, None, true.t)
    k = 100
    arrival = told.stamp[k] + latency(30.0)
    after = int(np.searchsorted(true.t, arrival + 1e-6))
    assert np.array_equal(shown[after], told.counts[: k + 1].sum(axis=0))
    assert np.array_equal(shown[after - 1], told.counts[:k].sum(axis=0))


def test_a_horizon_of_zero_is_no_resampling(told, true):
    a, b = (pointer.pointer(told, 30.0, way, true.t) for way in (None, settings(ZERO, 30.0)))
    assert np.array_equal(a, b)


def test_without_resampling_the_pointer_is_late_by_latency_and_half_a_frame(told, true):
    shown = pointer.pointer(told, 30.0, None, true.t)
    expected = 1e3 * (latency(30.0) + 0.5 / 30.0)
    assert pointer.measured(shown, true, 1.2)["delay"] == pytest.approx(expected, abs=2.0)


def test_prediction_brings_the_pointer_nearer_and_smoother(told, true):
    bare, led = (
        pointer.measured(pointer.pointer(told, 30.0, way, true.t), true, 1.2) for way in (None, PointerSettings())
    )
    assert led["off"] < 0.4 * bare["off"]
    assert led["rough"] < 0.4 * bare["rough"]
    assert abs(led["delay"]) < 0.2 * bare["delay"]


def test_distance_and_roughness_are_what_they_say():
    t = 0.004 * np.arange(200.0)
    true = Path(t, np.zeros((200, 3)))
    shown = np.zeros((200, 3))
    shown[:, 0] = np.where(np.arange(200) % 2, 1.0, -1.0)
    found = pointer.measured(shown, true, 0.1)
    assert found["off"] == pytest.approx(1.0)
    assert found["rough"] == pytest.approx(4.0 / np.sqrt(3.0))


def test_the_exact_pointer_overshoots_a_stop_by_at_most_its_horizon():
    push = stroke(0.3, (-1.0, 0.0, 0.0), 7.0, up=0.12, hold=0.25, down=0.05)
    moving = Gestures((push,), 1.3)
    told = pointer.exact(moving, np.arange(1.0, 39.0) / 30.0, MATRIX)
    true = pointer.ball(moving, 1.3, MATRIX)
    beyond = {
        way: (pointer.pointer(told, 30.0, None if way == NONE else settings(way, 30.0), true.t) - true.place[-1]).max()
        for way in WAYS
    }
    assert beyond[NONE] < 1.0
    assert beyond[pointer.ONE] < beyond[DEFAULT] < 7.0 * 600.0 * PointerSettings().horizon


def test_so3_plays_nearly_as_well_as_exact_attitudes():
    found = pointer.played(30.0, 0, 5.0, False, True)
    assert found["tracked"] > 0.99
    assert found["apart"] == 0.0
    assert found[DEFAULT]["off"] < 1.5 * found[EXACT]["off"]
    assert found["true rough"] < found["whole rough"] < found[DEFAULT]["rough"] < found[NONE]["rough"]
    assert found["more"]["smooth 0"]["rough"] > found["more"]["default"]["rough"]


# ---- the page ----


def play_of(off):
    row = {"off": off, "rough": 0.9, "delay": 2.0}
    found = dict.fromkeys((*WAYS, EXACT), row)
    found |= {NONE: {"off": 10.0 * off, "rough": 9.0, "delay": 74.0}}
    return {**found, "true rough": 0.03, "whole rough": 0.66, "apart": 0.0, "tracked": 1.0}


def stop_of(beyond, bare=0.0):
    t = np.arange(0.0, 1.3, 0.004).tolist()
    found = {way: {f"{d:g}": [beyond, 3.0 * beyond] for d in STOPPED} | {"path": t} for way in WAYS}
    found[NONE] = {f"{d:g}": [0.0, bare] for d in STOPPED} | {"path": t}
    found[NEXT] = {f"{d:g}": [4.0 * beyond] for d in STOPPED} | {"path": t}
    return {**found, "t": t, "true": t, "end": 0.7}


GIVEN = {
    "play-15-0": play_of(20.0),
    "play-30-0": {**play_of(8.0), "more": dict.fromkeys(MORE, play_of(8.0)[DEFAULT])},
    "play-30-1": play_of(12.0),
    **{f"play-{fps}-0": play_of(3.0) for fps in (60, 120, 240)},
    "film-30-0": play_of(9.0),
    "stop-15": stop_of(100.0, bare=60.0),
    "stop-30": stop_of(200.0),
    **{f"stop-{fps}": stop_of(20.0) for fps in (60, 120, 240)},
}


def test_medians_films_and_stops_are_on_the_page(tmp_path):
    found = said("pointer", page, {**GIVEN, "play-240-1": {"error": "too little memory"}})
    assert found.doubts == 0
    for line in (
        f"| 30 | {NONE} | 74 | 100.0 | 9.00 |",
        f"|  | {DEFAULT} | 2 | 10.0 | 0.90 |",
        "|  | smooth 0 | 2 | 8.0 | 0.90 |",
        f"| {DEFAULT} | 9.0 | 8.0 | 0.90 | 0.90 |",  # filmed, and the same motion without pictures
        f"| 15 | {NONE} | 30 (60) | 30 (60) |",
        f"|  | {pointer.ONE} | 200 (300) | 200 (300) |",
    ):
        assert line + "\n" in found.text
    for words in (
        "takes the delay from 74 to 2 ms and the roughness to 1/10",
        "the default pointer goes 400 counts too far at 30 Hz. These are 40 cm of the ball",
        "by up to 60 counts at 15 Hz. There",
        "goes farther beyond a stop: 400 instead of 200 counts at 15 Hz",
        "- play-240-1: too little memory",
    ):
        assert words in found.text
    assert [drawing.name for drawing in found.drawings] == ["pointer", "pointer-stop"]
    assert all(save(drawing, tmp_path).stat().st_size > 5000 for drawing in found.drawings)


@pytest.mark.parametrize(
    ("key", "result", "claim"),
    [
        ("play-15-0", {**play_of(20.0), "apart": 1.0}, "A horizon of 0"),
        ("play-15-0", {**play_of(20.0), "tracked": 0.9}, "In every motion discs held"),
        ("play-60-0", play_of(6.0), "With the default the pointer stays"),
        ("stop-60", stop_of(20.0, bare=40.0), "Without resampling the pointer goes too far"),
        ("stop-240", stop_of(200.0), "To aim well, use a faster camera"),
        ("stop-15", stop_of(0.0, bare=60.0), "Its price"),
    ],
)
def test_what_a_run_contradicts_is_marked(key, result, claim):
    assert "**Not borne out by this run:** " + claim in said("pointer", page, {**GIVEN, key: result}).text


def test_what_is_not_known_is_a_dash_or_a_shorter_table():
    one = {**play_of(8.0), DEFAULT: {"off": 8.0, "rough": 0.9, "delay": None}}
    assert f"|  | {DEFAULT} | – | 8.0 | 0.90 |" in said("pointer", page, {"play-30-0": one}).text
    for key, result in GIVEN.items():
        assert said("pointer", page, {key: result}).text.startswith("## The pointer")


def test_jobs_have_keys_of_their_own():
    whole = jobs(WHOLE)
    assert len({job.key for job in whole}) == len(whole) > len(jobs(Request(True, None)))
