"""Poses: errors in the thesis' angles, honest draws."""

import json

import numpy as np
import pytest
from experiments import poses
from experiments.kit import thesis
from scipy.stats import chi2

from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import from_euler, to_euler
from spheremouse.simulate.ball.scene import default_scene


def sightings(rig, centre):
    return [Sighting(k, c, 0.05**2 * np.eye(2), 30) for k, c in zip(rig.targets.codes, centre, strict=True)]


@pytest.fixture(scope="module")
def results():
    """One camera of each view, few draws."""
    films = {f"{view}-0": poses.filmed(view, 1, [1, 2]) for view in ("far", "near")}
    return json.loads(json.dumps({**films, "drawn-far": poses.drawn("far", 3)}))


@pytest.mark.parametrize("view", ["far", "near"])
def test_an_error_is_told_in_the_thesis_angles(view):
    scene = default_scene(1, view)
    rig, true = scene.rig(), scene.pose
    step = np.array([1e-3, -2e-3, 0.5e-3, *np.radians([0.03, -0.02, 0.04])])
    moved = Pose(from_euler(to_euler(true.rotation) + step[3:]), true.position + step[:3])
    found = poses.pose_result(sightings(rig, predict_targets(moved, rig)), rig, true)
    assert found["error"] == pytest.approx([1.0, -2.0, 0.5, 0.03, -0.02, 0.04], abs=2e-4)


def test_sigma_is_the_scatter_of_the_error():
    scene, rng = default_scene(1, "far"), np.random.default_rng(0)
    rig = scene.rig()
    centre = predict_targets(scene.pose, rig)
    found = [
        poses.pose_result(sightings(rig, centre + 0.05 * rng.standard_normal(centre.shape)), rig, scene.pose)
        for _ in range(150)
    ]
    error = np.array([f["error"] for f in found])
    # residuals may enlarge a covariance, hence the upper side is wide
    ratio = error.std(axis=0) / np.mean([f["sigma"] for f in found], axis=0)
    assert np.all((ratio > 0.65) & (ratio < 1.2))
    correlation = np.corrcoef(error.T)
    assert np.abs(correlation - np.array(found[0]["correlation"])).max() < 0.25


def test_the_far_camera_has_the_correlations_of_table_21():
    scene = default_scene(1, "far")
    rig = scene.rig()
    found = poses.pose_result(sightings(rig, predict_targets(scene.pose, rig)), rig, scene.pose)
    for i, row in enumerate(thesis.THESIS_TABLES["21"]["correlation"], start=1):
        assert found["correlation"][i][:i] == pytest.approx(row, abs=0.12)


def test_draws_are_honest_with_calibrated_targets():
    entries = poses.drawn("near", 14)["entries"]
    low, high = chi2.ppf([0.001, 0.999], 6 * 14) / (6 * 14)
    assert low < np.mean([e["chi_square"] for e in entries]) / 6.0 < high


def test_cameras_of_seeds_differ_and_see_all_targets():
    scene = default_scene(1, "near")
    found = [poses.strayed_pose(scene, np.random.default_rng(seed)) for seed in range(20)]
    for pose in found:
        centre = predict_targets(pose, scene.rig())
        assert np.all((centre > 0.0) & (centre < (640.0, 480.0)))
    assert len({tuple(p.position) for p in found}) == 20


def test_films_give_poses_from_all_counts(results):
    for view in ("far", "near"):
        film = results[f"{view}-0"]
        assert set(film["figure"]["counts"]) == {"1", "2"}
        assert set(film["table"]["counts"]) == {"30"}
        assert 0.0 < film["table"]["scatter_px"] < film["figure"]["scatter_px"] < 0.1  # 3 and 15 grey values
        exact, calibrated = (film["table"]["counts"]["30"][k] for k in ("exact", "calibrated"))
        assert np.linalg.norm(exact["error"][:3]) < 1.0  # mm
        assert np.all(np.array(exact["sigma"]) < np.array(calibrated["sigma"]))


def pose(error, sigma=1.0, correlation=0.5):
    """Errors as long as that in all six; standard deviations as large as that."""
    matrix = np.where(np.eye(6) > 0.0, 1.0, correlation).tolist()
    chi = 6.0 * (error / sigma) ** 2
    return {"error": [error] * 6, "sigma": [sigma] * 6, "correlation": matrix, "chi_square": chi}
