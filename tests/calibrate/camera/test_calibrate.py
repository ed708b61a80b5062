"""`spheremouse calibrate camera`: photos in, camera.yaml and reports out; what bad input is told."""

import json
import shlex

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places
from conftest import datasets_dir
from elements import Elements
from typer.testing import CliRunner

from spheremouse.commands import app
from spheremouse.errors import SpheremouseError
from spheremouse.files.rig import load_camera
from spheremouse.geometry.camera import fold_in_picture, project

SIZE = CAMERA.width, CAMERA.height
BOARD = ("--board", "9x6", "--square", "30mm")


@pytest.fixture(scope="module")
def poses():
    return places(8, np.random.default_rng(0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, poses):
    path = tmp_path_factory.mktemp("Kamera Ü, it's a board")
    rng = np.random.default_rng(1)
    for k, (R, t) in enumerate(zip(*poses, strict=True)):
        cv2.imwrite(str(path / f"view_{k}.png"), picture(R, t, rng=rng, noise=1.5))
    cv2.imwrite(str(path / "wall.png"), picture(None, None, rng=rng, noise=1.5))
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory, folder):
    path = tmp_path_factory.mktemp("made")
    result = run(folder, *BOARD, "--out", path / "camera.yaml", "--json", path / "camera.json")
    return path, result


def run(*words):
    return CliRunner().invoke(app, ["calibrate", "camera", *map(str, words)], catch_exceptions=False)


def refused(*words):
    with pytest.raises(SpheremouseError) as e:
        run(*words)
    assert "\n" not in str(e.value)
    return str(e.value)


def test_photos_give_the_camera(made):
    path, result = made
    assert result.exit_code == 0
    camera = load_camera(path / "camera.yaml")
    truth = np.concatenate([CAMERA.intrinsic, CAMERA.distortion])
    found = np.concatenate([camera.intrinsic, camera.distortion])
    assert (camera.width, camera.height) == SIZE
    assert np.all(np.abs(found - truth) < 4.0 * np.sqrt(np.diag(camera.covariance)))
    assert abs(camera.fx / CAMERA.fx - 1.0) < 5e-3


def test_figures_agree_with_the_file_and_name_every_photo(made):
    path, result = made
    figures = json.loads((path / "camera.json").read_text())
    camera = load_camera(path / "camera.yaml")
    assert figures["camera"]["fx"] == camera.fx
    assert figures["camera"]["dist"] == camera.distortion.tolist()
    assert np.allclose(figures["camera"]["sigma"], np.sqrt(np.diag(camera.covariance)))
    assert [v["file"] for v in figures["board_views"]] == [f"view_{k}.png" for k in range(8)] + ["wall.png"]
    assert [v["used"] for v in figures["board_views"]] == [True] * 8 + [False]
    rms = np.array([v["rms_px"] for v in figures["board_views"][:8]])
    assert figures["rms_px"] == pytest.approx(np.sqrt(np.mean(rms**2)), rel=0.01)
    assert "wall.png" in result.output
    assert figures["board_views"][-1]["why"] == "shows no chessboard"


def test_the_report_is_whole_and_needs_nothing_beside_it(made):
    path, _ = made
    page = Elements((path / "camera.html").read_text())
    assert page.tags.count("svg") == 1
    assert page.tags.count("img") == 8
    assert all(link.startswith(("data:", "#")) for link in page.links)
    assert "script" not in page.tags
    for what in ("wall.png", "k3", "prefers-color-scheme: dark"):
        assert what in page.words


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--board", "8x5", "--square", "30mm"), "has 9x6 inner corners, not 8x5"),
        (("--board", "9x6", "--square", "30"), "30mm"),
        (("--board", "9x6", "--square", "30m"), "from the board; measure a square"),
        (("--board", "9x6"), "--square"),
        (("--board", "9x6", "--square", "30mm", "--marker", "20mm"), "a chessboard needs no --marker"),
        (("--board", "9x6", "--square", "30mm", "--marker", "40mm"), "smaller than the square"),
        (("--board", "9x6", "--square", "30mm", "--marker", "20mm", "--dictionary", "X"), "DICT_4X4_50"),
        (("--board", "9x6", "--square", "30mm", "--distortion", "3"), "one of 0, 2, 4, 5"),
    ],
)
def test_bad_input_is_told_what_to_do(folder, tmp_path, words, said):
    photos = [folder / f"view_{k}.png" for k in range(4)]
    assert said in refused(*photos, *words, "--out", tmp_path / "camera.yaml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_photos_of_the_device_are_not_taken_for_a_board_of_another_size(tmp_path):
    """A grid of 3x3 is found in two of them; a board in none."""
    said = refused(datasets_dir() / "stills" / "device", *BOARD, "--out", tmp_path / "c.yaml")
    assert "no board found in" in said
    assert "are they photos of the board?" in said
    assert "3x3" not in said


def test_without_photos_it_asks_for_them_first():
    assert "the command needs photos and a board. example: spheremouse calibrate camera board/ --board" in refused()


def test_what_comes_next_is_there(made, folder):
    """Not a file that nobody has made; and more photos need --force."""
    path, result = made
    said = result.output.splitlines()
    assert f"next: spheremouse calibrate init {path}" in said
    words = shlex.split(next(line for line in said if line.startswith("with more photos")).partition(": ")[2])
    again = ["camera", str(folder), *BOARD, "--json", str(path / "camera.json"), "--out", str(path / "camera.yaml")]
    assert words == ["spheremouse", "calibrate", *again, "--force"]


def test_too_few_photos_are_named_with_the_reason(folder, tmp_path):
    said = refused(folder / "view_0.png", folder / "wall.png", *BOARD, "--out", tmp_path / "c.yaml")
    assert "in 1 of 2 photos" in said
    assert "wall.png: shows no chessboard" in said


def test_a_lens_model_that_folds_in_the_picture_is_refused_and_its_remedy_works(tmp_path):
    """Boards in the middle alone leave k3 to chance (OpenCV's issue 15577)."""
    rng, number = np.random.default_rng(2), 0
    while number < 6:
        R, t = places(1, rng)
        uv, _ = project(PATTERN.corners() @ R[0].T + t[0], CAMERA)
        if np.linalg.norm(uv - np.array(SIZE) / 2, axis=1).max() < 190.0:
            cv2.imwrite(str(tmp_path / f"{number}.png"), picture(R[0], t[0], rng=rng, noise=8.0, blur=1.2))
            number += 1
    said = refused(tmp_path, *BOARD, "--out", tmp_path / "camera.yaml")
    assert "not one-to-one in the picture: it folds" in said
    assert "--distortion 2" in said
    assert run(tmp_path, *BOARD, "--distortion", "2", "--out", tmp_path / "camera.yaml").exit_code == 0
    assert fold_in_picture(load_camera(tmp_path / "camera.yaml"))[0] < 0.05
