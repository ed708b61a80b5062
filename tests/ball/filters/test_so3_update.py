"""The correction with a step of unknown instant and level, against the update of each hypothesis on its own."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from spheremouse.ball.filters.so3_motion import AXES, CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT, RIG_ROW
from spheremouse.geometry.rotation import exp, left_jacobian, log, tangent_basis
from spheremouse.native import kernels
from tests.ball.filters import twins
from tests.ball.filters.twins import linear, place, transfer

DT = 1.0 / 30.0
BETWEEN = 0.2
RESOLVED = 1.0 / 30.0  # s
INSTANTS = (np.arange(6) + 0.5) / 6
VARIANCES = np.array([0.1, 2.0, 30.0]) ** 2
USUAL = np.array([0.8, 0.15, 0.05])
N = MAP_OFFSET + 8 + CLONE_DIM  # four discs
APART, HELD = slice(KINEMATIC_DIM, MAP_OFFSET), slice(AXES, MAP_OFFSET)
WITH_RIG = slice(RIG_ROW, MAP_OFFSET)
SIGMA = np.repeat([1e-3, 0.02, 0.5, 3e-3, 1e-3, 5e-4, 1e-3], [3, 3, 3, 10, 1, 8, 3])


def covariance(rng, n):
    A = rng.normal(size=(n, 2 * n))
    return A @ A.T / (2 * n)


def drawn(rng, far):
    """A prior with three modes, `far` standard deviations apart: sizes as in play."""
    k = MAP_OFFSET - KINEMATIC_DIM
    to_motion, to_apart = np.zeros((N, 6)), np.zeros((N, k))
    to_motion[3:9], to_apart[APART] = np.eye(6), np.eye(k)
    others = np.r_[0:3, MAP_OFFSET:N]
    to_motion[others], to_apart[others] = rng.normal(size=(len(others), 6)), rng.normal(size=(len(others), k))
    to_apart[3:9] = rng.normal(size=(6, k))
    motion = np.array([share * covariance(rng, 6) for share in (0.05, 0.1, 0.2)])
    weights = rng.dirichlet(np.ones(9)).reshape(3, 3)
    means = far * rng.normal(size=(3, 6))
    means -= weights.sum(axis=1) @ means
    own = np.zeros((N, N))
    own[np.ix_(others, others)] = covariance(rng, len(others))
    apart = covariance(rng, k)
    shared = to_apart @ apart @ to_apart.T + own
    of_modes = np.array([to_motion @ C @ to_motion.T + shared for C in motion]) * np.outer(SIGMA, SIGMA)
    means = means @ to_motion.T * SIGMA
    return means, of_modes, weights


def frame(rng, P, holds=False):
    """A ball with covariance P that hardly turns, and the innovations of its discs: H, R, z and the points for them."""
    discs = rng.normal(size=(4, 3))
    discs /= np.linalg.norm(discs, axis=1, keepdims=True)
    rates = 0.002 * rng.normal(size=3), 5.0 * rng.normal(size=3)  # too slow to determine the readout
    body = exp(rng.normal(size=3)), *rates, discs, tangent_basis(discs), P, 1e-3, np.zeros(4), 4, holds, 0, np.zeros(3)
    noise = rng.normal(size=(4, 3, 3)) * 3e-4
    row = rng.uniform(-0.5, 0.5, 4)
    points = discs, noise @ noise.transpose(0, 2, 1), 0.01 * row, row, rng.normal(size=(4, 3, 4)), 1.0, np.zeros(4)
    _, H, noise = map(np.array, zip(*(linear(body, points, k, k) for k in range(4)), strict=True))
    R = block_diag(*noise) + min(np.trace(P[:3, :3]) / 3.0, 0.01) ** 2 * np.eye(8)
    return body, points, H.reshape(8, N), R


def showing(body, points, z):
    """Return the points in directions with the innovations z, (8,)."""
    delay = points[2] + body[6] * points[3]
    there = [(*place(body, k, delay[k])[:2], z[2 * k : 2 * k + 2]) for k in range(4)]
    return np.array([np.sqrt(1.0 - at @ at) * p + E @ at for p, E, at in there]), *points[1:]


def activity(variances):
    return 13.8, BETWEEN, 1.0, variances, np.zeros(len(variances)), np.resize(USUAL, len(variances))


def corrected(body, points, dt, modes):
    """Return covariance, level weights, level, modes, log likelihood, and the error vector by which the state moved."""
    pairs, pending = (np.arange(4), np.arange(4), np.zeros((9, 9))), (np.zeros((9, 9)), dt, modes[2].sum(axis=0), modes)
    (motion, P, at_level, (level, _, readout, rig_error, eccentricity), modes), log_likelihood = kernels.correct(
        body, points, pairs, pending, activity(VARIANCES)
    )
    attitude, rate, acceleration, discs, _ = motion
    along = np.einsum("kia,ki->ka", body[4], discs) / np.sum(body[3] * discs, axis=1, keepdims=True)
    dx = np.zeros(N)
    dx[:KINEMATIC_DIM] = *log(attitude @ body[0].T), *(rate - body[1]), *(acceleration - body[2])
    dx[KINEMATIC_DIM:AXES] = *(eccentricity - body[11]), *(rig_error - body[7])
    dx[READOUT], dx[MAP_OFFSET:-CLONE_DIM] = readout - body[6], along.ravel()
    return P, at_level, level, modes, log_likelihood, dx


def stepped(at_level):
    """Return the probabilities of the levels after a step: the first makes none, the others keep `USUAL`."""
    usual, n = USUAL[1:], len(at_level) - 1
    move = np.array([[abs(i - j) == 1 and min(1.0, usual[j] / usual[i]) / 3.0 for j in range(n)] for i in range(n)])
    move = move + np.diag(1.0 - move.sum(axis=1))
    assert_allclose(usual @ move, usual)
    return np.concatenate([[0.0], at_level[1:] @ move])


def needed_to_stop(rate):
    """Return the probabilities of the levels of a step that stops the ball: the level that it takes, or a neighbour."""
    enough = 3.0 * VARIANCES[1:] >= rate @ rate / BETWEEN**2
    needed = np.zeros(len(VARIANCES))
    needed[1 + (np.argmax(enough) if enough.any() else len(enough) - 1)] = 1.0
    return stepped(needed)


def each_on_its_own(means, covariances, weights, H, R, z, motion, held, dt):
    """Return for each hypothesis its new mode, its level, whether it is a step, its probability, and its moments."""
    (rate, acceleration), quiet, fades = motion, np.exp(-dt / BETWEEN), min(1.0, dt / RESOLVED)
    recent = (1.0 - np.exp(-max(dt, RESOLVED) / BETWEEN)) / len(INSTANTS)
    for mode, (mean, P, at_level) in enumerate(zip(means, covariances, weights, strict=True)):
        for level, weight in enumerate(at_level):
            for after, share in ((0, fades if mode else 1.0), (mode, 1.0 - fades)) if mode else ((0, 1.0),):
                yield after, level, False, *schmidt(share * weight * (quiet if level else 1.0), mean, P, H, R, z, held)
        turning, before = rate + mean[3:6], acceleration + mean[6:9]
        as_last, of_stop = stepped(at_level), at_level[1:].sum() * needed_to_stop(turning)
        for level, variance in enumerate(VARIANCES):
            stopping = -turning * min(1.0 / BETWEEN, np.sqrt(3.0 * variance) / np.linalg.norm(turning))
            kinds = (as_last, np.zeros(3)), (as_last, -before), (of_stop, stopping - before)
            likely = [(at[level], step) for at, step in kinds if recent * at[level] > 1e-5]
            for instant, (weight, step) in product(INSTANTS, likely):
                t, share = instant * dt, (1.0 - quiet) / len(INSTANTS) / 3.0 * weight
                effect = np.zeros((N, 3))
                effect[:KINEMATIC_DIM] = np.kron(np.array([[0.5 * t * t], [t], [1.0]]), np.eye(3))
                moved, spread = mean + effect @ step, P + variance * effect @ effect.T
                yield level, level, True, *schmidt(share, moved, spread, H, R, z, held)


def schmidt(share, mean, P, H, R, z, held):
    S = R + H @ P @ H.T
    K = P @ H.T @ np.linalg.inv(S)
    K[held] = 0.0
    rest = np.eye(N) - K @ H
    after = rest @ P @ rest.T + K @ R @ K.T
    return share * multivariate_normal.pdf(z, H @ mean, S), mean + K @ (z - H @ mean), after


def moments(p, means, covariances):
    mean = p @ means
    return mean, np.einsum("k,kij->ij", p, covariances) + (means - mean).T @ (p[:, None] * (means - mean))


@pytest.mark.parametrize("dt", [DT, 0.1 * DT])
@pytest.mark.parametrize("holds", [False, True])
@pytest.mark.parametrize("far", [0.0, 0.3, 2.0])
def test_the_correction_is_the_mean_over_the_hypotheses_of_schmidts(far, holds, dt):
    """Without hypotheses below a thousandth of their mode, which are left out."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        means, covariances, weights = drawn(rng, far)
        _, prior = moments(weights.sum(axis=1), means, covariances)
        body, points, H, R = frame(rng, prior, holds)
        z = 2e-3 * rng.normal(size=8)
        each = each_on_its_own(means, covariances, weights, H, R, z, body[1:3], WITH_RIG if holds else HELD, dt)
        new, levels, steps, p, after, spreads = map(np.array, zip(*each, strict=True))
        for level in range(1, len(VARIANCES)):
            of_level = steps & (new == level)
            p[of_level & (p < max(1e-3 * p[of_level].sum(), 1e-8 * p.sum()))] = 0.0
        likelihood, p = p.sum(), p / p.sum()
        mean, total = moments(p, after, spreads)
        total[-CLONE_DIM:, -CLONE_DIM:] += np.outer(mean, mean)[-CLONE_DIM:, -CLONE_DIM:]  # about what was sent
        expected = mean.copy()
        expected[-CLONE_DIM:] = 0.0
        T = transfer(body, total, expected)
        total = T @ total @ T.T

        modes = means[:, 3:9].copy(), covariances[:, 3:9, 3:9].copy(), weights
        P, at_level, _, modes, log_likelihood, dx = corrected(body, showing(body, points, z), dt, modes)
        scale = np.sqrt(np.diag(total))
        assert_allclose(dx / scale, expected / scale, atol=1e-7)
        assert_allclose(P / np.outer(scale, scale), total / np.outer(scale, scale), atol=1e-7)
        assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > -1e-9
        assert_allclose(log_likelihood, np.log(likelihood), atol=1e-9)
        assert_allclose(at_level, [p[levels == k].sum() for k in range(len(VARIANCES))], atol=1e-9)
        for k in range(len(VARIANCES)):
            share = p[new == k].sum()
            if share > 0.0:
                m, C = moments(p[new == k] / share, after[new == k][:, 3:9], spreads[new == k][:, 3:9, 3:9])
                s = np.sqrt(np.diag(C))
                assert_allclose(modes[0][k] / s, (m - mean[3:9]) / s, atol=1e-6)
                assert_allclose(modes[1][k] / np.outer(s, s), C / np.outer(s, s), atol=1e-6)


