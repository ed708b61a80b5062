"""Taking photos: of the board, of the device, and the session."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places

from spheremouse.ball.device import Axes, Device
from spheremouse.calibrate.camera.coverage import VIEWS, missing
from spheremouse.calibrate.photographing.board import BoardSelector
from spheremouse.calibrate.photographing.device import DeviceSelector
from spheremouse.calibrate.photographing.session import take_photos
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.ball.stills import StillsOptions, device_picture, photos, prepare_stills
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


def test_the_hindrance_of_most_frames_is_in_the_outcome(tmp_path, pictures):
    wall = np.full_like(pictures[0], 90)
    assert taken(film([*pictures[:1], wall, wall]), tmp_path)[0].hindrance == "it shows no chessboard"
    assert taken([], tmp_path)[0].hindrance == ""


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


@pytest.fixture(scope="module")
def poses():
    return places(8, np.random.default_rng(0))


def resumed(selector, *pictures):
    for image in pictures:
        assert selector.resume(image)
    return selector


def looked(selector, image):
    """The check of a picture that rests."""
    selector.check(image)
    return selector.check(image)


def selector_of(*pictures):
    return resumed(BoardSelector(PATTERN, SIZE), *pictures)


def before_the_camera(tilt, axis=(0.0, 1.0, 0.0), distance=0.45):
    R = exp(np.radians(tilt) * np.asarray(axis))
    return picture(R, np.array([0.0, 0.0, distance]) - R @ PATTERN.corners().mean(axis=0))


def test_a_moving_board_is_no_photo(poses):
    selector = selector_of()
    image = picture(poses[0][0], poses[1][0])
    assert "hold still" in selector.check(image).words  # nothing to compare with
    moved = selector.check(np.roll(image, 3, axis=1))
    assert "moves by 3 px" in moved.words
    assert not moved.gain
    assert selector.check(np.roll(image, 3, axis=1)).gain


def test_a_blurred_board_is_no_photo(poses):
    image = picture(poses[0][0], poses[1][0])
    selector = selector_of()
    assert looked(selector, image).gain  # now it is known how sharp this camera is
    check = looked(selector, cv2.GaussianBlur(image, (0, 0), 1.5))
    assert not check.gain
    assert "blurred (edges of 1.7 px, 0.7 px at best)" in check.words


def test_a_view_is_taken_once_and_again_with_another_tilt():
    selector = selector_of(before_the_camera(0.0))
    same = looked(selector, before_the_camera(2.0))
    assert not same.gain
    assert "there already" in same.words
    assert looked(selector, before_the_camera(30.0)).gain == "facing left"
    assert looked(selector, before_the_camera(30.0, (1.0, 0.0, 0.0))).gain == "facing down"


def test_what_is_wanted_is_what_the_calibration_misses():
    selector = selector_of(before_the_camera(30.0))
    assert selector.wanted() == missing(selector.coverage)
    assert selector.status()[0].endswith(f"1 photos, {VIEWS} or more wanted")
    far = looked(selector, before_the_camera(0.0, distance=1.2))
    assert "come closer: the board fills 5 % of the picture" in far.words


def test_what_is_no_board_is_named(poses):
    selector = selector_of()
    assert selector.check(np.zeros((480, 640, 3), np.uint8)).words == "the picture is dark"
    assert selector.check(picture(None, None)).words == "it shows no chessboard"
    other = BoardSelector(PATTERN.__class__(7, 5, 0.03), SIZE)
    assert "9x6 corners of a chessboard, not 7x5" in other.check(picture(poses[0][0], poses[1][0])).words
    assert not selector.resume(picture(None, None))
    assert selector.count == 0


@pytest.fixture(scope="module")
def stills():
    return prepare_stills(StillsOptions(photos=6, boards=0, size=(1280, 720), seed=1))


@pytest.fixture(scope="module")
def pictures_device(stills):
    return [photo.image for photo in photos(stills)]


def selector_of_device(stills, *pictures_device, **changes):
    targets, scene = stills.scene.targets, stills.scene
    device = Device(targets.ids, targets.codes, targets.radii, scene.disc_radius, Axes(2, 1, 3))
    camera = replace(scene.camera, covariance=1e-2 * np.eye(9) * np.array([1, 1, 1, 1, *[1e-6] * 5]))
    return resumed(DeviceSelector(replace(device, **changes), camera), *pictures_device)


def photographed(stills, pose):
    picture = device_picture(replace(stills.scene, pose=pose))
    noise = np.random.default_rng(5).normal(0.0, 1.0, picture.shape)
    return np.clip(np.rint(cv2.GaussianBlur(picture, (0, 0), 0.5) + noise), 0, 255).astype(np.uint8)


def turned(stills, pose, degrees, axis=(0.0, 1.0, 0.0)):
    middle = stills.scene.targets.position.mean(axis=0)
    R = exp(np.radians(degrees) * np.asarray(axis))
    return Pose(R @ pose.rotation, middle + R @ (pose.position - middle))


@pytest.mark.slow
def test_a_picture_from_a_new_side_is_taken_and_its_angle_is_the_true_one(stills, pictures_device):
    selector = selector_of_device(stills, *pictures_device[:2])
    check = looked(selector, pictures_device[2])
    way = np.array([p.position for p in stills.device_poses[:3]]) - stills.scene.targets.position.mean(axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    true = np.degrees(np.arccos(way[:2] @ way[2])).min()
    (told,) = re.findall(r"(\d+)° from the nearest photo", check.gain)
    assert float(told) == pytest.approx(true, abs=1.0)


@pytest.mark.slow
def test_the_same_side_is_taken_once_unless_it_is_from_nearer(stills, pictures_device):
    selector = selector_of_device(stills, *pictures_device[:2])
    front = stills.device_poses[0]
    near = looked(selector, photographed(stills, turned(stills, front, 6.0)))
    assert not near.gain
    assert "6° from a photo there is, 10° are wanted" in near.words
    assert looked(selector, photographed(stills, turned(stills, front, 14.0))).gain.startswith("14°")
    middle = stills.scene.targets.position.mean(axis=0)
    closer = Pose(front.rotation, middle + 0.7 * (front.position - middle))
    assert looked(selector, photographed(stills, closer)).gain == "from nearer"


@pytest.mark.slow
def test_too_few_targets_another_device_and_a_mirrored_picture_are_named(stills, pictures_device):
    selector = selector_of_device(stills, *pictures_device[:2])
    assert "0 of 4 targets found" in looked(selector, np.full_like(pictures_device[0], 90)).words
    assert looked(selector, np.zeros_like(pictures_device[0])).words == "the picture is dark"
    assert not looked(selector, pictures_device[2][:, ::-1].copy()).gain
    with pytest.raises(CalibrationError, match="colour"):
        selector.check(pictures_device[0][..., 0])


@pytest.mark.slow
def test_photos_from_missing_sides_are_wanted_until_all_sides_have_one(stills, pictures_device):
    selector = selector_of_device(stills, *pictures_device[:2])
    assert "take one from the right" in selector.wanted()
    assert "take one from the left" not in selector.wanted()
    assert not selector.enough
    selector = selector_of_device(stills)
    for image in pictures_device:
        selector.add(selector.check(image).seen)
    assert selector.wanted() == ["take more from places between"]
    assert selector.enough


@pytest.mark.slow
def test_a_complete_set_grows_if_the_session_is_called_again(stills, pictures_device):
    selector = selector_of_device(stills, *pictures_device)
    assert not selector.enough
    for _ in range(2):
        selector.add(selector.check(pictures_device[0]).seen)
    assert selector.enough
