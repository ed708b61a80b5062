"""The wand's films: its paths against their own laws, its renderer against OpenCV and an independent path tracer."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from conftest import datasets_dir

from spheremouse.errors import ConfigurationError
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import open_wand
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.wand.ball import disc_paints, paint_ball
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.simulate.wand.path import (
    BALL_HEIGHT,
    CAMERA_HEIGHT,
    R_CAM_WORLD,
    REST_AFTER,
    REST_BEFORE,
    drive,
    hand,
    turning_rates,
)
from spheremouse.simulate.wand.render import Carried, WandRenderer, WandScene, indoor_light, outdoor_light
from spheremouse.wand.ball import WandBall, grzonka_ball, wand_disc
from tests.simulate.scenes import LENS, rng

CAMERA = InteriorOrientation(1280, 960, 2100.0, 2100.0, 640.0, 480.0)
HAND = WandOptions(motion="hand", seed=4, noise=0.0, size=(640, 480), seconds=3.0, vary=0.0)  # one background for all


class Across:
    """A ball before the camera that moves to the right."""

    seconds, distance, speed = 100.0, 0.25, 0.4  # s, m, m/s

    def pose(self, t):
        centre = np.column_stack([self.speed * t, 0.0 * t, np.full_like(t, self.distance)])
        return centre, np.tile(np.eye(3), (len(t), 1, 1))


@pytest.mark.parametrize("seed", [1, 7])
def test_a_drive_is_that_of_the_thesis(seed):
    path = drive(rng(seed))
    t = np.arange(0.0, path.seconds, 0.05)
    centre, R = path.pose(t)
    world = centre @ R_CAM_WORLD
    speed = np.linalg.norm(np.diff(centre, axis=0), axis=1) / 0.05
    assert np.allclose(world[:, 1], CAMERA_HEIGHT - BALL_HEIGHT)  # on a level floor
    assert speed.max() == pytest.approx(0.035, rel=1e-6)
    assert np.degrees(turning_rates(R, 0.05).max()) == pytest.approx(50.0, abs=0.5)  # wobble only while it drives
    assert 0.55 < np.abs(world[:, 0]).max() < 0.67
    assert 3.65 < world[:, 2].min() < 3.8
    assert 4.2 < world[:, 2].max() < 4.35
    assert np.all(speed[t[1:] < REST_BEFORE] == 0.0)
    assert np.all(speed[t[1:] > path.seconds - REST_AFTER + 0.1] < 1e-12)


def test_a_robot_drives_where_its_ball_says_it_looks():
    path = replace(drive(rng(3)), bumps=np.zeros((2, 6, 2)))  # a level floor
    t = np.arange(REST_BEFORE, path.seconds - REST_AFTER, 0.01)
    centre, R = path.pose(t)
    velocity = np.diff(centre, axis=0) / 0.01
    driving = np.linalg.norm(velocity, axis=1) > 0.035 * (1.0 - 1e-6)  # the whole step
    assert driving.mean() > 0.8
    assert np.allclose(velocity[driving], 0.035 * R[:-1][driving, :, 0], atol=1e-6)


def test_robots_keep_clear_of_each_other():
    paths = [drive(rng(k), part=k, of=3) for k in range(3)]
    t = np.arange(0.0, 250.0, 0.5)
    places = [p.pose(t)[0] for p in paths]
    for a, b in ((0, 1), (1, 2)):
        assert np.min(np.linalg.norm(places[a] - places[b], axis=1)) > 0.19


@pytest.mark.parametrize(("speed", "rate"), [(0.4, 180.0), (0.1, 360.0)])
def test_a_hand_reaches_the_speeds_asked_for_and_no_more(speed, rate):
    for seed in range(4):
        path = hand(rng(seed), speed=speed, rate=np.radians(rate))
        t = np.arange(0.0, path.seconds, 0.01)
        centre, R = path.pose(t)
        assert np.max(np.linalg.norm(np.diff(centre, axis=0), axis=1)) / 0.01 == pytest.approx(speed, rel=0.02)
        assert np.degrees(np.max(turning_rates(R, 0.01))) == pytest.approx(rate, rel=0.02)
        assert np.max(np.abs(centre - path.middle)) < 0.16
        assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-12)


def test_a_disc_appears_where_opencv_projects_its_rim():
    """The centroid of a painted disc against the polygon of its rim projected by OpenCV."""
    disc = wand_disc(0.4, 0.5, 0.3, "red")
    ball, camera = WandBall("one", 0.05, (disc,)), replace(CAMERA, distortion=LENS)
    centre = np.array([-0.5, 0.2, 2.0])
    R = np.linalg.qr(np.column_stack([-centre, (1, 0, 0), (0, 1, 0)]))[0]
    R *= np.sign(np.linalg.det(R))
    R = R if disc.direction @ R.T @ centre < 0 else R @ np.diag([-1.0, -1.0, 1.0])
    light = indoor_light()
    only_disc = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    flat = replace(light, gloss=0.0, power=np.zeros((2, 3)), above=np.ones(3), below=np.ones(3))
    layer = paint_ball(ball, only_disc, [(centre, R)], camera, flat)
    red = layer.paint[..., 2] / 0.5
    v, u = np.mgrid[: red.shape[0], : red.shape[1]]
    found = np.array([np.sum(red * u), np.sum(red * v)]) / red.sum() + layer.window[:2]
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    a = np.linalg.svd(disc.direction[None])[2][1:]
    rim = np.cos(disc.angle) * disc.direction + np.sin(disc.angle) * (
        np.cos(t)[:, None] * a[0] + np.sin(t)[:, None] * a[1]
    )
    seen = cv2.projectPoints(ball.radius * rim, R, centre, camera.matrix, camera.distortion)[0][:, 0]
    m = cv2.moments(seen.astype(np.float32))
    assert red.sum() == pytest.approx(m["m00"], rel=0.005)
    assert found == pytest.approx([m["m10"] / m["m00"], m["m01"] / m["m00"]], abs=0.02)


def test_cover_is_the_area_of_the_outline_and_goes_to_the_edge_of_the_picture():
    ball, light = grzonka_ball(), indoor_light()

    def painted(*centre):
        return paint_ball(ball, disc_paints(ball), [(np.array(centre), np.eye(3))], CAMERA, light)

    layer, half = painted(0.0, 0.0, 2.0), painted(-640.5 / 2100 * 2, 0, 2.0)
    assert layer.paint[..., 3].sum() == pytest.approx(np.pi * 2100.0**2 / (2.0**2 / 0.05**2 - 1.0), rel=2e-3)
    assert half.window.left == 0
    assert half.paint[..., 3].sum() == pytest.approx(0.5 * layer.paint[..., 3].sum(), rel=0.06)
    assert painted(5.0, 0, 2.0) is None
    assert painted(0, 0, -2.0) is None


def test_exposure_lengthens_the_picture_of_a_moving_ball():
    """The ball's picture is longer by its way during the exposure, about the place at mid-exposure."""
    plain = prepare_wand(HAND).scene

    def extent(exposure):
        scene = replace(plain, balls=(Carried(grzonka_ball(), Across(), "nothing"),), exposure_s=exposure)
        with_ball, without = (WandRenderer(s).picture(0.0, rng()) for s in (scene, replace(scene, balls=())))
        changed = np.any(with_ball != without, axis=2)
        columns, rows = (np.flatnonzero(changed.any(axis=k)) for k in (0, 1))
        return columns[0], columns[-1], np.ptp(rows)

    sharp, blurred = np.array(extent(0.0)), np.array(extent(0.02))
    half = 0.5 * Across.speed * 0.02 * plain.camera.fx / Across.distance  # px
    np.testing.assert_allclose(blurred - sharp, [-half, half, 0.0], atol=1.6)


