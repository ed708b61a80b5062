"""The measuring instrument: figures against hand-made errors, SciPy and a batch adjustment; the command's words."""

import json
import math
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from conftest import directions as ball_directions
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import pearsonr

from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE, DiscTruth, Truth
from spheremouse.errors import ConfigurationError
from spheremouse.evaluation import metrics, plot
from spheremouse.evaluation.bound import Bound, Sight, manoeuvre, posterior_bound
from spheremouse.evaluation.detection import detection_quality
from spheremouse.evaluation.run import Reference, Run
from spheremouse.evaluation.table import consistency, path_notes
from spheremouse.files.ball_map import save_map, saved_now
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import rotation_between, tangent_basis
from spheremouse.output.counts import MotionSettings
from spheremouse.simulate.ball.events import degrade
from spheremouse.simulate.ball.film import SimulationOptions, prepare
from spheremouse.simulate.to_dataset import write_simulation
from spheremouse.tracker import Frame, Status

CAMERA = InteriorOrientation(640, 480, 600.0, 620.0, 318.0, 243.0)
POSE = Pose(Rotation.from_euler("XYZ", [175.0, 4.0, 80.0], degrees=True).as_matrix(), np.array([0.1, -0.05, 2.3]))
RIG = Rig(CAMERA, Ball(0.6), Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)), 0.02)
T, L, S = Status.TRACKING, Status.LOST, Status.SEARCHING


def random_motion(n, seed=0):
    """A ball that turns a lot: attitudes by SciPy from random rates."""
    rng = np.random.default_rng(seed)
    rate = np.cumsum(rng.normal(0.0, 0.3, (n, 3)), axis=0)
    R = Rotation.random(rng=rng)
    attitude = []
    for w in rate:
        attitude.append(R.as_matrix())
        R = Rotation.from_rotvec(w / 30.0) * R
    return Truth(np.arange(n) / 30.0, np.array(attitude), rate)


def truth_turns(truth):
    """Rotation vectors from frame to frame, by SciPy."""
    R = Rotation.from_matrix(truth.attitude)
    return (R[1:] * R[:-1].inv()).as_rotvec()


def perfect_run(truth, detected=None, used=None):
    n = len(truth)
    none = tuple(np.zeros((0, 2)) for _ in range(n))
    return Run(
        frame=np.arange(n),
        stamp=truth.stamp,
        status=(T,) * n,
        attitude=truth.attitude.copy(),
        rate=truth.rate.copy(),
        rotation=np.concatenate([np.zeros((1, 3)), truth_turns(truth)]),
        covariance=np.broadcast_to(np.eye(6), (n, 6, 6)).copy(),
        absolute=np.zeros(n, dtype=bool),
        detected=none if detected is None else detected,
        used=none if used is None else used,
        seconds={"detect": np.full(n, 3e-3), "filter": np.full(n, 1e-3)},
    )


def figures(run, reference, found=None, frames=None):
    return metrics.report(run, reference, RIG, dataset="d", tracker="so3", frames=frames or len(run.frame), found=found)


def test_attitude_errors_are_rotation_vectors_in_obj():
    """Errors that grow from zero are given back exactly, whatever the ball's frame and wherever it has turned to."""
    truth = random_motion(50).attitude
    e = np.linspace(0.0, 1.0, 50)[:, None] * [0.3, -0.5, 0.7]
    estimate = Rotation.from_rotvec(e).as_matrix() @ truth @ Rotation.random(rng=1).as_matrix()
    assert_allclose(metrics.attitude_error(estimate, truth), e, atol=1e-13)


def test_the_first_frames_error_is_taken_as_turning_with_the_ball():
    """exp(e) R in all frames: what is left is e against e turned along with the ball since."""
    truth, e = random_motion(50).attitude, np.array([0.02, -0.01, 0.03])
    moved = truth @ truth[0].T
    expected = (Rotation.from_rotvec(e) * Rotation.from_rotvec(moved @ -e)).as_rotvec()
    assert_allclose(metrics.attitude_error(Rotation.from_rotvec(e).as_matrix() @ truth, truth), expected, atol=1e-14)


