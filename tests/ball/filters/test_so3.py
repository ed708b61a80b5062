"""The default filter: its derivatives, its covariance against sampling and NEES, its map, and a hand on the ball."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from so3_world import (
    DISCS,
    DT,
    FILTER,
    HORIZON,
    LAST,
    OWN,
    RADIUS,
    SETTINGS,
    SIGMA,
    draw,
    film,
    follow,
    innovation,
    own_motion,
    points_at,
    rolling,
    seen,
    settled,
    squared,
    white_jerk,
    with_errors,
)

from spheremouse.ball.filters.so3 import Pairing, relocate
from spheremouse.ball.filters.so3_map import augment
from spheremouse.ball.filters.so3_motion import AXES, CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS, PERSISTENCE_S
from spheremouse.ball.filters.so3_state import inject
from spheremouse.geometry.rotation import exp, log, tangent_basis

FLICK = 7.0 * np.array([1.0, 0.3, 0.5]) / np.linalg.norm([1.0, 0.3, 0.5])  # 400 deg/s


def difference(a, b):
    """Error vector of state a against state b with the same discs, (23 + 2m,)."""
    d = np.einsum("mij,mi->mj", b.basis, a.discs - b.discs).ravel()
    core = [log(a.attitude @ b.attitude.T), a.rate - b.rate, a.acceleration - b.acceleration]
    core.append(a.eccentricity - b.eccentricity)
    axes = reference = np.zeros(3)  # never corrected
    return np.concatenate([*core, a.rig_error - b.rig_error, axes, [a.readout - b.readout], d, reference])


def error_of(state, R):
    return np.linalg.norm(log(state.attitude @ R.T))


def test_prediction_moves_an_error_as_its_covariance_says():
    """F of the prediction, read from its covariance without process noise, equals central differences."""
    quiet = replace(FILTER, settings=replace(SETTINGS, acceleration_sigma=1e-30))
    state, _ = settled(rate=(1.5, -2.0, 1.0))
    joint = state.joint.copy()
    joint[READOUT, READOUT] = 1e-4
    joint[READOUT, :3] = joint[:3, READOUT] = 1e-6
    state = state._replace(joint=joint)
    dt, h = 0.4, 1e-6
    k = len(state.joint)
    base = quiet.predict(state, state.stamp + dt)
    F = np.empty((k, k))
    for i in range(k):
        e = h * np.eye(k)[i]
        ends = [quiet.predict(inject(state, s * e), state.stamp + dt) for s in (1, -1)]
        F[:, i] = (difference(ends[0], base) - difference(ends[1], base)) / (2 * h)
    F[AXES:READOUT, AXES:READOUT] = np.eye(3)
    assert_allclose(base.joint, F @ state.joint @ F.T, atol=1e-6 * np.abs(base.joint).max())


@pytest.mark.parametrize(
    ("rate", "delay", "readout"), [(0.0, 0.0, 0.0), (0.1, 0.015, 0.0), (1.0, 0.015, -0.01), (0.1, 0.01, 0.02)]
)
def test_the_innovation_depends_on_each_error_as_finite_differences_say(rate, delay, readout):
    """H joint with a unit covariance, at rates that are parts of a flick, with rows read up to `delay` s late."""
    state, _ = settled()
    k = len(state.joint)
    state = state._replace(rate=rate * FLICK, acceleration=np.zeros(3), joint=np.eye(k), readout=readout)
    p = state.discs @ state.attitude.T
    columns = np.flatnonzero(p[:, 2] > HORIZON)
    row = np.random.default_rng(34).uniform(-0.5, 0.5, len(columns))
    late = (2.0 * delay + readout) * row
    turned = np.einsum("kij,kj->ki", exp(late[:, None] * rate * FLICK), p[columns])
    points = replace(points_at(turned), delay=2.0 * delay * row, row=row)
    H, HP, _, _ = innovation(state, points, columns)
    assert_allclose(HP[:, :KINEMATIC_DIM], H)
    step = np.full(k, 1e-6)
    step[6:KINEMATIC_DIM] = 1e-3  # half of (15 ms)²: too small a slope for the same step
    for i in np.delete(np.arange(k), np.arange(AXES, READOUT)):
        e = step[i] * np.eye(k)[i]
        z = [innovation(inject(state, s * e), points, columns)[2] for s in (1, -1)]
        slope = -(z[0] - z[1]) / (2 * step[i])
        # the delay counts to first order, and z, which is zero but for the noise, turns with the axes
        bound = 0.05 * np.abs(slope).max() if 3 <= i < KINEMATIC_DIM else 0.03 if delay and i < 3 else 2e-3
        assert_allclose(HP[:, i], slope, atol=bound)


@pytest.mark.parametrize("delay", [0.0, 0.015])
def test_a_new_disc_is_as_uncertain_as_sampling_says(delay):
    """Its covariance and its correlation with rotation and rate, against adding it from drawn states and points."""
    rng = np.random.default_rng(2)
    state, _ = settled()
    P = state.joint.copy()
    P[:3, :3] += 1e-4 * np.diag([1.0, 2.0, 0.5]) * (delay == 0.0)  # an attitude, or a rate, that is badly known
    P[3:6, 3:6] += 0.04 * np.diag([1.0, 2.0, 0.5]) * (delay > 0.0)
    state = state._replace(joint=P)
    place, sigma = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8]), 5e-3 if delay == 0.0 else SIGMA
    added = augment(state, replace(points_at(place, sigma), delay=np.array([delay])), np.array([0]), RADIUS)
    samples = []
    for e in draw(state.joint, rng, 4000):
        truth = inject(state, -e)  # estimate = truth + e
        d = points_at(place, sigma, rng).direction[0] @ exp(delay * truth.rate) @ truth.attitude
        samples.append(np.concatenate([e, added.basis[-1].T @ (added.discs[-1] - d)]))
    scatter = np.cov(np.array(samples).T)
    ours = added.joint[LAST, LAST]
    assert_allclose(scatter[-2:, -2:], ours, atol=0.08 * np.abs(ours).max())
    sd = np.sqrt(np.outer(np.diag(added.joint)[LAST], np.diag(added.joint)[:6]))
    sd[sd == 0.0] = 1.0
    assert_allclose(scatter[-2:, :6] / sd, added.joint[LAST, :6] / sd, atol=0.06)
    assert delay == 0.0 or np.abs(added.joint[LAST, 3:6] / sd[:, 3:]).max() > 0.5


@pytest.mark.parametrize("every", [1, 4])
def test_motion_since_the_reference_is_as_certain_as_runs_drawn_from_the_own_model_say(every):
    """NEES of rotation vector and rate, 95 % band; and what two attitudes have wrong alike does not count."""
    rng = np.random.default_rng(21)
    runs, squares, shares = 60, [], []
    for _ in range(runs):
        state, reference = OWN.initial(0.0, np.eye(3)), (np.eye(3), np.eye(3))
        for k, (R, w, _) in enumerate(own_motion(rng, 41)):
            state = OWN.update(OWN.predict(state, k * DT), points_at(seen(R), rng=rng))
            if k % every:
                continue
            turn, true = log(state.attitude @ reference[0].T), log(R @ reference[1].T)
            C = state.increment_covariance(turn)
            if k == 40:
                squares.append(squared(np.concatenate([turn - true, state.rate - w]), C))
                shares.append(np.trace(C[:3, :3]) / np.trace(state.covariance[:3, :3]))
            state, reference = state.clone_attitude(), (state.attitude, R)
    low, high = chi2.ppf([0.025, 0.975], 6 * runs) / runs
    assert low < np.mean(squares) < high
    assert np.median(shares) < (0.9 if every == 1 else 1.2)  # two that were independent would have 2


@pytest.mark.parametrize("dt", [DT, 0.5])
def test_predicted_covariance_is_the_scatter_of_samples(dt):
    """Of a ball left alone; of a long interval all but the last part under an acceleration that fades."""
    rng = np.random.default_rng(3)
    noisy = replace(FILTER, settings=replace(SETTINGS, acceleration_sigma=2.0, levels=(1.0,)))
    P0 = np.diag([1e-4, 4e-4, 2e-4, 1e-3, 3e-3, 2e-3, 0.5, 0.2, 0.4])
    P0[0, 4] = P0[4, 0] = 3e-4
    w, a0 = np.array([0.8, -1.2, 2.0]), np.array([-0.5, 0.3, 1.0])
    start = noisy.initial(0.0, exp(np.array([0.2, 0.1, -0.4])))
    start = start._replace(rate=w, acceleration=a0, joint=block_diag(P0, np.zeros((14, 14))))
    predicted = noisy.predict(start, dt)
    n, steps, tau = 6000, 8, PERSISTENCE_S
    e = draw(P0, rng, n)
    R, rate, a = exp(e[:, :3]) @ start.attitude, w + e[:, 3:6], a0 + e[:, 6:]
    last = min(dt, 0.5 * tau)
    for part, fade in ((dt - last, 1.0 / tau), (last, 0.0)):
        if part <= 0.0:
            continue
        F, Q = white_jerk(part / steps, 2.0, tau, fade)
        jerk = np.linalg.cholesky(Q)
        for _ in range(steps):  # jerk integrated in small steps: the exact law of (angle, rate, acceleration)
            now = np.einsum("ij,jnk->ink", F, np.stack([np.zeros((n, 3)), rate, a]))
            now += np.einsum("ij,jnk->ink", jerk, rng.normal(size=(3, n, 3)))
            R, rate, a = exp(now[0]) @ R, now[1], now[2]
    error = np.concatenate([log(R @ predicted.attitude.T), rate - predicted.rate], axis=1)
    scatter = np.cov(error.T)
    scale = np.sqrt(np.outer(np.diag(predicted.covariance), np.diag(predicted.covariance)))
    assert_allclose(scatter / scale, predicted.covariance / scale, atol=0.07 if dt < 0.1 else 0.09)  # large turns bend


def test_nees_of_runs_drawn_from_the_own_model():
    """50 runs with rates, accelerations and noise as the filter assumes, the map unknown: chi-square, 95 % band."""
    rng = np.random.default_rng(12)
    runs, frames, checks = 50, 60, (10, 39, 59)
    nees = {k: [] for k in range(10, frames)}
    nis = dof = 0.0
    for _ in range(runs):
        state = OWN.initial(0.0, np.eye(3))
        for k, (R, w, _) in enumerate(own_motion(rng, frames)):
            state = OWN.update(OWN.predict(state, k * DT), points_at(seen(R), rng=rng))
            if k >= 3:  # before, the rate is all but unknown, and the allowance for that makes it smaller
                nis, dof = nis + state.nis, dof + 2 * len(state.used)
            if k in nees:
                P = state.covariance
                nees[k].append([squared(log(state.attitude @ R.T), P[:3, :3]), squared(state.rate - w, P[3:, 3:])])
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    # frames of a run hang together: their mean has at most the scatter of one of them
    means = [np.mean(nees[k], axis=0) for k in checks] + [np.mean([nees[k] for k in range(20, frames)], axis=(0, 1))]
    assert np.all((low < np.array(means)) & (np.array(means) < high))
    low, high = chi2.ppf([0.025, 0.975], dof)  # the filter's own consistency, too: what `nis` says it is
    assert low < nis < high


@pytest.mark.parametrize(
    ("sigma", "updates"),
    [(1e-9, 1000), *(pytest.param(s, 5000, marks=pytest.mark.slow) for s in (SIGMA, 1e-9))],
)
def test_covariance_stays_symmetric_and_positive(sigma, updates):
    """Random attitudes in small steps, random subsets of the discs, pose and ball considered; down to float noise."""
    rng = np.random.default_rng(42)
    considered = block_diag(*(np.cov(rng.normal(size=(k, 3 * k))) for k in (6, 4))) * 1e-8
    own = with_errors(OWN, considered=considered, readout_sigma=0.015)
    state = own.initial(0.0, np.eye(3))
    R = np.eye(3)
    worst = 0.0
    for k in range(updates):
        R = exp(3e-4 * rng.normal(size=3)) @ R
        p = seen(R)
        some = rng.random(len(p)) < 0.6
        points = points_at(p[some], sigma, rng)
        by_rig = points.ddirection_drig + 0.1 * rng.normal(size=(len(points), 3, 4))
        points = replace(points, ddirection_drig=by_rig, row=-0.5 * p[some, 1])
        state = own.update(own.predict(state, k * 0.01), points)
        if k % 3 == 0:
            state = state.clone_attitude()
        if k % 50 == 0:
            sd = np.sqrt(np.diag(state.joint))
            assert np.all(sd[3:-CLONE_DIM] > 0.0)
            assert np.all(sd[[0, -1]] > 0.0) or k == 0
            sd = np.where(sd > 0.0, sd, 1.0)
            assert_allclose(state.joint / np.outer(sd, sd), state.joint.T / np.outer(sd, sd), atol=1e-14)
            worst = min(worst, np.linalg.eigvalsh(state.joint / np.outer(sd, sd))[0])
    assert worst > -1e-9
    assert_allclose(state.joint[AXES:READOUT, AXES:READOUT], considered[3:6, 3:6])


@pytest.mark.parametrize("axis", [[0.0, 1.0, 0.0], [1.0, 0.2, 0.0], [0.0, 0.0, 1.0], [0.6, -0.3, 0.7]])
def test_no_attitude_is_singular(axis):
    """A full turn about any axis, through phi = 90 deg and back to the first discs."""
    rate = 2.0 * np.array(axis) / np.linalg.norm(axis)
    R, t = rolling(rate, round(2 * np.pi / 2.0 / DT) + 5)
    states = film(FILTER, R, t, np.random.default_rng(7))
    assert max(error_of(s, r) for s, r in zip(states, R, strict=True)) < 3e-3
    assert max(np.linalg.norm(s.rate - rate) for s in states[10:]) < 0.05
    assert all(np.linalg.eigvalsh(s.joint)[0] > -1e-15 for s in states[::10])


def test_the_result_does_not_depend_on_the_gauge():
    """The ball's own frame is arbitrary: another start attitude gives the same motion and the same covariance."""
    R, t = rolling([0.9, -0.5, 0.4], 40)
    G = exp(np.array([1.1, -0.7, 2.0]))
    plain = film(FILTER, R, t, np.random.default_rng(8))
    turned = follow(FILTER, FILTER.initial(0.0, G), R, t, np.random.default_rng(8))
    for a, b in zip(plain, turned, strict=True):
        assert_allclose(b.attitude, a.attitude @ G, atol=1e-9)
        assert_allclose(b.rate, a.rate, atol=1e-8)
        assert_allclose(b.covariance, a.covariance, atol=1e-9 * np.abs(a.covariance).max())


