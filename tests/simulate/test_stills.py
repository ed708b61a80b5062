"""Simulated calibration photos: what detectors find in them is where the truth says, and the folder is usable.

Corners of the board are checked against OpenCV's finder; targets and discs against the detectors of this project, which
other tests check against pictures that are not from here.
"""

import json
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from conftest import datasets_dir
from numpy.testing import assert_allclose

from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.ball.pose import predict_targets
from spheremouse.commands.calibrate.practice import practice
from spheremouse.commands.calibrate.practice import write as shell
from spheremouse.commands.calibrate.practice.write import device_of, device_yaml
from spheremouse.errors import CalibrationError, ConfigurationError, SpheremouseError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.device import load_device
from spheremouse.geometry.camera import InteriorOrientation, fold_in_picture, project
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball import board
from spheremouse.simulate.ball.stills import (
    StillsOptions,
    board_stations,
    device_stations,
    looking,
    photos,
    prepare_stills,
    seen_targets,
    truth_of,
)
from tests.simulate.scenes import rms, rng

pytestmark = pytest.mark.slow  # films of many stills

LENS = np.array([-0.49, 0.3, -0.0001, -0.0001, -0.11])
CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 967.0, 535.0, LENS)
SMALL = (1280, 720)


@pytest.fixture(scope="module")
def evening():
    return prepare_stills(StillsOptions(photos=2, boards=1, size=SMALL, seed=2))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("practice") / "set"
    practice(path, photos=2, boards=1, size="1280x720", seed=2)
    return path


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 4])
def test_opencv_finds_the_corners_of_the_board_where_they_are(evening, turn):
    camera = InteriorOrientation(640, 480, 420.0, 420.0, 321.0, 238.0, np.array([-0.4, 0.2, 0.001, -0.001, -0.05]))
    pose = looking(board.MIDDLE + np.array([0.4, -0.2, 1.3]), board.MIDDLE, turn)
    picture = cv2.GaussianBlur(board.render_board(replace(evening.scene, camera=camera, pose=pose)), (0, 0), 0.5)
    grey = cv2.cvtColor(np.clip(np.rint(picture), 0, 255).astype(np.uint8), cv2.COLOR_BGR2GRAY)
    true = project(pose.to_cam(board.corners()), camera)[0]
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-4)
    found = cv2.cornerSubPix(grey, true.astype(np.float32)[:, None].copy(), (4, 4), (-1, -1), stop)[:, 0]
    assert rms(found - true) < 0.06
    assert_allclose(np.mean(found - true, axis=0), 0.0, atol=0.015)


def test_the_boards_fill_the_picture_aslant_and_turned():
    poses = board_stations(CAMERA, 15, rng())
    tilts, turns, reached = [], [], np.zeros((9, 16), dtype=bool)
    for pose in poses:
        uv, _ = project(pose.to_cam(board.corners()), CAMERA)
        assert np.all((uv > 0.0) & (uv < (1919.0, 1079.0)))
        tilts.append(np.degrees(np.arccos(-pose.rotation[2, 2])))
        x = project(pose.to_cam(board.corners()[[0, 10]]), CAMERA)[0]
        turns.append(np.degrees(np.arctan2(*(x[1] - x[0])[::-1])))
        column, row = (uv / (120.0, 120.0)).astype(int).T
        reached[row, column] = True
    # the corners of the picture lie beyond what this lens maps; all else has been reached
    v, u = np.mgrid[0:9, 0:16] * 120.0 + 60.0
    inner = np.hypot(u - CAMERA.cx, v - CAMERA.cy) < 850.0
    assert np.mean(reached[inner]) > 0.97
    assert np.mean(reached) > 0.85
    assert np.ptp(turns) > 180.0


def test_targets_are_found_where_they_are(evening, folder):
    rig, off = evening.scene.rig(), []
    for k, pose in enumerate(evening.device_poses):
        image = cv2.imread(str(folder / f"device/device_{k}.jpg"))
        found = detect_targets(image, rig.targets.radii, RingSettings())
        true = predict_targets(pose, rig)
        seen = seen_targets(replace(evening.scene, pose=pose))
        assert set(found.codes) >= {rig.targets.codes[i] for i in np.flatnonzero(seen)}
        assert np.sum(seen) >= 3
        off += [c - true[rig.targets.codes.index(code)] for code, c in zip(found.codes, found.centre, strict=True)]
    assert rms(off) < 0.05


