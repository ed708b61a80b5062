"""Recordings of wands: what is written comes back, what is wrong is said with its file, nothing is written by half."""

import numpy as np
import pytest
from conftest import datasets_dir
from experiments.kit.balls import contrast_ball
from invoking import refusal

from spheremouse.errors import DatasetError
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import WandRecording, is_wand, open_wand
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import grzonka_ball
from tests.files.dataset.test_ball import spoil_scene

OPTIONS = WandOptions(motion="hand", seconds=0.3, fps=10.0, size=(160, 120), seed=1, balls=2)


@pytest.fixture(scope="module")
def film():
    return prepare_wand(OPTIONS, contrast_ball())


@pytest.fixture
def folder(film, tmp_path):
    path = tmp_path / "wand"
    assert list(write_wand(path, film)) == [1, 2, 3]
    return path


def test_the_shared_recording_opens():
    recording = open_wand(datasets_dir() / "wand_drive")
    assert isinstance(recording, WandRecording)
    assert (recording.frames, recording.fps, recording.camera.fx) == (162, 0.8, 2100.0)
    theirs, ours = recording.ball, grzonka_ball()
    assert theirs.radius == ours.radius
    for a, b in zip(theirs.discs, ours.discs, strict=True):
        assert np.allclose(a.direction, b.direction)
        assert (a.colour, a.angle) == (b.colour, pytest.approx(b.angle))
    assert np.allclose(recording.truth.position[0], (-0.63, 0.13643240242942245, 3.8217522420438685), atol=0)
    first = next(read_frames(recording))
    assert first.image.shape == (960, 1280, 3)


def test_what_is_written_comes_back_to_the_last_bit(folder, film):
    recording = open_wand(folder)
    shots = list(simulate_wand(film))
    for k in range(2):
        truth, truly = recording.truths[k], film.truth(k)
        assert np.array_equal(truth.position, truly.position)
        assert np.array_equal(truth.rotation, truly.rotation)
        assert np.array_equal(truth.stamp, truly.stamp)
    for frame, shot in zip(read_frames(recording), shots, strict=True):
        assert np.array_equal(frame.image, shot.frame.image)
        assert (frame.stamp, frame.sequence) == (shot.frame.stamp, shot.frame.sequence)
    assert recording.camera.intrinsic == film.scene.camera.intrinsic
    assert len(recording.balls) == 2
    for a, b in zip(recording.ball.discs, contrast_ball().discs, strict=True):
        assert np.allclose(a.direction, b.direction, atol=1e-9)
        assert (a.angle, a.points_angle) == (pytest.approx(b.angle), pytest.approx(b.points_angle))
    assert (recording.ball.name, recording.ball.body) == ("contrast", "white")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("wand", None, "scene.json: no `wand` in it"),
        ("wand.radius", -1.0, "wand.radius: must be greater than 0, is -1.0"),
        ("wand.discs", [], "wand.discs: must be a list of at least 1, is a list of 0"),
        ("wands.1.discs.3.diameter", 0.2, "wands.1.discs.3: larger than the ball of radius 0.05 m"),
        ("wand.radius", 0.049, "wand: differs from the first of `wands`; correct one of the two"),
        ("wands", [], "wands: is empty"),
        ("frames", 4, "truth.csv: 3 rows, but scene.json has 4 frames"),
    ],
)
def test_a_damaged_description_is_refused_in_words(folder, key, value, words):
    spoil_scene(folder, key, value)
    text = refusal(DatasetError, open_wand, folder)
    assert words in text
    assert str(folder) in text


def test_a_damaged_truth_is_refused_with_its_place(folder):
    table = folder / "truth.csv"
    whole = table.read_text()
    table.write_text(whole.replace("x_1", "x_9", 1))
    with pytest.raises(DatasetError, match=r"truth\.csv, line 1: no column x_1"):
        open_wand(folder)
    table.write_text(whole)
    lines = table.read_text().splitlines()
    cells = lines[2].split(",")
    cells[5:8] = [str(-float(c)) for c in cells[5:8]]
    lines[2] = ",".join(cells)
    table.write_text("\n".join(lines) + "\n")
    with pytest.raises(DatasetError, match=r"row 2: r11\.\.r33 is not a rotation"):
        open_wand(folder)


def test_frames_of_another_size_are_refused(folder):
    spoil_scene(folder, "width", 320)
    with pytest.raises(DatasetError, match=r"frame 0 is 160x120, but scene\.json has 320x120"):
        list(read_frames(open_wand(folder)))


def test_a_wand_is_known_by_its_description(folder, tmp_path):
    assert is_wand(folder)
    assert not is_wand(tmp_path)
    (tmp_path / "scene.json").write_text("{")
    assert not is_wand(tmp_path)
    (tmp_path / "scene.json").write_text('{"ball": {}}')
    assert not is_wand(tmp_path)
