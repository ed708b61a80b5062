"""Kalman filter of pose and velocity, compared with known motions, least squares and numerical derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from spheremouse.geometry.rotation import exp, log
from spheremouse.wand.pose_velocity import initialise, predict, predicted_velocity_covariance, update

ACCELERATION = np.repeat([2.0, 10.0], 3)
NOISE = np.diag([0.001, 0.001, 0.01, 0.02, 0.02, 0.01]) ** 2
DT = 1.0 / 30.0


def start(position=(0.1, -0.05, 1.0), rotation=None):
    return initialise(0.0, np.array(position), np.eye(3) if rotation is None else rotation, NOISE)


def moved(position, rotation, rng, frames, dt=DT, velocity=np.zeros(6)):  # noqa: B008  not changed
    """Return position, rotation and velocity of a ball with another acceleration in every frame."""
    poses = []
    for _ in range(frames):
        a = 0.5 * ACCELERATION * rng.standard_normal(6)
        way = velocity * dt + 0.5 * a * dt**2
        position, rotation = position + way[:3], exp(way[3:]) @ rotation
        velocity = velocity + a * dt
        poses.append((position, rotation, velocity))
    return poses


def seen(pose, rng):
    d = np.linalg.cholesky(NOISE) @ rng.standard_normal(6)
    return pose[0] + d[:3], exp(d[3:]) @ pose[1]


def test_constant_velocity_is_estimated_exactly():
    """Rotations of 0.37 rad between two frames."""
    velocity = np.array([0.1, -0.2, 0.3, 2.0, -1.0, 3.0])
    state = start()
    for k in range(1, 200):
        t = 0.1 * k
        position = np.array([0.1, -0.05, 1.0]) + velocity[:3] * t
        state = update(state, t, position, exp(velocity[3:] * t), NOISE, 0.1 * ACCELERATION)
    np.testing.assert_allclose(state.velocity, velocity, atol=1e-6)
    ahead = predict(state, state.stamp + 0.05, ACCELERATION)
    np.testing.assert_allclose(ahead.position, state.position + 0.05 * velocity[:3], atol=1e-6)
    np.testing.assert_allclose(log(ahead.rotation @ state.rotation.T), 0.05 * velocity[3:], atol=1e-6)


def test_estimate_equals_least_squares_over_all_frames():
    """One axis, with the accelerations as unknowns."""
    rng = np.random.default_rng(1)
    state, z, frames = start(), [1.0], 25
    for k in range(1, frames):
        z.append(1.0 + rng.normal(0.0, 0.01))
        state = update(state, k * DT, np.array([0.1, -0.05, z[-1]]), np.eye(3), NOISE, ACCELERATION)
    n = frames - 1  # unknowns: position and velocity at first, then the accelerations
    A, y, w = np.zeros((frames + 1 + n, 2 + n)), np.zeros(frames + 1 + n), np.zeros(frames + 1 + n)
    for k in range(frames):
        A[k, :2] = 1.0, k * DT
        A[k, 2 : 2 + k] = [(0.5 + k - 1 - j) * DT**2 for j in range(k)]
        y[k], w[k] = z[k], 1.0 / 0.01
    A[frames, 1], w[frames] = 1.0, 1.0 / 0.2
    A[frames + 1 :, 2:], w[frames + 1 :] = np.eye(n), 1.0 / (0.5 * ACCELERATION[2])
    x = np.linalg.lstsq(A * w[:, None], y * w, rcond=None)[0]
    C = np.linalg.inv((A * w[:, None]).T @ (A * w[:, None]))
    last = np.zeros((2, 2 + n))
    last[0, :2], last[0, 2:] = (1.0, n * DT), [(0.5 + n - 1 - j) * DT**2 for j in range(n)]
    last[1, 1], last[1, 2:] = 1.0, DT
    assert [state.position[2], state.velocity[2]] == pytest.approx(last @ x, rel=1e-8)
    P = state.covariance[np.ix_([2, 8], [2, 8])]
    np.testing.assert_allclose(P, last @ C @ last.T, rtol=1e-8)


@pytest.mark.parametrize("gap", [0.0, 0.4, 1.25])
def test_nees_is_consistent_also_after_a_gap(gap):
    """The acceleration changes with every frame, and five times a second without frames."""
    rng, nees = np.random.default_rng(2), []
    for _ in range(80):
        first = np.array([0.1, -0.05, 1.0]), exp(rng.standard_normal(3))
        poses = moved(*first, rng, 20)
        state = initialise(0.0, *seen(first, rng), NOISE)
        for k, pose in enumerate(poses):
            state = update(state, (k + 1) * DT, *seen(pose, rng), NOISE, ACCELERATION)
        p, R, v = poses[-1]
        if gap:
            number = int(np.ceil(gap / 0.2))
            p, R, v = moved(p, R, rng, number, gap / number, v)[-1]
            state = update(state, state.stamp + gap, *seen((p, R), rng), NOISE, ACCELERATION)
        e = np.concatenate([state.position - p, log(state.rotation @ R.T), state.velocity - v])
        part = np.arange(12) if not gap else np.arange(6, 9)  # large rotations are not linear
        nees.append(e[part] @ np.linalg.solve(state.covariance[np.ix_(part, part)], e[part]))
    low, high = chi2.ppf([0.005, 0.995], (12 if not gap else 3) * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


@pytest.mark.parametrize("speed", [3.0, 9.0, 18.0])
def test_velocity_of_a_fast_ball_converges_in_seven_frames(speed):
    rng, velocity = np.random.default_rng(5), np.array([0.9, 0.0, 0.0, 0.0, speed, 0.0])
    state = start()
    for k in range(1, 8):
        at = np.array([0.1, -0.05, 1.0]) + velocity[:3] * k * DT, exp(velocity[3:] * k * DT)
        state = update(state, k * DT, *seen(at, rng), NOISE, ACCELERATION)
    off = state.velocity - velocity
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(state.covariance)[6:]))
    assert abs(off[4]) < 0.15 * speed


def test_a_pose_beyond_a_hand_s_speed_restarts_the_filter_at_rest():
    rng = np.random.default_rng(3)
    state = start()
    for k, pose in enumerate(moved(state.position, state.rotation, rng, 30)):
        state = update(state, (k + 1) * DT, *seen(pose, rng), NOISE, ACCELERATION)
    elsewhere = state.position + np.array([0.4, 0.0, 0.0]), state.rotation
    new = update(state, state.stamp + DT, *elsewhere, NOISE, ACCELERATION)
    assert np.all(new.velocity == 0.0)
    np.testing.assert_array_equal(new.position, elsewhere[0])
    np.testing.assert_array_equal(new.covariance, initialise(0.0, *elsewhere, NOISE).covariance)
    mirrored = state.position, exp(np.array([0.0, 1.6, 0.0])) @ state.rotation
    assert np.all(update(state, state.stamp + DT, *mirrored, NOISE, ACCELERATION).velocity == 0.0)
    again = update(state, state.stamp, *mirrored, NOISE, ACCELERATION)  # at the same stamp
    assert np.all(again.velocity == 0.0)


@pytest.mark.parametrize(("off", "anew"), [(5.9, False), (6.1, True)])
def test_gate_is_six_standard_deviations(off, anew):
    state = predict(start(), DT, ACCELERATION)
    S = state.covariance[0, 0] + NOISE[0, 0]
    at = state.position + np.array([off * np.sqrt(S), 0.0, 0.0])
    found = update(start(), DT, at, state.rotation, NOISE, ACCELERATION)
    assert bool(found.position[0] == at[0]) == anew


def test_predicted_covariance_equals_that_of_numerical_derivatives():
    """A ball that rotates by a radian, without process noise."""
    velocity = np.array([0.3, -0.2, 0.1, 3.0, -4.0, 2.0])
    state = replace(start(rotation=exp(np.array([0.3, 1.0, -0.5]))), velocity=velocity)
    dt, step = 0.19, 1e-6

    def ahead(d):
        turned = exp(d[3:6]) @ state.rotation
        moved_on = predict(initialise(0.0, state.position + d[:3], turned, NOISE), 0.0, ACCELERATION)
        one = predict(replace(moved_on, velocity=velocity + d[6:]), dt, ACCELERATION)
        return one.position, one.rotation, one.velocity

    p, R, v = ahead(np.zeros(12))
    J = np.empty((12, 12))
    for k in range(12):
        a, b, c = ahead(step * np.eye(12)[k])
        J[:, k] = np.concatenate([a - p, log(b @ R.T), c - v]) / step
    expected = J @ state.covariance @ J.T
    np.testing.assert_allclose(predict(state, dt, np.zeros(6)).covariance, expected, rtol=1e-4, atol=1e-9)


def test_a_ball_that_stops_in_a_gap_has_no_reverse_velocity():
    state = start()
    for k in range(1, 20):
        at = np.array([0.1 + 0.3 * k * DT, -0.05, 1.0])
        state = update(state, k * DT, at, np.eye(3), NOISE, ACCELERATION)
    stopped = state.position + np.array([0.03, 0.0, 0.0])
    found = update(state, state.stamp + 0.4, stopped, np.eye(3), NOISE, ACCELERATION)
    assert abs(found.velocity[0]) < 2.0 * np.sqrt(found.covariance[6, 6])
    late = update(state, state.stamp + 3.0, stopped, np.eye(3), NOISE, ACCELERATION)
    assert np.all(late.velocity == 0.0)
    never = update(state, state.stamp + 1e7, stopped, np.eye(3), NOISE, ACCELERATION)
    assert np.linalg.eigvalsh(never.covariance)[0] > 0.0


def test_predicted_velocity_covariance_equals_that_of_the_predicted_state():
    state = predict(start(), 0.1, ACCELERATION)
    for later in (0.15, 0.25, 0.9):
        there = predict(state, later, ACCELERATION).covariance[6:, 6:]
        np.testing.assert_allclose(predicted_velocity_covariance(state, later, ACCELERATION), there)
