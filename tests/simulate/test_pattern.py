"""Painted balls: the albedo as a function on the sphere, and films against rays that OpenCV traces."""

import json
from dataclasses import replace
from functools import cache
from typing import get_args

import cv2
import numpy as np
import pytest

from spheremouse.errors import ConfigurationError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.ball.film import SimulationOptions, prepare
from spheremouse.simulate.ball.options import PatternName
from spheremouse.simulate.ball.pattern import Pattern
from spheremouse.simulate.ball.profile import play
from spheremouse.simulate.ball.render import Renderer
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.simulate.to_dataset import write_simulation
from tests.simulate.scenes import LENS, Fixed, fastest_time, image, painted, rng

NAMES = get_args(PatternName)
PAINTED = [name for name in NAMES if name != "none"]
ATTITUDE = exp(np.array([0.4, -1.1, 0.7]))


def anywhere(n, seed=0):
    u = rng(seed).standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def near():
    return Renderer(default_scene(view="near", width=320, height=240, distortion=LENS))


# ---- the albedo ----


@pytest.mark.parametrize("name", NAMES)
def test_the_albedo_is_a_function_of_the_direction_alone(name):
    pattern, u = Pattern(name, 5), anywhere(20_000)
    albedo = pattern.albedo(u)
    assert albedo.min() >= 0.0
    assert albedo.max() <= 1.0
    order = rng(2).permutation(len(u))
    assert np.allclose(pattern.albedo(u[order]), albedo[order], atol=2e-3)  # single precision at steep edges
    assert np.allclose([pattern.albedo(d[None])[0] for d in u[:50]], albedo[:50], atol=2e-3)
    assert np.array_equal(Pattern(name, 5).albedo(u), albedo)


