"""What is nearly a target: drawn with one fault each, and refused by the bound that it does not keep."""

import numpy as np
import pytest

from spheremouse.ball.detect.refused import Bound, refused_targets
from spheremouse.ball.detect.rings import RingSettings, detect_targets
from tests.ball.detect.test_rings import RADII, SETTINGS, blank, disc, photo, target

AT = np.array([80.3, 60.2])


def refused(image, settings=SETTINGS):
    return refused_targets(image, RADII, settings, detect_targets(image, RADII, settings))


def good():
    image = blank()
    target(image, "CMY", AT, 20.0)
    return image


def off_centre():
    image = blank()
    for colour, radius, shift in (("Y", 24.0, 0.0), ("M", 14.0, 6.0), ("C", 7.0, 6.0)):
        disc(image, colour, (AT[0] + shift, AT[1]), (radius, radius))
    return image


def out_of_proportion():
    image = blank()
    target(image, "CMY", AT, 26.0, rings=(1.0, 0.4, 0.16))
    return image


def small():
    image = blank()
    target(image, "CMY", AT, 9.6)
    return image


def without_third():
    image = blank()
    target(image, "CMY", AT, 20.0)
    disc(image, "W", AT, (7.0, 7.0))
    return image


@pytest.mark.parametrize(
    ("image", "settings", "bound", "code"),
    [
        (off_centre(), SETTINGS, Bound.CENTRE, "CMY"),
        (out_of_proportion(), SETTINGS, Bound.RATIO, "CMY"),
        (small(), RingSettings(min_radius=4.0), Bound.SIZE, "CMY"),
        (0.06 * good(), SETTINGS, Bound.LIGHT, "CMY"),
        (0.2 * good() + 165.0, SETTINGS, Bound.LIGHT, "CMY"),
        (good(), RingSettings(cyan=(75, 85)), Bound.HUE, "CMY"),
        (without_third(), SETTINGS, Bound.COLOURS, "MY"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_one_fault_is_one_refusal_by_its_bound(image, settings, bound, code):
    (found,) = refused(photo(image, noise=1.0), settings)
    assert (found.bound, found.code) == (bound, code)
    assert np.linalg.norm(found.centre - AT) < 7.0


@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_targets_and_an_empty_picture_are_not_refused(noise):
    assert refused(photo(good(), noise=noise)) == ()
    assert refused(photo(blank(), noise=noise)) == ()
