"""The parts that experiments share."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from experiments.kit import detections
from experiments.kit.film import bound, bound_rms, film_of, options_of, settings_of, tracked
from experiments.kit.r1 import LAG, SCALE, TRACKBALL, Slowed, agreement, of_truth
from experiments.kit.tags import painted, tag, tag_cells, tag_corners
from experiments.kit.trackball import simulate_log
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.truth import Truth
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.profile import play
from spheremouse.simulate.ball.scene import default_scene, frame, ring_target


@pytest.fixture(scope="module")
def film():
    return film_of(prepare(options_of({"seconds": 1.4})))


@pytest.fixture(scope="module")
def seen(film):
    return detections.look_at(film, settings_of(["tracker=ekf2"]))


def test_filtering_again_gives_the_run_of_tracking(film, seen):
    settings = settings_of(["tracker=ekf2"])
    whole, again = tracked(film, settings), detections.filtered(seen, settings, film)
    assert_array_equal(again.attitude, whole.run.attitude)
    assert_array_equal(again.rotation, whole.run.rotation)
    assert again.status == whole.run.status
    errors = detections.errors(again, film.truth, film.rig.ball.radius)
    expected = {key: whole.report[key] for key in errors}
    expected["detection"] = {**expected["detection"], "recall_axis": None}  # it takes the camera's true pose
    assert errors == expected
    assert errors["tracked"] > 30


def test_the_bound_of_a_run_is_that_of_its_report_and_noisier_pictures_have_a_higher_one():
    limits = []
    for noise in (1.0, 12.0):
        film = film_of(prepare(options_of({"discs": 40, "seconds": 1.0, "noise": noise})))
        run = tracked(film, settings_of())
        limit = bound(film, run)
        n = run.report["tracked"]
        assert n > 25
        error = run.report["attitude_rmse_deg"]["combined"] * (n / (n - 1)) ** 0.5  # the first has none
        assert limit["attitude_deg"]["combined"] == pytest.approx(error / run.report["bound_ratio"]["attitude"])
        assert limit["rate_deg_s"]["combined"] ** 2 == pytest.approx(sum(limit["rate_deg_s"][a] ** 2 for a in "xyz"))
        limits.append(limit["rate_deg_s"]["combined"])
    assert limits[1] > 1.3 * limits[0]
    assert bound_rms(None) is None


def motion(pace=0.5):
    return Slowed(play(8.0, np.random.default_rng(3)), pace)


def test_slow_motion_turns_as_its_rate_says_and_ends_at_the_same_place():
    slow, h = motion(), 1e-5
    t = np.linspace(0.1, 15.9, 40)
    turned = log(slow.attitude(t + h) @ slow.attitude(t - h).transpose(0, 2, 1)) / (2.0 * h)
    assert_allclose(turned, slow.rate(t), atol=1e-6)
    assert slow.seconds == pytest.approx(16.0)
    assert_allclose(slow.attitude(np.array([16.0])), slow.profile.attitude(np.array([8.0])))


def test_the_agreement_finds_lag_scale_and_offset_of_a_log_made_from_the_speeds():
    t = np.arange(0.0, 10.0, 1.0 / 30.0)

    def path(at):  # mm
        return np.stack([40.0 * np.sin(1.7 * at), 25.0 * np.cos(2.3 * at)], axis=1)

    fine = np.arange(-2.0, 12.0, 0.002)
    counts = np.diff(3.0 * path(fine) + 7.0 * fine[:, None], axis=0, prepend=0.0)
    counts[0] = 0.0
    late = fine + 0.15
    mouse = MouseLog(late, counts)
    found = agreement(t[:-1], t[1:], np.diff(path(t), axis=0), mouse)
    assert found is not None
    assert found.lag == pytest.approx(0.15, abs=0.0026)
    assert found.scale == pytest.approx(3.0, rel=1e-3)
    assert found.offset == pytest.approx(7.0, abs=0.05)
    assert found.r > 0.9999


def test_the_true_motion_agrees_with_the_trackball_but_for_its_faults():
    slow = motion()
    t = np.arange(0.0, 16.0, 1.0 / 30.0)
    mouse = simulate_log(slow.rate, 0.0, 16.0, TRACKBALL)
    found = of_truth(Truth(t, slow.attitude(t), slow.rate(t)), mouse, 0.6)
    assert found is not None
    assert 0.9 < found.r < 0.9999  # uneven reports, noise of the stamps, some lost
    assert found.scale == pytest.approx(SCALE / 600.0, rel=0.05)
    assert LAG - 0.01 < found.lag < LAG + 0.03  # a report comes after what it counts


FAMILY = cv2.aruco.DICT_4X4_50
HALF = 0.036  # m


@pytest.fixture(scope="module")
def scene():
    """The frame without a room and without targets, seen by a camera that is turned about its axis."""
    scene = default_scene(1, "far", width=480, height=360)
    none = replace(scene.targets, ids=(), codes=(), position=np.zeros((0, 3)))
    pose = replace(scene.pose, rotation=scene.pose.rotation @ exp(np.array([0.0, 0.0, 0.2])))
    return replace(scene, pose=pose, surroundings=tuple(frame(none, 0.0105)))


@pytest.fixture(scope="module")
def bare(scene):
    return render_backdrop(scene).white


def test_a_sheet_painted_later_looks_as_one_of_the_scene(scene, bare):
    rendered = render_backdrop(replace(scene, surroundings=tuple(frame(scene.targets, 0.0105)))).white
    targets = scene.targets
    sheets = [ring_target(p, targets.radii, c) for p, c in zip(targets.position, targets.codes, strict=True)]
    assert np.count_nonzero(np.abs(rendered - bare).max(axis=2) > 1.0) > 1000
    error = np.abs(painted(bare, scene, sheets) - rendered)
    assert np.max(error) < 0.01


def test_tags_are_where_they_were_put(scene, bare):
    where = scene.targets.position
    picture = painted(bare, scene, [tag(p, HALF, tag_cells(FAMILY, 10 + i)) for i, p in enumerate(where)])
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(FAMILY))
    corners, ids, _ = detector.detectMarkers(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    assert sorted(ids.ravel()) == [10, 11, 12, 13]
    true = project(scene.pose.to_cam(tag_corners(where, HALF).reshape(-1, 3)), scene.camera)[0].reshape(-1, 4, 2)
    for quad, number in zip(corners, ids.ravel(), strict=True):
        assert np.abs(quad[0] - true[number - 10]).max() < 1.6  # px: without refinement, and in the same order


def test_a_sheet_covers_what_it_covers(scene, bare):
    """A grey level that follows from areas: of a tag, the share of black cells."""
    cells = tag_cells(FAMILY, 3)
    where = scene.targets.position[0]
    sheets = (tag(where, HALF, c) for c in (cells, np.ones_like(cells), np.zeros_like(cells)))
    mixed, white, dark = (painted(bare, scene, [sheet]).astype(float).sum() for sheet in sheets)
    share = np.count_nonzero(~cells) / cells.size  # of the tag within its margin
    assert (white - mixed) / (white - dark) == pytest.approx(share, abs=0.01)
