"""A camera or a film without a rig: the preview, and the ball's outline."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import write_video
from invoking import fail, succeed

from spheremouse.ball.detect.appearance import ball_outline
from spheremouse.calibrate.outline.fit import R_OBJ_CAM, pinhole
from spheremouse.commands import app
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.rig import load_camera, load_rig, rig_text, save_camera
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate


@pytest.fixture(scope="module")
def shot():
    film = prepare(SimulationOptions(motion="rest", seconds=0.1))
    return next(iter(simulate(film))).frame.image, film.scene.rig()


def test_the_picture_marks_the_targets_and_the_json_lists_them(spheremouse, shot, tmp_path):
    image, rig = shot
    source = write_video(tmp_path / "f.avi", [image] * 2)
    code, out, err = spheremouse("preview", source, "--out", tmp_path / "p.png", "--json")
    assert (code, err) == (0, "")
    seen = json.loads(out)
    assert {t["code"] for t in seen["targets"]} == set(rig.targets.codes)
    assert (seen["size"], seen["colour"], seen["strangers"]) == ([640, 480], True, [])
    assert seen["blur_px"] < 0.5
    assert seen["spots"] > 5
    drawn = cv2.imread(str(tmp_path / "p.png"))
    assert drawn is not None
    assert drawn.shape == (960, 1280, 3)
    green = np.abs(drawn.astype(int) - (90, 220, 60)).max(axis=2) < 30
    for t in seen["targets"]:
        u, v = (round(2 * x) for x in t["place_px"])
        assert green[v - 40 : v + 41, u - 40 : u + 41].sum() > 100


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda i: (0.06 * i).astype(np.uint8), ("0 targets", "refused     CMY: too dark or too pale; more light")),
        (lambda i: cv2.GaussianBlur(i, (0, 0), 3.0), ("sharpness   blurred", "focus the lens")),
        (lambda i: cv2.cvtColor(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), ("0 targets",)),
        (lambda i: i, ("4 targets: ", "sharpness   sharp", "refused     M in C, no third colour")),
    ],
)
def test_each_fault_is_reported_with_its_remedy(spheremouse, shot, tmp_path, change, words):
    source = write_video(tmp_path / "f.avi", [change(shot[0])] * 2)
    code, out, err = spheremouse("preview", source, "--out", tmp_path / "p.png")
    assert (code, err) == (0, "")
    for each in words:
        assert each in out


def test_a_rig_of_another_device_is_reported(spheremouse, shot, tmp_path):
    image, rig = shot
    (tmp_path / "rig.yaml").write_text(rig_text(rig).replace(rig.targets.codes[0], "YCM"))
    source = write_video(tmp_path / "f.avi", [image] * 2)
    _, out, _ = spheremouse("preview", source, "--out", tmp_path / "p.png", "--rig", tmp_path / "rig.yaml")
    assert f"3 of the rig's 4 targets: {' '.join(rig.targets.codes[1:])}; not in the rig: {rig.targets.codes[0]}" in out


def test_an_error_is_one_line_and_leaves_no_file(spheremouse, shot, tmp_path):
    source = write_video(tmp_path / "f.avi", [shot[0]] * 2)
    before = sorted(tmp_path.iterdir())
    for words, said in (
        ((source, "--at", "9"), "gave no frame from 9 s on: give a smaller --at"),
        ((source, "--out", tmp_path / "f.avi"), "is not a picture; end its name in .png"),
        ((source, "--out", tmp_path / "none" / "p.png"), "cannot be written"),
        (("video:/nowhere",), "no such file"),
        ((source, "--set", "rings.nix=1"), "unknown key"),
    ):
        out = () if "--out" in words else ("--out", tmp_path / "p.png")
        assert said in spheremouse.fail("preview", *words, *out)
    assert sorted(tmp_path.iterdir()) == before


CAMERA = Path("camera.yaml")  # of pictures of 640x480


def clicks(recording):
    """Points on the outline of the recording's ball, as a person would give them, to a pixel."""
    scene = open_dataset(recording)
    return " ".join(f"{x:.0f},{y:.0f}" for x, y in ball_outline(scene.rig, scene.pose, 7))


