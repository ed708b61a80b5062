"""Photos taken for a calibration, and the device file that nobody filled in."""

import json
import re
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from boards import CAMERA, picture, places
from conftest import datasets_dir, write_video
from invoking import refusal
from typer.testing import CliRunner

from spheremouse.calibrate.board import NAME, Pattern, load_board
from spheremouse.calibrate.camera import coverage
from spheremouse.calibrate.photographing import board as photographing
from spheremouse.commands import app
from spheremouse.errors import SpheremouseError
from spheremouse.files.config import load
from spheremouse.files.device import device_template
from spheremouse.files.rig import load_camera, save_camera
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.settings import Configuration

SIZE = CAMERA.width, CAMERA.height
BOARD = ("--board", "9x6", "--square", "30mm")


@pytest.fixture(scope="module")
def poses():
    return places(6, np.random.default_rng(0))


def run(*words, command="photos"):
    return CliRunner().invoke(app, ["calibrate", command, *map(str, words)], catch_exceptions=False)


refused = partial(refusal, SpheremouseError, run)


def film(path, poses):
    """A video of two pictures at each place, and one on the way to the next."""
    rng, images = np.random.default_rng(3), []
    for R, t in zip(*poses, strict=True):
        image = picture(R, t)
        for frame in (image, image, np.roll(image, 6, axis=1)):
            noisy = np.clip(np.rint(frame + rng.normal(0.0, 1.0, frame.shape)), 0, 255).astype(np.uint8)
            images.append(cv2.cvtColor(noisy, cv2.COLOR_GRAY2BGR))
    return write_video(path, images, fps=10.0)


@pytest.mark.slow
def test_photos_are_taken_until_they_are_enough_and_the_next_command_works(tmp_path, poses, monkeypatch):
    monkeypatch.setattr(photographing, "enough", lambda found: found.views >= 4)
    folder = tmp_path / "my cabinet"
    result = run("--for", "camera", folder, *BOARD, "--source", film(tmp_path / "f.mkv", poses))
    assert f"{folder / 'board'}: 4 photos, which is enough" in result.stdout
    assert sorted(p.name for p in (folder / "board").iterdir()) == [f"view_{k:03d}.png" for k in range(4)]
    assert load_board(folder / NAME) == Pattern(9, 6, 0.03)
    words = shlex.split(result.stdout.splitlines()[-1].removeprefix("next: "))
    assert words[1:3] == ["calibrate", "camera"]
    run(*words[3:], command="camera")
    camera = load_camera(folder / "camera.yaml")
    assert camera.fx == pytest.approx(CAMERA.fx, rel=0.02)
    result = run(folder / "board", "--out", folder / "again.yaml", command="camera")  # the board is remembered here too
    assert "from its board.yaml: --board 9x6 --square 30mm" in result.stderr
    assert load_camera(folder / "again.yaml").fx == camera.fx
    assert not (folder / "config.yaml").exists()  # a film is no camera to come back to


@pytest.fixture(scope="module")
def source(tmp_path_factory, poses):
    """A film of three places."""
    R, t = poses
    return film(tmp_path_factory.mktemp("film") / "f.mkv", (R[:3], t[:3]))


def test_what_is_missing_is_said_and_the_same_command_goes_on(tmp_path, source):
    result = run("--for", "camera", tmp_path, *BOARD, "--source", source, "--set", "camera.focus=30")
    kept = load(tmp_path / "config.yaml", Configuration)
    assert (kept.camera.focus, kept.source) == (30, None)
    assert "3 photos so far; tilt the board" in result.stdout
    assert f"go on: spheremouse calibrate photos {tmp_path} --for camera --source {source}" in result.stdout
    assert "or go on with these: spheremouse calibrate camera" in result.stdout
    again = run("--for", "camera", tmp_path, "--source", source)  # the board is remembered
    assert "goes on with 3 photos" in again.output
    assert len(list((tmp_path / "board").iterdir())) == 3
    assert not coverage.enough(coverage.coverage(SIZE, [], np.empty((0, 3, 3))))


