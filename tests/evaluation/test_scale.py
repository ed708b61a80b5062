"""Scale and drift of simulated paths are those that were put in, within intervals that hold in 95 % of the runs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from spheremouse.evaluation.scale import scale_and_drift
from spheremouse.geometry.rotation import exp, log
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


def test_an_exact_path_gives_its_scale_and_drift_exactly():
    true = steps_of(played(1))
    found = found_in(true, true)
    assert_allclose(found.scale, SCALE, atol=1e-9)
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


def test_misaligned_axes_are_no_error_of_scale():
    true = steps_of(played(2))
    found = found_in(true, true @ exp(np.array([0.003, -0.002, 0.004])))
    assert_allclose(found.scale, SCALE, atol=2e-5)
    assert_allclose(found.drift, DRIFT, atol=1e-9)


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