def test_surface_speed_is_what_the_mouse_does_per_second():
    """Sent and true motion in mm, Y upwards, over the time they take; frames after a gap have no time."""
    truth = random_motion(30)
    matrix = MotionSettings(counts_per_mm=1.0).matrix(0.6)
    travel = np.array(
        [matrix @ rotation_between(a, b) * 30.0 for a, b in zip(truth.attitude[:-1], truth.attitude[1:], strict=True)]
    )
    run = perfect_run(truth)
    run = replace(run, rotation=run.rotation * 1.01, status=(*(T,) * 10, Status.LOST, *(T,) * 19))
    sent, true = metrics.surface_speeds(run, truth, 0.6)
    kept = [k for k in range(1, 30) if k not in {10, 11}]
    assert_allclose(true, travel[:, :2][np.array(kept) - 1] * (1.0, -1.0), rtol=1e-9, atol=1e-9)
    assert_allclose(sent, 1.01 * true, rtol=1e-9, atol=1e-9)


def test_pearson():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(200, 2))
    b = 0.5 * a + rng.normal(size=(200, 2)) + [0.0, 3.0]
    x, y, both = (pearsonr(a[:, i].ravel("F"), b[:, i].ravel("F"))[0] for i in ([0], [1], [0, 1]))
    assert metrics.correlation(a, b) == pytest.approx({"x": x, "y": y, "combined": both})
    assert metrics.pearson(np.ones(5), np.arange(5.0)) is None


def test_nees_of_errors_drawn_from_their_covariances():
    """Chi-square with k degrees: mean k, standard deviation sqrt(2 k / n)."""
    rng = np.random.default_rng(4)
    L = rng.normal(size=(20_000, 3, 3))
    e = np.einsum("nij,nj->ni", L, rng.normal(size=(20_000, 3)))
    assert metrics.mean_nees(e, L @ L.transpose(0, 2, 1)) == pytest.approx(3.0, abs=5 * math.sqrt(6.0 / 20_000))
    thin = L[:, :, :2]  # rank 2
    e = np.einsum("nij,nj->ni", thin, rng.normal(size=(20_000, 2)))
    assert metrics.mean_nees(e, thin @ thin.transpose(0, 2, 1)) == pytest.approx(2.0, abs=5 * math.sqrt(4.0 / 20_000))
    assert metrics.mean_nees(2.0 * np.eye(3)[:1], np.array([np.diag([4.0, 1.0, 1.0])])) == pytest.approx(1.0)
    assert metrics.mean_nees(np.full((1, 3), np.nan), np.eye(3)[None]) is None


def test_lost_episodes_are_counted_once_each():
    assert metrics.lost_episodes([S, T, L, L, T, L, T]) == 2
    assert metrics.lost_episodes([L, T]) == 1
    assert metrics.lost_episodes([S, T]) == metrics.lost_episodes([]) == 0


def disc_truth(*rows):
    """Rows of frame, u, v, area, state."""
    t = np.array(rows, dtype=float)
    centre = t[:, 1:3]
    return DiscTruth(t[:, 0].astype(int), np.arange(len(t)), centre, centre + 0.1, t[:, 3], t[:, 4].astype(int))


def test_detection_quality_by_hand():
    truth = disc_truth(
        (0, 100.0, 100.0, 80.0, VISIBLE),  # found, off by (0.3, -0.4)
        (0, 200.0, 100.0, 80.0, VISIBLE),  # not found: 3.5 px off
        (0, 204.5, 100.0, 11.9, VISIBLE),  # too small to be asked for
        (0, 300.0, 100.0, 80.0, PARTLY_HIDDEN),  # not asked for, but a disc where it is used
        (0, 400.0, 100.0, 80.0, HIDDEN),  # what is seen here is something else
        (1, 100.0, 100.0, 80.0, VISIBLE),  # two detections near one disc
        (1, 110.0, 100.0, np.nan, VISIBLE),  # at the limb
    )
    detected = (
        np.array([[100.3, 99.6], [203.5, 100.0], [300.0, 100.0], [400.0, 100.0]]),
        np.array([[101.0, 100.0], [99.5, 100.0]]),
    )
    used = (np.array([[100.3, 99.6], [301.0, 101.0], [400.0, 100.0], [50.0, 50.0]]), np.array([[101.0, 100.0]]))
    quality = detection_quality(perfect_run(random_motion(2), detected, used), truth)
    assert quality["recall"] == pytest.approx(2 / 3)
    assert quality["false_share"] == pytest.approx(2 / 5)
    assert quality["centre_rms_px"] == pytest.approx(math.sqrt((0.09 + 0.16 + 0.25 + 0.0) / 4))


