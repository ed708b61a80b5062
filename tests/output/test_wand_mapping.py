"""Laws of the wand's pointer: nothing is lost, nothing is invented, a ball at rest or lost is silent."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spheremouse.output.wand_mapping import PointingSettings, WandMapping
from spheremouse.tracker import Status
from spheremouse.wand.estimate import estimate, measured_pose
from spheremouse.wand.pose_velocity import initialise
from spheremouse.wand.state import Track, WandPose

DT = 1.0 / 30.0
SIGMA = 0.01  # rad and m
AHEAD = np.array([0.0, 0.0, 1.5])
SEEDS = st.integers(0, 2**32 - 1)
WAYS = st.sampled_from(["turn", "shift"])


def pose(position, rotation, sigma=SIGMA, seen=True):
    return WandPose("ball", position, rotation, np.eye(6) * max(sigma, 1e-12) ** 2, Status.TRACKING, None, seen=seen)


MISSING = WandPose("ball", None, None, None, Status.LOST, None)


def turned(*degrees):
    return Rotation.from_rotvec(np.radians(degrees)).as_matrix()


def walk(seed, n=40, turn=0.03, shift=0.01):
    """n random poses, (n, 3) m and (n, 3, 3), each a small step from the one before."""
    rng = np.random.default_rng(seed)
    R = [Rotation.random(random_state=rng)]
    for v in rng.normal(0.0, turn, (n - 1, 3)):
        R.append(Rotation.from_rotvec(v) * R[-1])
    return np.cumsum(rng.normal(0.0, shift, (n, 3)), axis=0) + AHEAD, np.array([r.as_matrix() for r in R])


def reports(poses, mapping, dt=DT, track=Track()):  # noqa: B008  frozen
    """Return counts, rate and estimate of each pose."""
    found, measured = [], None
    for k, one in enumerate(poses):
        made = estimate(measured, track, one, k * dt, k)
        found.append((*mapping.counts(made), made))
        measured = measured_pose(measured, one, k * dt)
    return found


def follow(poses, settings):
    """Return the counts of each pose, (n, 3), and the mapping after the last."""
    mapping = WandMapping(settings)
    return np.array([counts for counts, _, _ in reports(poses, mapping)]), mapping


def way_of(p, R, settings):
    """(3,) integral of the motion, by SciPy."""
    if settings.by == "shift":
        return p[-1] - p[0]
    rotation = Rotation.from_matrix(R)
    return (rotation[1:] * rotation[:-1].inv()).as_rotvec().sum(axis=0)


@given(SEEDS, WAYS, st.floats(0.0, 4.0), st.booleans(), st.booleans(), st.booleans())
def test_counts_are_the_integral_less_slack_and_remainder(seed, by, play, facing, invert_x, invert_z):
    settings = PointingSettings(by=by, play=play, facing=facing, invert_x=invert_x, invert_z=invert_z, scale_y=1.7)
    p, R = walk(seed)
    counts, after = follow(map(pose, p, R), settings)
    integral, M = way_of(p, R, settings), settings.matrix()
    assert counts.sum(axis=0) + after.fraction == pytest.approx(M @ (integral - after.slack), abs=1e-6)
    assert np.abs(after.fraction).max() < 1.0
    assert np.abs(after.slack).max() <= play * SIGMA + 1e-12
    assert (np.abs(counts.sum(axis=0) - M @ integral) <= np.abs(M) @ np.full(3, play * SIGMA) + 1.0).all()


@given(SEEDS, WAYS)
def test_there_and_back_on_the_same_way_is_nothing_without_play(seed, by):
    p, R = walk(seed)
    settings = PointingSettings(by=by, play=0.0)
    counts, _ = follow(map(pose, np.concatenate([p, p[::-1]]), np.concatenate([R, R[::-1]])), settings)
    assert np.abs(counts.sum(axis=0)).max() <= 1
    assert np.abs(counts).sum() > 100


@pytest.mark.slow
@given(SEEDS, WAYS, st.floats(1.0, 4.0))
def test_what_jitters_within_the_play_moves_nothing(seed, by, play):
    rng = np.random.default_rng(seed)
    d = rng.uniform(-1.0, 1.0, (200, 6)) * play * SIGMA * 0.98 / 2.0  # two of them are less than the play apart
    R = [Rotation.from_rotvec(v).as_matrix() for v in d[:, 3:] * 0.98]
    counts, _ = follow(map(pose, d[:, :3] + (0, 0, 1), R), PointingSettings(by=by, play=play))
    assert not counts.any()


def test_the_dead_band_is_as_wide_as_the_filter_is_unsure():
    """The same motion: lost in the noise of one filter, and known to another."""
    R = [turned(0, a, 0) for a in (0.0, 0.5)]
    for sigma, moves in ((np.radians(0.3), False), (np.radians(0.1), True)):
        counts, _ = follow([pose(np.array([0, 0, 1.0]), r, sigma) for r in R], PointingSettings())
        assert (counts[1, 0] > 0) == moves
    assert counts[1, 0] == pytest.approx(1800 * np.radians(0.5 - 2 * 0.1), abs=1.0)


def test_a_filter_that_becomes_surer_moves_nothing():
    p, R = np.array([0, 0, 1.0]), turned(0, 1, 0)
    steps = [pose(p, np.eye(3), 0.02), pose(p, R, 0.02), *(pose(p, R, s) for s in (0.01, 0.003, 0.0))]
    counts, after = follow(steps, PointingSettings())
    assert not counts.any()
    assert after.slack[1] == pytest.approx(np.radians(1))


@given(SEEDS, WAYS, st.sampled_from(["lost", "leap"]))
def test_a_ball_that_was_lost_or_leapt_begins_anew_where_it_is(seed, by, fault):
    p, R = walk(seed, n=15)
    settings = PointingSettings(by=by)
    before = list(map(pose, p, R))
    away = [replace(MISSING, phase=Status.SEARCHING), MISSING, MISSING] if fault == "lost" else []
    far = list(map(pose, p + np.array([1.0, 0.0, 0.0]), R @ turned(0, 90, 0)))
    counts, _ = follow([*before, *away, *far], settings)
    alone, mapping = follow(before, settings)
    assert (counts[: len(before)] == alone).all()
    assert not counts[len(before) : len(before) + len(away) + 1].any()
    mapping.interrupted()
    assert (counts[-len(far) :] == [again for again, _, _ in reports(far, mapping)]).all()


def test_while_it_is_hidden_nothing_moves_and_afterwards_nothing_is_missing():
    p = np.array([0, 0, 1.0])
    steps = [pose(p, turned(0, a, 0), sigma=0.0) for a in (0, 2, 4)]
    guess = replace(pose(p, turned(30, 0, 0)), seen=False)
    counts, _ = follow([steps[0], steps[1], guess, guess, steps[2]], PointingSettings())
    assert not counts[2:4].any()
    assert counts.sum(axis=0) == pytest.approx((1800 * np.radians(4), 0, 0), abs=1.0)


def test_a_slow_camera_is_no_leap():
    """Stamps that stand still move nothing either."""
    p = np.array([0, 0, 1.0])
    for dt, moves in ((0.5, True), (0.02, False), (0.0, False)):
        mapping = WandMapping(PointingSettings())
        _, (counts, _, made) = reports([pose(p, np.eye(3)), pose(p, turned(0, 60, 0))], mapping, dt=dt)
        assert (counts[0] > 0) == moves
        assert np.linalg.norm(made.increment[:3]) == pytest.approx(np.radians(60) if moves else 0.0)


# ---- which way ----

CAMERA_AHEAD = {True: np.diag([-1.0, 1.0, -1.0]), False: np.eye(3)}  # R_cam_holder: right, down, ahead


@pytest.mark.parametrize("facing", [True, False])
def test_the_pointer_goes_where_the_holder_points(facing):
    """A laser held ahead: its spot on a wall goes right, down; a wheel that is turned clockwise goes forward."""
    to_cam = CAMERA_AHEAD[facing]
    p, still = np.array([0, 0, 1.0]), pose(np.array([0, 0, 1.0]), np.eye(3), 0.0)
    for axis, angle, expected in (("x", -5, (0, 1, 0)), ("y", 5, (1, 0, 0)), ("z", 5, (0, 0, 1))):
        turn = Rotation.from_euler(axis, angle, degrees=True).as_matrix()  # in the holder's frame
        spot, top = turn @ (0, 0, 1), turn @ (0, -1, 0)
        assert np.sign(np.round((spot[0], spot[1], top[0]), 6)).tolist() == list(expected)
        counts, _ = follow([still, pose(p, to_cam @ turn @ to_cam.T, 0.0)], PointingSettings(facing=facing))
        assert np.sign(counts[1]).tolist() == list(expected)
        assert np.abs(counts[1]).max() == pytest.approx(1800 * np.radians(5), abs=1.0)


@pytest.mark.parametrize("facing", [True, False])
def test_shifts_go_where_the_holder_shifts(facing):
    settings = PointingSettings(by="shift", facing=facing)
    for way in np.eye(3):
        p = np.array([0, 0, 1.0])
        counts, _ = follow(
            [pose(p, np.eye(3), 0.0), pose(p + CAMERA_AHEAD[facing] @ way * 0.05, np.eye(3), 0.0)], settings
        )
        assert counts[1] == pytest.approx(4800 * 0.05 * way, abs=1.0)


@given(WAYS, st.booleans(), st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_the_rate_is_that_of_the_counts(by, facing, velocity):
    """So that the pointer may be carried on with it."""
    v, settings = np.array(velocity), PointingSettings(by=by, facing=facing, play=0.0, scale_z=0.3)
    steps = [pose((0, 0, 1) + v[:3] * k * DT, Rotation.from_rotvec(v[3:] * k * DT).as_matrix(), 0.0) for k in range(20)]
    counts, _ = follow(steps, settings)
    rate = settings.matrix() @ (v[3:] if by == "turn" else v[:3])
    assert counts.sum(axis=0) == pytest.approx(rate * 19 * DT, abs=1.0)
    pose_velocity = replace(initialise(0.0, AHEAD, np.eye(3), np.eye(6)), velocity=v)
    for _, told, made in reports(steps[:2], WandMapping(settings), track=Track(pose_velocity=pose_velocity)):
        assert made.rate == pytest.approx(np.roll(v, 3))
        assert told == pytest.approx(rate)


def test_a_motion_is_as_uncertain_as_sampled_poses_are():
    """Rotation and shift of two poses that are off as their covariances say; where it begins to count, no error."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2, 6, 6)) * 1e-3
    P = [a @ a.T for a in A]
    p, R = np.array([0.1, -0.2, 1.0]), turned(20, -30, 40)
    q, Q = p + 0.02, turned(25, -10, 50)
    pose_velocity = initialise(0.0, q, Q, np.eye(6))

    def motion(e):
        poses = [
            WandPose(
                "ball", at + d[:3], Rotation.from_rotvec(d[3:]).as_matrix() @ to, C, Status.TRACKING, None, seen=True
            )
            for (at, to), d, C in zip(((p, R), (q, Q)), e, P, strict=True)
        ]
        mapping = WandMapping(PointingSettings())
        first, second = reports(poses, mapping, dt=1.0, track=Track(pose_velocity=pose_velocity))
        assert not np.any(first[2].increment_covariance)
        return second[2]

    drawn = [motion([L @ rng.normal(size=6) for L in A]) for _ in range(4000)]
    scatter = np.cov(np.array([m.increment for m in drawn]).T)
    told = motion(np.zeros((2, 6))).increment_covariance
    scale = np.sqrt(np.outer(np.diag(scatter), np.diag(scatter)))
    assert np.abs(told - scatter).max() < 0.1 * np.diag(scatter).max()
    assert np.abs((told - scatter) / scale).max() < 0.15
    assert motion(np.zeros((2, 6))).covariance[6:9, 6:9] == pytest.approx(pose_velocity.covariance[9:, 9:])


def test_fractions_survive_a_loss():
    """Nothing moves at it, and half a count is not lost for ever."""
    _, mapping = follow([pose(AHEAD, turned(0, angle, 0), 0.0) for angle in (0.0, 1.0)], PointingSettings())
    fraction = mapping.fraction
    assert abs(fraction[0]) > 0.1
    assert reports([MISSING], mapping)[0][:2] == ((0, 0, 0), None)
    assert mapping.fraction == fraction
