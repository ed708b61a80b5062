"""The default filter: its derivatives, its covariance against sampling, batch least squares and NEES, and its map."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from spheremouse.filters.so3 import So3Filter, So3Settings, relocate
from spheremouse.filters.so3_state import augment, inject
from spheremouse.intersect import SpherePoints
from spheremouse.rotation import exp, log

RADIUS = 0.6
HORIZON = 0.25
DT = 1.0 / 30.0
SIGMA = 3e-4  # rad, of a direction per axis: 0.07 px of the far camera
SETTINGS = So3Settings()
FILTER = So3Filter(SETTINGS, np.array([0.0, 0.0, 1.0]), HORIZON, 0.02 / RADIUS)


DISCS = directions(26, 4, 0.3)


def points_at(direction, sigma=SIGMA, rng=None):
    """SpherePoints at directions (n, 3) in obj, with isotropic noise in the tangent plane if `rng` is given."""
    d = np.asarray(direction, dtype=float).reshape(-1, 3)
    if rng is not None:
        noise = sigma * rng.normal(size=d.shape)
        d = d + noise - d * np.sum(noise * d, axis=1, keepdims=True)
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
    n = len(d)
    C = (RADIUS * sigma) ** 2 * (np.eye(3) - d[:, :, None] * d[:, None, :])
    return SpherePoints(RADIUS * d, C, d, C, np.zeros((n, 3, 6)), np.zeros((n, 3, 4)), np.arange(n))


def seen(R, discs=DISCS):
    """Directions in obj of the discs well on the near side at attitude R."""
    p = discs @ R.T
    return p[p[:, 2] > HORIZON + 0.1]


def film(filter_, attitudes, stamps, rng, *, discs=DISCS, state=None):
    """States after each frame."""
    state = filter_.initial(stamps[0], attitudes[0]) if state is None else state
    states = []
    for R, t in zip(attitudes, stamps, strict=True):
        state = filter_.update(filter_.predict(state, t), points_at(seen(R, discs), rng=rng))
        states.append(state)
    return states


def rolling(rate, n, dt=DT):
    """Attitudes and stamps of a constant rate (3,) rad/s in obj."""
    t = np.arange(n) * dt
    return exp(np.asarray(rate) * t[:, None]), t


def settled(rate=(0.3, -0.2, 0.4), n=30, seed=0):
    """A state with discs, correlations and a rate, and its attitudes."""
    R, t = rolling(rate, n)
    return film(FILTER, R, t, np.random.default_rng(seed))[-1], R[-1]


def difference(a, b):
    """Error vector of state a against state b with the same discs, (9 + 2m,)."""
    d = np.einsum("mij,mi->mj", b.basis, a.discs - b.discs).ravel()
    return np.concatenate([log(a.attitude @ b.attitude.T), a.rate - b.rate, a.acceleration - b.acceleration, d])


def draw(joint, rng, n):
    """Samples (n, k) of a zero-mean Gaussian whose covariance may be singular."""
    w, V = np.linalg.eigh(joint)
    return rng.normal(size=(n, len(w))) @ (V * np.sqrt(np.maximum(w, 0.0))).T


def singer(dt, sigma, tau):
    """F and Q of angle, rate and acceleration over a step, (3, 3), for one axis, by Van Loan's method."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / tau]])
    G = np.diag([0.0, 0.0, 2.0 * sigma**2 / tau])
    E = expm(np.block([[-A, G], [np.zeros((3, 3)), A.T]]) * dt)
    F = E[3:, 3:].T
    return F, F @ E[:3, 3:]


# --- derivatives -----------------------------------------------------------------------------------------------------


def test_prediction_moves_an_error_as_its_covariance_says():
    """F of the prediction, read from its covariance without process noise, equals central differences."""
    quiet = replace(FILTER, settings=replace(SETTINGS, acceleration_sigma=1e-30))
    state, _ = settled(rate=(1.5, -2.0, 1.0))
    dt, h = 0.4, 1e-6
    k = len(state.joint)
    base = quiet.predict(state, state.stamp + dt)
    F = np.empty((k, k))
    for i in range(k):
        e = h * np.eye(k)[i]
        ends = [quiet.predict(inject(state, s * e), state.stamp + dt) for s in (1, -1)]
        F[:, i] = (difference(ends[0], base) - difference(ends[1], base)) / (2 * h)
    assert_allclose(base.joint, F @ state.joint @ F.T, atol=1e-6 * np.abs(base.joint).max())