def test_slivers_are_told_from_larger_discs():
    truth = disc_truth(*((k, 100.0, 100.0, a, VISIBLE) for k, a in enumerate((13.0, 16.0, 16.0, 59.0, 61.0))))
    seen = [np.array([[100.0 + e, 100.0]]) for e in (0.5, 0.5, 50.0, 0.3, 0.1)]
    quality = detection_quality(perfect_run(random_motion(5), tuple(seen)), truth)
    assert quality["recall"] == pytest.approx(4 / 5)
    assert quality["recall_15"] == pytest.approx(3 / 4)
    assert quality["centre_rms_60_px"] == pytest.approx(0.1 / 2**0.5)


def test_recall_by_the_semi_minor_axis_asks_for_the_same_discs_at_any_size():
    """Rows whose axis is long enough, whatever their area; None where nobody says how long the axes are."""
    areas, axes = (5.0, 80.0, 80.0, 80.0, np.nan), np.array([1.3, 1.3, 1.2, 1.25, np.nan])
    truth = disc_truth(*((k, 100.0, 100.0, a, VISIBLE) for k, a in enumerate(areas)))
    seen = [np.array([[100.0 + e, 100.0]]) for e in (0.5, 50.0, 50.0, 0.5, 0.5)]
    run = perfect_run(random_motion(5), tuple(seen))
    assert detection_quality(run, truth, axes)["recall_axis"] == pytest.approx(2 / 3)
    assert detection_quality(run, truth)["recall_axis"] is None


def test_one_detection_is_not_two_discs_and_none_is_no_error():
    truth = disc_truth((5, 100.0, 100.0, 20.0, VISIBLE), (5, 104.0, 100.0, 20.0, VISIBLE))
    between = (*[np.zeros((0, 2))] * 5, np.array([[102.0, 100.0]]))
    assert detection_quality(perfect_run(random_motion(6), between), truth)["recall"] == 0.5
    nothing = dict.fromkeys(DETECTION)
    assert detection_quality(perfect_run(random_motion(1)), truth) == nothing
    assert detection_quality(perfect_run(random_motion(6)), truth) == {**nothing, "recall": 0.0, "recall_15": 0.0}


def test_pose_error_in_obj_axes():
    turn = np.deg2rad([0.1, -0.2, 0.3])
    P = np.diag(np.square([1e-3, 2e-3, 3e-3, *np.deg2rad([0.05, 0.06, 0.07])]))
    found = Pose((Rotation.from_rotvec(turn) * Rotation.from_matrix(POSE.rotation)).as_matrix(), POSE.position, P)
    error = metrics.pose_error(replace(found, position=np.add(POSE.position, [1e-3, 0.0, -2e-3])), POSE)
    assert_allclose(error["position_mm"], [1.0, 0.0, -2.0], atol=1e-12)
    assert_allclose(error["angle_deg"], [0.1, -0.2, 0.3], atol=1e-10)
    assert_allclose(error["sigma_position_mm"], [1.0, 2.0, 3.0])
    assert_allclose(error["sigma_angle_deg"], [0.05, 0.06, 0.07])


def test_frame_times_add_the_stages_of_each_frame():
    times = metrics.frame_times({"detect": np.array([1e-3, 2e-3, 9e-3]), "filter": np.array([5e-4, 1e-4, 1e-3])})
    assert times["median"] == pytest.approx(2100.0)
    assert times["max"] == pytest.approx(10_000.0)
    assert times["p99"] == pytest.approx(2100.0 + 0.98 * 7900.0)
    assert metrics.frame_times({}) == {"median": None, "p99": None, "max": None}


def test_nis_is_per_degree_of_freedom_of_the_discs_used_and_known_before():
    """Innovations drawn from their covariance give 1; frames that found their discs, or are lost, do not count."""
    rng = np.random.default_rng(3)
    truth = random_motion(4000)
    used = tuple(np.zeros((n, 2)) for n in rng.integers(1, 9, 4000))
    nis = np.array([np.sum(rng.normal(size=2 * len(u)) ** 2) for u in used])
    nis[:500], nis[500:1000] = 0.0, 1e6
    phase = (T,) * 500 + (L,) * 500 + (T,) * 3000
    run = replace(perfect_run(truth, used=used), nis=nis, status=phase)
    freedom = 2 * sum(len(u) for u in used[1000:])
    assert metrics.mean_nis(run) == pytest.approx(1.0, abs=5 * math.sqrt(2.0 / freedom))
    assert metrics.mean_nis(replace(run, nis=None)) is None
    assert metrics.mean_nis(replace(run, status=(L,) * 4000)) is None


