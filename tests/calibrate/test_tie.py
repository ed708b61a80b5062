"""The rotation between the axes of two cameras follows from one ball's motion as both see it, with its covariance."""
# pyright: reportArgumentType=false

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from spheremouse.ball.pose import predict_targets
from spheremouse.calibrate.tie import AttitudeTrack, tie, tied
from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball.scene import default_scene

TURN = exp(np.array([0.2, 1.4, -0.3]))  # R_first_second
OTHER = exp(np.array([1.0, -0.5, 2.0]))  # from the axes on the ball of one track to those of the other
ALL = np.eye(3)


def motion(stamps, axes=ALL):
    """Attitudes and rates of a ball that turns about changing axes, a sum of three swings; `axes` [0, 0, 1] alone."""

    def angles(t):
        return np.array([1.5 * np.sin(0.9 * t), 2.0 * np.sin(0.7 * t + 1.0), 1.2 * np.sin(1.3 * t + 2.0)]) @ axes

    attitudes = np.array([exp(angles(t)) for t in stamps])
    ahead = np.array([exp(angles(t + 1e-5)) for t in stamps])
    return attitudes, np.array([log(b @ a.T) / 1e-5 for a, b in zip(attitudes, ahead, strict=True)])


def tracks(rng, sigma=1e-4, seconds=15.0, lag=0.0, axes=ALL):
    """What two cameras see, each in its own axes, with `sigma` rad of noise."""
    first, second = np.arange(0.0, seconds, 1 / 30), np.arange(0.011, seconds, 1 / 25)

    def noisy(attitudes):
        return np.array([exp(sigma * rng.normal(size=3)) @ R for R in attitudes])

    R, w = motion(first, axes)
    S, v = motion(second - lag, axes)
    return AttitudeTrack(first, noisy(R), w), AttitudeTrack(second, noisy(TURN.T @ S @ OTHER), v @ TURN)


def test_the_axes_and_the_lag_of_the_clock_are_found():
    found = tie(*tracks(np.random.default_rng(1), sigma=0.0, lag=0.004))
    assert np.linalg.norm(log(found.rotation @ TURN.T)) < 1e-4
    assert found.lag == pytest.approx(0.004, abs=1e-4)


@pytest.mark.parametrize("step", [2, 4])
def test_the_order_of_cameras_of_different_rates_does_not_matter(step):
    """Between frames of a slow camera, an attitude cannot be interpolated."""
    first, second = tracks(np.random.default_rng(7), sigma=1e-4, lag=0.004)
    slow = AttitudeTrack(first.stamp[::step], first.attitude[::step], first.rate[::step])
    found, back = tie(slow, second), tie(second, slow)
    assert np.linalg.norm(log(found.rotation @ TURN.T)) < 1e-3
    assert found.lag == pytest.approx(0.004, abs=5e-4)
    assert_allclose(back.rotation, found.rotation.T, atol=1e-12)
    assert_allclose(back.covariance, back.rotation @ found.covariance @ back.rotation.T, atol=1e-15)
    assert back.lag == pytest.approx(-found.lag)


def test_the_covariance_is_at_least_the_scatter():
    """It supposes errors that last; those here are independent, so it is larger."""
    found = [tie(*tracks(np.random.default_rng(seed), sigma=5e-4)) for seed in range(6)]
    errors = np.array([log(each.rotation @ TURN.T) for each in found])
    sigma = np.sqrt(np.mean([np.diag(each.covariance) for each in found], axis=0))
    assert (np.abs(errors) < 4.0 * sigma).all()
    assert (sigma < 2e-3).all()
    assert np.degrees(found[0].rms) == pytest.approx(np.degrees(5e-4) * 6**0.5, rel=0.1)


def test_frames_that_went_wrong_hardly_count():
    first, second = tracks(np.random.default_rng(2))
    wrong = second.attitude.copy()
    wrong[100:105] = wrong[100:105] @ exp(np.array([0.0, 0.02, 0.0]))
    found = tie(first, replace(second, attitude=wrong))
    assert np.degrees(np.linalg.norm(log(found.rotation @ TURN.T))) < 0.02


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"seconds": 4.0}, r"at the same time for 3\.9 s"),
        ({"axes": np.diag([0.0, 0.0, 1.0]), "sigma": 2e-3}, "the axes are known to .* only"),
    ],
)
def test_motion_that_determines_no_axes_is_refused(options, problem):
    with pytest.raises(CalibrationError, match=problem):
        tie(*tracks(np.random.default_rng(3), **options))


def test_tracks_of_two_runs_are_refused():
    first, second = tracks(np.random.default_rng(4))
    with pytest.raises(CalibrationError, match="not of one ball by one clock"):
        tie(first, replace(second, stamp=second.stamp + 1.0))
    with pytest.raises(CalibrationError, match=r"for 0\.0 s"):
        tie(first, replace(second, stamp=second.stamp + 1000.0))


@pytest.mark.parametrize("with_pose", [True, False])
def test_the_tied_rig_shows_the_same_picture_with_the_errors_of_the_tie(with_pose):
    scene = default_scene()
    rig = replace(scene.rig(), pose=scene.pose if with_pose else None)
    found = tie(*tracks(np.random.default_rng(5), sigma=1e-3))
    other = tied(rig, found)
    pose = tied(replace(rig, pose=scene.pose), found).pose
    assert_allclose(predict_targets(pose, other), predict_targets(scene.pose, rig), atol=1e-6)
    assert (other.pose is None) is not with_pose
    draws = np.random.default_rng(6).multivariate_normal(np.zeros(3), found.covariance, 4000)
    places = np.array([(exp(e) @ other.targets.position.T).T.ravel() for e in draws])
    added = (
        other.targets.covariance
        - np.kron(np.eye(4), found.rotation) @ rig.targets.covariance @ np.kron(np.eye(4), found.rotation).T
    )
    assert_allclose(np.cov(places.T), added, atol=0.1 * np.abs(added).max())