def test_the_innovation_depends_on_the_state_as_its_jacobian_says():
    """H joint, from the filter, against differences of the innovation for an error of each component."""
    state, _ = settled()
    state = replace(state, joint=np.eye(len(state.joint)))  # then H @ joint is H
    p = state.discs @ state.attitude.T
    columns = np.flatnonzero(p[:, 2] > HORIZON)[:4]
    points = points_at(p[columns], rng=np.random.default_rng(1))
    rows = np.arange(len(columns))
    H, _, _, _ = FILTER._innovation(state, points, rows, columns)
    h = 1e-6
    for i in range(len(state.joint)):
        e = h * np.eye(len(state.joint))[i]
        z = [FILTER._innovation(inject(state, s * e), points, rows, columns)[2] for s in (1, -1)]
        assert_allclose(-(z[0] - z[1]) / (2 * h), H[:, i], atol=2e-3)  # the axes turn with the state: second order


def test_a_new_disc_is_as_uncertain_as_sampling_says():
    """Its covariance and its correlation with the attitude, against founding it from drawn states and points."""
    rng = np.random.default_rng(2)
    state, _ = settled()
    P = state.joint.copy()
    P[:3, :3] += 1e-4 * np.diag([1.0, 2.0, 0.5])  # an attitude that is badly known
    state = replace(state, joint=P)
    place = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
    sigma = 5e-3
    founded = augment(state, points_at(place, sigma), np.array([0]))
    errors = draw(state.joint, rng, 4000)
    samples = []
    for e in errors:
        truth = inject(state, -e)  # estimate = truth + e
        d = (points_at(place, sigma, rng).direction @ truth.attitude)[0]
        samples.append(np.concatenate([e, founded.basis[-1].T @ (founded.discs[-1] - d)]))
    scatter = np.cov(np.array(samples).T)
    own, ours = scatter[-2:, -2:], founded.joint[-2:, -2:]
    assert_allclose(own, ours, atol=0.08 * np.abs(ours).max())
    scale = np.sqrt(np.outer(np.diag(founded.joint)[-2:], np.diag(founded.joint)[:3]))
    assert_allclose(scatter[-2:, :3] / scale, founded.joint[-2:, :3] / scale, atol=0.06)


# --- covariance against independent truth ----------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [DT, 0.5])
def test_predicted_covariance_is_the_scatter_of_samples(dt):
    rng = np.random.default_rng(3)
    noisy = replace(FILTER, settings=replace(SETTINGS, acceleration_sigma=2.0))
    P0 = np.diag([1e-4, 4e-4, 2e-4, 1e-3, 3e-3, 2e-3, 0.5, 0.2, 0.4])
    P0[0, 4] = P0[4, 0] = 3e-4
    w, a0 = np.array([0.8, -1.2, 2.0]), np.array([-0.5, 0.3, 1.0])
    start = replace(noisy.initial(0.0, exp(np.array([0.2, 0.1, -0.4]))), rate=w, acceleration=a0, joint=P0)
    predicted = noisy.predict(start, dt)
    n, steps = 6000, 8
    e = draw(P0, rng, n)
    R, rate, a = exp(e[:, :3]) @ start.attitude, w + e[:, 3:6], a0 + e[:, 6:]
    F, Q = singer(dt / steps, 2.0, SETTINGS.persistence)
    jerk = np.linalg.cholesky(Q)
    for _ in range(steps):  # jerk integrated in small steps: the exact law of (angle, rate, acceleration) over each
        now = np.einsum("ij,jnk->ink", F, np.stack([np.zeros((n, 3)), rate, a]))
        now += np.einsum("ij,jnk->ink", jerk, rng.normal(size=(3, n, 3)))
        R, rate, a = exp(now[0]) @ R, now[1], now[2]
    error = np.concatenate([log(R @ predicted.attitude.T), rate - predicted.rate], axis=1)
    scatter = np.cov(error.T)
    scale = np.sqrt(np.outer(np.diag(predicted.covariance), np.diag(predicted.covariance)))
    assert_allclose(scatter / scale, predicted.covariance / scale, atol=0.07 if dt < 0.1 else 0.09)  # large turns bend