@pytest.mark.parametrize("name", NAMES)
def test_the_albedo_has_no_seam_and_no_pole(name):
    """Great circles through the poles and across every half plane where a map would begin."""
    pattern = Pattern(name, 5)
    angle = np.linspace(0.0, 2.0 * np.pi, 60_001)
    circles = [(np.eye(3)[i], np.eye(3)[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
    circles += [(R[0], R[1]) for R in exp(rng(3).uniform(-2.0, 2.0, (3, 3)))]
    for a, b in circles:
        albedo = pattern.albedo(np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b)
        assert np.max(np.abs(np.diff(albedo))) < 0.12  # 1e-4 rad of an edge of 0.004 rad, which may be twice as steep


@pytest.mark.parametrize("name", PAINTED)
def test_each_seed_is_another_ball_with_the_same_look(name):
    u = anywhere(50_000)
    balls = np.array([Pattern(name, seed).albedo(u) for seed in range(4)])
    assert np.all(np.abs(np.corrcoef(balls) - np.eye(4)) < 0.2)
    assert np.ptp(balls.mean(axis=1)) < 0.15
    assert np.allclose(balls.std(axis=1), balls.std(), rtol=0.4)


def test_patterns_look_as_they_are_called():
    u = anywhere(100_000)
    albedo = {name: Pattern(name, 7).albedo(u) for name in NAMES}
    assert np.all(albedo["none"] == 1.0)
    for name in ("patches", "speckle"):  # two tones with sharp edges
        assert np.mean((albedo[name] < 0.15) | (albedo[name] > 0.99)) > 0.9
    assert 0.15 < np.mean(albedo["patches"] < 0.5) < 0.55
    assert 0.05 < np.mean(albedo["speckle"] < 0.5) < 0.25
    assert 0.08 < albedo["marble"].std() < 0.2
    dirt = 1.0 - albedo["dirt"]
    assert dirt.min() == 0.0
    assert 0.1 < np.quantile(dirt, 0.995) < 0.25  # faint
    assert 0.02 < np.mean(dirt > 0.05) < 0.25  # and few


# ---- films ----


@cache
def points_of(renderer, parts):
    """Points of the ball, (h, parts, w, parts, 3) in radii, that OpenCV's camera sees; nan where a ray misses it."""
    scene = renderer.scene
    camera, pose = scene.camera, scene.pose
    offset = (np.arange(parts) + 0.5) / parts - 0.5
    v, dv, u, du = np.meshgrid(np.arange(camera.height), offset, np.arange(camera.width), offset, indexing="ij")
    uv = np.stack([u + du, v + dv], axis=-1)
    exact = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
    xy = cv2.undistortPoints(uv.reshape(-1, 1, 2), camera.matrix, camera.distortion, criteria=exact)[:, 0]
    ray = np.column_stack([xy, np.ones(len(xy))]) @ pose.rotation.T
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = -ray @ pose.position
    left = scene.ball_radius**2 - pose.position @ pose.position + along**2
    depth = along - np.sqrt(np.where(left > 0.0, left, np.nan))
    return ((pose.position + depth[:, None] * ray) / scene.ball_radius).reshape(*u.shape, 3)


def traced(pattern, points, attitude):
    """Return the mean albedo of the `points` of each pixel, (h, w), nan if a part of it misses the ball."""
    albedo, hit = np.full(points.shape[:-1], np.nan), ~np.isnan(points[..., 0])
    albedo[hit] = pattern.albedo(points[hit] @ attitude)
    return albedo.mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("name", "view"), [("none", "far"), ("patches", "far"), ("dirt", "far"), ("speckle", "near"), ("marble", "near")]
)
def test_a_pixel_shows_the_light_times_the_albedo_where_its_ray_hits(small, near, name, view):
    bare = {"far": small, "near": near}[view]
    seen = image(painted(bare, name), Fixed(ATTITUDE))
    expected = traced(Pattern(name, 1), points_of(bare, 4), ATTITUDE)
    white, black, outline = bare.backdrop.white, bare.backdrop.black, bare.backdrop.outline
    whole = (bare.backdrop.ball == 1.0) & ~np.isnan(expected)
    assert whole.sum() > 10_000
    error = (seen - black - (white - black) * np.nan_to_num(expected)[..., None])[whole]
    assert np.sqrt(np.mean(np.square(error))) < (0.5 if name in ("none", "marble", "dirt") else 5.0)
    assert np.all(np.abs(np.mean(error, axis=0)) < 0.05)
    assert np.array_equal(seen[outline == 0.0], np.rint(white[outline == 0.0]))
    if name == "none":
        assert np.array_equal(seen, np.clip(np.rint(white), 0.0, 255.0))


def test_discs_lie_on_the_pattern(small):
    """On a plain ball they are those of a ball without a pattern; on another they hide it."""
    discs = {"disc_directions": small.scene.disc_directions, "exposure_s": 0.02}
    profile = play(20.0, rng(5))
    t = fastest_time(profile)
    plain = Renderer(replace(small.scene, exposure_s=0.02), None, small.backdrop).frame(profile, t, 0, rng())
    on_none, on_marble = (painted(small, name, **discs).frame(profile, t, 0, rng()) for name in ("none", "marble"))
    assert np.max(np.abs(on_none.frame.image.astype(int) - plain.frame.image)) <= 1
    assert np.array_equal(on_marble.discs.centre, plain.discs.centre)
    assert np.array_equal(on_marble.discs.state, plain.discs.state)
    black = np.all(np.abs(plain.frame.image - small.backdrop.black) <= 1.0, axis=2)
    assert np.array_equal(on_marble.frame.image[black], plain.frame.image[black])
    assert np.any(on_marble.frame.image != plain.frame.image)


def test_a_lifted_ball_takes_its_pattern_along(small):
    film = prepare(SimulationOptions(pattern="patches", size=(320, 240), motion="still", seconds=2.0, lift=0.5))
    renderer = Renderer(film.scene, film.options, small.backdrop)
    before, during = (renderer.frame(film.profile, t, 0, rng()).frame.image[..., 1] for t in (0.2, 1.0))
    inside = cv2.erode((small.backdrop.ball > 0.99).astype(np.uint8), np.ones((31, 31), np.uint8)) > 0
    rows, columns = np.nonzero(inside)
    part = before[rows.min() : rows.max(), columns.min() : columns.max()]
    match = cv2.matchTemplate(during, part, cv2.TM_CCOEFF_NORMED)
    _, best, _, (u, _) = cv2.minMaxLoc(match)
    assert best > 0.9
    assert u - columns.min() < -2  # up is to the left: the camera lies on its side


# ---- options and datasets ----


def test_a_painted_ball_has_discs_only_if_they_are_asked_for():
    assert len(prepare(SimulationOptions()).scene.disc_directions) == 26
    bare, both = (prepare(SimulationOptions(pattern="marble", discs=n, seed=4, layout=6)) for n in (None, 8))
    assert len(bare.scene.disc_directions) == 0
    assert bare.scene.rig().disc_radius is None
    assert len(both.scene.disc_directions) == 8
    assert both.scene.rig().disc_radius == 0.02
    assert bare.scene.pattern == both.scene.pattern == Pattern("marble", 6)
    for event in ("disc_off", "disc_moved"):
        with pytest.raises(ConfigurationError, match=f"^--{event.replace('_', '-')}: the ball has no discs"):
            prepare(SimulationOptions(pattern="marble", **{event: 0.1}))


def test_a_dataset_names_the_pattern_and_has_no_discs(tmp_path):
    film = prepare(SimulationOptions(pattern="speckle", size=(160, 120), seconds=0.2, hands=True))
    assert list(write_simulation(tmp_path / "film", film)) == [1, 2, 3, 4, 5, 6]
    scene = json.loads((tmp_path / "film" / "scene.json").read_text())
    assert scene["pattern"] == "speckle"
    assert not {"disc_radius", "truth_disc_directions"} & set(scene)
    assert not (tmp_path / "film" / "discs.csv").exists()
    recording = open_dataset(tmp_path / "film")
    assert len(recording.truth) == recording.frames == 6
    assert (recording.rig.disc_radius, recording.discs, recording.truth_directions) == (None, None, None)