def test_a_disc_out_of_view_is_known_again_and_closes_the_loop():
    rate = np.array([0.0, 2.0, 0.3])
    n = round(2 * np.pi / np.linalg.norm(rate) / DT)
    R, t = rolling(rate, n + 20)
    states = film(FILTER, R, t, np.random.default_rng(10))
    half, end = states[n // 2], states[-1]
    assert np.any(half.discs[:4] @ half.attitude.T @ FILTER.station.towards < HORIZON)  # of the first discs
    assert len(end.discs) <= 26  # none is taken for a new one
    assert error_of(end, R[-1]) < 6e-4
    sd = [np.sqrt(np.trace(s.joint[:3, :3])) for s in states]
    assert sd[-1] < 0.8 * max(sd)  # the old discs lend their certainty


def test_only_fresh_points_add_discs_and_never_on_top_of_one_another():
    state = FILTER.initial(0.0, np.eye(3))
    p = points_at(seen(np.eye(3)))
    n = len(p)
    assert len(FILTER.update(state, p, np.zeros(n, dtype=bool)).discs) == 0
    fresh = np.arange(n) < 2
    assert_allclose(FILTER.update(state, p, fresh).discs, p.direction[:2], atol=1e-12)
    twice = points_at(np.repeat(p.direction, 2, axis=0), rng=np.random.default_rng(0))
    assert len(FILTER.update(state, twice).discs) == n
    again = FILTER.update(FILTER.update(state, p), points_at(p.direction, rng=np.random.default_rng(1)))
    assert len(again.discs) == n


@pytest.mark.parametrize(
    ("sightings", "misses", "stays"), [(1, 7, False), (ESTABLISHED_HITS, 5, True), (5, 30, False), (35, 65, True)]
)
def test_a_disc_that_is_not_seen_again_is_dropped_the_later_the_better_it_is_known(sightings, misses, stays):
    """On trial at once, a look-alike that lasted its trial after a second, a disc behind a hand for seconds never."""
    real = seen(np.eye(3))[1:]
    ghost = np.array([0.05, 0.1, 1.0]) / np.linalg.norm([0.05, 0.1, 1.0])
    state = FILTER.initial(0.0, np.eye(3))
    for k in range(sightings + misses):
        p = np.vstack([real, ghost]) if k < sightings else real
        state = FILTER.update(FILTER.predict(state, k * DT), points_at(p))
    assert len(state.discs) == len(real) + stays
    assert bool(np.any(state.discs @ ghost > 0.999)) == stays
    assert len(state.joint) == MAP_OFFSET + 2 * len(state.discs) + CLONE_DIM


@pytest.mark.parametrize(("sigma", "misses"), [(1e-3, True), (0.3, False)])
def test_a_disc_is_missed_only_where_it_should_be(sigma, misses):
    """An attitude known to 17 degrees does not tell which discs face the camera."""
    state = settled()[0]
    joint = state.joint.copy()
    joint[:3, :3] = sigma**2 * np.eye(3)
    none = Pairing(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp))
    after = FILTER.keep_map(state._replace(joint=joint), points_at([0.0, 0.0, 1.0]), none, np.zeros(1, dtype=bool))
    assert np.any(after.missed > state.missed) == misses