DETECTION = ["recall", "false_share", "centre_rms_px", "recall_15", "recall_axis", "centre_rms_60_px"]
KEYS = {
    "dataset": None,
    "tracker": None,
    "frames": None,
    "tracked": None,
    "lost_episodes": None,
    "attitude_rmse_deg": ["x", "y", "z", "combined"],
    "rate_rmse_deg_s": ["x", "y", "z", "combined"],
    "surface_speed_rmse_mm_s": ["x", "y", "combined"],
    "surface_speed_r": ["x", "y", "combined"],
    "rotation_scale": ["x", "y", "z"],
    "rotation_scale_ci95": ["x", "y", "z"],
    "drift_deg_min": ["x", "y", "z"],
    "drift_deg_min_ci95": ["x", "y", "z"],
    "mean_discs": None,
    "identified_from_frame": None,
    "detection": DETECTION,
    "pose_error": ["position_mm", "angle_deg", "sigma_position_mm", "sigma_angle_deg"],
    "nees": ["attitude", "rate"],
    "nis": None,
    "rate_roughness_deg_s": None,
    "bound_ratio": ["attitude", "rate"],
    "frame_us": ["median", "p99", "max"],
    "stages_us": ["detect", "filter"],
}


def assert_has_all_keys(result, without=()):
    assert list(result) == list(KEYS)
    nested = {key: parts for key, parts in KEYS.items() if parts and key not in without}
    assert {key: list(result[key]) for key in nested} == nested
    json.dumps(result, allow_nan=False)


def test_report_has_the_keys_of_the_format_and_known_errors():
    truth = random_motion(40)
    discs = disc_truth(*[(k, 100.0, 100.0, 80.0, VISIBLE) for k in range(40)])
    seen = tuple(np.array([[100.0, 100.1]]) for _ in range(40))
    run = perfect_run(truth, seen, seen)
    error = np.deg2rad([0.1, 0.2, 0.2])
    run.attitude[1:] = Rotation.from_rotvec(error).as_matrix() @ run.attitude[1:]
    run = replace(run, rate=run.rate + np.deg2rad([3.0, 0.0, 4.0]))
    result = figures(run, Reference(truth, discs, POSE), POSE)
    assert_has_all_keys(result)
    share = math.sqrt(39 / 40)  # the first frame is the reference
    expected = {"x": 0.1 * share, "y": 0.2 * share, "z": 0.2 * share, "combined": 0.3 * share}
    assert result["attitude_rmse_deg"] == pytest.approx(expected)
    assert result["rate_rmse_deg_s"] == pytest.approx({"x": 3.0, "y": 0.0, "z": 4.0, "combined": 5.0})
    assert result["surface_speed_rmse_mm_s"] == pytest.approx({"x": 0.0, "y": 0.0, "combined": 0.0}, abs=1e-9)
    assert result["surface_speed_r"]["x"] == pytest.approx(1.0)
    assert result["nees"] == pytest.approx({"attitude": error @ error, "rate": np.deg2rad(5.0) ** 2})
    assert result["mean_discs"] == 1.0
    off = 0.1 / 2**0.5
    assert result["detection"] == pytest.approx(dict(zip(DETECTION, (1.0, 0.0, off, 1.0, None, off), strict=True)))
    assert result["frame_us"]["median"] == pytest.approx(4000.0)
    assert result["stages_us"] == pytest.approx({"detect": 3000.0, "filter": 1000.0})


def test_the_roughness_of_white_noise_in_the_rate_is_known_and_that_of_a_steady_change_is_none():
    n = 4000
    truth = Truth(np.arange(n) / 30.0, np.tile(np.eye(3), (n, 1, 1)), np.outer(np.arange(n), [0.1, 0.0, -0.2]))
    run = perfect_run(truth)
    assert metrics.rate_roughness(run) == pytest.approx(0.0, abs=1e-6)
    noisy = replace(run, rate=run.rate + np.random.default_rng(1).normal(0.0, np.deg2rad(0.5), (n, 3)))
    # the second difference of white noise has six times its variance, here in three components
    expected = 0.5 * math.sqrt(3 * 6)
    assert metrics.rate_roughness(noisy) == pytest.approx(expected, rel=0.05)