def test_noise_is_as_ordered_and_what_the_lens_does_not_reach_is_black():
    stills = prepare_stills(StillsOptions(photos=0, boards=1, size=(320, 240), focal=300.0))
    scene = replace(stills.scene, camera=replace(stills.scene.camera, fx=200.0, fy=200.0))
    clean, noisy = (next(photos(replace(stills, scene=scene, noise=n))).image.astype(float) for n in (0.0, 6.0))
    assert rms((noisy - clean)[(clean > 40) & (clean < 215)]) == pytest.approx(6.0, rel=0.02)
    assert clean[0, 0].max() == 0.0


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 960), (640, 480), (720, 720), (720, 1280)])
def test_the_lens_of_every_size_folds_in_the_outermost_corners_alone(size):
    camera = prepare_stills(StillsOptions(photos=0, boards=0, size=size)).scene.camera
    share, distance = fold_in_picture(camera)
    assert share < 0.035
    assert distance > 0.9 * 0.5 * np.hypot(*size)


@pytest.mark.parametrize("n", [1, 6, 16])
def test_the_device_is_seen_whole_and_from_all_sides(n):
    scene = prepare_stills(StillsOptions(photos=0, boards=0)).scene
    poses = device_stations(scene, n, rng())
    assert len(poses) == n
    away = np.array([pose.position for pose in poses])
    assert np.all((np.linalg.norm(away, axis=1) > 1.8) & (np.linalg.norm(away, axis=1) < 3.3))
    for pose in poses:
        assert np.sum(seen_targets(replace(scene, pose=pose))) >= 3
        limb = scene.ball_radius * np.array([np.cross(pose.rotation[:, 2], axis) for axis in np.eye(3)])
        uv, _ = project(pose.to_cam(np.concatenate([limb, -limb])), scene.camera)
        assert np.all((uv > 0.0) & (uv < (1919.0, 1079.0)))
    if n > 1:
        azimuth = np.degrees(np.arctan2(away[:, 0], away[:, 2]))
        elevation = np.degrees(np.arcsin((away[:, 1] + 0.17) / np.linalg.norm(away, axis=1)))
        assert azimuth.min() < -35.0 < 35.0 < azimuth.max()
        assert np.ptp(elevation) > 35.0
        up = np.array([pose.rotation[1] for pose in poses])  # Y of obj in cam
        assert np.any(np.abs(up[:, 0]) > 0.7)  # one at least is turned
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        angle = np.degrees(np.arccos(np.clip(away @ away.T, -1.0, 1.0))) + 180.0 * np.eye(n)
        assert angle.min() > 6.0  # no two from the same place


def little(path, **options):
    practice(path, **{"photos": 0, "boards": 1, "size": "320x240", "focal": 300.0, **options})


def test_the_folder_has_what_a_calibration_needs(folder, evening):
    assert sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()) == [
        "board.yaml",
        "board/chess_00.jpg",
        "device.yaml",
        *(f"device/device_{k}.jpg" for k in range(2)),
        *(f"film/{name}" for name in ("discs.csv", "scene.json", "truth.csv", "video.mkv")),
        "truth.json",
    ]
    truth = json.loads((folder / "truth.json").read_text())
    assert truth == truth_of(evening)
    assert truth["device_poses"].keys() == {"device_0", "device_1"}
    assert np.shape(truth["discs_obj"]) == (50, 3)
    assert_allclose(np.linalg.norm(truth["discs_obj"], axis=1), truth["ball"]["radius"])
    device = load_device(folder / "device.yaml")
    assert device.codes == tuple(t["code"] for t in truth["targets"])
    assert len(device.distances) == 4
    assert list(folder.parent.iterdir()) == [folder]  # nothing half-made is left behind


def test_the_film_shows_the_gestures_of_axes_from_the_first_place(folder, evening):
    film = open_dataset(folder / "film")
    assert_allclose(film.pose.matrix(), evening.device_poses[0].matrix(), atol=1e-12)
    assert (film.rig.camera.width, film.rig.camera.height) == SMALL
    turns = [log(b @ a.T) for a, b in pairwise(film.truth.attitude)]
    assert_allclose(np.sum(turns, axis=0), np.full(3, np.pi / 3.0), atol=1e-6)


def test_keys_are_those_of_the_reference_set():
    reference = json.loads((datasets_dir() / "stills" / "truth.json").read_text())
    assert truth_of(prepare_stills(StillsOptions(photos=1, boards=0))).keys() == reference.keys()


def test_the_same_seed_gives_the_same_evening_and_another_another():
    a, b, c = (prepare_stills(StillsOptions(boards=3, photos=2, seed=seed)) for seed in (4, 4, 5))
    assert truth_of(a) == truth_of(b) != truth_of(c)
    assert device_yaml(a) == device_yaml(b) != device_yaml(c)
    assert all(np.array_equal(p.matrix(), q.matrix()) for p, q in zip(a.board_poses, b.board_poses, strict=True))


