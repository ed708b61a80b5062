"""Noise of the centres of a run, by size, against noise that was put on them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE, DiscTruth
from spheremouse.evaluation.bound import measured, semi_minor_axes
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import from_euler, tangent_basis


def sky(frames, areas, states):
    """Discs 30 px apart in a row, the same in all frames."""
    k = len(areas)
    centre = np.stack([30.0 * np.arange(1, k + 1), np.full(k, 50.0)], axis=1)
    return DiscTruth(
        np.repeat(np.arange(frames), k), np.tile(np.arange(k), frames), np.tile(centre, (frames, 1)),
        np.tile(centre, (frames, 1)), np.tile(np.array(areas, dtype=float), frames), np.tile(states, frames)
    )  # fmt: skip


def test_each_size_has_the_noise_that_was_put_on_it():
    rng = np.random.default_rng(2)
    true = np.array([0.3, 0.1, 0.02, 0.5])
    truth = sky(800, [20.0, 80.0, 300.0, 300.0], [VISIBLE, VISIBLE, VISIBLE, PARTLY_HIDDEN])
    detected = [truth.of_frame(f).centre + rng.normal(size=(4, 2)) * true[:, None] for f in range(800)]
    sights = measured(range(800), detected, truth)
    assert len(sights) == 800
    assert_allclose(np.concatenate([s.sigma for s in sights]).reshape(800, 4), np.tile(true, (800, 1)), rtol=0.06)


def test_hidden_discs_and_detections_of_nothing_are_no_sights():
    truth = sky(2, [100.0, 100.0, 100.0], [VISIBLE, HIDDEN, VISIBLE])
    first, last = truth.of_frame(0), truth.of_frame(1)
    sights = measured([0, 1], [first.centre, last.centre[1:] + 2.0], truth)
    assert_array_equal(sights[0].disc, [0, 2])
    assert_array_equal(sights[1].disc, [2])  # the other lies on a hidden one
    assert len(measured([0], [np.zeros((0, 2))], truth)[0].disc) == 0


def test_a_rare_size_borrows_from_its_neighbour():
    """Of one centre no noise can be told."""
    rng = np.random.default_rng(3)
    truth = sky(50, [20.0, 100.0], [VISIBLE, VISIBLE])
    detected = []
    for f in range(50):
        points = truth.of_frame(f).centre + 0.1 * rng.normal(size=(2, 2))
        detected.append(points if f == 0 else points[1:])
    sigma = [s.sigma for s in measured(range(50), detected, truth)]
    assert sigma[0][0] == sigma[0][1] == pytest.approx(0.1, rel=0.2)


def test_what_is_cut_and_what_is_large_do_not_share_a_noise():
    """However few there are of either."""
    rng = np.random.default_rng(4)
    for frames_cut, frames_large in ((12, 300), (40, 12)):
        truth = sky(300, [300.0, np.nan], [VISIBLE, PARTLY_HIDDEN])
        detected = []
        for f in range(300):
            points = truth.of_frame(f).centre + np.array([[0.03], [1.0]]) * rng.normal(size=(2, 2))
            detected.append(points[[f < frames_large, f < frames_cut]])
        sights = measured(range(300), detected, truth)
        large = [s.sigma[s.disc == 0] for s in sights]
        cut = [s.sigma[s.disc == 1] for s in sights]
        assert_allclose(np.concatenate(large), 0.03, rtol=0.3)
        assert_allclose(np.concatenate(cut), 1.0, rtol=0.5)


def test_perfect_centres_still_have_a_noise():
    truth = sky(3, [100.0], [VISIBLE])
    sights = measured(range(3), [truth.of_frame(f).centre for f in range(3)], truth)
    assert all(0.0 < s.sigma[0] < 1e-3 for s in sights)


def test_no_frames_no_sights():
    assert measured([], [], sky(1, [100.0], [VISIBLE])) == []


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_the_semi_minor_axis_is_that_of_the_rim(scale):
    """Of 720 points of the rim, by their moments; at the limb and beside the ball there is none."""
    camera = InteriorOrientation(
        round(640 * scale), round(480 * scale), 640 * scale, 640 * scale, 320 * scale, 240 * scale
    )
    pose = Pose(from_euler(np.radians([180.0, 0.0, 90.0])), np.array([0.0, 0.0, 2.35]))
    rig = Rig(camera, Ball(0.6), Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)), 0.02)
    slant, way = np.radians([0.0, 30.0, 60.0, 70.0, 74.5]), np.radians([0.0, 40.0, 170.0, 250.0, 300.0])
    u = np.stack([np.sin(slant) * np.cos(way), np.sin(slant) * np.sin(way), np.cos(slant)], axis=1)
    alpha, phase = 0.02 / 0.6, np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    around = np.stack([np.cos(phase), np.sin(phase)], axis=1) @ np.swapaxes(tangent_basis(u), 1, 2)
    rim = project(pose.to_cam(0.6 * (np.cos(alpha) * u[:, None] + np.sin(alpha) * around)).reshape(-1, 3), camera)[0]
    off = rim.reshape(5, 720, 2) - rim.reshape(5, 720, 2).mean(axis=1, keepdims=True)
    true = np.linalg.norm(off, axis=2).min(axis=1)
    centre = project(pose.to_cam(0.6 * u), camera)[0]
    axes = semi_minor_axes(np.concatenate([centre, [[2.0, 2.0]]]), rig, pose)
    assert_allclose(axes[:4], true[:4], rtol=0.02)
    assert np.isnan(axes[4:]).all()
