"""The detector's native functions name a wrong argument, and a followed disc is no new one."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import CLEAN, DISCS, POSE, RIG, photo

from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.projection import GREY
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.windows import AT_REST, FitSettings, Motion
from spheremouse.native import kernels

SETTINGS = FitSettings(GREY, 0.8, 0.93, 0.25, size_tolerance=0.25, rim=0.7, sigma=0.02)
DETECTOR = disc_detector(DiscSettings(), RIG, POSE)
NOWHERE = np.zeros((0, 2))


def test_a_followed_disc_is_no_new_one():
    """The discs come first, and the search leaves them out; if there are too few, it waits."""
    image, search = photo(CLEAN, 1.0)[:, :, None], SearchState(0, 1.0, 1.0)
    model = DETECTOR.model, DETECTOR.lattice.of_turn(0), search, AT_REST, NOWHERE
    followed, *_, state = kernels.follow_discs(image, DISCS[:9], *model, 10)
    assert len(followed) == 9
    assert state[0] == 0
    more, _ = DETECTOR.follow(image, search, known=followed)
    assert len(more) > 0
    centre, *_, state = kernels.follow_discs(image, DISCS[:9], *model, 9)
    assert_array_equal(centre[:9], followed)
    assert_allclose(centre[9:], more.centre, atol=0.02)
    assert state[0] == 1


def test_a_wrong_argument_is_named():
    model, image, places = DETECTOR.model, np.zeros((480, 640, 3), np.uint8), NOWHERE
    for arguments, name in [
        ((image[:400], places, model, 1.0, 0.0, 0.0), "mask"),
        ((image, DISCS, model, 1.0, 0.0, 0.0), "places"),
    ]:
        with pytest.raises(TypeError, match=name):
            kernels.measure_places(*arguments)
    whole = DETECTOR.lattice.of_turn(0)
    outside = whole[0]._replace(place=whole[0].place + 1000), *whole[1:]
    for lattice, search, error, name in [
        (outside, SearchState(), ValueError, "samples"),
        (whole[:2], SearchState(), TypeError, "lattice"),
        (whole, SearchState(-1), ValueError, "turn"),
        (whole, SearchState(noise=np.nan), ValueError, "noise"),
        (whole, SearchState(rejected=places), TypeError, "rejected"),
    ]:
        with pytest.raises(error, match=name):
            kernels.follow_discs(image, DISCS, model, lattice, search, AT_REST, places, 0)


def test_numbers_out_of_range_are_no_discs():
    image = cv2.cvtColor(photo(CLEAN, 1.0), cv2.COLOR_GRAY2BGR)
    wild = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0])
    directions = np.stack([wild, np.roll(wild, 1), np.roll(wild, 2)], axis=1)
    search = DETECTOR.lattice.of_turn(0), SearchState(0, 1.0), Motion(wild[:3], 1.0), NOWHERE, 1
    assert len(kernels.follow_discs(image, directions, DETECTOR.model, *search)[0]) == 0
    assert len(kernels.measure_places(image, directions[:, :2].copy(), DETECTOR.model, 1.0, 0.0, 0.0)[0]) == 0
    expected = np.stack([wild, wild], axis=1), np.repeat(wild, 4).reshape(-1, 2, 2), np.repeat(wild, 7).reshape(-1, 7)
    ok = kernels.fit_discs(image, DETECTOR.model.mask, expected, 1.0, SETTINGS, 0.25, 0.0)[0]
    assert_array_equal(ok, False)
    blurred = SETTINGS._replace(blur=np.nan)
    assert not kernels.fit_discs(image, DETECTOR.model.mask, expected, np.nan, blurred, 0.25, 0.0)[0].any()
    assert kernels.noise_of(image, np.full(3, np.nan, dtype=np.float32), 0, 480, 0, 640) > 100.0  # nothing is known
