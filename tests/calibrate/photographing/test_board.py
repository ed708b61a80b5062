"""Which pictures of a board are taken, and what is said of the others."""

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places
from photographed import looked, resumed

from spheremouse.calibrate.camera.coverage import VIEWS
from spheremouse.calibrate.photographing.board import BoardJudge
from spheremouse.geometry.rotation import exp

SIZE = CAMERA.width, CAMERA.height


@pytest.fixture(scope="module")
def poses():
    return places(8, np.random.default_rng(0))


def judge_of(*pictures):
    return resumed(BoardJudge(PATTERN, SIZE), *pictures)


def before_the_camera(tilt, axis=(0.0, 1.0, 0.0), distance=0.45):
    R = exp(np.radians(tilt) * np.asarray(axis))
    return picture(R, np.array([0.0, 0.0, distance]) - R @ PATTERN.corners().mean(axis=0))


def test_a_moving_board_is_no_photo(poses):
    judge = judge_of()
    image = picture(poses[0][0], poses[1][0])
    assert "hold still" in judge.look(image).words  # nothing to compare with
    moved = judge.look(np.roll(image, 3, axis=1))
    assert "moves by 3 px" in moved.words
    assert not moved.gain
    assert judge.look(np.roll(image, 3, axis=1)).gain


def test_a_blurred_board_is_no_photo(poses):
    image = picture(poses[0][0], poses[1][0])
    judge = judge_of()
    assert looked(judge, image).gain  # now it is known how sharp this camera is
    look = looked(judge, cv2.GaussianBlur(image, (0, 0), 1.5))
    assert not look.gain
    assert "blurred (edges of 1.5 px, 0.7 px at best)" in look.words


def test_a_view_is_taken_once_and_again_with_another_tilt():
    judge = judge_of(before_the_camera(0.0))
    same = looked(judge, before_the_camera(2.0))
    assert not same.gain
    assert "there already" in same.words
    assert looked(judge, before_the_camera(30.0)).gain == "facing left"
    assert looked(judge, before_the_camera(30.0, (1.0, 0.0, 0.0))).gain == "facing down"


def test_what_is_wanted_is_what_the_calibration_misses():
    judge = judge_of(before_the_camera(0.0))
    assert {f"faces {way}" in " ".join(judge.wanted()) for way in ("left", "right", "up", "down")} == {True}
    assert "hold the board in the upper left corner of the picture" in judge.wanted()
    turned = judge_of(*[before_the_camera(tilt) for tilt in (30.0, 35.0)])
    assert "faces left" not in " ".join(turned.wanted())
    assert turned.status()[0].endswith(f"2 photos, {VIEWS} or more wanted")
    assert (
        "come closer: the board fills 5 % of the picture" in looked(turned, before_the_camera(0.0, distance=1.2)).words
    )


def test_what_is_no_board_is_named(poses):
    judge = judge_of()
    assert judge.look(np.zeros((480, 640, 3), np.uint8)).words == "the picture is dark"
    assert judge.look(picture(None, None)).words == "it shows no chessboard"
    other = BoardJudge(PATTERN.__class__(7, 5, 0.03), SIZE)
    assert "9x6 corners of a chessboard, not 7x5" in other.look(picture(poses[0][0], poses[1][0])).words
    assert not judge.resume(lambda: picture(None, None))
    assert judge.count == 0
