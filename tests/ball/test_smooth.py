"""The fixed-interval smoother: least squares, covariance against sampling, gaps, and the default filter's frames."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2
from so3_world import DT, OWN, SETTINGS, own_motion, points_at, seen, squared, white_jerk

from spheremouse.ball.filters.so3_settings import PERSISTENCE_S, usual_acceleration
from spheremouse.ball.filters.so3_state import PLACED
from spheremouse.ball.smooth import Observation, jerk_densities, observe, smooth, smooth_interval
from spheremouse.geometry.rotation import exp, log
from spheremouse.tracker import Estimate, Status

SIGMA = 2e-4  # rad, of a frame's rotation
LEVELS = 2.0 * (SETTINGS.acceleration_sigma * np.array(SETTINGS.levels)) ** 2 / PERSISTENCE_S  # jerk densities
AXES = np.eye(3)
TURNING = np.ix_((0, 1, 2, 6, 7, 8), (0, 1, 2, 6, 7, 8))


def estimated(k, attitude, rate, *, covariance=None, confirmed=True, status=Status.TRACKING):
    """An estimate of frame k with an increment; `covariance` (6, 6) of rotation and rate."""
    P = np.zeros((12, 12))
    P[TURNING] = np.eye(6) if covariance is None else covariance
    increment = np.eye(6) if confirmed else np.zeros((6, 6))
    rates = np.concatenate([rate, np.zeros(3)])
    return Estimate(k * DT, k, status, attitude, np.zeros(3), rates, P, np.zeros(6), increment, confirmed=confirmed)


def measured(k, attitude, rng=None, *, information=None, **estimate):
    """A frame that measures the rotation alone, about an estimate 0.01 rad beside it."""
    J = np.zeros((9, 9))
    J[:3, :3] = np.eye(3) / SIGMA**2 if information is None else information
    beside = exp(np.array([0.01, -0.004, 0.006])) @ attitude
    seen_at = attitude if rng is None else exp(SIGMA * rng.normal(size=3)) @ attitude
    z = np.concatenate([log(seen_at @ beside.T), np.zeros(6)])
    e = estimated(k, beside, np.array([0.1, 0.2, -0.1]), **estimate)
    return Observation(e, np.zeros(3), J, J @ z, np.zeros((6, 6)))


def jerked(rng, n, density, axes=AXES):
    """Attitudes, (n, 3, 3), and rates, (n, 3), of a ball under white jerk about `axes`, (3, a)."""
    F, Q = white_jerk(DT, np.sqrt(0.5 * density * PERSISTENCE_S))
    jerk = np.linalg.cholesky(Q)
    R, x = np.eye(3), np.stack([np.zeros(3), rng.normal(size=3), rng.normal(size=3)])
    attitudes, rates = [], []
    for k in range(n):
        if k:
            x[0] = 0.0
            x = F @ x + jerk @ rng.normal(size=(3, 3))
            x = x @ axes @ axes.T
            R = exp(x[0]) @ R
        attitudes.append(R)
        rates.append(x[1].copy())
    return np.array(attitudes), np.array(rates)


def test_a_rotation_about_one_axis_is_the_least_squares_fit_of_all_frames():
    """Rotations about one axis commute, so the problem is linear: means and covariances, the last frame included."""
    rng, n, density = np.random.default_rng(1), 25, LEVELS[2]
    attitudes, _ = jerked(rng, n, density, np.array([[1.0], [0.0], [0.0]]))
    angle = log(attitudes)[:, 0] + SIGMA * rng.normal(size=n)
    frames = [measured(k, exp(np.array([a, 0.0, 0.0]))) for k, a in enumerate(angle)]
    F, Q = white_jerk(DT, np.sqrt(0.5 * density * PERSISTENCE_S))
    white = np.linalg.inv(np.linalg.cholesky(Q))
    A, b = np.zeros((4 * n, 3 * n)), np.zeros(4 * n)
    A[np.arange(n), 3 * np.arange(n)], b[:n] = 1.0 / SIGMA, angle / SIGMA
    for k in range(n - 1):
        rows = slice(n + 3 * k, n + 3 * k + 3)
        A[rows, 3 * k : 3 * k + 3], A[rows, 3 * k + 3 : 3 * k + 6] = -white @ F, white
    prior = PLACED, 2.5 * SETTINGS.start_rate_sigma, usual_acceleration(SETTINGS)
    A[-3:, :3], b[-3] = np.diag(1.0 / np.array(prior)), (angle[0] + 0.01) / PLACED
    covariance = np.linalg.inv(A.T @ A)
    solution = (covariance @ A.T @ b).reshape(n, 3)
    motions, _ = smooth_interval(frames, np.full(n - 1, density), SETTINGS)
    assert_allclose([log(m.attitude)[0] for m in motions], solution[:, 0], atol=1e-3 * SIGMA)
    assert_allclose([m.rate[0] for m in motions], solution[:, 1], atol=1e-4)
    assert_allclose([m.acceleration[0] for m in motions], solution[:, 2], atol=1e-3)
    for k, motion in enumerate(motions):
        block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        assert_allclose(motion.covariance[::3, ::3], block, rtol=1e-3, atol=1e-6 * np.abs(block).max())


def test_covariances_are_the_scatter_of_runs_of_the_motion_assumed():
    """Rotation, rate and increment of 60 runs at the true density of the jerk: chi-square, 95 % band."""
    rng, runs, n, squares = np.random.default_rng(4), 60, 20, []
    for _ in range(runs):
        attitudes, rates = jerked(rng, n, LEVELS[1])
        frames = [measured(k, R, rng) for k, R in enumerate(attitudes)]
        motions, _ = smooth_interval(frames, np.full(n - 1, LEVELS[1]), SETTINGS)
        for k in (0, 9, n - 1):
            error = np.concatenate([log(motions[k].attitude @ attitudes[k].T), motions[k].rate - rates[k]])
            squares.append(squared(error, motions[k].covariance[:6, :6]))
    low, high = chi2.ppf([0.025, 0.975], 6 * runs) / runs
    means = np.reshape(squares, (runs, 3)).mean(axis=0)
    assert np.all((low < means) & (means < high))


def test_increments_are_as_certain_as_runs_say_and_add_up():
    """One frame of three does not confirm the attitude; an error that all frames share is in no increment."""
    rng, runs, n, squares = np.random.default_rng(5), 60, 20, []
    settings = replace(SETTINGS, levels=(1.0,), acceleration_sigma=1.0)
    for _ in range(runs):
        attitudes, _ = jerked(rng, n, 2.0 / PERSISTENCE_S)
        frames = [
            measured(k, R, rng, confirmed=k % 3 != 1)._replace(shared=1e-3 * np.eye(6)) for k, R in enumerate(attitudes)
        ]
        smoothed = smooth(frames, settings)
        confirmed = [k for k in range(n) if k % 3 != 1]
        for before, k in pairwise(confirmed):
            error = smoothed[k].increment[:3] - log(attitudes[k] @ attitudes[before].T)
            squares.append(squared(error, smoothed[k].increment_covariance[:3, :3]))
        total = smoothed[0].rotation
        for e in smoothed:
            total = exp(e.increment[:3]) @ total
        assert_allclose(total, smoothed[-2].rotation, atol=1e-9)  # the last frame is not confirmed
    # increments of a run hang together: their mean has at most the scatter of one of them
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    assert low < np.mean(squares) < high


def test_the_error_that_all_frames_share_remains():
    attitudes, _ = jerked(np.random.default_rng(6), 40, LEVELS[0])
    shared = np.diag([1e-6, 2e-6, 3e-6, 1e-8, 1e-8, 1e-8])
    frames = [measured(k, R)._replace(shared=shared) for k, R in enumerate(attitudes)]
    alone = smooth([f._replace(shared=np.zeros((6, 6))) for f in frames], SETTINGS)
    for ours, without in zip(smooth(frames, SETTINGS), alone, strict=True):
        assert_allclose(ours.covariance[TURNING], without.covariance[TURNING] + shared, atol=1e-15)
        assert_allclose(ours.increment_covariance, without.increment_covariance)


def test_another_frame_turns_the_result_with_it():
    rng, M = np.random.default_rng(7), exp(np.array([0.7, -1.1, 0.4]))
    attitudes, _ = jerked(rng, 20, LEVELS[3])
    frames = [measured(k, R, rng) for k, R in enumerate(attitudes)]
    turned = []
    for o in frames:
        T = np.kron(np.eye(3), M)
        e = o.estimate
        e = e._replace(rotation=M @ e.rotation, rate=np.concatenate([M @ e.rate[:3], e.rate[3:]]))
        turned.append(Observation(e, M @ o.acceleration, T @ o.information @ T.T, T @ o.score, o.shared))
    for a, b in zip(smooth(frames, SETTINGS), smooth(turned, SETTINGS), strict=True):
        assert_allclose(M @ a.rotation, b.rotation, atol=1e-10)
        assert_allclose(M @ a.rate[:3], b.rate[:3], atol=1e-8)
        assert_allclose(M @ a.covariance[6:9, 6:9] @ M.T, b.covariance[6:9, 6:9], rtol=1e-6, atol=1e-12)


def test_frames_without_information_are_bridged_with_a_larger_error():
    attitudes, _ = jerked(np.random.default_rng(8), 31, LEVELS[0])
    frames = [measured(k, R) for k, R in enumerate(attitudes)]
    for k in range(10, 20):
        frames[k] = measured(k, np.eye(3), information=np.zeros((3, 3)), confirmed=False)
    smoothed = smooth(frames, SETTINGS)
    variance = np.array([np.trace(e.covariance[:3, :3]) for e in smoothed])
    errors = np.linalg.norm(log(np.array([e.rotation for e in smoothed]) @ attitudes.transpose(0, 2, 1)), axis=1)
    assert np.all(variance[11:19] > variance[5])
    assert 11 <= np.argmax(variance) <= 18
    assert np.all(errors < 4.0 * np.sqrt(variance))
    assert not any(e.confirmed or e.increment.any() for e in smoothed[10:20])


def test_a_loss_ends_an_interval():
    """Frames before a loss and after it are smoothed as if there were no others; a lost ball keeps its estimate."""
    rng = np.random.default_rng(9)
    attitudes, _ = jerked(rng, 30, LEVELS[1])
    frames = [measured(k, R, rng) for k, R in enumerate(attitudes)]
    for k in (14, 15):
        frames[k] = frames[k]._replace(estimate=frames[k].estimate._replace(status=Status.LOST, confirmed=False))
    smoothed = smooth(frames, SETTINGS)
    parts = [*smooth(frames[:14], SETTINGS), *(f.estimate for f in frames[14:16]), *smooth(frames[16:], SETTINGS)]
    assert len(smoothed) == 30
    for ours, part in zip(smoothed, parts, strict=True):
        assert_allclose(ours.rotation, part.rotation)
        assert_allclose(ours.covariance, part.covariance)
    assert not smoothed[16].increment.any()
    assert smooth([], SETTINGS) == []
    (alone,) = smooth(frames[:1], SETTINGS)  # a frame alone shows its attitude
    assert np.linalg.norm(log(alone.rotation @ attitudes[0].T)) < 5.0 * SIGMA


def test_a_ball_found_again_without_a_frame_of_loss_starts_an_interval():
    """Its increment has no error, since no frame showed that motion."""
    attitudes, _ = jerked(np.random.default_rng(10), 20, LEVELS[0])
    elsewhere = [R if k < 10 else exp(np.array([1.0, 0.0, 0.0])) @ R for k, R in enumerate(attitudes)]
    frames = [measured(k, R) for k, R in enumerate(elsewhere)]
    found = frames[10].estimate._replace(increment_covariance=np.zeros((6, 6)))
    frames[10] = frames[10]._replace(estimate=found)
    smoothed = smooth(frames, SETTINGS)
    assert np.linalg.norm(log(smoothed[9].rotation @ elsewhere[9].T)) < 3.0 * SIGMA
    assert not smoothed[10].increment.any()


@pytest.mark.parametrize("level", [1, 3])
def test_the_density_of_the_jerk_is_that_of_the_level_in_force(level):
    """A ball left alone, then a player at a level: within the ratio of densities of neighbouring levels, 16."""
    rng = np.random.default_rng(11)
    quiet, _ = jerked(rng, 90, LEVELS[0])
    active, _ = jerked(rng, 90, LEVELS[level])
    attitudes = [*quiet, *(active @ quiet[-1])]
    found = jerk_densities([measured(k, R, rng) for k, R in enumerate(attitudes)], SETTINGS)
    assert np.median(found[20:70]) < 2.0 * LEVELS[0]
    assert LEVELS[level] / 4.0 < np.median(found[110:170]) < 4.0 * LEVELS[level]


def test_the_smoothed_rate_of_the_default_filter_has_half_the_error_and_its_covariance():
    """40 runs with rates, accelerations and noise as the filter assumes, the map unknown at the start."""
    rng, runs, n = np.random.default_rng(12), 40, 40
    ours, theirs, nees, attitude_nees = [], [], [], []
    for _ in range(runs):
        state, frames, truth = OWN.initial(0.0, np.eye(3)), [], []
        for k, (R, w, _) in enumerate(own_motion(rng, n)):
            points = points_at(seen(R), rng=rng)
            state = OWN.update(OWN.predict(state, k * DT), points)
            e = estimated(k, state.attitude, state.rate, covariance=state.covariance, confirmed=k > 0)
            frames.append(observe(e, state, points, OWN))
            truth.append((R, w))
        smoothed = smooth(frames, OWN.settings)
        assert_allclose(smoothed[0].rotation, np.eye(3), atol=1e-12)  # this frame defines the axes of the ball
        assert not smoothed[0].covariance[:3].any()
        for k, e in enumerate(smoothed[10:30], 10):
            R, w = truth[k]
            error = e.rate[:3] - w
            ours.append(error @ error)
            theirs.append(np.sum((frames[k].estimate.rate[:3] - w) ** 2))
            nees.append(squared(error, e.covariance[6:9, 6:9]))
            attitude_nees.append(squared(log(e.rotation @ R.T), e.covariance[:3, :3]))
    assert np.sqrt(np.mean(ours)) < 0.5 * np.sqrt(np.mean(theirs))
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    assert low < np.mean(nees) < high
    assert low < np.mean(attitude_nees) < high


def test_the_density_falls_soon_after_a_push():
    """A steady turn, a push of a tenth of a second, and a steady turn again: a filter of one level alone would lag."""
    rng, n, pushed = np.random.default_rng(13), 90, (40, 43)
    rate = np.cumsum([20.0 * DT * (pushed[0] <= k < pushed[1]) for k in range(n)])
    angle = np.cumsum(DT * rate)
    frames = [measured(k, exp(np.array([a, 0.0, 0.0])), rng) for k, a in enumerate(angle)]
    found = jerk_densities(frames, SETTINGS)
    assert np.max(found[pushed[0] - 2 : pushed[1] + 1]) > 10.0 * LEVELS[2]
    assert np.max(found[pushed[1] + 4 :]) < 4.0 * LEVELS[0]
    assert np.max(found[10 : pushed[0] - 4]) < 4.0 * LEVELS[0]


def test_residuals_within_the_frames_scale_the_noise():
    """With a quarter of the variance stated, each frame informs four times as much; one frame alone changes little."""
    attitudes, _ = jerked(np.random.default_rng(14), 30, LEVELS[1])
    right = [measured(k, R) for k, R in enumerate(attitudes)]
    too_sure = [o._replace(information=4.0 * o.information, score=4.0 * o.score) for o in right]
    stated = [o._replace(squared_residual=2.5e4, expected_residual=1e5) for o in right]
    for ours, expected in zip(smooth(stated, SETTINGS), smooth(too_sure, SETTINGS), strict=True):
        assert_allclose(ours.covariance, expected.covariance, rtol=1e-3, atol=1e-13)
    (alone,), (unscaled,) = smooth([right[0]._replace(expected_residual=1.0)], SETTINGS), smooth(right[:1], SETTINGS)
    assert_allclose(alone.covariance, unscaled.covariance, rtol=0.15)


def test_the_expected_residual_of_a_frame_is_its_mean():
    """Over 40 runs with the noise stated, from the first sighting of each disc on, within 10 %."""
    rng, squares, expected = np.random.default_rng(15), 0.0, 0.0
    for _ in range(40):
        state = OWN.initial(0.0, np.eye(3))
        for k, (R, _, _) in enumerate(own_motion(rng, 15)):
            points = points_at(seen(R), rng=rng)
            state = OWN.update(OWN.predict(state, k * DT), points)
            o = observe(estimated(k, state.attitude, state.rate), state, points, OWN)
            squares, expected = squares + o.squared_residual, expected + o.expected_residual
    assert_allclose(squares, expected, rtol=0.1)


def test_an_unconfirmed_frame_informs_unless_it_is_ambiguous():
    """The filter's attitude may be too uncertain to report, though its pairs are right."""
    rng, state = np.random.default_rng(16), OWN.initial(0.0, np.eye(3))
    for k in range(3):
        points = points_at(seen(np.eye(3)), rng=rng)
        state = OWN.update(OWN.predict(state, k * DT), points)
    for confirmed, ambiguous in ((True, True), (True, False), (False, True), (False, False)):
        o = observe(estimated(2, state.attitude, state.rate, confirmed=confirmed), state, points, OWN, ambiguous)
        assert o.information.any() == (confirmed or not ambiguous)
        assert (o.squared_residual > 0.0) == (confirmed or not ambiguous)
