"""A match of ball and trackball returns the simulated scale, axes and lag within its standard deviations."""

import numpy as np
import pytest
from experiments.kit.trackball import Trackball, simulate_log, trackball_matrix
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremouse.evaluation.trackball import CountPath, RotationSteps, judge, match, settings_of
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import exp, log
from spheremouse.output.counts import MotionSettings
from spheremouse.simulate.ball.profile import Gestures, play, stroke

FPS, RADIUS = 30.0, 0.6
BEGIN = 5000.0  # s, of the frames' clock


class Shifted:
    def __init__(self, profile):
        self.profile = profile

    def rate(self, t):
        return self.profile.rate(t - BEGIN)


def filmed(profile, seed=0, noise=7e-4, fps=FPS):
    """Rotation steps of a tracker whose attitudes have noise, rad."""
    t = BEGIN + np.arange(int(profile.seconds * fps)) / fps
    errors = noise * np.random.default_rng([seed, 1]).standard_normal((len(t), 3))
    R = exp(errors) @ profile.attitude(t - BEGIN)
    return RotationSteps(t[:-1], t[1:], log(R[1:] @ R[:-1].transpose(0, 2, 1)))


def recorded(profile, trackball, seed=0):
    return simulate_log(Shifted(profile).rate, BEGIN - 2.0, BEGIN + profile.seconds + 2.0, trackball, seed)


def playing(seed, seconds=30.0):
    return play(seconds, np.random.default_rng(seed))


BELOW = trackball_matrix(480.0, 480.0)


# ---- the simulated trackball ----


def test_the_log_counts_what_the_ball_turned():
    profile = playing(1)
    trackball = Trackball(trackball_matrix(300.0, 700.0, 0.4, 0.2), lag=0.7, drift=1e-4)
    seen = recorded(profile, trackball)
    t = np.linspace(0.0, profile.seconds, 60_001)
    w = profile.rate(t)
    whole = trackball.matrix @ (0.5 * (w[1:] + w[:-1]) * np.diff(t)[:, None]).sum(axis=0)
    np.testing.assert_allclose(seen.counts.sum(axis=0), whole, atol=1.1)
    np.testing.assert_array_equal(seen.counts, np.rint(seen.counts))
    steps = np.diff(seen.stamp[1:-1])
    assert steps.min() > 1.0 / trackball.fastest
    assert np.all(np.any(seen.counts[1:-1] != 0, axis=1))  # silent at rest
    assert not np.any(seen.counts[[0, -1]])


def test_a_slipping_trackball_counts_less():
    profile = Gestures((stroke(1.0, (0.0, 0.0, 1.0), 6.0, up=0.1, hold=0.5, down=0.1),), 3.0)
    sums = [recorded(profile, Trackball(BELOW, grip=g)).counts[:, 0].sum() for g in (np.inf, 1e6, 5.0)]
    assert sums[0] == sums[1] == pytest.approx(480.0 * 6.0 * 0.6, abs=1.0)
    # 5 rad/s² for 0.65 s and back: a triangle of 2.1 rad in place of 3.6
    assert sums[2] == pytest.approx(480.0 * 2.1, rel=0.1)


# ---- the estimate ----


@settings(max_examples=6, derandomize=True)
@given(
    scale=st.floats(60.0, 3000.0),
    ratio=st.floats(0.5, 2.0),
    turned=st.floats(-3.1, 3.1),
    tilt=st.floats(-0.5, 0.5),
    lag=st.floats(-1e5, 1e5),
    seed=st.integers(0, 1000),
)
def test_scale_axes_and_lag_are_within_their_standard_deviations(scale, ratio, turned, tilt, lag, seed):
    trackball = Trackball(trackball_matrix(scale, -scale * ratio, turned, tilt), lag=lag, stamp_sigma=5e-4)
    profile = playing(seed)
    found = match(filmed(profile, seed), recorded(profile, trackball, seed))
    assert np.all(np.abs(found.matrix - trackball.matrix) < 6.0 * found.sigma)
    assert abs(found.lag - lag) < 6.0 * found.lag_sigma < 0.01


@pytest.mark.slow
def test_the_covariance_is_that_of_the_errors():
    """The mean of e' P^-1 e / 7 over plays is 1 for a perfect covariance, less for one on the safe side."""
    distances, relative = [], []
    for seed in range(16):
        trackball = Trackball(trackball_matrix(500.0, -400.0, 0.3 * seed, 0.2), lag=0.031, stamp_sigma=5e-4)
        profile = playing(seed + 50)
        found = match(filmed(profile, seed), recorded(profile, trackball, seed))
        error = np.append((found.matrix - trackball.matrix).ravel(), found.lag - 0.031)
        distances.append(error @ np.linalg.solve(found.covariance, error) / 7.0)
        relative.append(found.sigma.max() / 450.0)
    print(f"mean {np.mean(distances):.2f}, sigma of A up to {100 * max(relative):.2f} % of the scale")
    assert 0.3 < np.mean(distances) < 1.4  # 112 degrees of freedom: 1 +- 0.13
    assert max(relative) < 0.02


