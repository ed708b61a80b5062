"""A ball that is followed by its pattern: no command speaks of discs that it lacks, or needs their radius."""

import json
import re
from dataclasses import replace
from functools import cache
from itertools import islice

import cv2
import numpy as np
import pytest
from conftest import directions
from invoking import invoke, succeed

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.appearance import ball_mask, clear_mask
from spheremouse.ball.detect.diagnosis import Cause, why_no_pattern
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.settings import Settings, So3Settings
from spheremouse.ball.track import step, with_settings
from spheremouse.commands import app
from spheremouse.files.ball_map import save_map, saved_now
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.ball.recorded import recorded_mask
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.to_dataset import write_simulation
from spheremouse.tracker import Status

OPTIONS = SimulationOptions(pattern="speckle", motion="thesis", seconds=3.0, noise=3.0, size=(320, 240), seed=3)


@cache
def film(frames=None):
    simulation = prepare(OPTIONS)
    pose = simulation.scene.pose
    return replace(simulation.scene.rig(), pose=pose), pose, [f.frame for f in islice(simulate(simulation), frames)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pattern") / "film"
    list(write_simulation(folder, prepare(replace(OPTIONS, size=(640, 480), seconds=1.0))))  # it shows the targets
    return folder


def test_a_ball_that_rests_and_one_that_is_dark_state_why():
    rig, pose, frames = film()
    still, dark = (BallAdapter((rig,), Configuration(), None, lambda _: None) for _ in range(2))
    for k in range(45):
        still.follow(replace(frames[0], stamp=k / 30.0, sequence=k))
    assert re.fullmatch(r"the ball is not followed for \d s: nothing has turned .*; turn it .*", still.reason)
    ball, lines = ball_mask(rig, pose) > 0, []
    for frame in frames:
        dark.follow(replace(frame, image=np.where(ball[..., None] & (frame.stamp >= 1.5), np.uint8(3), frame.image)))
        lines.append(dark.take_messages().change)
    log = "; ".join(filter(None, lines))
    assert re.search(r"tracking: \d+ parts of the pattern in view; .*the ball turns; what stands still is masked", log)
    assert "lost: no part of the pattern in view" in log
    assert "disc" not in log
    assert "it is nearly black (3 of 255)" in dark.reason
    assert dark.scene()["discs"] is None


@pytest.mark.parametrize("pattern", ["none", "dirt"])
def test_a_ball_with_too_little_pattern_states_so_within_two_seconds(pattern):
    simulation = prepare(SimulationOptions(seconds=0.1, size=(320, 240), pattern=pattern, noise=4.0))
    made = list(simulate(simulation))
    adapter = BallAdapter((replace(simulation.scene.rig(), pose=made[0].pose),), Configuration(), None, lambda _: None)
    for k in range(60):
        adapter.follow(replace(made[k % len(made)].frame, stamp=k / 30.0, sequence=k))
    assert re.fullmatch(r"the ball .*: \d+ % of it shows no pattern above the noise; paint or stick .*", adapter.reason)


@pytest.mark.parametrize(("level", "known", "cause"), [(0, True, Cause.DARK), (255, False, Cause.BRIGHT)])
def test_the_light_comes_before_the_pattern(level, known, cause):
    rig, pose, (frame,) = film(1)
    assert why_no_pattern(np.full_like(frame.image, level), rig, pose, known).cause is cause
    assert why_no_pattern(frame.image, rig, pose, known).cause in (Cause.UNLIKE, Cause.UNTURNED)


def test_a_masked_picture_keeps_the_ball_and_little_else():
    rig, pose, _ = film(1)
    keep = recorded_mask(rig, pose, Settings())
    clear = cv2.dilate(clear_mask(rig, pose), np.ones((3, 3), np.uint8))  # a chart interpolates between pixels
    rows, columns = (np.flatnonzero(clear.any(axis=axis)) for axis in (1, 0))
    box = keep[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] > 0
    assert keep[clear > 0].all()
    assert np.mean(box[clear[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] == 0]) < 0.2


def test_another_setting_of_the_filter_keeps_the_picture_and_another_detector_begins_again():
    rig, pose, frames = film()
    rig = replace(rig, disc_radius=0.02)
    settings = Settings(detector="texture")
    tracker = build(rig, pose, settings)
    state = begin(tracker, 0.0)
    for frame in frames:
        state = step(state, frame, tracker).state
    assert state.status is Status.TRACKING
    same, _ = with_settings(state, tracker, replace(settings, so3=So3Settings(acceleration_sigma=1.0)))
    assert same.status is Status.TRACKING
    assert same.search is state.search
    other, of_discs = with_settings(state, tracker, Settings())
    assert other.status is Status.SEARCHING
    back, _ = with_settings(other, of_discs, settings)
    assert back.status is Status.SEARCHING
    np.testing.assert_array_equal(back.filter.attitude, state.filter.attitude)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("tune", "FILM"), "tune searches settings of discs, and this ball is followed by its pattern"),
        (("evaluate", "FILM", "--tracker", "ekf2"), "the tracker ekf2 follows discs, and this ball has none"),
        (("evaluate", "FILM", "--tracker", "ekf2", "--detector", "texture"), "texture needs the tracker so3"),
        (
            ("calibrate", "rolling", "--source", "dataset:FILM", "--out", "FILM/r.yaml"),
            "has no discs, and their paths are measured; give --disc-radius",
        ),
        (
            ("evaluate", "FILM", "--map", "FILM/../discs.yaml"),
            "is a map of discs, and the tracker follows a pattern: name this device's map",
        ),
    ],
)
def test_commands_refuse_what_needs_discs_in_one_line(recording, words, says):
    discs = DiscMap(directions(9, 1), 1e-6 * np.eye(18), np.full(9, 50, dtype=np.intp))
    rig = replace(open_dataset(recording).rig, disc_radius=0.02)
    save_map(recording.parent / "discs.yaml", saved_now(discs, rig))
    code, output = invoke(app, *(word.replace("FILM", str(recording)) for word in words))
    assert code != 0
    assert says in " ".join(output.split())


