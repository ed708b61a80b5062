"""What is drawn of hand-held balls, judged by geometry and pixels."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from spheremouse.commands import app
from spheremouse.errors import SpheremouseError
from spheremouse.files.wand import save_wand
from spheremouse.geometry.camera import InteriorOrientation, sphere_outline, unproject
from spheremouse.geometry.rotation import exp
from spheremouse.session.overlay.pen import GREEN, WHITE
from spheremouse.session.overlay.wand import WandOverlay, pin, rims
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.tracker import Frame, Status, unknown
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.state import WandEpoch, WandPose
from spheremouse.wand.track import begin

CAMERA = InteriorOrientation(640, 480, 500.0, 505.0, 322.0, 238.0, np.array([-0.2, 0.05, 0.001, -0.001, 0.0]))
BALL = grzonka_ball()
PLACE, ATTITUDE = np.array([0.2, -0.1, 0.9]), exp(np.array([1.2, 0.4, -0.3]))


def rays(points):
    xy = unproject(points, CAMERA)[0]
    d = np.column_stack([xy, np.ones(len(xy))])
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def epoch(pose, image=None):
    tracker = build(CAMERA, (BALL,))
    frame = Frame(np.full((480, 640, 3), 90, np.uint8) if image is None else image, 1.5, 3)
    return tracker, WandEpoch(frame, replace(begin(tracker), poses=(pose,)), unknown(1.5), 0.0)


def pose(**changes):
    whole = WandPose("grzonka", PLACE, ATTITUDE, 1e-4 * np.eye(6), Status.TRACKING, None, 1.0, 100.0, True)
    return replace(whole, **changes)


def drawn(one):
    tracker, seen = epoch(one)
    overlay = WandOverlay(tracker)
    overlay.remember(seen)
    return overlay.draw(seen, (1, 2, 3))


def count(image, colour, off=60):
    """Pixels near a colour, above the strip: thin lines mix with what is below."""
    return np.count_nonzero(np.all(np.abs(image[:440].astype(int) - colour) < off, axis=2))


def test_the_outline_touches_the_ball():
    d = rays(sphere_outline(PLACE, BALL.radius, CAMERA))
    off = np.linalg.norm(np.cross(d, PLACE), axis=1)
    np.testing.assert_allclose(off, BALL.radius, rtol=1e-6)


@pytest.mark.parametrize("lean", [-2.8, -1.2, 0.0, 1.2])
def test_of_the_pin_only_what_the_ball_does_not_hide_is_drawn(lean):
    """Lines of sight to all of it pass the ball, or end before it."""
    R = exp(np.array([lean, 0.0, 0.0]))
    shown = pin(BALL, PLACE, R, CAMERA)
    whole = PLACE + np.linspace(1.0, 1.6, 16)[:, None] * BALL.radius * R[:, 2]
    hidden = 0
    for X in whole:
        d = X / np.linalg.norm(X)
        enters = d @ PLACE - np.sqrt(max((d @ PLACE) ** 2 - PLACE @ PLACE + BALL.radius**2, 0.0))
        passes = np.linalg.norm(np.cross(d, PLACE)) >= BALL.radius - 1e-9
        hidden += not passes and np.linalg.norm(X) > enters + 1e-9
    assert len(shown) == 16 - hidden
    assert (hidden > 0) == (R[:, 2] @ PLACE > 0.0)


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.5])
def test_rims_are_where_discs_end_on_the_near_side(turn):
    R = exp(np.array([0.0, turn, 0.3])) @ ATTITUDE
    arcs = rims(BALL, PLACE, R, CAMERA)
    assert arcs
    for d in rays(np.concatenate(arcs)):
        t = d @ PLACE - np.sqrt(max((d @ PLACE) ** 2 - PLACE @ PLACE + BALL.radius**2, 0.0))  # where it meets the ball
        u = R.T @ (t * d - PLACE) / BALL.radius
        away = [np.arccos(np.clip(u @ disc.direction, -1.0, 1.0)) - disc.angle for disc in BALL.discs]
        assert min(np.abs(away)) < 2e-3
    facing = [disc for disc in BALL.discs if (R @ disc.direction) @ (PLACE + BALL.radius * (R @ disc.direction)) < 0.0]
    assert len(arcs) >= len(facing)


def test_what_is_seen_is_white_and_what_is_predicted_is_grey_and_what_is_lost_is_not_drawn():
    seen, hidden = drawn(pose()), drawn(pose(seen=False, event="grzonka is hidden"))
    lost = drawn(pose(position=None, rotation=None, covariance=None, phase=Status.LOST, seen=False))
    assert count(seen, WHITE) > 40
    assert count(hidden, WHITE) < 0.05 * count(seen, WHITE)
    assert count(seen, GREEN) > 10
    assert count(seen, (30, 210, 255)) > 3
    assert len(np.unique(lost[:440].reshape(-1, 3), axis=0)) == 1
    assert len(np.unique(lost[460:].reshape(-1, 3), axis=0)) > 2  # the strip says so


def test_the_trace_is_half_a_second_long_at_any_rate():
    tracker, first = epoch(pose())
    overlay = WandOverlay(tracker)
    overlay.remember(first)
    gone = WandEpoch(
        replace(first.frame, stamp=first.frame.stamp + 0.4),
        replace(first.state, poses=(pose(position=None, rotation=None, covariance=None, seen=False),)),
        unknown(1.9),
        0.0,
    )
    overlay.remember(gone)
    assert count(overlay.draw(gone, (0, 0, 0)), (90, 90, 90), 1) < 440 * 640
    overlay.remember(replace(gone, frame=replace(first.frame, stamp=first.frame.stamp + 0.6)))
    assert count(overlay.draw(gone, (0, 0, 0)), (90, 90, 90), 1) == 440 * 640


@pytest.mark.parametrize(
    "place", [(0.0, 0.0, 0.06), (0.0, 0.0, 0.02), (0.5, 0.0, 0.07), (0.0, 0.0, -1.0), (3.0, 2.0, 1.0)]
)
def test_balls_at_the_camera_or_out_of_view_do_no_harm(place):
    towards = exp(np.array([np.pi, 0.0, 0.0]))  # the pole at the camera, and the pin's end behind it
    with np.errstate(all="raise"):
        image = drawn(pose(position=np.array(place), rotation=towards))
    assert image.shape == (480, 640, 3)
    assert count(image, GREEN) < 1500


@pytest.mark.slow
@pytest.mark.parametrize("name", ["seen.png", "seen.mp4"])
def test_run_draws_a_recording(tmp_path, name):
    film = prepare_wand(WandOptions(motion="hand", size=(320, 240), seconds=0.4, seed=2))
    list(write_wand(tmp_path / "film", film))
    path = tmp_path / name
    told = CliRunner().invoke(
        app, ["run", "--tracker", "wand", "--source", f"dataset:{tmp_path / 'film'}", "--output", "null",
              "--overlay", str(path)],
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    capture = cv2.VideoCapture(str(path))
    shots = 0
    while (read := capture.read())[0]:
        shots, image = shots + 1, read[1]
    assert shots == (1 if name.endswith("png") else 6)
    assert image.shape[:2] == ((960, 1280) if name.endswith("png") else (480, 640))
    assert told.stderr.splitlines()[-2] == f"overlay: {path}"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["film", name]


@pytest.mark.parametrize(
    "name",
    ["film/video.mkv", "film/scene.json", "film/frames/000000.png", "axes.png", "out.mp4", "ball.avi", "folder.mp4"],
)
@pytest.mark.slow
def test_an_overlay_destroys_nothing_that_the_run_needs(tmp_path, name):
    film = prepare_wand(WandOptions(motion="hand", size=(320, 240), seconds=0.2, seed=2))
    list(write_wand(tmp_path / "film", film))
    (tmp_path / "film" / "frames").mkdir()  # as recordings of single frames have it
    (tmp_path / "film" / "frames" / "000000.png").write_bytes(b"a frame")
    save_wand(tmp_path / "ball.avi", BALL)
    (tmp_path / "folder.mp4").mkdir()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    words = ["--output", f"text:{tmp_path / 'out.mp4'}", "--output", f"text:{tmp_path / 'axes.png'}"]
    told = CliRunner().invoke(
        app, ["run", "--tracker", "wand", "--source", f"dataset:{tmp_path / 'film'}", *words,
              "--ball", str(tmp_path / "ball.avi"), "--overlay", str(tmp_path / name)],
    )  # fmt: skip
    assert isinstance(told.exception, SpheremouseError)
    assert str(tmp_path / name) in str(told.exception)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