def test_a_missing_scale_or_drift_has_its_reason():
    n = 400
    turned = Rotation.from_rotvec(np.cumsum(np.full((n, 3), [0.0, 0.02, 0.0]), axis=0)).as_matrix()
    truth = Truth(np.arange(n) / 30.0, turned, np.full((n, 3), [0.0, 0.6, 0.0]))
    result = figures(perfect_run(truth), Reference(truth))
    assert result["rotation_scale"] == {"x": None, "y": pytest.approx(1.0), "z": None}
    lines = path_notes(result)
    assert [line.partition(":")[2].partition(":")[0].strip() for line in lines] == [
        "no rotation scale about x",
        "no rotation scale about z",
        "no drift",
    ]
    short = figures(perfect_run(random_motion(60)), Reference(random_motion(60)))
    assert path_notes(short) == ["d: no rotation scale and drift: they need ten seconds of tracking"]
    assert path_notes(figures(perfect_run(truth), Reference())) == []


def test_only_tracked_frames_count_and_frames_are_found_by_their_index():
    """A run that began at frame 10 of the recording, was lost for a while, and then says nonsense."""
    truth = random_motion(60)
    run = perfect_run(Truth(truth.stamp[10:], truth.attitude[10:], truth.rate[10:]))
    phase = [S] * 5 + [T] * 20 + [L] * 10 + [T] * 15
    garbage = np.array([p is not T for p in phase])
    run.attitude[garbage] = Rotation.random(rng=5).as_matrix()
    run.rate[garbage] = 1e3
    result = figures(replace(run, frame=np.arange(10, 60), status=tuple(phase)), Reference(truth), frames=60)
    assert (result["frames"], result["tracked"], result["lost_episodes"]) == (60, 35, 1)
    assert result["attitude_rmse_deg"]["combined"] == pytest.approx(0.0, abs=1e-9)
    assert result["rate_rmse_deg_s"]["combined"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("status", [T, S])
def test_what_is_not_known_is_null_and_not_zero(status):
    """Without a truth, or where nothing was tracked."""
    run = replace(perfect_run(random_motion(5)), status=(status,) * 5)
    result = figures(run, Reference(None if status is T else random_motion(5)))
    assert_has_all_keys(result, without=("detection", "pose_error"))
    assert (result["detection"], result["pose_error"]) == (None, None)
    for key in ("attitude_rmse_deg", "rate_rmse_deg_s", "surface_speed_rmse_mm_s", "surface_speed_r", "nees"):
        assert set(result[key].values()) == {None}
    assert result["bound_ratio"] == {"attitude": None, "rate": None}
    assert (result["tracked"], result["mean_discs"]) == ((5, 0.0) if status is T else (0, None))


def test_identified_is_the_first_frame_whose_attitude_is_absolute():
    """Counted in the recording, from whichever of its frames the run began."""
    truth = random_motion(20)
    run = replace(perfect_run(truth), frame=np.arange(4, 24), absolute=np.arange(20) >= 3)
    assert metrics.identified_from(run) == 7
    assert figures(run, Reference())["identified_from_frame"] == 7
    assert figures(perfect_run(truth), Reference())["identified_from_frame"] is None


def test_standard_deviations_that_differ_from_the_errors_are_told_by_their_factor():
    ball = {"dataset": "d", "nees": {"attitude": 0.75, "rate": 48.0}, "nis": 1.0}
    assert consistency(ball) == [
        "d: standard deviations of attitude 2.0 times larger than the errors: they are on the safe side",
        "d: standard deviations of rate 4.0 times smaller than the errors: do not rely on them",
    ]
    assert consistency({"dataset": "d", "nees": {"attitude": 3.0, "rate": None}, "nis": None}) == []
    wand = {"dataset": "w", "anees": {"position": 0.25, "rotation": 1.2, "pose": None}}
    assert [line.partition(" larger")[0] for line in consistency(wand)] == [
        "w: standard deviations of position 2.0 times"
    ]


def batch_covariance(truth, sights, directions):
    """Covariances of the last attitude and rate by one adjustment of everything at once.

    Unknown: first rate, an acceleration per interval (prior: covariance falls geometrically with the distance), two
    coordinates per disc. Jacobians by central differences through the motion itself and OpenCV's projection.
    """
    n, m = len(truth), len(directions)
    dt = np.diff(truth.stamp)
    acceleration = np.diff(truth.rate, axis=0) / dt[:, None]
    prior = np.zeros((n - 1, 3, n - 1, 3))
    for axis, a in enumerate(acceleration.T):
        lasting = max(np.sum(a[1:] * a[:-1]) / np.sum(a**2), 0.0)
        apart = np.abs(np.subtract.outer(np.arange(n - 1), np.arange(n - 1)))
        prior[:, axis, :, axis] = np.mean(a**2) * lasting**apart
    turn = [
        Rotation.from_matrix(b @ a.T).as_rotvec() for a, b in zip(truth.attitude[:-1], truth.attitude[1:], strict=True)
    ]
    basis = tangent_basis(directions)
    T_cam = POSE.rotation.T

    def attitudes(x):
        R, w, a = Rotation.from_matrix(truth.attitude[0]), x[:3], x[3 : 3 * n].reshape(-1, 3)
        path = [R]
        for k in range(n - 1):
            R = Rotation.from_rotvec(turn[k] + dt[k] * w + 0.5 * dt[k] ** 2 * a[k]) * R
            w = w + dt[k] * a[k]
            path.append(R)
        return path, w

    def pixels(x):
        path, _ = attitudes(x)
        d = directions + np.einsum("mij,mj->mi", basis, x[3 * n :].reshape(m, 2))
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
        uv = []
        for R, sight in zip(path, sights, strict=True):
            points = 0.6 * R.apply(d[sight.disc])
            uv.append(
                cv2.projectPoints(points, cv2.Rodrigues(T_cam)[0], -T_cam @ POSE.position, CAMERA.matrix, None)[0]
            )
        return np.concatenate(uv).ravel()

    def last(x):
        path, w = attitudes(x)
        return np.r_[(path[-1] * Rotation.from_matrix(truth.attitude[-1]).inv()).as_rotvec(), w]

    def jacobian(f):
        steps = 1e-5 * np.eye(3 * n + 2 * m)
        return np.array([(f(s) - f(-s)) / 2e-5 for s in steps]).T

    J = jacobian(pixels) / np.repeat(np.concatenate([s.sigma for s in sights]), 2)[:, None]
    information = J.T @ J
    size = 3 * (n - 1)
    information[3 : 3 * n, 3 : 3 * n] += np.linalg.inv(prior.reshape(size, size))
    A = jacobian(last)
    covariance = A @ np.linalg.solve(information, A.T)
    return covariance[:3, :3], covariance[3:, 3:]


@pytest.mark.parametrize("lasting", [False, True])
def test_bound_equals_an_adjustment_of_all_frames_at_once(lasting):
    """Discs come into view, go, and come back, with noises of their own; the step between frames is not constant."""
    rng = np.random.default_rng(6)
    n = 7
    truth = random_motion(n, seed=7)
    truth = replace(truth, stamp=np.cumsum(rng.uniform(0.02, 0.08, n)))
    if lasting:
        truth = replace(truth, rate=np.cumsum(np.cumsum(truth.rate, axis=0), axis=0))
        assert manoeuvre(truth).lasting.min() > 0.2
    near = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (5, 3))).apply([0.0, 0.0, 1.0])
    directions = near @ truth.attitude[3]
    seen = [np.array(s) for s in ([0, 1, 2], [0, 1, 2], [1, 2, 3], [1, 3, 4], [3, 4], [0, 3, 4], [0, 1, 2, 3, 4])]
    sights = [Sight(s, rng.uniform(0.02, 0.2, len(s))) for s in seen]
    bound = posterior_bound(truth, sights, directions, RIG, POSE)
    attitude, rate = batch_covariance(truth, sights, directions)
    assert_allclose(bound.attitude[-1], attitude, rtol=2e-4, atol=2e-4 * attitude.max())
    assert_allclose(bound.rate[-1], rate, rtol=2e-4, atol=2e-4 * rate.max())
    assert_allclose(bound.attitude[0], 0.0)


