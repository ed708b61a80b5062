"""Rolling: the ball's place, the discs and their covariances, from sightings simulated and from recordings."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import directions
from scipy.stats import chi2
from typer.testing import CliRunner

from spheremouse.ball.device import Axes, Device, Distance
from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.ball.rig import CODES, Ball, Rig, Targets
from spheremouse.calibrate.report.rolling import advise
from spheremouse.calibrate.rolling.adjust import adjust_rolling
from spheremouse.calibrate.rolling.axes import axes_from_gestures, axes_from_rings, axes_from_targets
from spheremouse.calibrate.rolling.calibrate import Solution, Views, solve
from spheremouse.calibrate.rolling.problem import GLOBAL, Rolling, Sightings, angular_rates, apply_step, equations_of
from spheremouse.calibrate.rolling.rig import AxesFrom, build_rig, place
from spheremouse.calibrate.rolling.start import Spots, start
from spheremouse.capture import Stream, section
from spheremouse.commands.calibrate import app
from spheremouse.errors import CalibrationError
from spheremouse.files.ball_map import load_map
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.rig import load_rig, save_camera
from spheremouse.geometry.camera import InteriorOrientation, Pose, ellipse_to_pixel, project, project_circle
from spheremouse.geometry.rotation import align, exp, hat, log, tangent_basis
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

CAMERA = InteriorOrientation(640, 480, 640.0, 642.0, 322.0, 237.0, np.array([-0.2, 0.08, 1e-3, -5e-4, 0.0]))


def play(frames, fps, rng, speed=1.5):
    """Attitudes, (f, 3, 3), of a ball that a hand turns: rates that change smoothly about all axes."""
    n = frames // 10 + 4
    knots = rng.normal(0.0, speed, (n, 3))
    at = np.arange(frames) / 10.0
    k, w = at.astype(int), (at % 1.0)[:, None]
    w = 0.5 - 0.5 * np.cos(np.pi * w)
    rates = knots[k] * (1.0 - w) + knots[k + 1] * w
    R = [exp(rng.normal(0.0, 1.0, 3))]
    for rate in 0.5 * (rates[:-1] + rates[1:]):
        R.append(exp(rate / fps) @ R[-1])
    return np.array(R), rates


def rolled(seed, frames=90, discs=40, sigma=0.1, readout=0.0, camera=CAMERA, fps=15.0, speed=1.5, eccentric=0.0):
    """A true `Rolling` and its sightings, with noise of `sigma` px or half of that.

    The eccentricity is random, with a standard deviation of `eccentric` radii.
    """
    rng, e = np.random.default_rng(seed), eccentric * np.random.default_rng([seed, 1]).normal(size=3)
    c = np.array([rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08), 1.0])
    c /= np.linalg.norm(c)
    ratio = rng.uniform(2.4, 4.2)
    R, rates = play(frames, fps, rng, speed)
    d = directions(discs, seed)
    stamp = np.arange(frames) / fps
    truth = Rolling(c, ratio, d, stamp, R, readout, e)
    frame, disc = np.meshgrid(np.arange(frames), np.arange(discs), indexing="ij")
    frame, disc = frame.ravel(), disc.ravel()
    late = np.zeros(len(frame))
    for _ in range(5):  # the row it is seen in says when it is seen
        turned = np.einsum("nij,njk,nk->ni", exp(rates[frame] * late[:, None]), R[frame], e + d[disc])
        uv, _ = project(ratio * c + turned, camera)
        late = readout * ((uv[:, 1] + 0.5) / camera.height - 0.5)
    inside = np.all((uv > 0) & (uv < [camera.width, camera.height]), axis=1)
    seen = (turned @ -c > np.cos(0.9 * np.arccos(1.0 / ratio))) & inside & (rng.uniform(size=len(uv)) < 0.8)
    n = np.count_nonzero(seen)
    scale = np.where(rng.uniform(size=n) < 0.5, sigma, 0.5 * sigma)
    noise = rng.normal(size=(n, 2)) * scale[:, None]
    covariance = scale[:, None, None] ** 2 * np.eye(2)
    return truth, Sightings(frame[seen], disc[seen], uv[seen] + noise, covariance)


def disturbed(truth, seed, by=0.01):
    """A start that is off by about one percent and half a degree."""
    rng = np.random.default_rng(seed + 1000)
    c = truth.direction + rng.normal(0.0, by / 3.0, 3)
    d = truth.discs + rng.normal(0.0, by, truth.discs.shape)
    return replace(
        truth,
        direction=c / np.linalg.norm(c),
        ratio=truth.ratio * float(np.exp(rng.normal(0.0, by))),
        discs=d / np.linalg.norm(d, axis=1, keepdims=True),
        attitude=exp(rng.normal(0.0, by, (len(truth.attitude), 3))) @ truth.attitude,
        readout=0.0,
        eccentricity=np.zeros(3),
    )


def place_nees(found, truth):
    """Chi-square of the direction along the true tangent plane and of the ratio."""
    B = np.zeros((4, 3))
    B[:3, :2], B[3, 2] = tangent_basis(truth.direction), 1.0
    error = np.append(found.rolling.direction - truth.direction, found.rolling.ratio - truth.ratio) @ B
    return error @ np.linalg.solve(B.T @ found.covariance @ B, error)


def test_the_jacobian_is_that_of_the_residuals():
    truth, s = rolled(3, frames=12, discs=12, readout=0.02, eccentric=0.01)
    at = replace(disturbed(truth, 3), readout=0.01, eccentricity=truth.eccentricity)
    m, f, h = len(at.discs), len(at.attitude), 1e-6
    # Rates follow from the attitudes, and are held in the Jacobian: only the own turn is compared
    assert np.abs(angular_rates(at)).max() > 0.1
    first, step = GLOBAL + 2 * int(s.disc[0]), h * np.eye(GLOBAL + 2 * m + 3 * f)
    turns = [step[GLOBAL + 2 * m + k :: 3].sum(axis=0) for k in range(3)]
    for here, steps in ((at, step[[*range(GLOBAL), first, first + 1]]), (replace(at, readout=0.0), turns)):
        J = equations_of(here, s, CAMERA).jacobian
        for dx in steps:
            plus, minus = (equations_of(apply_step(here, sign * dx), s, CAMERA).residual for sign in (1, -1))
            expected = J @ dx / h
            assert np.abs((minus - plus).ravel() / (2 * h) - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says():
    """Over 100 rollings the mean NEES of direction and ratio, and of the map, lies in the 95 % band."""
    runs, nees, discs, freedom = 100, 0.0, 0.0, 0
    for seed in range(runs):
        truth, s = rolled(seed, frames=45, discs=24, eccentric=2e-3)
        found = adjust_rolling(s, disturbed(truth, seed), CAMERA)
        nees += place_nees(found, truth)
        kept = np.flatnonzero(np.bincount(s.disc, minlength=24) >= 5)
        if len(kept) == len(found.rolling.discs):
            chi, k = map_nees(found, truth.discs[kept])
            discs, freedom = discs + chi, freedom + k
    low, high = chi2.ppf([0.025, 0.975], 3 * runs)
    assert low < nees < high
    low, high = chi2.ppf([0.025, 0.975], freedom)
    assert 0.85 * low < discs < high  # the factor on the covariance is never below 1: a little wide


def map_nees(found, true):
    """Chi-square of the map in the frame that fits it best, and its degrees of freedom."""
    d, Q = found.rolling.discs, found.disc_covariance
    R = align(true, d)
    error = np.einsum("mij,mi->mj", tangent_basis(d), true @ R.T - d).ravel()
    free = -(tangent_basis(d).transpose(0, 2, 1) @ hat(d)).reshape(-1, 3)
    P = np.eye(len(Q)) - free @ np.linalg.pinv(free)
    value, vector = np.linalg.eigh(P @ Q @ P)
    firm = value > 1e-6 * value[-1]
    return float(np.sum((vector.T @ P @ error)[firm] ** 2 / value[firm])), int(firm.sum())


@pytest.mark.parametrize("seed", [21, 22])
def test_a_ball_that_is_not_centred_is_calibrated_about_the_point_that_it_turns_about(seed):
    """By some millimetres on a ball of 1.2 m. The centre of a ball that is centred is found where it turns."""
    truth, s = rolled(seed, frames=240, eccentric=3e-3)
    found = adjust_rolling(s, disturbed(truth, seed), CAMERA)
    assert place_nees(found, truth) < chi2.ppf(0.999, 3)
    assert found.is_eccentric
    here = align(truth.discs, found.rolling.discs) @ truth.eccentricity
    error = found.rolling.eccentricity - here
    assert error @ np.linalg.solve(found.eccentricity_covariance, error) < chi2.ppf(0.999, 3)
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(here)
    centred, s = rolled(seed, frames=240)
    found = adjust_rolling(s, disturbed(centred, seed), CAMERA)
    assert not found.is_eccentric


def test_a_rolling_shutter_is_found():
    truth, s = rolled(11, frames=240, discs=40, readout=0.02, fps=30.0)
    found = adjust_rolling(s, disturbed(truth, 11), CAMERA, 0.015)
    assert abs(found.rolling.readout - 0.02) < 2e-4
    assert place_nees(found, truth) < chi2.ppf(0.999, 3)


def test_false_sightings_are_set_aside():
    truth, s = rolled(7, frames=90, discs=30)
    rng = np.random.default_rng(7)
    bad = rng.uniform(size=len(s)) < 0.03
    angle = rng.uniform(0.0, 2.0 * np.pi, bad.sum())
    centre = s.centre.copy()
    centre[bad] += (3.0 + 5.0 * rng.uniform(size=(bad.sum(), 1))) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    clean, found = (adjust_rolling(replace(s, centre=c), disturbed(truth, 7), CAMERA) for c in (s.centre, centre))
    assert 0.8 * bad.sum() <= found.rejected - clean.rejected < 1.5 * bad.sum()
    assert place_nees(found, truth) < chi2.ppf(0.999, 3)


def test_errors_of_a_place_widen_the_covariance():
    """What pulls all discs alike in one part of the picture is no white noise: the variance says so."""
    truth, s = rolled(8, frames=300, discs=40)
    pulled = s.centre + 0.15 * np.sin(s.centre / 40.0)
    found = adjust_rolling(replace(s, centre=pulled), disturbed(truth, 8), CAMERA)
    plain = adjust_rolling(s, disturbed(truth, 8), CAMERA)
    assert found.correlation > 2.0 * plain.correlation


def test_too_few_discs_are_refused():
    truth, s = rolled(2, frames=60, discs=30)
    with pytest.raises(CalibrationError, match="discs were followed on the ball, at least 5"):
        adjust_rolling(s.take(s.disc < 4), truth, CAMERA)


def spots_of(truth, s, bolts=6, sigma=0.2, seed=0):
    """Spots as a detector gives them: those of the discs, and bolts that stay."""
    rng = np.random.default_rng(seed)
    still = rng.uniform([100, 80], [540, 400], (bolts, 2))
    every = []
    for k in range(len(truth.attitude)):
        centre = np.concatenate([s.centre[s.frame == k], still + rng.normal(0.0, 0.1, still.shape)])
        every.append(Spots(centre + rng.normal(0.0, sigma, centre.shape), np.full(len(centre), 120.0)))
    return every


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_the_start_finds_the_ball(seed):
    truth, s = rolled(seed, frames=150, discs=30, fps=30.0, speed=0.8)
    found = start(spots_of(truth, s), CAMERA)
    assert abs(found.ratio / truth.ratio - 1.0) < 0.02
    assert np.linalg.norm(np.cross(found.direction, truth.direction)) < np.deg2rad(0.2)


def test_the_start_finds_the_ball_through_a_lens_that_has_no_ray_in_the_corners():
    lens = InteriorOrientation(640, 480, 400.0, 400.0, 319.5, 239.5, np.array([-0.5, 0.0, 0.0, 0.0, 0.0]))
    R, d, centre = play(24, 15.0, np.random.default_rng(1))[0], directions(25, 0), np.array([0.0, 0.0, 2.2])
    on_ball = d @ R.swapaxes(1, 2)
    facing = on_ball @ [0.0, 0.0, 1.0] < -0.55
    seen = [
        Spots(project(centre + p[f], lens)[0], np.full(np.count_nonzero(f), 120.0))
        for p, f in zip(on_ball, facing, strict=True)
    ]
    assert abs(start(seen, lens).ratio / 2.2 - 1.0) < 0.02


def test_nothing_that_moves_is_no_ball():
    rest = [Spots(np.array([[100.0, 100.0], [300.0, 200.0], [400.0, 250.0]]), np.full(3, 80.0))] * 60
    with pytest.raises(CalibrationError, match="no ball with discs is seen to turn"):
        start(rest, CAMERA)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_sheet_that_slides_is_no_ball(seed):
    """It fits a ball without end whose surface touches the camera."""
    rng = np.random.default_rng(seed)
    marks = np.column_stack([rng.uniform(-1.5, 1.5, 40), rng.uniform(-1.2, 1.2, 40)])
    seen = []
    for t in np.arange(150) / 15.0:
        place = marks + np.array([0.5 * np.sin(0.9 * t), 0.4 * np.sin(0.7 * t + 1.0)])
        place = place[np.linalg.norm(place, axis=1) < 0.75]
        centre = np.array([CAMERA.cx, CAMERA.cy]) + 0.5 * CAMERA.fx * place + rng.normal(0.0, 0.1, place.shape)
        seen.append(Spots(centre, np.full(len(centre), 120.0)))
    with pytest.raises(CalibrationError, match="do not turn as one ball"):
        start(seen, CAMERA)


def test_spots_that_share_no_rotation_are_no_ball():
    rng = np.random.default_rng(4)
    place, way = rng.uniform([150, 100], [450, 350], (8, 2)), rng.normal(0.0, 1.5, (8, 2))
    crossing = [Spots(place + k * way, np.full(8, 80.0)) for k in range(60)]
    with pytest.raises(CalibrationError, match="do not turn as one ball"):
        start(crossing, CAMERA)


@pytest.mark.slow
def test_two_balls_are_told():
    wide = InteriorOrientation(1280, 480, 640.0, 640.0, 640.0, 240.0)
    every = [[], []]
    for k, x in enumerate((-0.45, 0.45)):
        truth, s = rolled(20 + k, frames=120, discs=30, fps=30.0, speed=0.8, camera=wide)
        c = np.array([x, 0.0, 1.0]) / np.hypot(x, 1.0)
        p = 3.6 * c + np.einsum("nij,nj->ni", truth.attitude[s.frame], truth.discs[s.disc])
        facing = (p - 3.6 * c) @ -c > 0.4
        uv = project(p, wide)[0]
        every[k] = [uv[facing & (s.frame == f)] for f in range(120)]
    both = [Spots(np.concatenate(pair), np.full(sum(map(len, pair)), 90.0)) for pair in zip(*every, strict=True)]
    with pytest.raises(CalibrationError, match="two balls"):
        start(both, wide)


R_OBJ_CAM = exp(np.array([0.1, -0.15, 0.3])) @ np.diag([1.0, -1.0, -1.0])


def gestures(tilt):
    """Forward in the first 3 s, right in the next 3; `tilt` (3,) rad turns the axis of the second, in obj."""
    fps = 30.0
    forward, right = np.array([-1.0, 0.0, 0.0]), exp(np.asarray(tilt)) @ np.array([0.0, 0.0, -1.0])
    R = [np.eye(3)]
    for k in range(179):
        R.append(exp(R_OBJ_CAM.T @ (forward if k < 90 else right) / fps) @ R[-1])
    return Rolling(np.array([0.0, 0.0, 1.0]), 4.0, directions(5, 0), np.arange(180) / fps, np.array(R))


def test_forward_is_minus_x_and_right_is_minus_z():
    found = axes_from_gestures(gestures([0.0, 0.0, 0.0]), (0.0, 2.9), (3.1, 5.9))
    assert np.abs(log(found.rotation @ R_OBJ_CAM.T)).max() < 1e-6
    assert 2.0 < np.rad2deg(np.sqrt(np.diag(found.own)[:3])).min() < 4.0


def test_gestures_that_are_not_square_share_it_and_say_so():
    straight, off = (axes_from_gestures(gestures([0.0, a, 0.0]), (0.0, 2.9), (3.1, 5.9)) for a in (0.0, 0.2))
    assert np.linalg.norm(log(off.rotation @ R_OBJ_CAM.T)) == pytest.approx(0.1, abs=0.005)
    assert off.own[1, 1] > 2.0 * straight.own[1, 1]
    with pytest.raises(CalibrationError, match="apart and not 90°"):
        axes_from_gestures(gestures([0.0, 0.6, 0.0]), (0.0, 2.9), (3.1, 5.9))


def test_a_gesture_without_a_turn_is_told():
    with pytest.raises(CalibrationError, match=r"not seen to roll right from 7 to 9 s"):
        axes_from_gestures(gestures([0.0, 0.0, 0.0]), (0.0, 2.9), (7.0, 9.0))


def test_targets_of_another_device_are_told():
    rig, rolling, pose = target_scene()
    sightings = seen_targets(rig, pose, np.random.default_rng(2))
    moved = rig.targets.position + np.array([[0, 0, 0], [0, 0.1, 0], [0, 0, 0], [0.1, 0, 0.0]])
    with pytest.raises(CalibrationError, match=r"px off where the rig|no camera position fits"):
        axes_from_targets(sightings, replace(rig, targets=replace(rig.targets, position=moved)), rolling)
    with pytest.raises(CalibrationError, match="2 of 4 targets are seen"):
        axes_from_targets(sightings[:2], rig, rolling)


def rolled_targets(seed, rig, radius=0.6, **how):
    """RollingAdjustment, axes with the direction held, and the truth: pose and radius; rig and lens are off as they
    say."""
    rng = np.random.default_rng(seed)
    truth, s = rolled(seed, **how)
    L = np.sqrt(np.diag(rig.camera.covariance))[:4] * rng.normal(size=4)
    camera = replace(rig.camera, fx=CAMERA.fx + L[0], fy=CAMERA.fy + L[1], cx=CAMERA.cx + L[2], cy=CAMERA.cy + L[3])
    pose = Pose(R_OBJ_CAM, -radius * truth.ratio * (R_OBJ_CAM @ truth.direction))
    sightings = seen_targets(rig, pose, rng)
    C = rig.targets.covariance
    off = rng.multivariate_normal(np.zeros(len(C)), C, method="eigh").reshape(-1, 3)
    moved = replace(rig, camera=camera, targets=replace(rig.targets, position=rig.targets.position + off))
    found = adjust_rolling(s, disturbed(truth, seed), camera)
    return found, axes_from_targets(sightings, moved, found.rolling), pose, off.ravel()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "lens", "targets"), [(0.4, 0.0, 0.0), (0.1, 0.3, 0.0), (0.2, 0.2, 1e-3)], ids=["direction", "lens", "all"]
)
def test_axes_and_pose_are_as_certain_as_they_say(sigma, lens, targets):
    """Where direction, lens or targets are the weak part, too; and targets and radius are correlated as they say."""
    scene, *_ = target_scene()
    camera = replace(CAMERA, covariance=np.diag([lens**2] * 4 + [0.0] * 5))
    scene = replace(scene, camera=camera, targets=replace(scene.targets, covariance=targets**2 * np.eye(12)))
    runs, axes_nees, nees, held, joint = 24, 0.0, 0.0, 0.0, 0.0
    for seed in range(runs):
        found, axes, pose, off = rolled_targets(seed, scene, frames=40, discs=24, sigma=sigma, speed=0.8)
        p, ball, _, cross = place(found, axes, None)
        e = log(axes.rotation @ pose.rotation.T)
        held += e @ np.linalg.solve((axes.own + axes.by_lens @ axes.by_lens.T)[:3, :3], e)
        axes_nees += e @ np.linalg.solve(p.covariance[3:, 3:], e)
        error = np.concatenate([p.position - pose.position, e, [ball.radius - 0.6]])
        C = np.block([[p.covariance, p.ball_covariance[:, 3:]], [p.ball_covariance[:, 3:].T, ball.covariance[3:, 3:]]])
        nees += error @ np.linalg.solve(C, error)
        if targets:
            cross = cross[:, 3:]
            C = np.block([[scene.targets.covariance, cross], [cross.T, ball.covariance[3:, 3:]]])
            error = np.append(off, error[-1])
            joint += error @ np.linalg.solve(C, error)
    low, high = chi2.ppf([0.001, 0.999], 3 * runs)
    assert 0.6 * low < axes_nees < high  # the variance factors are never below 1: a little wide
    low, high = chi2.ppf([0.001, 0.999], 7 * runs)
    assert 0.6 * low < nees < high
    if targets:
        low, high = chi2.ppf([0.001, 0.999], 13 * runs)
        assert 0.6 * low < joint < high
    elif not lens:
        assert held > 2.0 * axes_nees  # what was left out would show


def test_targets_of_a_free_rig_take_a_length():
    """They are as uncertain as over many lengths and rigs. A length leaves targets of a metric rig alone."""
    metric, *_ = target_scene()
    targets = metric.targets
    free = replace(targets, position=targets.position / 0.6, covariance=1e-6 * np.eye(12), radii=targets.radii / 0.6)
    found, axes, _, _ = rolled_targets(3, replace(metric, targets=free), radius=1.0)
    _, ball, placed, cross = place(found, axes, 0.6, rescaled=True)
    np.testing.assert_allclose(placed.position, targets.position, atol=0.01)
    np.testing.assert_allclose(placed.radii, targets.radii, rtol=0.01)
    x = placed.position.ravel()
    assert ball.covariance[3, 3] == pytest.approx((0.002 * 0.6) ** 2)
    np.testing.assert_allclose(cross[:, 3], ball.covariance[3, 3] / 0.6 * x, rtol=1e-6)
    by_length = placed.covariance - np.outer(cross[:, 3], cross[:, 3]) / ball.covariance[3, 3]
    exact = place(found, replace(axes, own=np.pad(axes.own[:4, :4], (0, 12))), 0.6, rescaled=True)
    assert np.linalg.eigvalsh(by_length).min() > 0.0
    assert np.all(np.diag(exact.targets.covariance) < np.diag(placed.covariance))
    np.testing.assert_array_equal(place(found, axes, 0.6).targets.position, axes.targets.position)
    np.testing.assert_allclose(place(found, axes, 0.6).cross, 0.0, atol=1e-15)


@pytest.mark.parametrize("source", ["targets", "device"])
def test_a_length_changes_the_rings_of_a_free_rig_alone(monkeypatch, source):
    """A device gives its rings in m. A metric rig has no covariance between its targets and a length."""
    metric, *_ = target_scene()
    targets = metric.targets
    free = replace(targets, position=targets.position / 0.6, radii=targets.radii / 0.6)
    for rig, scale_free in ((replace(metric, targets=free), True), (metric, False)):
        found, axes, _, _ = rolled_targets(3, rig, radius=1.0 if scale_free else 0.6)
        if source == "device":
            axes = replace(axes, distance=None, targets=targets)
        monkeypatch.setattr(AxesFrom, "find", lambda *_, axes=axes: (axes, source))
        known = AxesFrom(replace(rig, scale_free=scale_free), None, None, CAMERA)
        built = build_rig(Solution(found, None, 0.03, Views(), 6.0), known, 0.6, 0.0).rig
        np.testing.assert_allclose(built.targets.radii, targets.radii, rtol=0.01)
        assert not built.scale_free
        assert (built.cross_covariance is None) == (source == "targets" and not scale_free)


def target_scene():
    """A rig with four targets, a ball in front of its camera, and the pose of that at 2.4 m."""
    position = np.array([[-0.32, 0.15, 0.56], [-0.32, -0.6, 0.56], [0.33, -0.6, 0.52], [0.33, 0.15, 0.56]])
    targets = Targets((1, 2, 3, 4), CODES[:4], position, np.zeros((12, 12)), np.array([0.012, 0.024, 0.036]))
    c = np.array([0.02, -0.01, 1.0])
    c /= np.linalg.norm(c)
    rolling = Rolling(c, 4.0, directions(5, 0), np.zeros(1), np.eye(3)[None])
    return Rig(CAMERA, Ball(1.0), targets, 0.02), rolling, Pose(R_OBJ_CAM, -2.4 * (R_OBJ_CAM @ c))


def seen_targets(rig, pose, rng):
    return [
        Sighting(code, p + rng.normal(0.0, 0.05, 2), 0.05**2 * np.eye(2), 30)
        for code, p in zip(rig.targets.codes, predict_targets(pose, rig), strict=True)
    ]


@pytest.mark.slow
def test_sizes_of_targets_give_axes_within_their_sigma():
    rig, _, pose = target_scene()
    rig = replace(rig, targets=replace(rig.targets, position=rig.targets.position * [1, 1, 0] + [0, 0, 0.56]))
    device = Device((1, 2, 3, 4), CODES[:4], rig.targets.radii, 0.02, Axes(2, 1, 3))
    points = pose.to_cam(rig.targets.position)
    outer = project_circle(points, np.broadcast_to(pose.rotation[2], points.shape), 0.036)
    uv, shape = ellipse_to_pixel(*outer, CAMERA)
    size = np.linalg.det(shape) ** 0.25
    exact = axes_from_rings(list(zip(device.codes, uv, size, strict=True)), device, CAMERA)
    assert np.linalg.norm(log(exact.rotation @ R_OBJ_CAM.T)) < 1e-5
    assert np.abs(exact.targets.position - points).max() < 1e-5
    rng, nees = np.random.default_rng(3), 0.0
    for _ in range(20):
        one = size * np.exp(0.005 * rng.normal()) + 0.05 * rng.normal()
        one = one * np.exp(0.002 * rng.normal(size=4)) + 0.02 * rng.normal(size=4)
        seen = list(zip(device.codes, uv + rng.normal(0.0, 0.05, uv.shape), one, strict=True))
        found = axes_from_rings(seen, device, CAMERA)
        error = log(R_OBJ_CAM @ found.rotation.T)
        nees += error @ np.linalg.solve(found.own[:3, :3], error)
    low, high = chi2.ppf([0.025, 0.975], 60)
    assert low < nees < high
    with pytest.raises(CalibrationError, match=r"target 3 \(MCY\), not seen"):
        axes_from_rings([s for s in seen if s[0] != device.codes[2]], device, CAMERA)


@pytest.mark.slow
@pytest.mark.parametrize("taped", [False, True])
def test_the_lens_is_considered_in_sizes(taped):
    """A focal length off by one standard deviation moves targets and axes by what the covariance adds for it."""
    ids, place = (1, 2, 3, 4), np.array([[-0.3, 0.2, 2.0], [-0.3, -0.5, 2.1], [0.3, -0.5, 2.0], [0.3, 0.2, 2.05]])
    tape = (Distance(1, 2, 0.715, 0.001), Distance(1, 3, 0.92, 0.001)) if taped else ()
    device = Device(ids, CODES[:4], np.array([0.012, 0.024, 0.036]), 0.02, Axes(2, 1, 3), tape)
    size = 0.036 * 641.0 / place[:, 2]
    seen = list(zip(device.codes, project(place, CAMERA)[0], size, strict=True))
    C = np.zeros((9, 9))
    C[:2, :2] = 1.0  # fx and fy together
    plain, considered = (axes_from_rings(seen, device, replace(CAMERA, covariance=c)) for c in (0.0 * C, C))
    off = axes_from_rings(seen, device, replace(CAMERA, fx=CAMERA.fx + 1.0, fy=CAMERA.fy + 1.0))
    turn = log(off.rotation @ plain.rotation.T)
    moved = np.concatenate([turn, [0.0], (off.targets.position - plain.targets.position).ravel()])
    added = considered.own + considered.by_lens @ considered.by_lens.T - plain.own
    assert np.abs(added - np.outer(moved, moved)).max() < 0.02 * (moved @ moved)


def test_one_axis_alone_is_advised_against():
    truth, s = rolled(6, frames=90, discs=30)
    R = np.array([exp(np.array([0.05 * k, 0.0, 0.0])) for k in range(90)]) @ truth.attitude[0]
    found = adjust_rolling(s, truth, CAMERA)
    alone = replace(found, rolling=replace(found.rolling, attitude=R))
    assert any("one axis only" in line for line in advise(alone))
    assert not any("one axis" in line for line in advise(found))


def run(*arguments):
    return CliRunner().invoke(app, ["rolling", *map(str, arguments)])


@pytest.mark.slow
def test_far26_without_photos(far26, tmp_path):
    """Six seconds of it: place within what the issue asks of ten, the axes from the targets, and a rig that loads."""
    out, figures = tmp_path / "rig.yaml", tmp_path / "rolled.json"
    result = run("--source", f"dataset:{far26}", "--seconds", "6", "--out", out, "--json", figures)
    assert result.exit_code == 0, result.output
    follows = result.output.splitlines()[-1]
    assert follows.startswith(f"next: spheremouse axes --config {tmp_path / 'config.yaml'} --rig {out} --source ")
    assert "dataset:" not in follows  # gestures are shown to the camera
    told = json.loads(figures.read_text())
    pose = open_dataset(far26).pose
    true = pose.to_cam(np.zeros(3))
    assert abs(told["ratio"] / (np.linalg.norm(true) / 0.6) - 1.0) < 1e-3
    away = np.linalg.norm(np.cross(told["center_direction"], true)) / np.linalg.norm(true)
    assert np.rad2deg(away) < 0.02
    rig = load_rig(out)
    assert np.rad2deg(np.linalg.norm(log(rig.pose.rotation @ pose.rotation.T))) < 0.1
    assert rig.ball.radius == pytest.approx(0.6, abs=2e-3)
    assert told["axes"] == "targets"
    assert len(load_map(tmp_path / "rig.map.yaml").map) == len(told["discs"])
    again = run("--source", f"dataset:{far26}", "--out", out)
    assert again.exit_code != 0
    assert "--force" in str(again.exception)


@pytest.mark.slow
def test_a_live_camera_is_guided(far26, tmp_path, monkeypatch):
    """Prompts say what to do and when; without targets the two gestures follow, and a camera that ends is told."""
    recording = open_dataset(far26)
    camera = tmp_path / "camera.yaml"
    save_camera(camera, recording.rig.camera)
    live = [Stream(read_frames(recording), live=True, fps=30.0) for _ in range(2)]
    monkeypatch.setattr("spheremouse.capture.open_source", lambda *_: live.pop())
    result = run("--source", "opencv:0", "--camera", camera, "--seconds", "3")
    assert "roll the ball slowly in all directions" in result.stderr
    assert "now FORWARD" in result.stderr
    assert "stopped before the ball was rolled forward and right" in str(result.exception)


@pytest.mark.slow
def test_a_length_that_contradicts_the_targets_is_told(far26):
    result = run("--source", f"dataset:{far26}", "--seconds", "3", "--radius", "1.2m")
    assert result.exit_code != 0
    assert "give the radius and no diameter" in str(result.exception)
    assert "the targets of the rig put it at 0." in str(result.exception)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--radius", "0.6m", "--circumference", "3770mm"), "give one of the two"),
        (("--forward", "3:5"), "give both"),
        (("--forward", "5:3", "--right", "6:8"), "write seconds as in 45:50"),
        (("--camera", "none.yaml"), "no such file"),
    ],
)
def test_bad_options_are_told_in_a_line(far26, options, said):
    result = run("--source", f"dataset:{far26}", *options)
    assert result.exit_code != 0
    assert said in str(result.exception)
    assert "\n" not in str(result.exception).strip()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "ball"), [(52, (180.0, 90.0, 30.0)), (53, (20.0, 20.0, 20.0))])
def test_light_discs_are_rolled_as_well(seed, ball):
    """What is dark between them turns with the ball, and makes a false start."""
    colours = {"ball_colour": ball, "disc_colour": (240.0, 240.0, 240.0)}
    film = prepare(SimulationOptions(motion="play", seconds=6.0, noise=3.0, seed=seed, **colours))
    frames, scene = [shot.frame for shot in simulate(film)], film.scene
    true = scene.pose.to_cam(np.zeros(3))

    def footage(seconds):
        return section(iter(frames), 0.0, seconds or 6.0)

    found = solve(footage, scene.camera, (0.0, 0.0), lambda *_: None, lambda what, frames: frames).rolled.rolling
    assert abs(found.ratio / (np.linalg.norm(true) / 0.6) - 1.0) < 2e-3
    assert np.rad2deg(np.linalg.norm(np.cross(found.direction, true)) / np.linalg.norm(true)) < 0.03