def test_a_film_without_a_calibration_is_tracked_in_the_axes_of_its_camera(recording, tmp_path):
    film, out = recording / "video.mkv", tmp_path / "ball"
    text = succeed(app, "ball", film, "--out", out)
    assert "assumed: a field of view of 45° from top to bottom" in text
    assert "rotations across the view come out 2." in text
    assert sorted(p.name for p in out.iterdir()) == ["camera.yaml", "config.yaml", "outline.png", "rig.yaml"]
    assert load_camera(out / "camera.yaml").fy == pytest.approx(120.0 / np.tan(np.radians(22.5)))
    lines = tmp_path / "lines.jsonl"
    text = succeed(app, "track", film, "--rig", out / "rig.yaml", "--output", f"text:{lines}")
    samples = [json.loads(line) for line in lines.read_text().splitlines()]
    scene = open_dataset(recording)
    R = R_OBJ_CAM @ scene.pose.rotation.T  # the film's camera is rolled by 90° in the device's axes
    tracked = [s for s in samples if s["status"] == "tracking" and s["confirmed"]]
    assert len(tracked) > 60
    rates = np.array([s["rate"] for s in tracked])
    frame = [round(s["stamp"] * 30.0) for s in tracked]
    true = scene.truth.rate[frame] @ R.T
    # the filter's rate follows a jump of the true one in some frames, which says nothing about the scale
    jumps = np.linalg.norm(np.diff(scene.truth.rate, axis=0, prepend=0.0), axis=1) > 0.3
    steady = np.convolve(jumps, np.ones(8))[frame] == 0.0
    assert np.mean(steady) > 0.8
    scale = np.sum((rates * true)[steady], axis=0) / np.sum((true * true)[steady], axis=0)
    np.testing.assert_allclose(scale, [0.974, 0.974, 1.0], atol=0.03)


def test_a_recording_gives_its_camera_and_evaluate_turns_the_truth_into_the_axes_of_the_rig(recording, tmp_path):
    out, figures = tmp_path / "ball", tmp_path / "figures.json"
    succeed(app, "ball", recording, "--out", out)
    succeed(app, "evaluate", recording, "--rig", out / "rig.yaml", "--json", figures)
    assert json.loads(figures.read_text())["rate_rmse_deg_s"]["combined"] < 5.0


def test_points_by_hand_need_no_motion_and_find_the_same_ball(recording, tmp_path):
    """They may follow each other without quotes."""
    points = clicks(recording)
    for name, words in (("a", ()), ("b", ("--points", points)), ("c", ("--points", *points.split()))):
        succeed(app, "ball", recording, "--out", tmp_path / name, *words)
    assert (tmp_path / "b" / "rig.yaml").read_text() == (tmp_path / "c" / "rig.yaml").read_text()
    a, b = (load_rig(tmp_path / name / "rig.yaml").pose for name in "ab")
    off = b.position - a.position
    C = a.covariance[:3, :3] + b.covariance[:3, :3]
    assert off @ np.linalg.solve(C, off) < 16.3  # 0.999


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("another.mkv",), "another.mkv: give one film; points come after --points"),
        (("--points", "1,2 3,4"), "--points: 2 points fix no outline; give 3 or more"),
        (("--points", "1,2 3 5,6"), "--points '1,2 3 5,6': write X,Y in px, as in \"320,72"),
        (("--points", "1,2 3,4 nan,6"), "write X,Y in px"),
        (("--points", "10,10 20,20 30,30"), "on no outline of a ball; give points all around it"),
        (("--points", "152,30 250,120 160,206 70,120 160,120"), "160,120 is "),
        (("--vfov", 45, "--camera", CAMERA), "--camera and --vfov: give one of the two"),
        (("--camera", CAMERA), "frame 0 is 320x240, the camera was calibrated at 640x480: "),
        (("--camera", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_a_wrong_request_is_one_line_with_a_remedy_and_writes_nothing(recording, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    save_camera(CAMERA, pinhole((640, 480), 45.0))
    assert message in fail(app, "ball", recording, "--out", tmp_path / "ball", *words)
    assert not (tmp_path / "ball").exists()


def test_a_folder_is_replaced_only_with_force_and_a_file_never(recording, tmp_path):
    out, words = tmp_path / "ball", ("--points", clicks(recording))
    succeed(app, "ball", recording, "--out", out, *words)
    before = (out / "rig.yaml").read_text()
    said = fail(app, "ball", recording, "--out", out, *words, "--vfov", 60)
    assert "there already; name another file, or replace it with --force" in said
    assert before == (out / "rig.yaml").read_text()
    succeed(app, "ball", recording, "--out", out, *words, "--vfov", 60, "--force")
    assert before != (out / "rig.yaml").read_text()
    assert "is a file; name a folder" in fail(app, "ball", recording, "--out", out / "rig.yaml", *words)


def test_a_missing_film_and_a_film_without_a_rig_are_one_line(recording, tmp_path):
    said = fail(app, "ball", tmp_path / "none.mkv", "--out", tmp_path / "ball")
    assert "none.mkv: no such file; name a film" in said
    assert "give its rig file with --rig" in fail(app, "track", recording / "video.mkv", "--output", "null")
