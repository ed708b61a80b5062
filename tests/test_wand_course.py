"""Pose and velocity of a ball together, against what is known without the filter."""

import numpy as np
import pytest
from scipy.stats import chi2

from spheremouse.rotation import exp, log
from spheremouse.wand.course import begun, measured, predicted, speed_covariance, told

ACCELERATION = np.repeat([2.0, 10.0], 3)
NOISE = np.diag([0.001, 0.001, 0.01, 0.02, 0.02, 0.01]) ** 2
DT = 1.0 / 30.0


def start(position=(0.1, -0.05, 1.0), rotation=None):
    return begun(0.0, np.array(position), np.eye(3) if rotation is None else rotation, NOISE)


def moved(position, rotation, rng, frames, dt=DT):
    """Poses, (position, rotation), and velocities of a ball whose acceleration is another in every frame."""
    velocity, poses = np.zeros(6), []
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


def test_what_moves_evenly_is_told_exactly():
    """Whatever the attitude, and however far it turns between two frames."""
    velocity = np.array([0.1, -0.2, 0.3, 2.0, -1.0, 3.0])
    course = start()
    for k in range(1, 200):
        t = 0.1 * k
        position = np.array([0.1, -0.05, 1.0]) + velocity[:3] * t
        course = measured(predicted(course, t, 0.1 * ACCELERATION), position, exp(velocity[3:] * t), NOISE)
    np.testing.assert_allclose(course.velocity, velocity, atol=1e-6)
    ahead = predicted(course, course.stamp + 0.05, ACCELERATION)
    np.testing.assert_allclose(ahead.position, course.position + 0.05 * velocity[:3], atol=1e-6)
    np.testing.assert_allclose(log(ahead.rotation @ course.rotation.T), 0.05 * velocity[3:], atol=1e-6)


def test_it_is_the_best_linear_estimate_of_all_that_was_seen():
    """Along one axis: weighted least squares of all frames at once, with accelerations as unknowns."""
    rng = np.random.default_rng(1)
    course, z, frames = start(), [1.0], 25
    for k in range(1, frames):
        z.append(1.0 + rng.normal(0.0, 0.01))
        course = measured(predicted(course, k * DT, ACCELERATION), np.array([0.1, -0.05, z[-1]]), np.eye(3), NOISE)
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
    assert [course.position[2], course.velocity[2]] == pytest.approx(last @ x, rel=1e-8)
    P = course.covariance[np.ix_([2, 8], [2, 8])]
    np.testing.assert_allclose(P, last @ C @ last.T, rtol=1e-8)


def test_errors_are_as_large_as_said():
    rng, nees = np.random.default_rng(2), []
    for _ in range(60):
        first = np.array([0.1, -0.05, 1.0]), exp(rng.standard_normal(3))
        poses = moved(*first, rng, 20)
        course = begun(0.0, *seen(first, rng), NOISE)
        for k, pose in enumerate(poses):
            course = measured(predicted(course, (k + 1) * DT, ACCELERATION), *seen(pose, rng), NOISE)
        p, R, v = poses[-1]
        e = np.concatenate([course.position - p, log(course.rotation @ R.T), course.velocity - v])
        nees.append(e @ np.linalg.solve(course.covariance, e))
    low, high = chi2.ppf([0.005, 0.995], 12 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


def test_the_covariance_stays_symmetric_and_positive():
    course = start()
    for k in range(1, 400):
        course = measured(predicted(course, 0.004 * k, ACCELERATION), course.position, course.rotation, 100.0 * NOISE)
        assert np.linalg.eigvalsh(course.covariance)[0] > 0.0
    np.testing.assert_array_equal(course.covariance, course.covariance.T)


def test_from_a_pose_that_no_motion_reaches_it_begins_anew():
    rng = np.random.default_rng(3)
    course = start()
    for k, pose in enumerate(moved(course.position, course.rotation, rng, 30)):
        course = measured(predicted(course, (k + 1) * DT, ACCELERATION), *seen(pose, rng), NOISE)
    ahead = predicted(course, course.stamp + DT, ACCELERATION)
    elsewhere = ahead.position + np.array([0.4, 0.0, 0.0]), ahead.rotation
    new = measured(ahead, *elsewhere, NOISE)
    assert np.all(new.velocity == 0.0)
    np.testing.assert_array_equal(new.position, elsewhere[0])
    np.testing.assert_array_equal(new.covariance, begun(0.0, *elsewhere, NOISE).covariance)
    turned = measured(ahead, ahead.position, exp(np.array([0.0, 1.6, 0.0])) @ ahead.rotation, NOISE)
    assert np.all(turned.velocity == 0.0)


def test_a_velocity_that_is_told_is_believed():
    velocity = np.array([0.1, 0.0, 0.0, 0.0, 2.0, 0.0])
    course = told(start(), velocity, 1e-6 * np.eye(6))
    np.testing.assert_array_equal(course.covariance[:6, :6], NOISE)
    ahead = predicted(course, 0.4, np.zeros(6))
    np.testing.assert_allclose(ahead.position - course.position, [0.04, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(log(ahead.rotation), [0.0, 0.8, 0.0], atol=1e-12)


def test_the_velocity_is_as_uncertain_ahead_as_when_one_is_there():
    course = predicted(start(), 0.1, ACCELERATION)
    np.testing.assert_allclose(
        speed_covariance(course, 0.25, ACCELERATION), predicted(course, 0.25, ACCELERATION).covariance[6:, 6:]
    )
