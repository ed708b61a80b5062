"""The ball's centre from the discs of one frame: exact shifts found again, its covariance, and what is no shift."""

import numpy as np
import pytest
from ball_world import CAMERA, RIG, SIGMA, detected
from conftest import directions
from numpy.testing import assert_allclose

from spheremouse.ball.centre_offset import KnownDiscs, fits, shift_of
from spheremouse.ball.points import intersect
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import exp, hat

POSE = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.35]))
DISCS = directions(40, 3)
S = 0.004  # radii


def found(shift, turn=(0.0, 0.0, 0.0), noise=0.0, rng=None, wrong=0, seen=None):
    """What a frame says when the centre is off by `shift` and the attitude taken by `turn`."""
    p = DISCS @ exp(np.array(turn)).T
    uv = project(POSE.to_cam(np.array(shift) + 0.6 * p[p[:, 2] > 0.45][:seen]), CAMERA)[0]
    if noise:
        uv = uv + noise * rng.normal(size=uv.shape)
    uv[:wrong] += [4.0, 1.0]
    points = intersect(detected(uv, None), RIG, POSE)
    variance = np.full(len(DISCS), 1e-8)
    return shift_of(points, np.zeros(len(points)), KnownDiscs(DISCS, variance, np.eye(3), np.zeros(3)), 0.6, 0.07)


def by_least_squares(points, delay, discs, radius, reach):
    """Return pairs, shift, covariance, and the chi-squares without and with a shift."""
    expected = discs.directions @ discs.attitude.T
    distance = np.linalg.norm(points.direction[:, None] - expected, axis=2)
    near = distance < 2.0 * np.sin(0.5 * reach)
    pairs = [(i, k) for i, k in np.argwhere(near) if distance[i, k] == distance[i].min() == distance[:, k].min()]
    rows, right = [np.diag([1e-9**0.5] * 3 + [10.0] * 3)], [np.zeros(6)]
    for i, k in pairs:
        C = points.image_covariance[i] / radius**2 + (discs.variance[k] + 5e-4**2) * np.eye(3)
        white, p = np.linalg.inv(np.linalg.cholesky(C)), expected[k]
        rows.append(white @ np.hstack([-hat(p), -radius * points.ddirection_drig[i, :, 1:]]))
        right.append(white @ (points.direction[i] - p - delay[i] * np.cross(discs.rate, p)))
    A, z, k = np.concatenate(rows), np.concatenate(right), len(pairs)
    x, both, *_ = np.linalg.lstsq(A, z)
    turned = np.linalg.lstsq(A[:, :3], z)[1]
    C = np.linalg.inv(A.T @ A)[3:, 3:]
    return k, radius * x[3:], radius**2 * C, turned[0] / (2 * k - 3), both[0] / (2 * k - 6)


def test_a_frame_agrees_with_least_squares():
    rng = np.random.default_rng(4)
    for _ in range(20):
        attitude, rate = exp(0.005 * rng.normal(size=3)), rng.normal(size=3)
        p = DISCS[DISCS[:, 2] > 0.45]
        uv = project(POSE.to_cam(0.003 * rng.normal(size=3) + 0.6 * p), CAMERA)[0] + 0.3 * rng.normal(size=(len(p), 2))
        points, discs = (
            intersect(detected(uv, None), RIG, POSE),
            KnownDiscs(DISCS, 1e-7 * rng.random(40), attitude, rate),
        )
        delay = 0.01 * rng.normal(size=len(points))
        out, (k, shift, C, turned, both) = (f(points, delay, discs, 0.6, 0.07) for f in (shift_of, by_least_squares))
        assert out.pairs == k >= 5
        assert_allclose(out.shift, shift, rtol=1e-6, atol=1e-9)
        assert_allclose(out.covariance, C, rtol=1e-6, atol=1e-12)
        assert_allclose(out.mahalanobis**2, shift @ np.linalg.solve(C, shift), rtol=1e-6)
        assert_allclose((out.chi2_rotation, out.chi2_with_offset), (turned, both), rtol=1e-6)


@pytest.mark.parametrize("shift", [[0.0, 0.03, 0.0], [0.02, -0.01, 0.0], [0.0, 0.0, 0.03], [0.005, 0.0, 0.0]])
@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.01, -0.005, 0.01]])
def test_a_shift_of_the_centre_is_found(shift, turn):
    out = found(shift, turn)
    assert out.pairs >= 5
    assert_allclose(out.shift, shift, atol=0.2 * np.linalg.norm(shift))  # the equations are linear, 3 cm are not
    assert not fits(out, 0.6, S)


def test_a_rotation_alone_is_no_shift_and_noise_scatters_as_it_says():
    rng = np.random.default_rng(0)
    mahalanobis, before = [], []
    for _ in range(200):
        out = found([0.0, 0.0, 0.0], 0.01 * rng.normal(size=3), SIGMA, rng)
        assert fits(out, 0.6, S)
        mahalanobis.append(out.mahalanobis**2)
        before.append(out.chi2_rotation)
    # chi-square with 3 degrees of freedom and 1: less, since the floor for print is not in the noise here
    assert 0.05 < np.mean(mahalanobis) < 3.0
    assert 0.02 < np.mean(before) < 1.0


def test_one_wrong_pair_is_no_shift():
    out = found([0.0, 0.0, 0.0], wrong=1)
    assert out.chi2_rotation > 3.0
    assert out.chi2_with_offset > 0.3 * out.chi2_rotation


@pytest.mark.parametrize("seen", [0, 2, 3])
def test_three_discs_say_nothing(seen):
    assert found([0.0, 0.03, 0.0], seen=seen) is None


def test_discs_seen_many_times_over_in_one_place_tell_no_shift():
    """Nothing tells a turn about the line of sight, and of such equations rounding makes some that have no solution."""
    for place in np.random.default_rng(0).uniform((200, 120), (440, 360), (100, 2)):
        points = intersect(detected(np.tile(place, (9, 1)), None), RIG, POSE)
        discs = np.tile(points.direction[0], (9, 1))
        for variance in (0.0, 1e-8):
            out = shift_of(
                points, np.zeros(9), KnownDiscs(discs, np.full(9, variance), np.eye(3), np.zeros(3)), 0.6, 0.07
            )
            assert out is None or np.isfinite(out.mahalanobis)