def test_update_is_the_batch_solution():
    """Three frames of four discs: the last state and its covariance, against least squares over all of them at once.

    Unknown are the attitudes and rates of the epochs and the discs; tiny noise, so that both are linear.
    """
    rng = np.random.default_rng(5)
    discs = directions(4, 6, 0.5)
    discs[:, 2] = np.abs(discs[:, 2]) + 0.5
    discs /= np.linalg.norm(discs, axis=1, keepdims=True)
    sigma, dt, jolt = 1e-5, 0.1, 1e-3
    own = replace(SETTINGS, acceleration_sigma=jolt, start_rate_sigma=1e-3, levels=(1.0,))
    f = replace(FILTER, settings=own)
    w = np.array([4e-4, -3e-4, 5e-4])
    frames = [points_at(discs @ exp(w * k * dt).T, sigma, rng) for k in range(3)]
    state = f.initial(0.0, np.eye(3))
    for k, points in enumerate(frames):
        state = f.update(f.predict(state, k * dt), points)
    assert len(state.used) == 4

    F, Q = singer(dt, jolt, own.persistence)
    Wq = np.kron(np.linalg.cholesky(np.linalg.inv(Q)).T, np.eye(3))
    base = state.discs

    def residuals(x):
        start, x1, x2 = x[:6], x[6:15], x[15:24]
        d = base + np.einsum("mij,mj->mi", state.basis, x[24:].reshape(-1, 2))
        out = [start[:3] / 1e-3, start[3:] / jolt]
        before = np.concatenate([np.zeros(3), start])
        for now in (x1, x2):  # the turns are tiny: they add
            out.append(Wq @ (now - (F @ before.reshape(3, 3)).ravel()))
            before = now
        for turn, points in zip((np.zeros(3), x1[:3], x2[:3]), frames, strict=True):
            p = d @ exp(turn).T
            out.append(np.cross(points.direction, p).ravel() / sigma)
        return np.concatenate(out)

    fit = least_squares(residuals, np.zeros(24 + 8), x_scale=1e-4, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    C = np.linalg.inv(fit.jac.T @ fit.jac)[15:, 15:]
    sd = np.sqrt(np.diag(C))
    assert_allclose(log(state.attitude), fit.x[15:18], atol=0.02 * sd[:3].max())
    assert_allclose(state.rate, fit.x[18:21], atol=0.02 * sd[3:6].max())
    assert_allclose(state.acceleration, fit.x[21:24], atol=0.02 * sd[6:9].max())
    assert_allclose(state.joint / np.outer(sd, sd), C / np.outer(sd, sd), atol=0.02)


def test_nees_of_runs_drawn_from_the_own_model():
    """50 runs with rates, accelerations and noise as the filter assumes, the map unknown: chi-square, 95 % band."""
    rng = np.random.default_rng(12)
    own = replace(FILTER, settings=replace(SETTINGS, levels=(1.0,)))
    F, Q = singer(DT, SETTINGS.acceleration_sigma, SETTINGS.persistence)
    jerk = np.linalg.cholesky(Q)
    runs, frames, checks = 50, 40, (10, 39)
    nees = {k: [] for k in checks}
    nis = dof = 0.0
    for _ in range(runs):
        R, w = np.eye(3), SETTINGS.start_rate_sigma * rng.normal(size=3)
        a = SETTINGS.acceleration_sigma * rng.normal(size=3)
        state = own.initial(0.0, R)
        for k in range(frames):
            if k:
                now = F @ np.stack([np.zeros(3), w, a]) + jerk @ rng.normal(size=(3, 3))
                R, w, a = exp(now[0]) @ R, now[1], now[2]
            state = own.update(own.predict(state, k * DT), points_at(seen(R), rng=rng))
            if k >= 3:  # before, the rate is all but unknown, and the allowance for that makes it smaller
                nis, dof = nis + state.nis, dof + 2 * len(state.used)
            if k in checks:
                e = np.concatenate([log(state.attitude @ R.T), state.rate - w])
                P = state.covariance
                nees[k].append([e[:3] @ np.linalg.solve(P[:3, :3], e[:3]), e[3:] @ np.linalg.solve(P[3:, 3:], e[3:])])
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    for k in checks:
        attitude, rate = np.mean(nees[k], axis=0)
        assert low < attitude < high, f"attitude, frame {k}"
        assert low < rate < high, f"rate, frame {k}"
    low, high = chi2.ppf([0.025, 0.975], dof)  # the filter's own consistency, too: what `nis` says it is
    assert low < nis < high


# --- geometry --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [[0.0, 1.0, 0.0], [1.0, 0.2, 0.0], [0.0, 0.0, 1.0], [0.6, -0.3, 0.7]])
def test_no_attitude_is_singular(axis):
    """A full turn about any axis, through phi = 90 deg and back to the first discs."""
    rate = 2.0 * np.array(axis) / np.linalg.norm(axis)
    n = round(2 * np.pi / 2.0 / DT) + 5
    R, t = rolling(rate, n)
    states = film(FILTER, R, t, np.random.default_rng(7))
    error = np.array([np.linalg.norm(log(s.attitude @ r.T)) for s, r in zip(states, R, strict=True)])
    rates = np.array([np.linalg.norm(s.rate - rate) for s in states])
    assert error.max() < 3e-3
    assert rates[10:].max() < 0.05
    assert all(np.linalg.eigvalsh(s.joint)[0] > -1e-15 for s in states[::10])


def test_the_result_does_not_depend_on_the_gauge():
    """The ball's own frame is arbitrary: another start attitude gives the same motion and the same covariance."""
    R, t = rolling([0.9, -0.5, 0.4], 40)
    G = exp(np.array([1.1, -0.7, 2.0]))
    plain = film(FILTER, R, t, np.random.default_rng(8))
    turned = film(FILTER, R, t, np.random.default_rng(8), state=FILTER.initial(0.0, G))
    for a, b in zip(plain, turned, strict=True):
        assert_allclose(b.attitude, a.attitude @ G, atol=1e-9)
        assert_allclose(b.rate, a.rate, atol=1e-8)
        assert_allclose(b.covariance, a.covariance, atol=1e-9 * np.abs(a.covariance).max())


def test_axes_of_a_disc_go_along_when_it_crosses_z_0():
    """tangent_basis jumps at z = 0; the filter's axes must not: the covariance is written in them."""
    state, _ = settled()
    z0 = np.array([np.sqrt(1.0 - 1e-12), 0.0, 1e-6])
    state = augment(state, points_at(z0 @ state.attitude.T), np.array([0]))
    m = len(state.discs)
    dx = np.zeros(9 + 2 * m)
    down = state.basis[-1].T @ [0.0, 0.0, -1e-4]
    dx[-2:] = down
    moved = inject(state, dx)
    assert state.discs[-1, 2] > 0.0 > moved.discs[-1, 2]
    assert_allclose(moved.basis[-1], state.basis[-1], atol=2e-4)
    for axes, d in zip(moved.basis, moved.discs, strict=True):
        assert_allclose(axes.T @ axes, np.eye(2), atol=1e-12)
        assert_allclose(axes.T @ d, 0.0, atol=1e-12)


def test_a_map_near_z_0_filters_like_any_other():
    """Discs on the ball's equator z = 0, where noise pushes them across all the time."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    R, t = rolling([0.6, 0.0, 0.0], 90)
    tilt = exp(np.array([1.2, 0.3, 0.0]))
    attitudes = R @ tilt
    states = film(FILTER, attitudes, t, np.random.default_rng(9), discs=ring)
    e = log(states[-1].attitude @ attitudes[-1].T)
    assert e @ np.linalg.solve(states[-1].covariance[:3, :3], e) < chi2.ppf(0.999, 3)
    d = states[-1].discs[:, 2]
    assert d.min() < 0.0 < d.max()


# --- the map ---------------------------------------------------------------------------------------------------------


def test_a_disc_out_of_view_is_known_again_and_closes_the_loop():
    rate = np.array([0.0, 2.0, 0.3])
    n = round(2 * np.pi / np.linalg.norm(rate) / DT)
    R, t = rolling(rate, n + 20)
    states = film(FILTER, R, t, np.random.default_rng(10))
    half, end = states[n // 2], states[-1]
    gone = half.discs[:4] @ half.attitude.T @ FILTER.towards_camera < HORIZON
    assert np.any(gone)  # of the first discs
    assert len(end.discs) <= 26  # none is taken for a new one
    assert np.linalg.norm(log(end.attitude @ R[-1].T)) < 6e-4
    sd = [np.sqrt(np.trace(s.joint[:3, :3])) for s in states]
    assert sd[-1] < 0.8 * max(sd)  # the old discs lend their certainty


def test_only_fresh_points_found_discs_and_never_on_top_of_one_another():
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


def test_a_disc_on_trial_goes_and_a_kept_one_stays():
    R, t = rolling([0.0, 0.0, 0.0], 8)
    real = seen(R[0])[1:]
    ghost = np.array([0.05, 0.1, 1.0]) / np.linalg.norm([0.05, 0.1, 1.0])
    with_ghost = points_at(np.vstack([real, ghost]))
    for sightings, stays in ((SETTINGS.trial, True), (1, False)):
        state = FILTER.initial(0.0, R[0])
        for k in range(8):
            points = with_ghost if k < sightings else points_at(real)
            state = FILTER.update(FILTER.predict(state, t[k]), points)
        assert bool(np.any(state.discs @ ghost > 0.999)) == stays
        assert len(state.joint) == 9 + 2 * len(state.discs)


def test_a_disc_that_never_comes_again_is_dropped_in_the_end():
    """A look-alike that lasted its trial, masked since: it must not stay in the map for good, a real disc must."""
    real = seen(np.eye(3))[1:]
    ghost = np.array([0.05, 0.1, 1.0]) / np.linalg.norm([0.05, 0.1, 1.0])
    state = FILTER.initial(0.0, np.eye(3))
    for k in range(5 + 30):
        p = np.vstack([real, ghost]) if k < 5 else real
        state = FILTER.update(FILTER.predict(state, k * DT), points_at(p))
    assert len(state.discs) == len(real)
    for k in range(35, 100):  # a hand over one that was seen 35 times
        state = FILTER.update(FILTER.predict(state, k * DT), points_at(real[1:]))
    assert len(state.discs) == len(real)


def test_the_map_is_bounded():
    small = replace(FILTER, settings=replace(SETTINGS, most_discs=5))
    R, t = rolling([0.0, 1.5, 0.0], 60)
    states = film(small, R, t, np.random.default_rng(11))
    assert max(len(s.discs) for s in states) == 5
    assert all(np.all(s.used < 26) for s in states)


# --- what a hand does ------------------------------------------------------------------------------------------------


def test_a_flick_takes_a_wider_level_and_then_the_quiet_one_again():
    rng = np.random.default_rng(13)
    t = np.arange(75) * DT
    speed = np.interp(t, [0.5, 0.65, 0.9, 1.0], [0.2, 7.0, 7.0, 0.0])  # 400 deg/s by 45 rad/s², then a hand stops it
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * DT)])
    attitudes = exp(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    states = film(FILTER, attitudes, t, rng)
    level = np.array([s.level for s in states])
    assert np.all(level[8:14] < 5.0)
    assert level.max() > 50.0
    assert np.all(level[60:] < 10.0)
    error = [np.linalg.norm(log(s.attitude @ R.T)) for s, R in zip(states, attitudes, strict=True)]
    assert max(error) < 2e-3
    assert_allclose(states[-1].rate, 0.0, atol=0.02)
    assert all(len(s.discs) <= 26 for s in states)


def test_spurious_points_do_not_raise_the_level():
    """As many false points as hidden discs: nothing fits better at a wider level, so the quiet one must stay."""
    rng = np.random.default_rng(14)
    state, R = settled(rate=(0.0, 0.0, 0.0))
    for k in range(1, 20):
        p = seen(R)
        ghosts = directions(6, 100 + k, 0.3)
        ghosts[:, 2] = np.abs(ghosts[:, 2])
        ghosts = ghosts[np.max(ghosts @ (DISCS @ R.T).T, axis=1) < np.cos(0.15)]
        points = points_at(np.vstack([p[:3], ghosts]), rng=rng)
        state = FILTER.update(FILTER.predict(state, state.stamp + DT), points, np.zeros(len(points), dtype=bool))
        assert state.level < 5.0
        assert set(state.used) == {0, 1, 2}


def test_a_look_alike_beside_a_hidden_disc_is_left_out_after_a_gap():
    """Each pair alone passes a wide gate; together they contradict each other."""
    rng = np.random.default_rng(15)
    state, R = settled(rate=(0.1, 0.0, 0.0))
    state = FILTER.predict(state, state.stamp + 0.3)  # the longest gap that is followed by prediction
    R = exp(np.array([0.03, 0.0, 0.0])) @ R
    p = seen(R)
    p[0] = exp(np.array([0.0, 0.02, 0.01])) @ p[0]  # 1.3 deg beside its place
    points = points_at(p, rng=rng)
    after = FILTER.update(state, points, np.zeros(len(p), dtype=bool))
    assert 0 not in after.used
    assert len(after.used) >= 4
    assert np.linalg.norm(log(after.attitude @ R.T)) < 2e-3


def test_dropped_frames_are_longer_steps():
    rng = np.random.default_rng(16)
    rate = np.array([0.4, 0.5, -0.6])
    t = np.delete(np.arange(60), [10, 11, 12, 13, 14, 30, 31, 45]) * DT
    R = exp(rate * t[:, None])
    states = film(FILTER, R, t, rng)
    error = np.array([log(s.attitude @ r.T) for s, r in zip(states, R, strict=True)])
    assert np.abs(error).max() < 2e-3
    assert_allclose(states[-1].rate, rate, atol=0.03)


@pytest.mark.parametrize("gap", [0.0, -0.5, 60.0, 3600.0, 1e6])
def test_stamps_that_repeat_jump_back_or_far_ahead_do_no_harm(gap):
    """A clock that jumps, a machine that slept: finite and positive semi-definite, usable at once for a still ball."""
    rng = np.random.default_rng(17)
    state, R = settled(rate=(0.0, 0.0, 0.0), n=60)
    stamps = state.stamp + gap + np.arange(30) * DT
    for t in stamps:
        state = FILTER.update(FILTER.predict(state, t), points_at(seen(R), rng=rng))
        assert np.all(np.isfinite(state.joint))
        assert np.linalg.eigvalsh(state.joint)[0] > -1e-14
    assert len(state.used) >= 4
    assert np.linalg.norm(log(state.attitude @ R.T)) < 2e-3


def test_nothing_seen_is_a_prediction_and_one_disc_is_half_an_attitude():
    state, R = settled(rate=(0.2, 0.0, 0.0))
    predicted = FILTER.predict(state, state.stamp + DT)
    blind = FILTER.update(predicted, points_at(np.zeros((0, 3))))
    assert_allclose(blind.attitude, predicted.attitude)
    assert_allclose(blind.joint[9:, 9:], predicted.joint[9:, 9:])
    assert np.linalg.eigvalsh(blind.joint - predicted.joint)[0] > -1e-15  # the player may be at a livelier level
    assert len(blind.used) == 0
    own = replace(FILTER, settings=replace(SETTINGS, levels=(1.0,)))
    predicted = own.predict(replace(state, weights=np.ones(1)), state.stamp + DT)
    one = own.update(predicted, points_at(seen(exp(np.array([0.2 * DT, 0, 0])) @ R)[:1]))
    assert len(one.used) == 1
    p = seen(exp(np.array([0.2 * DT, 0, 0])) @ R)[0]
    across = np.cross(p, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(p, [0.0, 0.0, 1.0]))
    left = {n: v @ one.joint[:3, :3] @ v / (v @ predicted.joint[:3, :3] @ v) for n, v in (("p", p), ("a", across))}
    assert left["a"] < 0.9 < left["p"] <= 1.0  # it says nothing of a turn about itself


def test_a_long_rest_keeps_the_covariance_sound():
    """No drift to an asymmetric or indefinite matrix: a still ball, few discs, no noise left to gain."""
    rng = np.random.default_rng(18)
    few = DISCS[DISCS[:, 2] > 0.4][:3]
    state = FILTER.initial(0.0, np.eye(3))
    for k in range(1500):
        state = FILTER.update(FILTER.predict(state, k * DT), points_at(few, rng=rng))
    assert_allclose(state.joint, state.joint.T, atol=1e-15)
    assert np.linalg.eigvalsh(state.joint)[0] > -1e-15
    assert np.linalg.norm(log(state.attitude)) < 2e-3


def test_relocation_keeps_the_map_and_forgets_the_rest():
    state, _ = settled()
    found = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    placed = relocate(state, found, 0.003, SETTINGS, 99.0)
    assert placed.stamp == 99.0
    assert_allclose(placed.attitude, found)
    assert_allclose(placed.joint[9:, 9:], state.joint[9:, 9:])
    assert_allclose(placed.joint[:9, 9:], 0.0)
    after = FILTER.update(placed, points_at(seen(found), rng=np.random.default_rng(19)))
    assert len(after.used) >= 3
    assert np.linalg.norm(log(after.attitude @ found.T)) < 2e-3
