"""Colours: hues around zero, brightness taken out, regions and reductions that show what the whole shows."""

import cv2
import numpy as np
import pytest

from spheremouse.wand.colour import DEFAULT_COLOURS, ColourSettings, fields, reduction, rim_shift, tone

NAMES = ("blue", "red")


def picture(gain=1.0):
    image = np.full((96, 128, 3), 150, dtype=np.uint8)
    image[20:40, 20:40] = (30, 30, 200)  # red
    image[20:40, 60:80] = (190, 70, 30)  # blue
    image[60:80, 20:40] = (110, 150, 200)  # skin
    return np.clip(image * gain, 0, 255).astype(np.uint8)


def test_red_and_blue_are_told_from_grey_and_skin():
    found = fields(picture(), DEFAULT_COLOURS, NAMES)
    blue, red = found.binary
    assert red[30, 30] == 255
    assert red.sum() == 400 * 255
    assert blue[30, 70] == 255
    assert blue.sum() == 400 * 255


def test_hsv_is_that_of_opencv():
    """Of random pixels: a hue range that passes through zero, with bounds on saturation and value."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    bounds = ColourSettings(340.0, 20.0, 100.0, 230.0, 40.0, 1e4)
    mean = tone(image, {"x": bounds}, ("x",)).mean
    found = fields(image, {"x": bounds}, ("x",)).binary[0] > 0
    hsv = cv2.cvtColor(image.astype(np.float32) / 255.0, cv2.COLOR_BGR2HSV)
    h, s, v = hsv[..., 0], 255.0 * hsv[..., 1], 255.0 * hsv[..., 2]
    asked = ((h >= 340) | (h <= 20)) & (s >= 100) & (s <= 230) & (v * 127.0 / mean >= 40)
    assert np.mean(found != asked) < 2e-3  # pixels on a bound


@pytest.mark.parametrize("gain", [0.4, 1.2])
def test_brightness_does_not_matter(gain):
    assert (
        fields(picture(gain), DEFAULT_COLOURS, NAMES).binary.sum()
        == fields(picture(), DEFAULT_COLOURS, NAMES).binary.sum()
    )


def test_a_region_shows_what_the_whole_shows():
    image = picture()
    whole = fields(image, DEFAULT_COLOURS, NAMES)
    part = fields(image, DEFAULT_COLOURS, NAMES, (10, 10, 90, 50))
    np.testing.assert_array_equal(part.binary, whole.binary[:, 10:50, 10:90])
    inner = np.s_[:, 5:-5, 5:-5]
    np.testing.assert_array_equal(part.weight[inner], whole.weight[:, 10:50, 10:90][inner])


def test_the_field_falls_with_the_distance_from_the_colour():
    weight = fields(picture(), DEFAULT_COLOURS, NAMES).weight[1].astype(int)
    across = weight[30, 36:46]
    assert across[0] == 255
    assert across[-1] == 0
    assert np.all(np.diff(across) <= 0)
    assert across[3] + across[4] == pytest.approx(255, abs=2)  # the edge lies between columns 39 and 40


def test_large_balls_are_looked_at_reduced():
    assert reduction(50) == 1
    assert reduction(130) == 2
    half = fields(picture(), DEFAULT_COLOURS, NAMES, None, 2)
    assert half.binary.shape == (2, 48, 64)
    assert half.binary[1, 15, 15] == 255


@pytest.mark.parametrize("saturation", [60.0, 95.0, 150.0])
def test_a_bound_on_saturation_moves_a_rim_by_what_mixed_light_says(saturation):
    """A disc drawn fine, its light averaged and blurred as a lens does, then made grey values: its area tells."""
    fine, radius = 12, 14.0
    at = (np.arange(48 * fine) + 0.5) / fine - 24.0
    cover = (at[:, None] ** 2 + at[None] ** 2 < radius**2).astype(np.float32)
    white, red = np.array([0.75, 0.77, 0.78]), np.array([0.014, 0.012, 0.51])
    cover = cv2.GaussianBlur(cover, (0, 0), 0.45 * fine).reshape(48, fine, 48, fine).mean(axis=(1, 3))[..., None]
    image = np.rint(255.0 * (cover * red + (1.0 - cover) * white) ** (1 / 2.2)).astype(np.uint8)
    bounds = ColourSettings(hue_min=340.0, hue_max=14.0, saturation_min=saturation)
    found = fields(image, {"red": bounds}, ("red",))
    shift = np.sqrt(np.count_nonzero(found.binary[0]) / np.pi) - radius
    assert found.rim[0] == rim_shift(bounds)
    assert shift == pytest.approx(rim_shift(bounds), abs=0.1)
    assert fields(image, {"red": bounds}, ("red",), None, 2).rim[0] == pytest.approx(0.5 * rim_shift(bounds))