@pytest.mark.slow
def test_a_run_saves_its_picture_and_the_next_one_recognises_it(recording, tmp_path):
    file = tmp_path / "a.yaml"
    words = ("run", "--source", f"dataset:{recording}", "--output", "null", "--map", file)
    first, again = (" ".join(invoke(app, *words)[1].split()) for _ in range(2))
    assert re.search(r"a.yaml: \d+ % of the pattern saved", first)
    assert re.search(r"a.yaml: \d+ % of the pattern, saved just now", again)
    assert re.search(r"recognised by \d+ parts of the pattern of the saved map", again)
    assert "the patterns' correlation is 1.00" in again
    assert f"{file}: " in invoke(app, "map", "show", file, "--output", tmp_path / "a.png")[1]
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    tracked = invoke(app, "track", recording, "--output", "null", "--map", file)[1]
    assert "parts of the pattern of the saved map" in " ".join(tracked.split())
    found = invoke(app, "evaluate", recording, "--map", file, "--json", tmp_path / "r.json")
    assert found[0] == 0
    assert json.loads((tmp_path / "r.json").read_text())["identified_from_frame"] < 3


def test_the_report_names_the_detector_and_has_no_figures_of_discs(recording):
    output = succeed(app, "evaluate", recording)
    assert "with detector texture" in output
    assert "points used per frame" in output
    assert re.search(r"RMSE / bound: attitude, rate *│ *–  – ", output)


@pytest.mark.slow
def test_an_overlay_and_an_mcap_file_need_no_radius(recording, tmp_path):
    words = ("--source", f"dataset:{recording}", "--output", "null", "--overlay", tmp_path / "last.png")
    succeed(app, "run", *words)
    assert (tmp_path / "last.png").exists()
    pytest.importorskip("foxglove")
    succeed(app, "export", recording, tmp_path / "film.mcap")


def test_the_doctor_checks_ball_and_light_and_no_disc(recording):
    _, output = invoke(app, "doctor", "--source", f"dataset:{recording}")
    picture = " ".join(output.partition("picture")[2].partition("output")[0].split())
    assert "followed by its pattern" in picture
    assert "wrong" not in picture
    assert "disc" not in picture
