"""Wrong calibrations: rigs, what becomes of the mouse."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import mistakes
from experiments.kit import tour
from experiments.mistakes import FREE, TOLD, wrong
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.geometry.camera import project
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Status

RIG = default_scene().rig()


@pytest.fixture(scope="module")
def film():
    return tour.filmed({}, 1, 1.2)


def row(error, lost=0, **more):
    mouse = {"scale": -5.0 * error, "direction": error, "spin": 0.1, "wobble": error, **more}
    return {"attitude": error, "rate": 10.0 * error, "lost": lost, "tracked": 95, "frames": 100, **mouse}


def cell(error, lost=0):
    return {"rows": {name: row(error, lost if name == "so3" else 0) for name in ("ekf1", "ekf2", "so3", FREE, TOLD)}}


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(title)[2].partition("|")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


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
        assert wrong(RIG, name, 0.01, 1).camera is not RIG.camera
        assert wrong(RIG, name, 0.01, 1).camera.intrinsic == RIG.camera.intrinsic
    assert_array_equal(wrong(RIG, "focal", 0.05, 1).targets.position, RIG.targets.position)


def test_an_evening_has_all_mistakes_in_proportion():
    rigs = [wrong(RIG, "evening", 2.0, k) for k in range(400)]
    sigma = mistakes.EVENING
    assert np.std([r.camera.fx / RIG.camera.fx - 1.0 for r in rigs]) == pytest.approx(2.0 * sigma["focal"], rel=0.15)
    assert np.std([r.ball.radius for r in rigs]) == pytest.approx(2.0 * sigma["radius"], rel=0.15)
    assert np.std([r.camera.cx for r in rigs]) == pytest.approx(2.0 * sigma["principal"], rel=0.15)
    both = np.hypot(sigma["centre"], sigma["targets"])
    assert np.std([r.targets.position[2, 1] for r in rigs]) == pytest.approx(2.0 * both, rel=0.15)
    said = mistakes.told(RIG, 2.0)
    assert np.sqrt(said.targets.covariance[4, 4]) == pytest.approx(2.0 * both)
    assert np.sqrt(said.ball.covariance[3, 3]) == pytest.approx(2.0 * sigma["radius"])


def test_the_lens_at_the_edge_of_the_ball_is_where_it_bends_the_outline(film):
    pose, camera = film.truth.pose, film.rig.camera
    far, radius = np.linalg.norm(pose.position), film.rig.ball.radius
    limb = np.array([0.0, np.cos(np.arcsin(radius / far)) * radius, radius * radius / far])  # the camera is on Z
    bent = replace(camera, distortion=np.array([-0.1, 0.0, 0.0, 0.0, 0.0]))
    there = pose.to_cam(limb[None])
    moved = np.linalg.norm(project(there, camera)[0] - project(there, bent)[0])
    assert mistakes.at_edge(film, 0.1) == pytest.approx(moved, rel=1e-6)


# ---- the mouse ----


def test_scale_direction_spin_and_wobble_are_told_apart():
    rng = np.random.default_rng(0)
    made = rng.standard_normal((400, 3))
    angle = np.radians(3.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A = 1.1 * np.column_stack([turn, [0.02, 0.0]])
    found = mistakes.pointer_errors(made @ A.T, made)
    assert found["scale"] == pytest.approx(10.0)
    assert found["direction"] == pytest.approx(3.0)
    assert found["spin"] == pytest.approx(2.2)
    assert found["wobble"] == pytest.approx(0.0, abs=1e-9)
    noisy = mistakes.pointer_errors(made[:, :2] + 0.05 * rng.standard_normal((400, 2)), made)
    assert noisy["wobble"] == pytest.approx(5.0, rel=0.1)
    assert abs(noisy["scale"]) < 1.0


def test_axes_of_different_speed_lead_astray():
    made = np.random.default_rng(0).standard_normal((100, 3))
    found = mistakes.pointer_errors(made[:, :2] * (1.1, 1.0 / 1.1), made)
    assert found["scale"] == pytest.approx(0.0, abs=1e-9)
    k = 1.1**2
    assert found["direction"] == pytest.approx(np.degrees(np.arcsin((k - 1.0) / (k + 1.0))), rel=1e-3)


def test_a_ball_that_turns_about_one_axis_tells_no_direction():
    made = np.outer(np.linspace(-1.0, 1.0, 50), [1.0, 0.0, 0.0])
    assert mistakes.pointer_errors(made[:, :2], made) is None
    assert mistakes.pointer_errors(np.zeros((50, 2)), np.zeros((50, 3))) is None


def test_a_scale_is_that_of_the_radius_by_which_it_was_sent(film):
    seen = mistakes.detections.look_at(film, mistakes.kit.settings_of(["tracker=ekf2"]))
    run = mistakes.detections.filtered(seen, mistakes.kit.settings_of(["tracker=ekf2"]), film)
    right, large = (mistakes.mouse(run, film.truth.motion, radius, 0.6) for radius in (0.6, 0.66))
    assert 1.0 + large["scale"] / 100.0 == pytest.approx(1.1 * (1.0 + right["scale"] / 100.0), rel=1e-9)
    assert large["direction"] == pytest.approx(right["direction"], abs=1e-6)
    few = replace(run, status=(*run.status[:5], *[Status.LOST for _ in run.status[5:]]))
    assert mistakes.mouse(few, film.truth.motion, 0.6, 0.6) is None


def test_errors_grow_with_the_mistake(film):
    rigs = [film.rig, wrong(film.rig, "radius", 0.005, 1), wrong(film.rig, "radius", 0.01, 1)]
    rows = [mistakes.followed(film, rig)["rows"] for rig in rigs]
    assert set(rows[0]) == {"ekf1", "ekf2", "so3", FREE}
    right, small, large = (r["ekf2"]["attitude"] for r in rows)
    assert 2.0 * right < small < large
    assert rows[0]["so3"]["direction"] < 1.0


def test_a_film_gives_what_json_holds_and_a_missing_pose_is_said():
    found = json.loads(json.dumps(mistakes.with_mistakes(1, 0.6, {"focal": ([0.02], 1), "targets": ([0.2], 1)})))
    assert found["mistakes"]["focal"]["0.02"][0]["rows"]["so3"]["frames"] == 18
    assert "error" in found["mistakes"]["targets"]["0.2"][0]
    assert found["edge"] == 0.0
    assert found["bound"]["attitude"] > 0.0