def test_a_wrong_pose_leaves_the_covariance_positive_in_a_long_jerky_play():
    """Modes that lie far apart, a pose that is correlated with all, and one step after the other."""
    rng = np.random.default_rng(2)
    means, covariances, weights = drawn(rng, 3.0)
    _, P = moments(weights.sum(axis=1), means, covariances)
    body, points, H, R = frame(rng, P)
    modes = means[:, 3:9].copy(), covariances[:, 3:9, 3:9].copy(), weights
    F = np.eye(N)
    F[:3, 3:6] = F[3:6, 6:9] = DT * np.eye(3)
    F[:3, 6:9] = 0.5 * DT * DT * np.eye(3)
    for _ in range(200):
        z = np.linalg.cholesky(H @ P @ H.T + R) @ rng.normal(size=8) * rng.choice([1.0, 10.0])
        z *= min(1.0, 0.3 / np.abs(z).max())  # a pair is in view
        P, _, _, modes, *_ = corrected((*body[:5], P, *body[6:]), showing(body, points, z), DT, modes)
        P = F @ P @ F.T
        modes = modes[0] @ F[3:9, 3:9].T, F[3:9, 3:9] @ modes[1] @ F[3:9, 3:9].T, modes[2]
        scale = np.sqrt(np.diag(P))
        assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > -1e-8


