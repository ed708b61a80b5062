"""The camera of the default filter: pose and ball, wrong in every frame alike, and a rolling shutter."""

from dataclasses import replace

import numpy as np
import pytest
from ball_world import CAMERA, detected, image_of, other
from conftest import covariance_of, seeds
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.optimize import least_squares
from scipy.stats import chi2
from so3_world import (
    DISCS,
    DT,
    FILTER,
    HORIZON,
    OWN,
    RADIUS,
    SETTINGS,
    SIGMA,
    draw,
    innovation,
    own_motion,
    points_at,
    settled,
    squared,
    white_jerk,
    with_errors,
)

from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_camera import with_seen_centre, with_uncertain_turn
from spheremouse.ball.filters.so3_map import augment
from spheremouse.ball.filters.so3_motion import AXES, CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.ball.filters.so3_rig import Station
from spheremouse.ball.filters.so3_state import CENTRE, COMMON, ECCENTRICITY, RIG, inject
from spheremouse.ball.points import intersect
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball.profile import play

STATION = np.array([0.2, 0.3, 1.9])
PIXEL = 0.07  # px, noise of a centre


def station(scale):
    """Rig, pose and filter of a camera whose pose is known to `scale` mm and mrad, the ball alike."""
    z = -STATION / np.linalg.norm(STATION)
    x = np.cross([0.3, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    pose = Pose(rotation, STATION, scale**2 * covariance_of([1e-3, 1e-3, 2e-3, 1e-3, 1e-3, 1e-3], 1))
    ball = Ball(RADIUS, np.zeros(3), scale**2 * covariance_of([1e-3, 1e-3, 1e-3, 5e-4], 2))
    rig = Rig(CAMERA, ball, NO_TARGETS, 0.02)
    distance = np.linalg.norm(STATION)
    considered = block_diag(pose.covariance, rig.ball.covariance)
    filter_ = So3Filter(OWN.settings, Station(STATION / distance, RADIUS / distance, RADIUS, considered), 0.02 / RADIUS)
    return rig, pose, filter_


def in_view(R, margin):
    p = DISCS @ R.T
    return p[p @ STATION / np.linalg.norm(STATION) > RADIUS / np.linalg.norm(STATION) + margin]


def played(filter_, rig, pose, errors, rng):
    """Mean squares of attitude and rate error with each of `errors`, (n, 10), and the part of true pairs made."""
    squares, used, possible = [], 0, 0
    for error in errors:
        through = other(rig, pose, error)
        state = filter_.initial(0.0, np.eye(3))
        known = np.zeros((0, 3))
        for k, (R, w, _) in enumerate(own_motion(rng, 60)):
            d = in_view(R, 0.3)
            points = intersect(detected(image_of(d, *through), rng, PIXEL), rig, pose)
            state = filter_.update(filter_.predict(state, k * DT), points)
            # the discs that were in view before: each of them is a pair
            possible += np.count_nonzero(np.max((d @ R) @ known.T, axis=1, initial=-1.0) > 1.0 - 1e-9)
            used += len(state.used)
            known = np.concatenate([known, d @ R])
            if k >= 20:
                P = state.covariance
                turn, rate = log(R @ state.attitude.T), w - state.rate
                squares.append([squared(turn, P[:3, :3]), squared(rate, P[3:, 3:])])
    return np.mean(squares, axis=0), used / possible


def test_discs_found_with_a_wrong_rig_have_its_error_in_common():
    """Given the rig, each disc is where its ray cuts the ball, though no frame has shown that yet."""
    rig, pose, consider = station(0.0)
    seen = detected(image_of(in_view(np.eye(3), 0.2), rig, pose), None, PIXEL)
    state = consider.initial(0.0, np.eye(3))
    for k in range(3):
        state = consider.update(consider.predict(state, k * DT), intersect(seen, rig, pose))
    P = consider.with_rig_uncertainty(state, np.inf).joint
    shift = np.concatenate([[2e-4], 5e-4 * STATION / np.linalg.norm(STATION)])
    error = P[:, RIG] @ np.linalg.pinv(P[RIG, RIG]) @ shift
    given = state.discs + np.einsum("mij,mj->mi", state.basis, error[MAP_OFFSET:-CLONE_DIM].reshape(-1, 2))
    about_it = intersect(seen, rig, pose, shift).direction
    assert np.abs(about_it - state.discs).max() > 2e-4
    assert_allclose(given, about_it, atol=2e-6)


def test_errors_of_pose_and_ball_are_in_the_covariance():
    """60 drawn poses and balls, constant over a run: chi-square of attitude and rate, 95 % band of the runs' mean."""
    rig, pose, consider = station(0.5)
    rng = np.random.default_rng(21)
    errors = draw(consider.station.considered, rng, 60)
    squares, used = played(consider, rig, pose, errors, rng)
    low, high = chi2.ppf([0.025, 0.975], 3 * 60) / 60
    assert np.all((low < squares) & (squares < high))
    assert used > 0.8
    ignorant = with_errors(consider, considered=np.zeros((10, 10)))
    squares, _ = played(ignorant, rig, pose, errors[:8], rng)
    assert squares[0] > 20.0 * high  # far outside: measured 150 to 230 where 3 is right
    assert squares[1] > 1.5 * high


def test_what_pose_and_ball_are_wrong_in_together_is_no_error_of_the_attitude():
    """Camera and ball shifted alike by 5 mm, lengths wrong by 1 %: no ray meets the ball elsewhere for that."""
    rig, pose, apart = station(0.2)
    grown = 0.01 * np.concatenate([STATION, np.zeros(6), [RADIUS]])
    shift = 0.005 * np.concatenate([np.eye(3), np.zeros((3, 3)), np.eye(3), np.zeros((1, 3))])
    C = apart.station.considered + np.outer(grown, grown) + shift @ shift.T
    together = with_errors(apart, considered=C)
    rng = np.random.default_rng(25)
    low, high = chi2.ppf([0.025, 0.975], 3 * 40) / 40
    squares, used = played(together, rig, pose, draw(C, rng, 40), rng)
    assert low < squares[0] < high
    assert used > 0.8
    sigmas = []
    for filter_ in (apart, together):
        state = filter_.initial(0.0, np.eye(3))
        for k in range(30):
            uv = image_of(in_view(exp(np.array([1.0, 0.3, 0.2]) * k * DT), 0.3), rig, pose)
            points = intersect(detected(uv, None, PIXEL), rig, pose)
            state = filter_.update(filter_.predict(state, k * DT), points)
        sigmas.append(np.sqrt(np.diag(state.covariance))[:3])
    assert_allclose(sigmas[1], sigmas[0], rtol=0.01)


def test_no_disc_is_turned_away_for_an_error_that_is_considered():
    rig, pose, consider = station(1.0)
    rng = np.random.default_rng(22)
    assert played(consider, rig, pose, draw(consider.station.considered, rng, 15), rng)[1] > 0.98


def test_innovation_and_new_discs_depend_on_pose_and_ball_as_finite_differences_say():
    """Rays of one picture meet the ball through another pose: differences against H and against the new disc's."""
    rig, pose, consider = station(1.0)
    d = in_view(np.eye(3), 0.2)
    seen_at = detected(image_of(d, rig, pose), None, PIXEL)
    points = intersect(seen_at, rig, pose)
    state = consider.update(consider.initial(0.0, np.eye(3)), points)
    state = inject(state, 1e-5 * np.random.default_rng(23).normal(size=len(state.joint)))  # not zero innovations
    rows = np.arange(len(d))
    known = state._replace(joint=np.eye(len(state.joint)))  # then H @ joint is H
    A = consider.station.common_by_pose_and_ball()
    H = innovation(known, points, rows)[1][:, COMMON] @ A
    bare = known._replace(landmarks=np.zeros((0, 3)), basis=np.zeros((0, 3, 2)), joint=np.eye(MAP_OFFSET + CLONE_DIM))
    added = augment(bare, points, rows, RADIUS)
    ours = added.joint[MAP_OFFSET:-CLONE_DIM, COMMON] @ A
    h = 1e-5
    for i in range(10):
        ends = [intersect(seen_at, *other(rig, pose, s * h * np.eye(10)[i])) for s in (1, -1)]
        z = [innovation(known, p, rows)[2] for p in ends]
        # the pose assumed is the truth less the error: what is seen moves against it
        assert_allclose(-(z[0] - z[1]) / (2 * h), H[:, i], atol=2e-4 * np.abs(H[:, i]).max())
        new = [augment(bare, p, rows, RADIUS).discs for p in ends]
        slope = np.einsum("mij,mi->mj", added.basis, (new[0] - new[1]) / (2 * h)).ravel()
        assert_allclose(ours[:, i], slope, atol=2e-4 * np.abs(slope).max())


def test_update_with_considered_errors_is_the_batch_solution():
    """Two frames of five discs: least squares over pixels with pose and ball as unknowns that have a prior."""
    scale, dt, jolt, sigma = 2e-3, 0.1, 1e-4, 1e-4
    rig, pose, consider = station(scale)
    quiet = replace(consider.settings, acceleration_sigma=jolt, start_rate_sigma=1e-4)
    consider = replace(consider, settings=quiet)
    rng = np.random.default_rng(24)
    through = other(rig, pose, draw(consider.station.considered, rng, 1)[0])
    w = 1e-4 * np.array([0.4, -0.7, 0.5])
    discs = in_view(np.eye(3), 0.2)[:5]
    frames = [detected(image_of(discs @ exp(w * t).T, *through), rng, sigma) for t in (0.0, dt)]
    state = consider.initial(0.0, np.eye(3))
    state.joint[ECCENTRICITY] = 0.0  # not negligible beside so little noise
    for k in range(2):
        state = consider.update(consider.predict(state, k * dt), intersect(frames[k], rig, pose))
    assert len(state.used) == 5

    F, Q = white_jerk(dt, jolt)
    Wq = np.kron(np.linalg.cholesky(np.linalg.inv(Q)).T, np.eye(3))
    Wc = np.linalg.cholesky(np.linalg.inv(consider.station.considered)).T

    def residuals(x):
        start, now, error = x[:6] * 1e-4, x[6:15] * 1e-4, x[15:25] * scale * 1e-3
        d = state.discs + np.einsum("mij,mj->mi", state.basis, 1e-4 * x[25:].reshape(-1, 2))
        before = np.concatenate([np.zeros(3), start])
        out = [start[:3] / 1e-4, start[3:] / jolt, Wq @ (now - (F @ before.reshape(3, 3)).ravel()), Wc @ error]
        place = other(rig, pose, error)
        for turn, frame in zip((np.zeros(3), now[:3]), frames, strict=True):
            out.append((image_of(d @ exp(turn).T, *place) - frame.centre).ravel() / sigma)
        return np.concatenate(out)

    fit = least_squares(residuals, np.zeros(25 + 10), "3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    unit = np.concatenate([np.full(15, 1e-4), np.full(10, scale * 1e-3), np.full(10, 1e-4)])
    C = np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(unit, unit)
    ours = np.concatenate([log(state.attitude), state.rate, state.acceleration])
    sd = np.sqrt(np.diag(C))
    assert_allclose(ours / sd[6:15], (fit.x * unit)[6:15] / sd[6:15], atol=0.03)
    at = np.concatenate([np.arange(6, 15), np.arange(25, 35)])
    rest = np.concatenate([np.arange(KINEMATIC_DIM), np.arange(MAP_OFFSET, len(state.joint) - CLONE_DIM)])
    A = consider.station.common_by_pose_and_ball()
    A = A[1:]  # without the focal length, which is exact
    prior, posterior = (A @ P @ A.T for P in (consider.station.considered, C[15:25, 15:25]))
    scale_at = np.outer(sd[at], sd[at])
    assert_allclose(state.joint[np.ix_(rest, rest)] / scale_at, C[np.ix_(at, at)] / scale_at, atol=0.02)
    spread = np.sqrt(np.diag(prior))
    cross = np.outer(sd[at], spread)
    batch = C[np.ix_(at, np.arange(15, 25))] @ A.T
    assert_allclose(state.joint[rest, COMMON][:, 1:] / cross, batch / cross, atol=0.02)
    assert_allclose(state.joint[AXES:READOUT, AXES:READOUT], prior[3:, 3:])
    assert_allclose(
        state.joint[CENTRE, CENTRE] / np.outer(spread[:3], spread[:3]),
        posterior[:3, :3] / np.outer(spread[:3], spread[:3]),
        atol=0.02,
    )
    assert_allclose(state.centre / spread[:3], (A @ (fit.x * unit)[15:25])[:3] / spread[:3], atol=0.02)


FLICK = 7.0 * np.array([1.0, 0.3, 0.5]) / np.linalg.norm([1.0, 0.3, 0.5])  # 400 deg/s
SHUTTER = 0.03  # s, for all rows
UNKNOWN = 0.015  # s, what is not known of it
LEARNING = with_errors(FILTER, readout_sigma=UNKNOWN)


def rolled(attitude, rng, *, shutter=SHUTTER, known=None):
    """Points of the discs in view, each at its own time: `attitude(t)`, (n, 3, 3), at t, (n,) s, after the stamp.

    The rows take `shutter` s; the points' delays are those of `known` s, by default the truth.
    """
    d = DISCS[(DISCS @ attitude(np.zeros(1))[0].T)[:, 2] > HORIZON + 0.1]
    t = np.zeros(len(d))
    for _ in range(6 if shutter else 1):  # when its row is read depends on where it is by then
        p = np.einsum("kij,kj->ki", attitude(t), d)
        t = -0.5 * shutter * p[:, 1]
    row = -0.5 * p[:, 1]
    return replace(points_at(p, rng=rng), delay=(shutter if known is None else known) * row, row=row)


def test_points_of_a_rolling_shutter_give_the_attitude_at_the_stamp():
    """400 deg/s, delays up to 15 ms, 40 runs; the bound is four standard deviations of their mean."""
    quiet = replace(FILTER, settings=replace(SETTINGS, start_rate_sigma=0.05))
    rng = np.random.default_rng(31)
    errors, sigmas = [], []
    for _ in range(40):
        state = quiet.initial(0.0, np.eye(3))._replace(rate=FLICK)
        for k in range(25):
            points = rolled(lambda t, k=k: exp(FLICK * (k * DT + t[:, None])), rng)
            state = quiet.update(quiet.predict(state, k * DT), points)
        errors.append(log(exp(FLICK * 24 * DT) @ state.attitude.T))
        sigmas.append(np.sqrt(np.diag(state.joint)[:3]))
    assert np.max(np.abs(points.delay)) > 0.01
    sigma = np.mean(sigmas, axis=0)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4.0 * sigma / np.sqrt(40))
    assert np.all(np.std(errors, axis=0) < 1.3 * sigma)


def played_through(filter_, shutter, known, seed):
    """The last state, and the squares of the attitude's errors, (frames,) rad², while somebody plays for 6 s."""
    motion, rng = play(6.0, np.random.default_rng(seed)), np.random.default_rng(100 + seed)
    stamps = np.arange(0.0, 6.0, DT)
    attitudes = motion.attitude(stamps)
    state, squares = filter_.initial(0.0, attitudes[0]), []
    for t, R in zip(stamps, attitudes, strict=True):
        points = rolled(lambda late, t=t: motion.attitude(t + late), rng, shutter=shutter, known=known)
        state = filter_.update(filter_.predict(state, t), points)
        squares.append(np.sum(log(state.attitude @ R.T) ** 2))
    return state, np.array(squares)


@pytest.mark.parametrize("shutter", [0.0, pytest.param(0.012, marks=pytest.mark.slow), 0.03])
def test_the_readout_is_learnt_from_play(shutter):
    """Four plays; the attitude is as good as that of a filter that knows it, but for chance."""
    ours, theirs = [], []
    for seed in range(4):
        state, squares = played_through(LEARNING, shutter, 0.0, seed)
        ours.append(squares)
        theirs.append(played_through(FILTER, shutter, shutter, seed)[1])
        assert state.readout_sigma < 2e-4
        assert abs(state.readout - shutter) < min(3.0 * state.readout_sigma, 5e-4)
    assert np.sqrt(np.mean(ours)) < 1.3 * np.sqrt(np.mean(theirs))


def test_the_readout_is_as_certain_as_it_says():
    """60 runs, with the attitude: chi-square, 99 % band (three looks at the same runs)."""
    rng = np.random.default_rng(36)
    # Discs added before the rate is known make the readout too certain: rate times readout is in no Jacobian
    own = replace(LEARNING, settings=replace(OWN.settings, start_rate_sigma=0.01))
    runs, checks, squares = 60, (10, 30, 59), []
    for _ in range(runs):
        shutter, start = UNKNOWN * rng.normal(), rng.normal(size=3)
        start *= 1.0 / np.linalg.norm(start)
        state = own.initial(0.0, np.eye(3))._replace(rate=start)
        for k, (R, w, a) in enumerate(own_motion(rng, 60, 0.01, start)):
            points = rolled(
                lambda t, R=R, w=w, a=a: exp(w * t[:, None] + 0.5 * a * t[:, None] ** 2) @ R,
                rng,
                shutter=shutter,
                known=0.0,
            )
            state = own.update(own.predict(state, k * DT), points)
            if k in checks:
                e = log(R @ state.attitude.T)
                off = (state.readout - shutter) / state.readout_sigma
                squares.append([off**2, squared(e, state.covariance[:3, :3]) / 3.0])
    nees = np.mean(np.reshape(squares, (runs, 3, 2)), axis=0)
    for column, numbers in ((0, runs), (1, 3 * runs)):
        low, high = chi2.ppf([0.005, 0.995], numbers) / numbers
        assert np.all((low < nees[:, column]) & (nees[:, column] < high))


def test_a_large_correction_with_an_unknown_readout_is_the_least_squares_solution():
    """Attitude and readout alone are unknown: the most likely ones, against a search for them."""
    rng = np.random.default_rng(37)
    state, R = settled(n=60)
    joint = np.zeros_like(state.joint)
    joint[:3, :3] = 0.05**2 * np.eye(3)
    joint[3:6, 3:6] = 1e-10 * np.eye(3)
    joint[READOUT, READOUT] = UNKNOWN**2
    rate = 0.5 * FLICK
    wrong = state._replace(attitude=exp(np.array([0.05, -0.04, 0.03])) @ R, rate=rate, acceleration=np.zeros(3))
    wrong = wrong._replace(joint=joint, process=np.zeros((KINEMATIC_DIM, KINEMATIC_DIM)))
    d = state.discs[(state.discs @ R.T)[:, 2] > HORIZON + 0.1]
    row = -0.5 * (d @ R.T)[:, 1]
    points = points_at(np.einsum("kij,kj->ki", exp(0.02 * row[:, None] * rate) @ R, d), rng=rng)
    points = replace(points, row=row)
    after = LEARNING.update(wrong, points, np.zeros(len(d), dtype=bool))
    assert len(after.used) == len(d)

    def residuals(x):
        p = np.einsum("kij,kj->ki", exp(x[3] * row[:, None] * rate) @ exp(x[:3]) @ wrong.attitude, d)
        return np.concatenate([np.cross(points.direction, p).ravel() / SIGMA, x[:3] / 0.05, [x[3] / UNKNOWN]])

    fit = least_squares(residuals, np.zeros(4), x_scale=[0.05, 0.05, 0.05, UNKNOWN], xtol=1e-14, ftol=1e-14)
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    assert abs(fit.x[3] - 0.02) < 4.0 * sigma[3]
    assert_allclose(log(after.attitude @ wrong.attitude.T), fit.x[:3], atol=0.5 * sigma[:3].max())
    assert_allclose(after.readout, fit.x[3], atol=2.0 * sigma[3])  # an allowance for the curvature weakens it


@pytest.mark.parametrize("rate", [0.1, 1.0])
def test_new_discs_depend_on_the_readout_as_finite_differences_say(rate):
    state, _ = settled()
    rows = np.arange(4)
    p = (state.discs @ state.attitude.T)[rows]
    row, readout, h = np.array([-0.4, 0.5, 0.1, -0.2]), 0.02, 1e-5
    points = replace(points_at(p), delay=0.01 * row, row=row)  # the rig says 10 ms
    nothing = {"landmarks": np.zeros((0, 3)), "basis": np.zeros((0, 3, 2)), "joint": np.eye(MAP_OFFSET + CLONE_DIM)}
    bare = state._replace(rate=rate * FLICK, acceleration=np.zeros(3), readout=readout, **nothing)
    added, *ends = (augment(bare._replace(readout=readout + s * h), points, rows, RADIUS) for s in (0, 1, -1))
    slope = np.einsum("mij,mi->mj", added.basis, (ends[0].discs - ends[1].discs) / (2 * h)).ravel()
    assert_allclose(added.joint[MAP_OFFSET:-CLONE_DIM, READOUT], slope, atol=1e-4 * np.abs(slope).max())


@pytest.mark.parametrize("seed", seeds(2, 4))
def test_a_false_turn_is_taken_back_without_a_push(seed):
    """The camera moved for three frames, and its pose was corrected: the ball has rested all the time."""
    rng = np.random.default_rng(seed)
    state, R = settled(rate=(0.0, 0.0, 0.0), n=60)
    turn = np.radians(0.3) * np.array([0.6, -0.8, 0.0])
    for part in (0.1, 0.4, 1.0):
        points = points_at(DISCS[:6] @ (exp(part * turn) @ R).T, rng=rng)
        state = FILTER.update(FILTER.predict(state, state.stamp + DT), points)
    after = [
        FILTER.update(FILTER.predict(before, state.stamp + DT), points_at(DISCS[:6] @ R.T, rng=rng))
        for before in (state, with_uncertain_turn(state, turn))
    ]
    assert np.linalg.norm(after[1].rate) < 0.5 * np.linalg.norm(after[0].rate)
    assert np.linalg.norm(after[1].rate) < 3.0 * np.sqrt(np.trace(after[1].joint[3:6, 3:6]))
    assert np.linalg.norm(log(after[1].attitude @ R.T)) < 5.0 * SIGMA


def test_a_seen_centre_corrects_all_but_the_motion():
    """Joseph's form of the covariance holds for any gain, also without the rows of rate and acceleration."""
    state, _ = settled(rate=(0.0, 1.0, 0.0), n=60)
    state = FILTER.predict(FILTER.let_centre_move(state), state.stamp + DT)
    axes, place, R = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 2)))[0], np.array([0.004, -0.003]), 1e-8
    seen = with_seen_centre(state, place, axes, R * np.eye(2))
    assert_allclose(axes.T @ seen.centre, place, atol=1e-5)
    assert_allclose(seen.rate, state.rate, atol=0.0)
    assert_allclose(seen.acceleration, state.acceleration, atol=0.0)
    H = np.zeros((2, len(state.joint)))
    H[:, CENTRE], H[:, ECCENTRICITY] = axes.T, axes.T @ state.attitude
    K = state.joint @ H.T @ np.linalg.inv(H @ state.joint @ H.T + R * np.eye(2))
    K[3:9] = 0.0
    A = np.eye(len(K)) - K @ H
    assert_allclose(np.diag(seen.joint), np.diag(A @ state.joint @ A.T + R * K @ K.T), rtol=1e-6, atol=1e-15)
    assert np.linalg.eigvalsh(seen.joint).min() > -1e-12