def test_a_program_gets_each_check_as_json_with_its_picture(tmp_path, source):
    shown = tmp_path / "shown.jpg"
    assert "--json" in refused("--for", "camera", tmp_path, *BOARD, "--source", source, "--picture", shown)
    result = run("--for", "camera", tmp_path, *BOARD, "--source", source, "--json", "--picture", shown)
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    checks, texts = [line for line in lines if "check" in line], [line["text"] for line in lines if "text" in line]
    assert [c["photos"] for c in checks if c["gain"]] == [1, 2, 3]
    assert any("tilt the board" in c["wanted"][0] and c["status"] for c in checks)
    assert [text.split(":")[0] for text in texts if text.startswith("view_")] == [f"view_00{k}.png" for k in range(3)]
    assert "3 photos so far" in texts[-3]
    assert cv2.imread(str(shown)).shape == (SIZE[1], SIZE[0], 3)


def test_a_film_that_breaks_off_keeps_its_photos_and_says_so(tmp_path, source):
    whole = Path(source.removeprefix("video:")).read_bytes()
    (tmp_path / "f.mkv").write_bytes(whole[: len(whole) // 2])
    assert re.search(
        r"truncated or damaged there; \d photos? in .* kept, and the same command",
        refused("--for", "camera", tmp_path, *BOARD, "--source", f"video:{tmp_path / 'f.mkv'}"),
    )
    assert list((tmp_path / "board").iterdir())


def test_where_nothing_can_be_taken_the_reason_is_told(tmp_path, source):
    assert "no photo in 9 frames: most often it shows 9x6 corners of a chessboard" in refused(
        "--for", "camera", tmp_path, "--board", "7x5", "--square", "30mm", "--source", source
    )
    assert not (tmp_path / NAME).exists()


def test_what_comes_before_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    assert "is a file" in refused("--for", "camera", tmp_path / "file")
    folder = tmp_path / "cabinet"
    folder.mkdir()
    assert "device.yaml: no such file; `spheremouse calibrate init" in refused("--for", "device", folder)
    (folder / "device.yaml").write_text(device_template())
    assert "photos of the board come first: spheremouse calibrate photos" in refused("--for", "device", folder)
    (folder / "config.yaml").write_text("camera: {size: 3}\n")
    assert "config.yaml" in refused("--for", "camera", folder)


def test_a_device_is_photographed_in_the_mode_of_its_camera(tmp_path, source):
    (tmp_path / "device.yaml").write_text(device_template())
    save_camera(tmp_path / "camera.yaml", replace(CAMERA, width=1280, height=960))
    assert "is for the mode 1280x960, the camera gives 640x480" in refused(
        "--for", "device", tmp_path, "--source", source
    )


@pytest.fixture
def cabinet(tmp_path):
    truth = json.loads((datasets_dir() / "stills" / "truth.json").read_text())
    c = truth["camera"]
    lens = [c[name] for name in ("fx", "fy", "cx", "cy")]
    camera = InteriorOrientation(truth["width"], truth["height"], *lens, np.array(c["dist"]), 1e-6 * np.eye(9))
    save_camera(tmp_path / "camera.yaml", camera)
    return tmp_path


def options(folder, device):
    return ("--device", device, "--camera", folder / "camera.yaml", "--out", folder / "rig.yaml")


def test_a_device_file_nobody_filled_in_is_refused(cabinet):
    """Its targets may well be those of the photos; the distances are not."""
    device = cabinet / "device.yaml"
    device.write_text(device_template(), encoding="utf-8")
    said = refused(datasets_dir() / "stills" / "device", *options(cabinet, device), command="device")
    assert "delete its first line" in said
    assert not (cabinet / "rig.yaml").exists()


def test_what_comes_next_saves_what_is_answered(cabinet):
    stills = datasets_dir() / "stills"
    given = ["--report", str(cabinet / "r.html"), "--json", str(cabinet / "f.json")]
    result = run(stills / "device", *options(cabinet, stills / "device.yaml"), *given, command="device")
    assert result.exit_code == 0, result.output
    again = next(line for line in result.output.splitlines() if line.startswith("with more photos"))
    assert " ".join(given) in again
    written = {path.name: path.stat().st_mtime_ns for path in cabinet.iterdir() if path.name != "camera.yaml"}
    assert max(written.values()) == written["rig.yaml"]  # it shows that all files are complete
    follows = next(line for line in result.output.splitlines() if line.startswith("next: "))
    config, rig = cabinet / "config.yaml", cabinet / "rig.yaml"
    assert follows.startswith(f"next: spheremouse axes --config {config} --rig {rig} --source ")
    assert "uinput" not in result.output  # `axes` has no such option
