"""Which pictures of a board are taken, and what is said of the others."""

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places
from photographed import looked, resumed

from spheremouse.calibrate.camera.coverage import VIEWS
from spheremouse.calibrate.photographing.board import BoardSelector
from spheremouse.geometry.rotation import exp

SIZE = CAMERA.width, CAMERA.height


@pytest.fixture(scope="module")
def poses():
    return places(8, np.random.default_rng(0))


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
    selector = selector_of(before_the_camera(0.0))
    assert {f"faces {way}" in " ".join(selector.wanted()) for way in ("left", "right", "up", "down")} == {True}
    assert "hold the board in the upper left corner of the picture" in selector.wanted()
    turned = selector_of(*[before_the_camera(tilt) for tilt in (30.0, 35.0)])
    assert "faces left" not in " ".join(turned.wanted())
    assert turned.status()[0].endswith(f"2 photos, {VIEWS} or more wanted")
    assert (
        "come closer: the board fills 5 % of the picture" in looked(turned, before_the_camera(0.0, distance=1.2)).words
    )


def test_what_is_no_board_is_named(poses):
    selector = selector_of()
    assert selector.check(np.zeros((480, 640, 3), np.uint8)).words == "the picture is dark"
    assert selector.check(picture(None, None)).words == "it shows no chessboard"
    other = BoardSelector(PATTERN.__class__(7, 5, 0.03), SIZE)
    assert "9x6 corners of a chessboard, not 7x5" in other.check(picture(poses[0][0], poses[1][0])).words
    assert not selector.resume(lambda: picture(None, None))
    assert selector.count == 0
