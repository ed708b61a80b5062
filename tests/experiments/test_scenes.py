"""Where discs, targets and camera are, and how the camera films."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import discs, places, poses, targets
from experiments.discs import LAYOUTS, directions_of, in_rows
from experiments.kit import film as kit
from experiments.kit import thesis
from experiments.kit import tour as tour_module
from experiments.kit.job import Request
from experiments.kit.tour import thinned, tour
from experiments.places import Place, Size, expected, scene_from, targets_in_view
from experiments.targets import KINDS, NUMBERS, key
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.ball.truth import VISIBLE
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import from_euler, log, to_euler
from spheremouse.simulate.ball import profile
from spheremouse.simulate.ball.render import Renderer
from spheremouse.simulate.ball.scene import default_scene


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


QUICK, WHOLE = Request(True, None), Request(False, None)
FRONT = Place(0, 0, 2.35, 640.0)
NOISE = [Size(11.0, 0.1, 0.5, 50), Size(90.0, 0.02, 1.0, 50)]


def with_noise(sigma):
    return [Size(1e-3, sigma, 1.0, 50), Size(1e4, sigma, 1.0, 50)]


def test_the_discs_in_view_are_those_that_the_renderer_shows_whole():
    scene = scene_from(Place(-30, 20, 2.2, 600.0), 3)
    renderer, times = Renderer(scene), np.linspace(0.0, 9.0, 6)
    seen = places.sights_at(scene, profile.thesis().attitude(times), with_noise(0.05))
    agree = total = 0
    for k, t in enumerate(times):
        truth = renderer.frame(profile.thesis(), float(t), k, np.random.default_rng(0)).discs
        shown, ours = set(truth.disc[truth.state == VISIBLE].tolist()), set(seen[k].disc.tolist())
        agree, total = agree + len(shown & ours), total + len(shown | ours)
    assert total > 60
    assert agree / total > 0.95  # a strut that covers a hundredth of a disc is seen by one of the two


def test_the_bound_is_proportional_to_the_noise_of_centres_where_motion_is_well_known():
    one, two = (expected(FRONT, (0,), 20, with_noise(s)) for s in (0.02, 0.04))
    assert 1.5 < two["attitude_deg"] / one["attitude_deg"] < 2.05
    assert one["targets"] == 4


def test_discs_that_are_seldom_found_tell_less_and_smaller_ones_nothing():
    sigma = places.centre_sigma(np.array([11.0, 90.0, 300.0, 5.0, np.nan]), NOISE)
    assert sigma[0] == pytest.approx(0.1 / np.sqrt(0.5))
    assert sigma[1:3] == pytest.approx([0.02, 0.02])
    assert np.all(np.isinf(sigma[3:]))


def test_targets_are_in_view_from_the_front_and_not_from_the_side_or_too_near():
    assert targets_in_view(scene_from(FRONT, 0)) == 4
    assert targets_in_view(scene_from(Place(75, 0, 2.35, 640.0), 0)) == 0
    assert targets_in_view(scene_from(Place(0, 0, 1.0, 640.0), 0)) == 0
    assert targets_in_view(scene_from(Place(0, 0, 2.35, 320.0), 0)) == 0  # the rings are too narrow


@pytest.fixture(scope="module")
def camera():
    """Four targets of the usual size and of one that is too small, from one camera."""
    return json.loads(json.dumps(targets.filmed(1, [4], [6, 36])))


def test_four_targets_are_the_thesis_own_and_none_lie_on_one_another():
    scene = default_scene(1)
    assert targets.places(4) == pytest.approx(scene.targets.position)
    for n in NUMBERS:
        where = targets.places(n)
        assert where.shape == (n, 3)
        apart = np.linalg.norm(where[:, None] - where[None], axis=2) + 10.0 * np.eye(n)
        assert apart.min() > 2.0 * 1.22 * 0.048 * np.sqrt(2.0)  # the largest sheets, corner to corner


def test_rings_and_tags_give_the_pose_and_what_is_too_small_none(camera):
    for kind in KINDS:
        usual = camera["sizes"][key(kind, 4, 36)]
        assert usual["found"] == 1.0
        assert np.linalg.norm(usual["position_mm"]) < 30.0
        assert np.all(np.array(usual["sigma_position_mm"]) > 0.1)
        small = camera["sizes"][key(kind, 4, 6)]
        assert small["found"] < 1.0
    rings, tags = (camera["sizes"][key(k, 4, 36)]["point_px"] for k in ("rings", "aruco"))
    assert rings < 0.05
    assert rings < tags < 1.0
    assert camera["sizes"][key("rings", 4, 6)]["error"]
    assert camera["px_per_mm"] == pytest.approx(2e-3 * 640.0 / 1.79, rel=0.06)


def sightings(rig, centre):
    return [Sighting(k, c, 0.05**2 * np.eye(2), 30) for k, c in zip(rig.targets.codes, centre, strict=True)]


@pytest.mark.parametrize("view", ["far", "near"])
def test_an_error_is_told_in_the_thesis_angles(view):
    scene = default_scene(1, view)
    rig, true = scene.rig(), scene.pose
    step = np.array([1e-3, -2e-3, 0.5e-3, *np.radians([0.03, -0.02, 0.04])])
    moved = Pose(from_euler(to_euler(true.rotation) + step[3:]), true.position + step[:3])
    found = poses.pose_result(sightings(rig, predict_targets(moved, rig)), rig, true)
    assert found["error"] == pytest.approx([1.0, -2.0, 0.5, 0.03, -0.02, 0.04], abs=2e-4)


def test_the_far_camera_has_the_correlations_of_table_21():
    scene = default_scene(1, "far")
    rig = scene.rig()
    found = poses.pose_result(sightings(rig, predict_targets(scene.pose, rig)), rig, scene.pose)
    for i, row in enumerate(thesis.THESIS_TABLES["21"]["correlation"], start=1):
        assert found["correlation"][i][:i] == pytest.approx(row, abs=0.12)


@pytest.fixture(scope="module")
def film():
    return tour_module.filmed({"fps": 60.0, "size": [320, 240]}, 1, 0.6)


def test_the_tour_leaves_no_axis_out_and_its_rate_is_that_of_its_attitude():
    for seed in (1, 2):
        path = tour(seed, 3.5)
        t = np.linspace(0.0, 3.5, 3501)
        R, w = path.attitude(t), path.rate(t)
        middle = 0.5 * (w[1:] + w[:-1])
        assert_allclose(log(R[1:] @ R[:-1].transpose(0, 2, 1)) / 1e-3, middle, atol=1e-3)
        assert np.all(w[t < 0.19] == 0.0)
        spread = np.linalg.svd(w, compute_uv=False)
        assert spread[2] > 0.2 * spread[0]


def test_a_thinned_film_is_the_film_at_the_slower_rate(film):
    fewer = thinned(film, 2)
    slow = tour_module.filmed({"size": [320, 240]}, 1, 0.6)
    assert [f.sequence for f in fewer.frames] == list(range(18))
    assert_allclose([f.stamp for f in fewer.frames], [f.stamp for f in slow.frames])
    assert_allclose(fewer.truth.motion.attitude, slow.truth.motion.attitude, atol=1e-12)
    for name in ("frame", "disc", "state"):
        assert_array_equal(getattr(fewer.truth.discs, name), getattr(slow.truth.discs, name))
    assert_allclose(fewer.truth.discs.centre, slow.truth.discs.centre, atol=1e-9)
    # the pictures differ by their noise of 3 grey values alone
    difference = fewer.frames[7].image.astype(float) - slow.frames[7].image
    assert np.std(difference) < 5.0


def test_the_classic_filters_are_told_the_true_acceleration(film):
    motion = film.truth.motion
    steady = replace(motion, rate=np.outer(motion.stamp, [3.0, 0.0, 0.0]))
    assert tour_module.acceleration(steady) == pytest.approx(np.sqrt(3.0))
    said = kit.settings_of([tour_module.suited(steady)]).euler.acceleration_sigma
    assert said == pytest.approx(np.sqrt(3.0))
