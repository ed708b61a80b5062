"""What errors are measured by, against independent truth."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from experiments import mistakes, pointer, surface
from experiments.kit import tour
from experiments.mistakes import mouse, pointer_errors, wrong
from experiments.pointer import Path, latency
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.geometry.rotation import log
from spheremouse.output.counts import NO_REMAINDER, MotionSettings, to_counts
from spheremouse.simulate.ball.profile import play
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Status

RIG = default_scene().rig()


@pytest.fixture(scope="module")
def film():
    return tour.filmed({}, 1, 1.2)


# ---- wrong rigs ----


def test_each_mistake_is_of_the_size_that_it_says_and_alone():
    assert wrong(RIG, "focal", 0.05, 1).camera.fx == pytest.approx(1.05 * RIG.camera.fx)
    assert wrong(RIG, "radius", -0.01, 1).ball.radius == pytest.approx(0.59)
    shift = wrong(RIG, "centre", 0.02, 1).targets.position - RIG.targets.position
    assert_allclose(shift, np.tile(shift[0], (4, 1)))
    assert np.linalg.norm(shift[0]) == pytest.approx(0.02)
    off = np.concatenate([(wrong(RIG, "targets", 0.01, k).targets.position - RIG.targets.position) for k in range(200)])
    assert np.std(off) == pytest.approx(0.01, rel=0.05)
    for name in ("radius", "centre", "targets"):
        assert wrong(RIG, name, 0.01, 1).camera is RIG.camera
    assert_array_equal(wrong(RIG, "focal", 0.05, 1).targets.position, RIG.targets.position)


# ---- the mouse ----


def test_scale_direction_spin_and_wobble_are_told_apart():
    rng = np.random.default_rng(0)
    made = rng.standard_normal((400, 3))
    angle = np.radians(3.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A = 1.1 * np.column_stack([turn, [0.02, 0.0]])
    found = pointer_errors(made @ A.T, made)
    assert found["scale"] == pytest.approx(10.0)
    assert found["direction"] == pytest.approx(3.0)
    assert found["spin"] == pytest.approx(2.2)
    assert found["wobble"] == pytest.approx(0.0, abs=1e-9)
    noisy = pointer_errors(made[:, :2] + 0.05 * rng.standard_normal((400, 2)), made)
    assert noisy["wobble"] == pytest.approx(5.0, rel=0.1)
    assert abs(noisy["scale"]) < 1.0


def test_a_ball_that_turns_about_one_axis_tells_no_direction():
    made = np.outer(np.linspace(-1.0, 1.0, 50), [1.0, 0.0, 0.0])
    assert pointer_errors(made[:, :2], made) is None
    assert pointer_errors(np.zeros((50, 2)), np.zeros((50, 3))) is None


def test_a_scale_is_that_of_the_radius_by_which_it_was_sent(film):
    seen = mistakes.detections.look_at(film, mistakes.kit.settings_of(["tracker=ekf2"]))
    run = mistakes.detections.filtered(seen, mistakes.kit.settings_of(["tracker=ekf2"]), film)
    right, large = (mouse(run, film.truth.motion, radius, 0.6) for radius in (0.6, 0.66))
    assert 1.0 + large["scale"] / 100.0 == pytest.approx(1.1 * (1.0 + right["scale"] / 100.0), rel=1e-9)
    assert large["direction"] == pytest.approx(right["direction"], abs=1e-6)
    few = replace(run, status=(*run.status[:5], *[Status.LOST for _ in run.status[5:]]))
    assert mouse(few, film.truth.motion, 0.6, 0.6) is None


MATRIX = MotionSettings().matrix(0.6)


@pytest.fixture(scope="module")
def motion():
    return play(9.0, np.random.default_rng(3))


def exact(motion, stamps):
    R, remainder, counts = motion.attitude(stamps), NO_REMAINDER, [(0, 0, 0)]
    for a, b in pairwise(R):
        moved, remainder = to_counts(log(b @ a.T), MATRIX, remainder)
        counts.append(moved)
    return pointer.Told(stamps, np.array(counts), motion.rate(stamps) @ MATRIX.T, np.ones(len(stamps), dtype=bool))


@pytest.fixture(scope="module")
def told(motion):
    return exact(motion, np.arange(1.0, 270.0) / 30.0)


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


def test_without_resampling_counts_come_as_frames_arrive(told, true):
    shown = pointer.pointer(told, 30.0, None, true.t)
    k = 100
    arrival = told.stamp[k] + latency(30.0)
    after = int(np.searchsorted(true.t, arrival + 1e-6))
    assert np.array_equal(shown[after], told.counts[: k + 1].sum(axis=0))
    assert np.array_equal(shown[after - 1], told.counts[:k].sum(axis=0))


def test_without_resampling_the_pointer_is_late_by_latency_and_half_a_frame(told, true):
    shown = pointer.pointer(told, 30.0, None, true.t)
    expected = 1e3 * (latency(30.0) + 0.5 / 30.0)
    assert pointer.measured(shown, true, 1.2)["delay"] == pytest.approx(expected, abs=2.0)


def test_distance_and_roughness_are_what_they_say():
    t = 0.004 * np.arange(200.0)
    true = Path(t, np.zeros((200, 3)))
    shown = np.zeros((200, 3))
    shown[:, 0] = np.where(np.arange(200) % 2, 1.0, -1.0)
    found = pointer.measured(shown, true, 0.1)
    assert found["off"] == pytest.approx(1.0)
    assert found["rough"] == pytest.approx(4.0 / np.sqrt(3.0))


@pytest.fixture(scope="module")
def results():
    work = {"points": surface.points_of_table_13(), "area": surface.areas(1500)}
    return json.loads(json.dumps(work))


@pytest.mark.parametrize(("distance", "area"), [(2.35, 1.685), (1.35, 1.257), (1e9, 2.262), (0.6, 0.0)])
def test_the_visible_cap(distance, area):
    assert surface.visible_cap(distance, 0.6) == pytest.approx(area, abs=1e-3)


def test_counting_agrees_with_the_formula(results):
    area = results["area"]
    formula = [surface.visible_cap(d, 0.6) for d in area["distance"]]
    assert area["alone"] == pytest.approx(formula, abs=0.01)
    for view in area["views"].values():
        assert view["alone"] == pytest.approx(surface.visible_cap(view["distance"], 0.6), abs=0.01)
        shares = [view[k] for k in ("alone", "behind frame", "one hand", "two hands")]
        assert shares == sorted(shares, reverse=True)
        assert shares[-1] > 0.2


def test_fed_with_the_thesis_covariances_table_13_comes_out(results):
    five = results["points"]["as the thesis"]
    ours = np.array([p["correlation"] for p in five]).ravel()
    theirs = np.array([c for _, c, _ in surface.TABLE_13]).ravel()
    strong = np.abs(theirs) > 0.6
    assert np.array_equal(np.sign(ours[strong]), np.sign(theirs[strong]))
    sigma = np.array([p["sigma"] for p in five]) / np.array([s for _, _, s in surface.TABLE_13])
    assert 0.7 < np.sqrt(np.mean(sigma**2)) < 1.3
