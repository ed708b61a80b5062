"""Wrong calibrations: rigs, what becomes of the mouse."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from experiments import mistakes
from experiments.kit import tour
from experiments.mistakes import wrong
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Status

RIG = default_scene().rig()


@pytest.fixture(scope="module")
def film():
    return tour.filmed({}, 1, 1.2)


def pointer_errors(sent, made) -> Any:
    return mistakes.pointer_errors(sent, made)


def mouse(*arguments) -> Any:
    return mistakes.mouse(*arguments)


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