def test_the_map_is_bounded():
    small = replace(FILTER, settings=replace(SETTINGS, most_discs=5))
    R, t = rolling([0.0, 1.5, 0.0], 60)
    assert max(len(s.discs) for s in film(small, R, t, np.random.default_rng(11))) == 5


def test_relocation_keeps_the_map_and_forgets_the_rest():
    state, _ = settled()
    joint = state.joint.copy()
    joint[READOUT, READOUT] = 1e-8
    state = state._replace(joint=joint, readout=0.012)  # learnt before
    found = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    placed = relocate(state, found, 9e-6 * np.eye(3), SETTINGS, 99.0)
    assert placed.stamp == 99.0
    assert_allclose(placed.attitude, found)
    assert_allclose(placed.joint[KINEMATIC_DIM:, KINEMATIC_DIM:], state.joint[KINEMATIC_DIM:, KINEMATIC_DIM:])
    assert_allclose(placed.joint[:KINEMATIC_DIM, KINEMATIC_DIM:], 0.0)
    assert placed.readout == 0.012  # the camera is the same
    after = FILTER.update(placed, points_at(seen(found), rng=np.random.default_rng(19)))
    assert len(after.used) >= 3
    assert error_of(after, found) < 2e-3


def test_a_flick_takes_a_wider_level_and_then_the_quiet_one_again():
    t = np.arange(75) * DT
    speed = np.interp(t, [0.5, 0.65, 0.9, 1.0], [0.2, 7.0, 7.0, 0.0])  # 400 deg/s by 45 rad/s², then a hand stops it
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * DT)])
    attitudes = exp(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    states = film(FILTER, attitudes, t, np.random.default_rng(13))
    level = np.array([s.manoeuvre_level for s in states])
    assert np.all(level[8:14] < 5.0)
    assert level.max() > 50.0
    assert np.all(level[60:] < 10.0)
    assert max(error_of(s, R) for s, R in zip(states, attitudes, strict=True)) < 2e-3
    assert_allclose(states[-1].rate, 0.0, atol=0.02)
    assert all(len(s.discs) <= 26 for s in states)


@pytest.mark.parametrize("angle", [0.001, 0.0015, 0.002, 0.003, 0.005, 0.01])
def test_every_disc_of_a_ball_that_starts_to_turn_stays_in_use(angle):
    """A push moves discs near its axis least. They alone still pair as at rest, and would hold the ball there."""
    rng = np.random.default_rng(31)
    state, R = settled(rate=(0.0, 0.0, 0.0), n=60)
    predicted = FILTER.predict(state, state.stamp + 1.0 / 60.0)
    for axis in directions(12, 7, 0.3):
        pushed = exp(angle * axis) @ R
        points = points_at(seen(R) @ exp(angle * axis).T, rng=rng)
        after = FILTER.update(predicted, points, np.zeros(len(points), dtype=bool))
        assert len(after.used) == len(points)
        assert error_of(after, pushed) < 4.0 * SIGMA


def jerky(rng, seconds):
    """Attitudes and rates at 30 Hz: a new constant acceleration every 0.1 to 0.5 s, after a rest of a second."""
    stamps, rates = [0.0, 1.0], [np.zeros(3), np.zeros(3)]
    while stamps[-1] < seconds:
        axis = rng.normal(size=3)
        stamps.append(stamps[-1] + rng.uniform(0.1, 0.5))
        rates.append(rng.uniform(0.0, 4.0) * axis / np.linalg.norm(axis))
    fine = np.arange(0.0, seconds, DT / 20.0)
    rate = np.stack([np.interp(fine, stamps, np.array(rates)[:, i]) for i in range(3)], axis=1)
    R, attitudes = np.eye(3), []
    for k in range(len(fine)):
        if k % 20 == 0:
            attitudes.append(R)
        R = exp(0.5 * (rate[k] + rate[min(k + 1, len(fine) - 1)]) * DT / 20.0) @ R
    return np.array(attitudes), rate[::20][: len(attitudes)]


def test_the_rate_of_a_jerky_ball_is_as_certain_as_it_says():
    """Twenty balls whose acceleration makes steps of 20 rad/s²: rate error and NEES."""
    squares, nees, attitude = [], [], []
    for seed in range(20):
        rng = np.random.default_rng([5, seed])
        R, w = jerky(rng, 6.0)
        states = film(FILTER, R, np.arange(len(R)) * DT, rng)
        for state, r, rate in list(zip(states, R, w, strict=True))[31:]:
            e = state.rate - rate
            squares.append(e @ e)
            nees.append(squared(e, state.covariance[3:, 3:]))
            attitude.append(error_of(state, r) ** 2)
    assert np.degrees(np.sqrt(np.mean(squares))) < 3.2
    assert 1.5 < np.mean(nees) < 4.5
    assert np.sqrt(np.mean(attitude)) < 5e-4


def strokes(rng, seconds):
    """Attitudes at 30 Hz: strokes of least jerk (Flash and Hogan 1985) by up to 70°, which run into each other."""
    fine, start = np.arange(0.0, seconds, DT / 20.0), 1.0
    rate = np.zeros((len(fine), 3))
    while start < seconds:
        length, axis = rng.uniform(0.25, 0.7), rng.normal(size=3)
        x = np.clip((fine - start) / length, 0.0, 1.0)
        speed = rng.uniform(0.1, 1.2) / length * 30.0 * x**2 * (1.0 - x) ** 2
        rate += speed[:, None] * axis / np.linalg.norm(axis)
        start += length * rng.uniform(0.6, 1.0) + max(rng.uniform(-0.3, 0.4), 0.0)
    R, attitudes = np.eye(3), []
    for k in range(len(fine)):
        if k % 20 == 0:
            attitudes.append(R)
        R = exp(rate[k] * DT / 20.0) @ R
    return np.array(attitudes)


@pytest.mark.slow
def test_strokes_that_run_into_each_other_do_not_lose_the_ball():
    """One stroke may be ten times as strong as the last one. The discs are 0.3 rad apart."""
    for seed in range(20):
        rng = np.random.default_rng([36, seed])
        R = strokes(rng, 6.0)
        states = film(FILTER, R, np.arange(len(R)) * DT, rng)
        assert max(error_of(s, r) for s, r in zip(states, R, strict=True)) < 0.01


def test_the_modes_have_the_mean_and_covariance_of_the_state():
    """After updates and predictions, with a disc more and a new reference."""
    rng = np.random.default_rng(8)
    R, _ = jerky(rng, 4.0)
    for state in film(FILTER, R, np.arange(len(R)) * DT, rng)[40:]:
        predicted = FILTER.predict(state.clone_attitude(), state.stamp + DT)
        for one in (state, predicted):
            means, covariances, weights = one.modes
            p = weights.sum(axis=1)
            mean = p @ means
            covariance = np.einsum("j,jab->ab", p, covariances) + (p * means.T) @ means
            sd = np.sqrt(np.diag(one.joint)[3:KINEMATIC_DIM])
            assert_allclose(p.sum(), 1.0, atol=1e-9)
            assert_allclose(mean / sd, 0.0, atol=1e-6)
            assert_allclose(
                covariance / np.outer(sd, sd), one.joint[3:KINEMATIC_DIM, 3:KINEMATIC_DIM] / np.outer(sd, sd), atol=1e-6
            )


@pytest.mark.parametrize("pairs", [1, 2, 3])
def test_modes_need_three_pairs(pairs):
    """With two a step and a wrong centre look alike."""
    rng = np.random.default_rng(9)
    state, R = settled(rate=(0.0, 0.0, 0.0), n=60)
    predicted = FILTER.predict(state, state.stamp + DT)
    after = FILTER.update(predicted, points_at(seen(R)[:pairs], rng=rng))
    assert len(after.used) == pairs
    assert (after.modes is None) == (pairs < 3)


def test_a_steady_push_leaves_no_error_behind():
    """A ball that speeds up evenly for half a second: the acceleration lasts, so that the rate does not lag."""
    push, t = np.array([6.0, -3.0, 2.0]), np.arange(45) * DT
    since = np.maximum(t - 1.0, 0.0)[:, None]
    states = film(FILTER, exp(0.5 * since**2 * push), t, np.random.default_rng(6))
    late = since[:, 0] > 0.15
    rates, true = np.array([s.rate for s in states]), since * push
    assert np.linalg.norm(rates - true, axis=1)[late].max() < np.radians(2.0)
    assert np.linalg.norm(states[-1].acceleration - push) < 1.0


def pushed():
    """A state after a push from rest by 5 rad/s² for 0.2 s."""
    t = np.arange(22) * DT
    angle = 2.5 * np.maximum(t - 0.5, 0.0) ** 2
    return film(FILTER, exp(angle[:, None] * np.array([1.0, 0.0, 0.0])), t, np.random.default_rng(0))[-1]


def unseen(state, frames):
    """The state after so many frames that show nothing."""
    stamps = state.stamp + np.arange(1, frames + 1) * DT
    return follow(FILTER, state, np.tile(np.eye(3), (frames, 1, 1)), stamps, None, DISCS[:0])[-1]


def test_an_unseen_push_fades():
    """Nothing tells how long a push lasts that is not seen: on the average about as long as `persistence`."""
    state = pushed()
    push, later = state.acceleration[0], unseen(state, 12)
    t, tau = 12 * DT, PERSISTENCE_S
    assert_allclose(later.rate[0] - state.rate[0], push * tau * (1.0 - np.exp(-t / tau)), rtol=0.3)
    assert later.acceleration[0] < 0.3 * push
    assert abs(FILTER.predict(state, later.stamp).rate[0] - later.rate[0]) < 0.3 * later.joint[3, 3] ** 0.5


def test_a_ball_that_rests_whenever_it_is_seen_was_not_pushed_meanwhile():
    """Two of three frames show nothing, so each tells of a longer time: a push before is soon no reason for another."""
    state, R, rng = pushed(), exp(np.array([0.1, 0.0, 0.0])), np.random.default_rng(1)
    for k in range(1, 61):
        shown = DISCS if k <= 6 or k % 3 == 0 else DISCS[:0]
        state = follow(FILTER, state, [R], [state.stamp + DT], rng, shown)[-1]
    assert np.sqrt(np.linalg.eigvalsh(unseen(state, 5).joint[:3, :3])[-1]) < np.radians(3.0)


def test_spurious_points_do_not_raise_the_level():
    """As many false points as hidden discs: nothing fits better at a wider level, so the quiet one must stay."""
    rng = np.random.default_rng(14)
    state, R = settled(rate=(0.0, 0.0, 0.0))
    for k in range(1, 20):
        ghosts = directions(6, 100 + k, 0.3)
        ghosts[:, 2] = np.abs(ghosts[:, 2])
        ghosts = ghosts[np.max(ghosts @ (DISCS @ R.T).T, axis=1) < np.cos(0.15)]
        points = points_at(np.vstack([seen(R)[:3], ghosts]), rng=rng)
        state = FILTER.update(FILTER.predict(state, state.stamp + DT), points, np.zeros(len(points), dtype=bool))
        assert state.manoeuvre_level < 5.0
        assert set(state.used) == {0, 1, 2}


def test_a_look_alike_beside_a_hidden_disc_is_left_out_after_a_gap():
    """Each pair alone passes a wide gate; together they contradict each other."""
    state, R = settled(rate=(0.1, 0.0, 0.0))
    state = FILTER.predict(state, state.stamp + 0.3)  # the longest gap that is followed by prediction
    R = exp(np.array([0.03, 0.0, 0.0])) @ R
    p = seen(R)
    p[0] = exp(np.array([0.0, 0.02, 0.01])) @ p[0]  # 1.3 deg beside its place
    after = FILTER.update(state, points_at(p, rng=np.random.default_rng(15)), np.zeros(len(p), dtype=bool))
    assert 0 not in after.used
    assert len(after.used) >= 4
    assert error_of(after, R) < 2e-3


def test_nothing_seen_is_a_prediction_and_one_disc_is_half_an_attitude():
    state, R = settled(rate=(0.2, 0.0, 0.0))
    state = state._replace(acceleration=np.zeros(3), modes=None)
    predicted = FILTER.predict(state, state.stamp + DT)
    blind = FILTER.update(predicted, points_at(np.zeros((0, 3))))
    assert_allclose(blind.attitude, predicted.attitude, atol=1e-5)  # a hand may stop the ball
    assert_allclose(blind.joint[KINEMATIC_DIM:, KINEMATIC_DIM:], predicted.joint[KINEMATIC_DIM:, KINEMATIC_DIM:])
    assert np.linalg.eigvalsh(blind.joint - predicted.joint)[0] > -1e-15  # the player may be at a livelier level
    predicted = OWN.predict(state._replace(weights=np.ones(1), modes=None), state.stamp + DT)
    p = seen(exp(np.array([0.2 * DT, 0, 0])) @ R)[0]
    one = OWN.update(predicted, points_at(p))
    assert len(one.used) == 1
    across = np.cross(p, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(p, [0.0, 0.0, 1.0]))
    twist, swing = (v @ one.joint[:3, :3] @ v / (v @ predicted.joint[:3, :3] @ v) for v in (p, across))
    assert swing < 0.9 < twist <= 1.0  # it says nothing of a turn about itself


def test_the_twist_about_one_disc_depends_on_its_prior_without_a_jump():
    """From a twist of zero to one of three standard deviations: unknown, as large as the swing; known, kept."""
    state, _ = settled(rate=(0.0, 0.0, 0.0))
    p = state.attitude @ state.discs[0]
    joint, kept = state.joint.copy(), []
    joint[3:6, 3:6] += 0.5**2 * np.outer(p, p)
    for twist in np.linspace(0.0, 1.5, 61):
        after, _ = FILTER.correct(
            state._replace(rate=twist * p, acceleration=np.zeros(3), joint=joint, modes=None),
            points_at(p),
            Pairing(np.array([0]), np.array([0])),
        )
        kept.append(p @ after.rate)
    assert kept[0] == pytest.approx(0.0, abs=0.01)
    assert kept[-1] == pytest.approx(1.5, abs=0.01)
    assert np.abs(np.diff(kept)).max() < 0.1


def test_a_disc_that_lies_on_another_leaves_the_map():
    state, _ = settled()
    beside = points_at(exp(0.3 * FILTER.disc_angle * np.array([1.0, 0.0, 0.0])) @ state.attitude @ state.discs[2])
    double = augment(state, beside, np.array([0]), RADIUS)
    none = np.array([], dtype=np.intp)
    after = FILTER.keep_map(double, beside, Pairing(none, none), np.zeros(1, dtype=np.bool_))
    assert_allclose(after.discs, state.discs)


@pytest.mark.slow
def test_a_gate_holds_every_point_that_would_be_paired_and_is_no_wider_than_its_worse_axis():
    """Around each disc, in all directions: points just outside are none of it, and some just inside are."""
    state = film(OWN, *rolling((0.3, -0.2, 0.4), 30), np.random.default_rng(0))[-1]
    predicted = OWN.predict(state, state.stamp + DT)
    which = OWN.visible(predicted)
    radius = OWN.gate_radius(state, which, DT)
    turn = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    for k, r in zip(which, radius, strict=True):
        p = predicted.attitude @ predicted.discs[k]
        around = (tangent_basis(p) @ [np.cos(turn), np.sin(turn)]).T
        inside, outside = (
            OWN.distances_to_discs(predicted, points_at(p + f * r * around, 2e-3), 1e3) for f in (0.97, 1.03)
        )
        column = np.flatnonzero(inside[1] == k)[0]
        assert inside[0][:, column].min() < SETTINGS.gate < outside[0][:, column].min()
