"""Scale and drift, the noise for the bound, and the comparison of two settings."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE, DiscTruth
from spheremouse.evaluation.bound import measured, semi_minor_axes
from spheremouse.evaluation.scale import scale_and_drift
from spheremouse.evaluation.tuning import CONFIDENCE, LIMIT, MIN_GAIN, compare, losses, scales
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import exp, from_euler, log, tangent_basis
from spheremouse.simulate.ball.profile import play

FPS = 30.0
SCALE = np.array([1.0005, 0.999, 1.0])
DRIFT = np.radians([1.0, 0.0, -2.0]) / 60.0  # rad/s


def steps_of(attitude):
    return log(attitude[1:] @ attitude[:-1].transpose(0, 2, 1))


def played(seed, seconds=30.0):
    """Attitudes of a ball that a hand plays with."""
    return play(seconds, np.random.default_rng(seed)).attitude(np.arange(round(seconds * FPS) + 1) / FPS)


def found_in(true, measured):
    found = scale_and_drift(np.full(len(true), 1.0 / FPS), SCALE * measured + DRIFT / FPS, true)
    assert found is not None
    return found


@pytest.mark.parametrize(("misaligned", "tolerance"), [((0.0, 0.0, 0.0), 1e-9), ((0.003, -0.002, 0.004), 2e-5)])
def test_an_exact_path_gives_its_scale_and_drift_exactly_and_misaligned_axes_change_neither(misaligned, tolerance):
    true = steps_of(played(1))
    found = found_in(true, true @ exp(np.array(misaligned)))
    assert_allclose(found.scale, SCALE, atol=tolerance)
    assert_allclose(found.drift, DRIFT, atol=1e-9)


@pytest.mark.parametrize(
    ("white", "walk"), [(3e-4, 0.0), pytest.param(3e-4, 2e-5, marks=pytest.mark.slow), (0.0, 2e-5)]
)
def test_the_intervals_hold_in_95_percent_of_the_runs(white, walk):
    """Errors of each attitude, rad, and errors that stay with the ball, rad per frame."""
    misses = []
    for seed in range(40):
        R, rng = played(seed), np.random.default_rng([seed, 1])
        e, stays = rng.normal(size=(2, len(R), 3))
        found = found_in(steps_of(R), steps_of(exp(white * e) @ R @ exp(walk * np.cumsum(stays, axis=0))))
        misses += [(found.scale - SCALE) / found.scale_width, (found.drift - DRIFT) / found.drift_width]
    held = np.mean(np.abs(misses) < 1.0)
    print(f"held {held:.3f}, RMS of the error over half the width {np.sqrt(np.mean(np.square(misses))):.2f} (0.5)")
    assert 0.9 < held < 0.99  # 240 of 0.95: 0.95 +- 0.014


def test_only_the_axis_that_the_ball_turned_about_has_a_scale():
    rng = np.random.default_rng(3)
    true = np.zeros((900, 3))
    true[:, 1] = 0.1 * np.sin(np.arange(900) / 20.0)
    noise = np.diff(3e-4 * rng.normal(size=(901, 3)), axis=0)
    found = found_in(true + 0.01 * noise, true + noise)
    assert np.isnan(found.scale).tolist() == [True, False, True]
    assert abs(found.scale[1] - SCALE[1]) < 2.0 * found.scale_width[1] < 2e-3
    assert np.all(np.abs(found.drift - DRIFT) < 2.0 * found.drift_width)
    oblique = true[:, [1]] * [1.0, 1.0, 0.0]
    found = found_in(oblique, oblique)
    assert np.isnan(found.scale).all()


def test_of_steady_motion_scale_and_drift_are_one():
    true = np.tile([0.0, 0.1, 0.0], (900, 1))
    found = scale_and_drift(np.full(900, 1.0 / FPS), 1.001 * true, true)
    assert found is not None
    assert found.scale[1] == pytest.approx(1.001)
    assert np.isnan(found.drift).all()


def test_ten_seconds_are_needed():
    true = steps_of(played(4, 20.0))
    for n, enough in ((0, False), (270, False), (330, True)):
        assert (scale_and_drift(np.full(n, 1.0 / FPS), true[:n], true[:n]) is not None) == enough


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
    assert measured([], [], truth) == []


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_the_semi_minor_axis_is_that_of_the_rim(scale):
    """Of 720 points of the rim, by their moments; at the limb and beside the ball there is none."""
    camera = InteriorOrientation(
        round(640 * scale), round(480 * scale), 640 * scale, 640 * scale, 320 * scale, 240 * scale
    )
    pose = Pose(from_euler(np.radians([180.0, 0.0, 90.0])), np.array([0.0, 0.0, 2.35]))
    rig = Rig(camera, Ball(0.6), NO_TARGETS, 0.02)
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


def correlated(rng, n):
    """Positive losses with the mean 2, of which five adjacent ones share a part."""
    smooth = np.convolve(rng.normal(size=n + 5), np.ones(5) / np.sqrt(5), "same")[:n]
    return 2.0 * smooth**2


def test_equal_settings_are_rarely_called_better():
    rng, n, runs = np.random.default_rng(1), 600, 500
    wrong = sum(compare(correlated(rng, n), correlated(rng, n), FPS).significant for _ in range(runs))
    expected = (1.0 - CONFIDENCE) * runs
    assert wrong <= expected + 3.0 * np.sqrt(expected)


def test_a_gain_beyond_chance_is_found_and_a_trivial_one_is_not():
    rng = np.random.default_rng(2)
    present = correlated(rng, 600)
    better = compare(present, 0.7 * present, FPS)
    assert better.significant
    assert better.gain == pytest.approx(0.3)
    assert not compare(present, (1.0 - 0.9 * MIN_GAIN) * present, FPS).significant
    assert not compare(present, 1.3 * present, FPS).significant
    assert not compare(np.full(30, 2.0), np.full(30, 1.0), FPS).significant  # a few frames decide nothing


def test_frames_without_an_estimate_have_the_limit():
    terms = np.array([[1.0, 3.0], [np.nan, np.nan], [1e9, 0.0], [3.0, 1.0]])
    made = losses(terms, scales(terms[[0, 3]]), missing=2)
    np.testing.assert_allclose(made, [LIMIT, LIMIT, 2.0, LIMIT, LIMIT, 2.0])


def test_without_a_tracked_frame_only_tracking_counts():
    scale = scales(np.full((5, 2), np.nan))
    np.testing.assert_array_equal(losses(np.array([[4.0, 9.0], [np.nan, np.nan]]), scale), [0.0, LIMIT])