def test_manoeuvre_of_known_processes():
    """A rate made of Gauss-Markov accelerations has their strength and lasting; one that alternates is white."""
    rng = np.random.default_rng(1)
    n, dt, lasting = 200_000, 0.02, np.array([0.0, 0.6, 0.95])
    noise = rng.normal(size=(n, 3)) * np.sqrt(1.0 - lasting**2)
    a = np.stack([lfilter([1.0], [1.0, -r], noise[:, i]) for i, r in enumerate(lasting)], axis=1) * [1.0, 2.0, 3.0]
    stamp = dt * np.arange(n + 1)
    rate = np.concatenate([np.zeros((1, 3)), np.cumsum(a * dt, axis=0)])
    found = manoeuvre(Truth(stamp, np.tile(np.eye(3), (n + 1, 1, 1)), rate))
    assert_allclose(found.sigma, [1.0, 2.0, 3.0], rtol=0.05)
    assert_allclose(found.lasting, lasting, atol=0.01)
    to_and_fro = Truth(stamp[:9], np.tile(np.eye(3), (9, 1, 1)), np.arange(9)[:, None] % 2 * np.ones(3))
    assert_allclose(manoeuvre(to_and_fro).lasting, 0.0)
    steady = Truth(stamp[:9], np.tile(np.eye(3), (9, 1, 1)), np.arange(9)[:, None] * np.ones(3))
    assert np.all(manoeuvre(steady).lasting < 1.0)  # what a finite film shows of it is finite


