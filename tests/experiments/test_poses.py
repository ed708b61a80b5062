"""Poses: errors in the thesis' angles, correlations of its tables."""

import numpy as np
import pytest
from experiments import poses
from experiments.kit import thesis

from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import from_euler, to_euler
from spheremouse.simulate.ball.scene import default_scene


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