def test_a_picture_of_two_balls_has_no_seam():
    """Each pixel is that of the picture with the ball that changes it alone, or of the empty room."""
    scene = prepare_wand(replace(HAND, balls=2)).scene
    both, first, second, room = (
        WandRenderer(replace(scene, balls=balls)).picture(1.0, rng())
        for balls in (scene.balls, scene.balls[:1], scene.balls[1:], ())
    )
    changed = [np.any(image != room, axis=2)[..., None] for image in (first, second)]
    assert not np.any(changed[0] & changed[1])
    assert all(2000 < np.count_nonzero(c) < 60_000 for c in changed)
    assert np.array_equal(both, np.where(changed[0], first, np.where(changed[1], second, room)))


def coloured(image):
    h, s, _ = (image_hsv.astype(int) for image_hsv in cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2HSV)))
    return {"red": (s > 110) & ((h < 12) | (h > 168)), "blue": (s > 110) & (h > 100) & (h < 135)}


@pytest.mark.slow
def test_coloured_regions_lie_where_a_path_tracer_puts_them():
    """The shared recording, rendered once more: centroids of its discs to a tenth of a pixel, areas to some percent.

    Measured over every fifth frame: 77 regions, 0.07 px RMS per axis, none beyond 0.23 px.
    """
    recording = open_wand(datasets_dir() / "wand_drive")
    truth = recording.truth

    class Replayed:
        seconds = 1e9

        def pose(self, t):
            i = np.rint(np.atleast_1d(t) * recording.fps).astype(int)
            return truth.position[i], truth.rotation[i]

    renderer = WandRenderer(
        WandScene(recording.camera, (Carried(recording.ball, Replayed(), "robot"),), indoor_light())
    )
    apart, ratio = [], []
    for frame in read_frames(recording):
        if frame.sequence % 10:
            continue
        ours = renderer.picture(frame.stamp, rng())
        x, y, z = truth.position[frame.sequence]
        u, v = int(640 + 2100 * x / z), int(480 + 2100 * y / z)
        part = slice(v - 32, v + 33), slice(max(u - 32, 0), u + 33)
        theirs, mine = coloured(frame.image[part]), coloured(ours[part])
        for name, mask in theirs.items():
            n, _, stats, centre = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
            m, _, my_stats, my_centre = cv2.connectedComponentsWithStats(mine[name].astype(np.uint8))
            for i in range(1, n):
                if stats[i, cv2.CC_STAT_AREA] < 40:
                    continue
                k = 1 + int(np.argmin(np.linalg.norm(my_centre[1:m] - centre[i], axis=1)))
                apart.append(my_centre[k] - centre[i])
                ratio.append(my_stats[k, cv2.CC_STAT_AREA] / stats[i, cv2.CC_STAT_AREA])
    apart = np.array(apart)
    assert len(apart) > 30
    assert np.all(np.sqrt(np.mean(apart**2, axis=0)) < 0.12)
    assert np.abs(apart).max() < 0.4
    assert 0.9 < np.median(ratio) < 1.1