def test_the_tape_errs_by_its_sigma(tmp_path):
    stills = prepare_stills(StillsOptions(photos=1, boards=0))
    position = dict(zip(stills.scene.targets.ids, stills.scene.targets.position, strict=True))
    off = []
    for seed in range(100):
        (tmp_path / "device.yaml").write_text(device_yaml(replace(stills, seed=seed)))
        for d in load_device(tmp_path / "device.yaml").distances:
            off.append((d.metres - np.linalg.norm(position[d.start] - position[d.end])) / d.sigma)
    n = len(off)
    assert n == 400
    assert abs(np.mean(off)) < 4.0 / np.sqrt(n)
    assert abs(np.std(off) - 1.0) < 4.0 / np.sqrt(2.0 * n)


def test_like_takes_ball_discs_and_targets_from_a_dataset(far26, monkeypatch):
    recording = open_dataset(far26)
    turned = exp(np.array([0.4, -0.3, 0.8]))
    attitude = recording.truth.attitude.copy()
    attitude[0] = turned
    recording = replace(recording, truth=replace(recording.truth, attitude=attitude))
    monkeypatch.setattr(shell, "open_dataset", lambda path: recording)
    stills = prepare_stills(StillsOptions(photos=2, boards=0), device_of(far26))
    truth = truth_of(stills)
    scene = json.loads((far26 / "scene.json").read_text())
    assert truth["ball"]["radius"] == scene["ball"]["radius"]
    assert [truth[k] for k in ("disc_radius", "target_radii", "targets")] == [
        scene[k] for k in ("disc_radius", "target_radii", "targets")
    ]
    # R_obj_ball turns a direction in `ball` to `obj`
    expected = [scene["ball"]["radius"] * turned @ np.array(d) for d in scene["truth_disc_directions"]]
    assert_allclose(truth["discs_obj"], expected, atol=1e-12)


def test_nothing_that_is_there_is_lost(tmp_path):
    there = tmp_path / "set"
    there.mkdir()
    (there / "letter.txt").write_text("dear")
    for force in (False, True):
        with pytest.raises(CalibrationError, match=r"set: holds letter\.txt, which is no"):
            little(there, force=force)
    assert [p.name for p in there.iterdir()] == ["letter.txt"]
    real = tmp_path / "real"
    (real / "board").mkdir(parents=True)
    with pytest.raises(CalibrationError, match=r"holds no truth\.json, so these are real photos"):
        little(real, force=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(CalibrationError, match="is a file; name a folder"):
        little(tmp_path / "file")


def test_a_small_picture_has_places_for_many_photos():
    """Seed 3 draws 2.9 m, from where the rings are too narrow."""
    assert len(prepare_stills(StillsOptions(photos=12, boards=0, size=(960, 540), seed=3)).device_poses) == 12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": "big"}, "--size big: write WIDTHxHEIGHT"),
        ({"dist": "1,2"}, "--dist 1,2: write 5 numbers"),
        ({"dist": "nan,0,0,0,0"}, "--dist .*: write 5 numbers"),
        ({"focal": -3.0}, "--focal -3: must be from 10"),
        ({"focal": 9000.0, "photos": 1}, "--focal 9000: no place in the room shows"),
        ({"focal": 9000.0}, "--focal 9000: the board does not fit"),
        ({"photos": 0, "boards": 0}, "nothing to photograph"),
        ({"discs": 5000}, "--discs: 5000 discs do not fit"),
        ({"like": "elsewhere", "discs": 5}, "--discs 5: the discs are those of --like"),
    ],
)
def test_options_that_make_no_picture_are_refused_in_one_line(tmp_path, options, message):
    with pytest.raises(SpheremouseError, match=message) as e:
        little(tmp_path / "set", **options)
    assert isinstance(e.value, CalibrationError | ConfigurationError)
    assert "\n" not in str(e.value)
    assert list(tmp_path.iterdir()) == []


def test_like_needs_targets_and_discs(far26, monkeypatch):
    recording = open_dataset(far26)
    rig = recording.rig
    few = replace(rig.targets, ids=rig.targets.ids[:2])
    for changed, message in (
        (replace(recording, truth_directions=None), "scene.json lacks the discs' places"),
        (replace(recording, rig=replace(rig, targets=few)), "2 ring targets"),
    ):
        monkeypatch.setattr(shell, "open_dataset", lambda path, changed=changed: changed)
        with pytest.raises(CalibrationError, match=message):
            device_of(far26)
