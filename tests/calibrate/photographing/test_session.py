"""A session: frames in, numbered photos in a folder out, whatever ends it."""

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places

from spheremouse.calibrate.photographing.board import BoardSelector
from spheremouse.calibrate.photographing.session import take_photos
from spheremouse.errors import CalibrationError, SourceError
from spheremouse.tracker import Frame

SIZE = CAMERA.width, CAMERA.height


@pytest.fixture(scope="module")
def pictures():
    return [
        cv2.cvtColor(picture(R, t), cv2.COLOR_GRAY2BGR)
        for R, t in zip(*places(4, np.random.default_rng(0)), strict=True)
    ]


class Recorder:
    """Takes down what a person would see."""

    def __init__(self):
        self.lines = []

    def print(self, text):
        self.lines.append(text)

    def show(self, selector, check, picture):
        assert selector.status()

    def taken(self, path, selector, check):
        assert path.exists()
        self.lines.append(path.name)


def film(pictures, rest=3):
    for k, image in enumerate(pictures):
        for j in range(rest):
            yield Frame(image, 0.1 * (k * rest + j), k * rest + j)


def taken(frames, folder):
    told = Recorder()
    return take_photos(frames, lambda size: BoardSelector(PATTERN, size), folder, told), told.lines


def test_each_view_is_kept_once_and_a_session_goes_on_where_it_was(tmp_path, pictures):
    folder = tmp_path / "new" / "board"
    outcome, lines = taken(film([pictures[0], pictures[0], pictures[1]]), folder)
    assert (outcome.selector.count, outcome.frames, outcome.failure) == (2, 9, None)
    assert lines == ["view_000.png", "view_001.png"]
    assert np.array_equal(cv2.imread(str(folder / "view_000.png")), pictures[0])
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    (folder / "view_001.png").unlink()
    outcome, lines = taken(film(pictures[1:3]), folder)
    assert lines[1:] == [f"{folder}: goes on with 1 photos", "view_001.png", "view_002.png"]
    assert (folder / "view_000.png").read_bytes() == before["view_000.png"]


def test_a_camera_that_goes_away_leaves_what_there_is(tmp_path, pictures):
    def broken():
        yield from film(pictures[:1])
        raise SourceError("the camera is gone")

    outcome, lines = taken(broken(), tmp_path)
    assert lines == ["view_000.png"]
    assert str(outcome.failure) == "the camera is gone"
    assert outcome.selector.count == 1


def test_photos_of_another_mode_are_no_place_for_these(tmp_path, pictures):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((240, 320, 3), 90, np.uint8))
    with pytest.raises(
        CalibrationError, match=r"holds photos of 320x240, the camera gives 640x480.*width=320,height=240"
    ):
        taken(film(pictures[:1]), tmp_path)


def test_photos_that_show_nothing_are_named_and_left(tmp_path, pictures):
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((480, 640, 3), 90, np.uint8))
    outcome, lines = taken(film(pictures[:1]), tmp_path)
    assert "note: wall.png: show too little to count" in lines
    assert outcome.selector.count == 1
    assert (tmp_path / "wall.png").exists()


def test_a_folder_that_cannot_be_is_said_so(tmp_path, pictures):
    (tmp_path / "file").write_text("")
    with pytest.raises(CalibrationError, match="cannot be made"):
        taken(film(pictures[:1]), tmp_path / "file")


def test_what_hinders_most_is_known_at_the_end(tmp_path):
    outcome, lines = taken(film([np.full((480, 640, 3), 90, np.uint8)]), tmp_path)
    assert (outcome.hindrance, outcome.selector.count, lines) == ("it shows no chessboard", 0, [])