def test_bound_ratio_leaves_out_the_first_frame():
    bound = Bound(np.tile(np.eye(3), (3, 1, 1)), np.tile(4.0 * np.eye(3), (3, 1, 1)))
    bound.rate[0] = 1e9
    e = np.array([[9.0, 9.0, 9.0], [1.0, 1.0, 1.0], [0.0, 3.0, 0.0]])
    assert metrics.bound_ratio(e, e, bound) == pytest.approx({"attitude": 2**0.5, "rate": 0.5**0.5})


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "short"
    list(write_simulation(path, prepare(SimulationOptions(seconds=0.5))))
    return path


@pytest.fixture
def evaluate(spheremouse):
    """(*words) -> standard output and error of `evaluate`, which must succeed."""
    return partial(spheremouse.succeed, "evaluate")


def test_command_writes_a_table_and_json(evaluate, filmed, tmp_path):
    file = tmp_path / "out.json"
    out, _ = evaluate(filmed, "--json", file)
    assert "attitude RMSE, °" in out
    result = json.loads(file.read_text())
    assert_has_all_keys(result)
    assert (result["dataset"], result["tracker"], result["frames"], result["tracked"]) == ("short", "so3", 15, 15)
    assert result["attitude_rmse_deg"]["combined"] < 0.2
    assert max(map(abs, result["pose_error"]["position_mm"])) < 5.0
    assert result["detection"]["recall"] > 0.8


def test_json_to_stdout_is_only_json_and_a_list_for_several(evaluate, filmed, tmp_path):
    """By the configuration of a run, whose source, output and files do not count."""
    file = tmp_path / "spheremouse.yaml"
    file.write_text("schema: 2\nsource: v4l2:0\nrig: none.yaml\npointer: {rate: 500}\ntracker: ekf2\n")
    out, err = evaluate(filmed, filmed, "--pose", "known", "--config", file, "--json", "-")
    both = json.loads(out)
    assert [r["tracker"] for r in both] == ["ekf2", "ekf2"]
    assert both[0]["pose_error"] is None
    assert "no truth.csv" not in err
    for r in both:
        del r["frame_us"], r["stages_us"]
    assert both[0] == both[1]


def test_the_smoothed_run_stands_beside_that_of_the_filter(evaluate, filmed):
    out, _ = evaluate(filmed, "--pose", "known", "--smooth", "--json", "-")
    filtered, smoothed = json.loads(out)
    assert (filtered["dataset"], smoothed["dataset"]) == ("short", "short, smoothed")
    assert smoothed["detection"] == filtered["detection"]
    assert smoothed["rate_rmse_deg_s"]["combined"] < 0.5 * filtered["rate_rmse_deg_s"]["combined"]


def test_with_a_saved_map_the_first_frame_is_identified_and_the_map_stays_as_it_is(evaluate, filmed, tmp_path):
    recording = open_dataset(filmed)
    d = recording.truth_directions
    turned = Rotation.random(rng=3).apply(d)
    true = DiscMap(turned, 1e-6 * np.eye(2 * len(d)), np.full(len(d), 100, dtype=np.intp))
    file = tmp_path / "m.yaml"
    save_map(file, saved_now(true, recording.rig))
    before = file.read_bytes()
    out, _ = evaluate(filmed, "--pose", "known", "--map", file, "--json", "-")
    result = json.loads(out)
    assert (result["identified_from_frame"], result["tracked"]) == (0, 15)
    assert result["attitude_rmse_deg"]["combined"] < 0.2
    assert file.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.yaml"]
    save_map(file, saved_now(replace(true, directions=ball_directions(len(d), 9)), recording.rig))
    out, _ = evaluate(filmed, "--pose", "known", "--map", file, "--json", "-")
    assert json.loads(out)["identified_from_frame"] is None  # another ball