def test_without_an_interval_there_is_no_step():
    rng = np.random.default_rng(3)
    _, (P, *_), weights = drawn(rng, 0.0)
    body, points, H, R = frame(rng, P)
    z = 3e-3 * rng.normal(size=8)
    modes = np.zeros((1, 6)), P[None, 3:9, 3:9].copy(), weights[:1] / weights[0].sum()
    _, at_level, level, _, _, dx = corrected(body, showing(body, points, z), 0.0, modes)
    assert_allclose(at_level, modes[2][0])
    assert level == 1.0
    free = np.r_[0:AXES, MAP_OFFSET : N - CLONE_DIM]
    assert_allclose(dx[free], (P @ H.T @ np.linalg.solve(H @ P @ H.T + R, z))[free], rtol=1e-7, atol=1e-12)


def test_a_large_correction_is_made_again_about_where_it_led():
    """Then the innovations that remain are those of the linear model there."""
    rng = np.random.default_rng(7)
    P = 1e-12 * np.eye(N)
    P[:3, :3] = 0.04 * np.eye(3)
    body, points, *_ = frame(rng, P)
    turn = np.array([0.2, -0.1, 0.15])
    true = (exp(turn) @ body[0], *body[1:])
    seen = showing(true, points, np.zeros(8))
    modes = np.zeros((1, 6)), P[None, 3:9, 3:9].copy(), np.full((1, 3), 1.0 / 3.0)
    dx = corrected(body, seen, 0.0, modes)[-1]
    assert_allclose(dx[:3], turn, atol=2e-3)