def test_the_sun_leaves_glare_on_the_ball_and_the_room_does_not():
    R = exp(np.array([np.pi / 2 + 0.2, 0, 0]))

    def whitest(light):
        ball = grzonka_ball()
        layer = paint_ball(ball, disc_paints(ball), [(np.array([0, 0.1, 1.0]), R)], CAMERA, light)
        return np.mean(layer.paint[..., :3].min(axis=2)[layer.paint[..., 3] > 0.99] > 1.4)

    assert all(whitest(outdoor_light(rng(seed))) > 0.005 for seed in range(5))
    assert whitest(indoor_light()) == 0.0


def test_a_film_repeats_and_another_seed_is_another():
    """And its noise is that asked for, new in every frame."""
    film, other = (prepare_wand(replace(HAND, seed=seed, seconds=0.2, noise=2.0, vary=0.1)) for seed in (4, 5))
    a, b = list(simulate_wand(film)), list(simulate_wand(film))
    assert len(a) == 3
    clean = WandRenderer(replace(film.scene, noise=0.0)).picture(0.0, rng()).astype(float)
    first, second = ((shot.frame.image - clean)[(clean > 30) & (clean < 225)] for shot in a[:2])
    assert np.std(first) == pytest.approx(2.0, rel=0.03)
    assert abs(np.mean(first)) < 0.05
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.01
    for one, same in zip(a, b, strict=True):
        assert np.array_equal(one.frame.image, same.frame.image)
        assert np.array_equal(one.position, same.position)
    assert not np.array_equal(film.truth().position, other.truth().position)
    assert np.array_equal(film.truth().position[1], a[1].position[0])
    assert [shot.frame.stamp for shot in a] == pytest.approx([0.0, 1 / 15, 2 / 15])


def test_a_second_ball_does_not_move_the_first():
    one, two = (prepare_wand(WandOptions(motion="hand", seconds=1.0, balls=n)) for n in (1, 2))
    assert np.array_equal(one.truth().rotation, two.truth(0).rotation)
    apart = two.truth(1).position - two.truth(0).position
    assert np.all(apart[:, 0] > 0.1)  # beside each other


@pytest.mark.slow
def test_hand_and_card_come_and_go():
    """The card hides the ball at its time; a second and a half later, and before, the picture is as without it."""
    options = replace(HAND, seconds=6.0)
    plain = WandRenderer(prepare_wand(options).scene)
    for field, hides in (("card", True), ("hand", False)):
        film = prepare_wand(replace(options, **{field: 3.0}))
        renderer = WandRenderer(film.scene)
        centre = film.truth().position[45]
        u, v = int(320 + 500 * centre[0] / centre[2]), int(240 + 500 * centre[1] / centre[2])
        changed = np.any(renderer.picture(3.0, rng()) != plain.picture(3.0, rng()), axis=2)
        assert changed.any()
        assert changed[v, u] == hides
        for t in (0.5, 5.5):
            assert np.array_equal(renderer.picture(t, rng()), plain.picture(t, rng()))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fps": 0.0}, "--fps: 0 must be above 0"),
        ({"seconds": 3000.0}, "--seconds: 3000 s from 0 s on; this motion ends"),
        ({"motion": "hand", "seconds": 1e6}, "--seconds: 1e+06 must be at most 3600"),
        ({"motion": "hand", "begin": 1e6}, "--begin: 1e+06 must be at most 3600"),
        ({"balls": 4}, "--balls: 4 must be at most 3"),
        ({"vary": 0.9}, "--vary: 0.9 must be at most 0.5"),
        ({"fps": 30.0, "blur": 0.05}, "--blur: 0.05 s is longer than a frame at 30 Hz"),
        ({"hand": 500.0}, "--hand: 500 s is not within the film's"),
        ({"rate": 90.0}, "--rate: belongs to a hand"),
        ({"distance": 4.0}, "--distance: belongs to a hand"),
        ({"motion": "hand", "distance": 0.1}, "--distance: 0.1 must be at least 0.4"),
        ({"noise": float("nan")}, "--noise: nan must be at least 0"),
    ],
)
def test_options_that_make_no_sense_are_refused_in_words(change, words):
    with pytest.raises(ConfigurationError) as refused:
        prepare_wand(WandOptions(**change))
    assert words in str(refused.value)