def linked(filmed, folder, *without):
    """A recording without some of its files."""
    folder.mkdir()
    for path in filmed.iterdir():
        if path.name not in without:
            (folder / path.name).symlink_to(path)
    return folder


def test_without_truth_it_runs_all_the_same(evaluate, filmed, tmp_path):
    bare = linked(filmed, tmp_path / "bare", "truth.csv", "discs.csv")
    out, err = evaluate(bare, "--pose", "known", "--json", "-")
    result = json.loads(out)
    assert (result["tracked"], result["attitude_rmse_deg"]["combined"], result["detection"]) == (15, None, None)
    assert 0.0 < result["nis"] < 3.0
    assert err.count("no truth.csv") == 1


def test_a_plot_of_two_cameras_needs_the_truth_of_both(spheremouse, filmed, tmp_path):
    bare = linked(filmed, tmp_path / "bare", "truth.csv", "discs.csv")
    for one, other in ((filmed, bare), (bare, filmed)):
        said = spheremouse.fail("evaluate", one, "--beside", other, "--plot", tmp_path / "run.png")
        assert said == f"{bare}: no truth.csv, which --plot compares with"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--tracker", "ekf3"), "--tracker"),
        (("--set", "so3.nothing=1"), "so3.nothing"),
        (("--config", "missing.yaml"), "missing.yaml"),
        (("--set", "tracker=wand"), "tracker: wand is for balls in a hand"),
        (("--json", "nowhere/out.json"), "nowhere/out.json: there is no folder"),
        (("--map", "missing.yaml"), "missing.yaml: no such file; check the path"),
        (("--map", "missing.yaml", "--tracker", "ekf1"), "--map: tracker ekf1 keeps no map"),
        (("--smooth", "--tracker", "ekf1"), "--smooth: there is no smoother for ekf1"),
        (("another", "--plot", "out.png"), "--plot"),
        (("another", "--beside", "side"), "--beside: belongs to one dataset"),
        (("missing",), "missing"),
        (("--noise", "inf"), "--noise, --brightness: must be finite"),
        (("--brightness=-inf",), "--noise, --brightness: must be finite"),
        (("--brightness", "nan"), "--noise, --brightness: must be finite"),
    ],
)
def test_a_fault_is_one_line_and_code_2(spheremouse, filmed, arguments, says):
    assert says in spheremouse.fail("evaluate", filmed, *arguments)


def test_a_recording_that_fails_does_not_take_the_others_along(spheremouse, filmed, tmp_path):
    cut = linked(filmed, tmp_path / "cut", "scene.json")
    scene = json.loads((filmed / "scene.json").read_text())
    del scene["targets"]
    (cut / "scene.json").write_text(json.dumps(scene))
    code, _out, err = spheremouse("evaluate", cut, filmed, "--json", tmp_path / "out.json")
    assert (code, len(err.splitlines()), str(cut) in err) == (2, 1, True)
    assert [r["dataset"] for r in json.loads((tmp_path / "out.json").read_text())] == ["short"]


def test_added_noise_and_brightness():
    image = np.full((200, 200, 3), 100, np.uint8)
    frames = [Frame(image, 0.0, 0), Frame(image, 1.0, 1), Frame(image, 0.0, 0)]
    a, b, again = (f.image.astype(float) for f in degrade(iter(frames), 10.0, 50.0))
    assert a.mean() == pytest.approx(150.0, abs=0.2)
    assert a.std() == pytest.approx(10.0, abs=0.2)
    assert np.corrcoef(a[..., 0].ravel(), a[..., 1].ravel())[0, 1] == pytest.approx(0.0, abs=0.03)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] == pytest.approx(0.0, abs=0.03)
    assert np.array_equal(a, again)
    (dark,) = degrade(iter(frames[:1]), 0.0, -120.0)
    assert not dark.image.any()


@pytest.mark.slow
def test_plot_draws_a_picture(tmp_path):
    truth = random_motion(60)
    run = replace(perfect_run(truth), covariance=np.broadcast_to(1e-4 * np.eye(6), (60, 6, 6)))
    path = tmp_path / "run.png"
    plot.plot_run(run, truth, path)
    image = cv2.imread(str(path))
    assert image.shape[0] > 600
    assert image.shape[1] > 1000
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
    with pytest.raises(ConfigurationError, match="cannot be written"):
        plot.plot_run(run, truth, tmp_path / "no" / "a.png")