def test_the_covariance_of_a_turn_is_that_of_its_two_attitudes():
    rng = np.random.default_rng(4)
    P, turn = covariance(rng, N), rng.normal(size=3)
    J = np.linalg.inv(left_jacobian(turn))
    A = np.zeros((6, N))
    A[:3, :3], A[3:, 3:6], A[:3, -CLONE_DIM:] = J, np.eye(3), -J @ exp(turn)
    assert_allclose(kernels.since_reference(P, turn), A @ P @ A.T, rtol=1e-12, atol=1e-12)


def test_discs_move_along_their_axes_which_stay_orthonormal_and_keep_their_hand():
    """Also across z = 0, where `tangent_basis` jumps: the covariance is written in the axes."""
    rng = np.random.default_rng(5)
    frames = exp(rng.normal(size=(4, 3)))
    frames[0] = exp(np.array([0.0, -1e-6, 0.0]))
    discs, basis = frames[:, :, 0].copy(), frames[:, :, 1:].copy()
    basis[::2, :, 1] *= -1.0  # left-handed as well
    dx = 0.1 * rng.normal(size=N)
    dx[MAP_OFFSET + 1] = 0.1
    rate, acceleration = rng.normal(size=(2, 3))
    body = frames[0], rate, acceleration, discs, basis, np.zeros((N, N)), 0.1, np.ones(4), 4, False, 0, np.ones(3)
    (attitude, new_rate, new_acceleration, moved, axes), _, readout, rig_error, eccentricity = kernels.move(body, dx)
    assert_allclose((*new_rate, *new_acceleration), (*(rate + dx[3:6]), *(acceleration + dx[6:9])))
    assert readout == 0.1 + dx[READOUT]
    assert_allclose((*eccentricity, *rig_error), 1.0 + dx[KINEMATIC_DIM:AXES])
    to = discs + np.einsum("kia,ka->ki", basis, dx[MAP_OFFSET:-CLONE_DIM].reshape(4, 2))
    assert_allclose(attitude, exp(dx[:3]) @ frames[0], atol=1e-15)
    assert_allclose(moved, to / np.linalg.norm(to, axis=1, keepdims=True), atol=1e-15)
    assert discs[0, 2] > 0.0 > moved[0, 2]
    full = np.concatenate([moved[:, :, None], axes], axis=2)
    assert_allclose(full.transpose(0, 2, 1) @ full, np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-15)
    assert np.all(np.einsum("kia,kia->ka", axes, basis) > 0.9)


def test_the_covariance_follows_a_move():
    body, _ = twins.drawn(4, sigma=0.03)
    dx = np.random.default_rng(7).normal(size=len(body[5])) * np.sqrt(np.diag(body[5]))
    T = transfer(body, body[5], dx)
    _, P, *_ = kernels.move(body, dx)
    assert not np.allclose(P, body[5], rtol=1e-3, atol=0.0)
    assert_allclose(P, T @ body[5] @ T.T, rtol=1e-8, atol=1e-9 * np.abs(P).max())


def test_a_wrong_argument_is_named():
    rng = np.random.default_rng(6)
    _, (P, *_), weights = drawn(rng, 0.0)
    body, points, *_ = frame(rng, P)
    modes = np.zeros((1, 6)), P[None, 3:9, 3:9].copy(), weights[:1]
    pairs, pending = (np.arange(4), np.arange(4), np.zeros((9, 9))), (np.zeros((9, 9)), DT, weights[0], modes)
    good = [body, points, pairs, pending, activity(VARIANCES)]
    for at, wrong, name in [
        (0, (*body[:5], P[:5], *body[6:]), "joint"),
        (2, (*pairs[:2], np.zeros((8, 9))), "added"),
        (2, (pairs[0], pairs[1][:3], pairs[2]), "columns"),
        (3, (*pending[:3], (np.zeros((2, 6)), *modes[1:])), "modes"),
        (4, activity(VARIANCES[:2].copy()), "weights"),
        (4, (*good[4][:4], np.zeros(1), good[4][5]), "drift"),
    ]:
        with pytest.raises(TypeError, match=name):
            kernels.correct(*good[:at], wrong, *good[at + 1 :])
    for which in (np.array([4, 0, 1, 2]), np.array([-1, 0, 1, 2])):
        with pytest.raises(IndexError, match="columns"):
            kernels.correct(*good[:2], (pairs[0], which, pairs[2]), *good[3:])
    with pytest.raises(ValueError, match="positive definite"):
        kernels.correct((*body[:5], -P, *body[6:]), *good[1:])