def test_lost_reports_slip_and_lost_frames_do_not_change_the_scale():
    profile = playing(9)
    ball = filmed(profile)
    tracked = (np.arange(len(ball.begin)) // 40) % 5 != 0  # lost for a fifth of the time
    ball = RotationSteps(*(part[tracked] for part in ball))
    found = match(ball, recorded(profile, Trackball(BELOW, lag=0.02, dropouts=0.5, grip=20.0)))
    assert found.outliers > 3
    np.testing.assert_allclose(found.matrix, BELOW, atol=0.01 * 480.0)
    assert judge(found).usable


def test_a_mouse_at_rest_between_reports_is_at_rest():
    log = MouseLog(np.array([0.0, 0.01, 1.0]), np.array([[0.0, 0], [4, 0], [8, 0]]))
    sums = CountPath.from_log(log).at(np.array([0.01, 0.5, 0.98, 0.995, 1.0]))
    assert sums[:, 0].tolist() == pytest.approx([4, 4, 4, 8, 12])


# ---- the verdict ----


@pytest.mark.parametrize(("turned", "note"), [(0.02, ()), (1.6708, ("5.7°",)), (2.9416, ("11.5°",))])
def test_a_turn_that_no_setting_expresses_is_a_note(turned, note):
    profile = playing(13)
    verdict = judge(match(filmed(profile), recorded(profile, Trackball(trackball_matrix(500.0, 400.0, turned)))))
    assert verdict.text.startswith("the two agree (r = ")
    assert len(verdict.notes) == len(note)
    assert all(angle in text for angle, text in zip(note, verdict.notes, strict=True))


def test_a_contact_beside_the_lowest_point_is_a_note():
    profile = playing(13)
    verdict = judge(match(filmed(profile), recorded(profile, Trackball(trackball_matrix(500.0, 500.0, tilt=0.4)))))
    assert any(
        note.startswith("it touches the ball 23° from the lowest point (towards X +0.39") for note in verdict.notes
    )


@pytest.mark.parametrize("radius", [RADIUS, None])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("sign", [(1, 1), (-1, 1), (1, -1)])
def test_the_settings_move_the_pointer_as_the_trackball_did(radius, swap, sign):
    profile = playing(17, 12.0)
    matrix = np.diag(sign) @ np.diag([520.0, 300.0]) @ (BELOW / 480.0)[[1, 0] if swap else [0, 1]]
    before = MotionSettings(scale_z=2.0)
    after = settings_of(match(filmed(profile), recorded(profile, Trackball(matrix))), radius, before)
    np.testing.assert_allclose(after.matrix(radius)[:2], matrix, atol=5.0)
    np.testing.assert_allclose(after.matrix(radius)[2], before.matrix(radius)[2], rtol=1e-4)


def test_equal_scales_stay_one_scale():
    profile = playing(17, 12.0)
    after = settings_of(match(filmed(profile), recorded(profile, Trackball(BELOW))), RADIUS, MotionSettings())
    assert (after.scale_x, after.scale_y, after.player) == (1.0, 1.0, "far-side")
    assert after.counts_per_mm == pytest.approx(0.8, rel=0.01)


def test_a_log_of_another_play_is_rejected():
    for seed in range(2):
        other = match(filmed(playing(seed)), recorded(playing(seed + 100, 40.0), Trackball(BELOW)))
        assert other is None or "of another time or another mouse" in judge(other).text


@pytest.mark.parametrize(("axis", "name"), [((1.0, 0.0, 0.0), "Z"), ((0.0, 0.0, 1.0), "X")])
def test_the_verdict_names_an_axis_without_motion(axis, name):
    strokes = [
        stroke(1.0 + 1.7 * k + 0.1 * (k % 3), axis, (2.0 + 0.2 * (k % 4)) * (-1) ** k, up=0.4, hold=0.2, down=0.5)
        for k in range(16)
    ]
    profile = Gestures(tuple(strokes), 29.0)
    verdict = judge(match(filmed(profile), recorded(profile, Trackball(BELOW))))
    assert f"too little motion about {name} to estimate the scale" in verdict.text
    assert not verdict.usable


def test_another_clock_does_no_harm():
    profile = playing(19)
    verdict = judge(match(filmed(profile), recorded(profile, Trackball(BELOW, lag=1.7e9))))
    assert verdict.usable
    assert any("ahead of that of the frames" in note for note in verdict.notes)


def test_nothing_in_common_is_no_match():
    profile = playing(19, 10.0)
    ball, seen = filmed(profile), recorded(profile, Trackball(BELOW))
    for n in (0, 1, 60):
        assert match(RotationSteps(*(part[:n] for part in ball)), seen) is None
    assert match(ball, MouseLog(seen.stamp[:2], np.array([[0.0, 0.0], [5.0, 0.0]]))) is None
    assert match(ball, MouseLog(seen.stamp, 0.0 * seen.counts)) is None
    assert match(ball._replace(rotation=0.0 * ball.rotation), seen) is None
    assert match(ball, seen) is not None
