"""`spheremouse doctor` for a ball in a hand: its files, and whether it is seen, on films with it and without it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from spheremouse.commands.doctor import examine as doctor
from spheremouse.commands.doctor.wand import sight
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import open_wand
from spheremouse.files.wand import save_wand
from spheremouse.finding import Verdict
from spheremouse.session.run_config import CommandLineOverrides
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.tracker import Frame
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.build import build


@pytest.fixture(scope="module")
def hand(tmp_path_factory):
    """Six pictures of a ball in a hand."""
    path = tmp_path_factory.mktemp("wand") / "hand"
    list(write_wand(path, prepare_wand(WandOptions("hand", seed=1, fps=15.0, seconds=0.4, size=(640, 480)))))
    return path


def examined(overrides):
    return {f.name: f for s in doctor.examine(overrides, seconds=1.0) for f in s.findings}


def test_a_ball_that_is_in_view_is_found_and_its_distance_told(hand):
    found = examined(CommandLineOverrides(None, ("tracker=wand", f"source=dataset:{hand}")))
    assert found["camera file"].text == "the source brings its own"
    assert found["ball"].text == "grzonka, 100 mm across, 8 discs"
    assert found["sight"].verdict is Verdict.OK
    away = np.linalg.norm(open_wand(hand).truth.position[-1])
    assert found["sight"].values["distance_m"] == pytest.approx(away, abs=0.03)
    assert not {"targets", "rig", "map", "discs"} & set(found)


def test_a_camera_without_a_file_and_a_ball_file_that_is_missing_are_lines(hand, tmp_path):
    found = examined(CommandLineOverrides(None, ("tracker=wand",)))
    assert found["camera file"].verdict is Verdict.UNCHECKED
    assert "give --camera FILE" in found["camera file"].advice
    file = tmp_path / "config.yaml"
    file.write_text("schema: 2\ntracker: wand\nwand: {balls: [mine.yaml]}\n")
    found = examined(CommandLineOverrides(file, (f"source=dataset:{hand}",)))
    assert found["ball"].verdict is Verdict.WRONG
    assert "mine.yaml: no such file" in found["ball"].text
    assert "sight" not in found


def test_balls_may_be_named_on_the_command_line(spheremouse, hand, tmp_path, monkeypatch):
    save_wand(tmp_path / "my ball.yaml", replace(grzonka_ball(), name="mine"))
    (tmp_path / "else").mkdir()
    file = tmp_path / "else" / "config.yaml"  # whose own ball does not count, nor its folder
    file.write_text("schema: 2\ntracker: wand\nwand: {balls: [none.yaml]}\n")
    monkeypatch.chdir(tmp_path)
    words = ("--tracker", "wand", "--source", f"dataset:{hand}", "--json", "--config", file)
    save_wand(tmp_path / "hers.yaml", replace(grzonka_ball(), name="hers"))
    _, out, err = spheremouse("doctor", *words, "--ball", "my ball.yaml", "--ball", "hers.yaml")
    found = {f["name"]: f for f in json.loads(out)["checks"]}
    assert found["ball"]["text"] == "mine, 100 mm across, 8 discs; hers, 100 mm across, 8 discs", err
    said = spheremouse.fail("doctor", "--ball", "my ball.yaml")
    assert said == "--ball: goes with --tracker wand; add that, or leave it out"


def test_what_is_not_seen_is_said_with_what_to_do(hand):
    recording = open_wand(hand)
    tracker = build(recording.camera, (grzonka_ball(),))
    grey = np.full((480, 640, 3), 128, np.uint8)
    empty = [Frame(grey, 0.1 * k, k) for k in range(4)]
    (size, seen) = sight(tuple(empty), tracker)
    assert size.verdict is Verdict.OK
    assert seen.verdict is Verdict.WRONG
    assert "match nothing" in seen.text
    assert "wand colours" in seen.text + seen.advice
    (size,) = sight(tuple(replace(f, image=grey[:, :320]) for f in empty), tracker)
    assert size.text == "pictures of 320x480, but the camera was calibrated at 640x480"
    _, seen = sight(tuple(replace(f, image=grey[:, :, 0]) for f in empty), tracker)
    assert (seen.verdict, seen.text) == (Verdict.UNCHECKED, "the pictures are grey")


def test_a_ball_that_is_seldom_seen_is_a_warning(hand):
    recording = open_wand(hand)
    frames = list(read_frames(recording))[:4]
    dark = [replace(f, image=np.full_like(f.image, 90)) for f in frames]
    views = tuple(replace(f, sequence=k, stamp=0.2 * k) for k, f in enumerate([*dark, *dark, *frames]))
    _, seen = sight(views, build(recording.camera, recording.balls))
    assert seen.verdict is Verdict.WARNING
    assert 0 < seen.values["found"] <= 4
