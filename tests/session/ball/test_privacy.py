"""Privacy: what is kept is all that the tracker looks at, and next to nothing besides."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from reporting import counts_of

from spheremouse.ball.build import build
from spheremouse.ball.detect.appearance import appearance, ball_mask, largest_disc
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import Targets
from spheremouse.ball.settings import Settings
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp
from spheremouse.session.ball.recorded import recorded_mask
from spheremouse.session.offline import initialise, track
from spheremouse.session.overlay.pen import masked
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.ball.scene import default_scene

FILMS = {
    "play": SimulationOptions(motion="play", seconds=2.0, noise=4.0, seed=1),
    "hands": SimulationOptions(motion="play", seconds=1.8, noise=4.0, seed=5, cover=0.8),
    "near": SimulationOptions(view="near", seconds=0.5, noise=3.0, size=(1280, 720), dist=(-0.1, 0, 0, 0, 0)),
    "light": SimulationOptions(seconds=1.0, noise=4.0, seed=6, ball_colour=(40, 40, 40), disc_colour=(230, 230, 230)),
    "rolling": SimulationOptions(seconds=0.7, noise=4.0, seed=7, blur=0.01, readout=0.02),
}


@cache
def film(name):
    simulation = prepare(FILMS[name])
    return simulation.scene.rig(), [f.frame for f in simulate(simulation)]


def black_but(frames, keep):
    return [replace(f, image=masked(f.image, keep)) for f in frames]


def differences(frames, keep, rig, pose, settings):
    """Frames of which the masked picture says anything else than the whole one, and the epochs of the whole one."""
    tracker = build(rig, pose, settings)
    whole, less = list(track(iter(frames), tracker)), list(track(iter(black_but(frames, keep)), tracker))
    return [a.frame.sequence for a, b in zip(whole, less, strict=True) if not same(a, b)], whole


def same(a, b):
    x, y = a.state, b.state
    return (
        np.array_equal(a.estimate.increment[:3], b.estimate.increment[:3])
        and (x.status, a.events) == (y.status, b.events)
        and np.array_equal(x.detections.centre, y.detections.centre)
        and np.array_equal(x.detections.covariance, y.detections.covariance)
        and np.array_equal(x.filter.attitude, y.filter.attitude)
        and np.array_equal(x.filter.covariance, y.filter.covariance)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", FILMS)
@pytest.mark.parametrize("grey", [False, True], ids=["colour", "grey"])
def test_a_masked_film_says_the_same_to_the_last_bit(name, grey):
    rig, frames = film(name)
    settings = Settings()
    if name == "light":
        settings = replace(settings, discs=replace(settings.discs, polarity="light"))
    pose = initialise(iter(frames), rig, settings).pose  # needs colour
    if grey:
        frames = [replace(f, image=cv2.cvtColor(f.image, cv2.COLOR_BGR2GRAY)) for f in frames]
    differ, epochs = differences(frames, recorded_mask(rig, pose, settings), rig, pose, settings)
    assert differ == []
    # There was motion to send
    assert np.any(counts_of([e.estimate for e in epochs], rig), axis=1).sum() > len(epochs) // 6


def at_the_limb(scene, seed):
    """A grey picture of the ball with discs near its outline, before a room of any brightness."""
    rng = np.random.default_rng(seed)
    rig, pose = scene.rig(), scene.pose
    image = np.where(ball_mask(rig, pose) > 0, 180, rng.integers(0, 256)).astype(np.uint8)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    distance = float(np.linalg.norm(pose.position))
    seen = appearance(directions, rig, pose)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    near = directions @ pose.position < rig.ball.radius + 0.2 * distance
    for i in np.flatnonzero(seen.whole & near)[:25]:
        rim = seen.centroid[i] + (np.linalg.cholesky(seen.shape[i]) @ circle).T
        cv2.fillPoly(image, [np.rint(rim * 16).astype(np.int32)], 30, cv2.LINE_AA, shift=4)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.5) + rng.normal(0.0, 2.0, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("view", ["far", "near"])
def test_discs_at_the_limb_are_found_alike_and_need_the_reach_of_the_closing(view):
    scene = default_scene(view=view)
    rig, pose = scene.rig(), scene.pose
    detector = disc_detector(Settings().discs, rig, pose)
    keep, side = recorded_mask(rig, pose, Settings()), 8 * detector.lattice.reduction + 1
    narrow = np.where(cv2.dilate(detector.model.mask, np.ones((side, side), np.uint8)) > 0, keep, 0).astype(np.uint8)
    rows, columns = detector.window
    step = (rows.stop - rows.start) // 16
    narrow[rows.start + step // 2 : rows.stop : step, columns] = 255  # the noise's lines
    found, missed = 0, 0
    for seed in range(40):
        image = at_the_limb(scene, seed)
        whole = detector.detect(image).centre
        assert np.array_equal(detector.detect(masked(image, keep)).centre, whole)
        found += len(whole)
        missed += not np.array_equal(detector.detect(masked(image, narrow)).centre, whole)
    assert found > 300
    assert missed > 2


def test_the_published_detector_finds_the_same_on_the_ball():
    """It looks at the whole picture: what it finds beside the ball goes, what is on the ball stays."""
    simulation = prepare(replace(FILMS["play"], seconds=1.0))
    rig, pose, settings = simulation.scene.rig(), simulation.scene.pose, Settings(detector="blobs", tracker="ekf1")
    frames = [f.frame for f in simulate(simulation)]
    tracker, keep = build(rig, pose, settings), recorded_mask(rig, pose, settings)
    whole, less = list(track(iter(frames), tracker)), list(track(iter(black_but(frames, keep)), tracker))
    for a, b in zip(whole, less, strict=True):
        assert np.array_equal(a.state.points.direction, b.state.points.direction)
        assert np.array_equal(a.state.filter.attitude, b.state.filter.attitude)
        assert len(a.state.points) > 3


@pytest.mark.parametrize(("view", "size"), [("far", (640, 480)), ("near", (640, 480)), ("far", (1920, 1080))])
def test_nothing_is_kept_but_ball_targets_and_sixteen_lines(view, size):
    scene = default_scene(26, view, 3, width=size[0], height=size[1])
    rig, pose = scene.rig(), scene.pose
    keep, ball = recorded_mask(rig, pose, Settings()), ball_mask(rig, pose)
    assert np.all(keep[ball > 0] == 255)
    diameter = largest_disc(rig, pose)
    reach = int(1.5 * diameter + 0.6 * diameter + 12)  # closing; smoothing and blocks of a picture that is reduced
    near = cv2.dilate(ball, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    rows, columns = np.flatnonzero(ball.any(axis=1)), np.flatnonzero(ball.any(axis=0))
    left = (keep > 0) & ~near
    depth = pose.to_cam(rig.targets.position)[:, 2]
    for centre, radius in zip(predict_targets(pose, rig), rig.camera.fx * rig.targets.radii[-1] / depth, strict=True):
        u, v = np.rint(np.clip(centre, -1e4, 1e4)).astype(int)
        if np.all((centre >= 0) & (centre < size)):
            assert np.all(keep[v - int(radius) : v + int(radius), u - int(radius) : u + int(radius)] == 255)
        half = int(2.4 * radius) + 16
        left[max(v - half, 0) : max(v + half, 0), max(u - half, 0) : max(u + half, 0)] = False
    assert left[: rows[0]].sum() == left[rows[-1] + 1 :].sum() == 0
    assert left[:, : columns[0]].sum() == left[:, columns[-1] + 1 :].sum() == 0
    lines = np.flatnonzero(left.any(axis=1))
    assert len(lines) <= 18
    assert np.all(np.diff(lines) > 5)
    assert not keep[0].any() or rows[0] <= reach
    assert np.mean(keep > 0) < np.mean(ball > 0) + 0.15


def test_places_without_discs_are_kept_all_the_same():
    """A rectangle in which no disc is looked for may be taken away later: the recording must still do."""
    scene = default_scene()
    settings = replace(Settings(), discs=replace(Settings().discs, masks=((200.0, 100.0, 400.0, 300.0),)))
    keep = recorded_mask(scene.rig(), scene.pose, Settings())
    assert np.array_equal(recorded_mask(scene.rig(), scene.pose, settings), keep)


def test_a_device_without_targets_keeps_the_ball():
    scene = default_scene()
    bare = replace(scene.rig(), targets=Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)))
    keep = recorded_mask(bare, scene.pose, Settings())
    assert np.all(keep[ball_mask(bare, scene.pose) > 0])
    assert np.count_nonzero(keep) < np.count_nonzero(recorded_mask(scene.rig(), scene.pose, Settings()))


def test_a_camera_that_looks_away_is_refused():
    scene = default_scene()
    away = Pose(scene.pose.rotation @ exp(np.array([0.0, np.pi / 2, 0.0])), scene.pose.position)
    with pytest.raises(PoseError):
        recorded_mask(scene.rig(), away, Settings())
