"""Colour fields: bounds, normalised brightness, regions, reduced pictures, offsets of rims, glare."""

import cv2
import numpy as np
import pytest

from spheremouse.native import kernels
from spheremouse.simulate.light import develop
from spheremouse.wand.colour import DEFAULT_COLOURS, PictureColours, colour_fields, picture_colours, reduction_factor
from spheremouse.wand.rims import rim_shift
from spheremouse.wand.settings import ColourSettings

NAMES = ("blue", "red")


def picture(gain=1.0):
    image = np.full((96, 128, 3), 150, dtype=np.uint8)
    image[20:40, 20:40] = (30, 30, 200)  # red
    image[20:40, 60:80] = (190, 70, 30)  # blue
    image[60:80, 20:40] = (110, 150, 200)  # skin
    return np.clip(image * gain, 0, 255).astype(np.uint8)


def test_default_bounds_separate_red_and_blue_from_grey_and_skin():
    found = colour_fields(picture(), DEFAULT_COLOURS, NAMES)
    blue, red = found.binary
    assert red[30, 30] == 255
    assert red.sum() == 400 * 255
    assert blue[30, 70] == 255
    assert blue.sum() == 400 * 255


def test_hsv_equals_that_of_opencv():
    """Random pixels, a hue range through zero, bounds on saturation and value."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    bounds = ColourSettings(340.0, 20.0, 100.0, 230.0, 40.0, 1e4)
    mean = picture_colours(image, {"x": bounds}, ("x",)).mean
    found = colour_fields(image, {"x": bounds}, ("x",)).binary[0] > 0
    hsv = cv2.cvtColor(image.astype(np.float32) / 255.0, cv2.COLOR_BGR2HSV)
    h, s, v = hsv[..., 0], 255.0 * hsv[..., 1], 255.0 * hsv[..., 2]
    expected = ((h >= 340) | (h <= 20)) & (s >= 100) & (s <= 230) & (v * 127.0 / mean >= 40)
    assert np.mean(found != expected) < 2e-3  # pixels on a bound


@pytest.mark.parametrize("gain", [0.4, 1.2])
def test_selection_is_independent_of_brightness(gain):
    assert (
        colour_fields(picture(gain), DEFAULT_COLOURS, NAMES).binary.sum()
        == colour_fields(picture(), DEFAULT_COLOURS, NAMES).binary.sum()
    )


def test_fields_of_a_region_equal_those_of_the_whole_picture():
    image = picture()
    whole = colour_fields(image, DEFAULT_COLOURS, NAMES)
    part = colour_fields(image, DEFAULT_COLOURS, NAMES, (10, 10, 90, 50))
    np.testing.assert_array_equal(part.binary, whole.binary[:, 10:50, 10:90])
    inner = np.s_[:, 5:-5, 5:-5]
    np.testing.assert_array_equal(part.weight[inner], whole.weight[:, 10:50, 10:90][inner])


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_the_size_of_a_reduced_region_moves_nothing_in_it(factor):
    """A remainder beside the last reduced pixel is left out. To stretch the picture over it would move all rims."""
    whole = [colour_fields(picture(), DEFAULT_COLOURS, NAMES, (3, 5, 3 + 24 * factor, 5 + 18 * factor), factor)]
    whole += [
        colour_fields(picture(), DEFAULT_COLOURS, NAMES, (3, 5, 3 + 24 * factor + k, 5 + 18 * factor + m), factor)
        for k, m in ((1, 0), (0, factor - 1), (factor - 1, factor - 1))
    ]
    for fields in whole[1:]:
        np.testing.assert_array_equal(fields.weight, whole[0].weight)


def test_pictures_of_large_balls_are_reduced():
    assert reduction_factor(50) == 1
    assert reduction_factor(130) == 2
    half = colour_fields(picture(), DEFAULT_COLOURS, NAMES, None, 2)
    assert half.binary.shape == (2, 48, 64)
    assert half.binary[1, 15, 15] == 255


def covered(radius, side, u=0.0, v=0.0):
    """Return the fraction of each pixel, (side, side), that a disc covers, blurred as by a lens."""
    fine = 12
    at = (np.arange(side * fine) + 0.5) / fine - side / 2
    cover = ((at[:, None] - v) ** 2 + (at[None] - u) ** 2 < radius**2).astype(np.float32)
    return cv2.GaussianBlur(cover, (0, 0), 0.45 * fine).reshape(side, fine, side, fine).mean(axis=(1, 3))


@pytest.mark.parametrize("saturation", [60.0, 95.0, 150.0])
def test_rim_shift_of_a_bound_on_saturation_is_that_of_mixed_light(saturation):
    """The selected area of a disc whose light is mixed before the gamma."""
    radius = 14.0
    cover = covered(radius, 48)[..., None]
    white, red = np.array([0.75, 0.77, 0.78]), np.array([0.014, 0.012, 0.51])
    image = np.rint(255.0 * (cover * red + (1.0 - cover) * white) ** (1 / 2.2)).astype(np.uint8)
    bounds = ColourSettings(hue_min=340.0, hue_max=14.0, saturation_min=saturation)
    found = colour_fields(image, {"red": bounds}, ("red",))
    shift = np.sqrt(np.count_nonzero(found.binary[0]) / np.pi) - radius
    assert found.rim[0] == rim_shift(bounds)
    assert shift == pytest.approx(rim_shift(bounds), abs=0.1)
    assert colour_fields(image, {"red": bounds}, ("red",), None, 2).rim[0] == pytest.approx(0.5 * rim_shift(bounds))


def gamma(light):
    return 255.0 * np.clip(light, 0.0, 1.0) ** (1 / 2.2)


def discs_on(radius, light, ground, beside=None, side=48, tone=gamma):
    """Return a picture of three discs on a ground with linear light; `beside` gives grey values for the part below."""
    rng = np.random.default_rng(4)
    cover = np.hstack([covered(radius, side, *rng.uniform(-0.5, 0.5, 2)) for _ in range(3)])
    grey = tone(cover * light + (1.0 - cover) * ground)
    if beside is not None:
        grey = np.vstack([grey, beside(grey.shape[1])])
    grey = np.clip(np.rint(grey + rng.normal(0.0, 1.5, grey.shape)), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def shift_of(found, radius):
    return np.sqrt(np.count_nonzero(found.binary[0][:48]) / (3.0 * np.pi)) - radius


def test_rims_of_large_dark_areas_have_no_effect_on_the_rim_shift():
    """Dark furniture on a grey wall: its rims lie elsewhere than those on white."""
    dark, known = {"dark": ColourSettings(value_max=75.0)}, PictureColours(127.0, np.zeros(1))

    def furniture(width):
        wall = np.full((120, width), 110.0)
        wall[20:, 20:-20] = 30.0
        return wall

    found = colour_fields(discs_on(4.0, 0.01, 0.8, beside=furniture), dark, ("dark",), known=known)
    assert found.rim[0] == pytest.approx(shift_of(found, 4.0), abs=0.1)
    alone = colour_fields(
        np.repeat(furniture(144).astype(np.uint8)[..., None], 3, axis=2), dark, ("dark",), known=known
    )
    assert alone.rim[0] == 0.0  # no disc at all


@pytest.mark.parametrize(
    ("factor", "radius", "light", "ground", "within"),
    [
        *((1, radius, 0.01, 0.7, 0.15) for radius in (2.0, 3.0, 5.0)),
        *((1, radius, light, 0.02, 0.2) for radius in (2.0, 4.0, 12.0) for light in (1.0, 1.5, 3.0)),
        *((1, radius, 8.0, 0.02, 0.4) for radius in (2.0, 4.0, 12.0)),
        *((factor, 6.0, *lights, 0.12) for factor in (2, 3) for lights in ((0.01, 0.7), (1.0, 0.02), (1.5, 0.02))),
    ],
)
def test_rim_shift_of_dark_and_of_overexposed_discs(factor, radius, light, ground, within):
    """Light above full scale moves the rim from 0.6 px inside to 0.6 px outside. px are those of a reduced picture."""
    bounds = {"some": ColourSettings(value_min=215.0) if light > ground else ColourSettings(value_max=75.0)}
    known = PictureColours(140.0 if light > ground else 127.0, np.zeros(1))
    image = discs_on(radius * factor, light, ground, side=48 * factor)
    found = colour_fields(image, bounds, ("some",), None, factor, known)
    true = shift_of(found, radius)
    assert found.rim[0] == pytest.approx(true, abs=within)
    assert np.sign(found.rim[0]) == np.sign(true)


@pytest.mark.parametrize("light", [1.4, 1.7, 2.0])
def test_rim_shift_of_lights_that_the_camera_compresses(light):
    """Their grey values approach 255 smoothly and do not give their light, so the shift is less certain."""
    image = discs_on(5.0, light, 0.02, tone=develop)
    found = colour_fields(
        image, {"some": ColourSettings(value_min=215.0)}, ("some",), known=PictureColours(140.0, np.zeros(1))
    )
    assert found.rim[0] == pytest.approx(shift_of(found, 5.0), abs=0.28)
    assert found.rim_sigma[0] == pytest.approx(0.5)
    assert colour_fields(image, DEFAULT_COLOURS, NAMES).rim_sigma == pytest.approx(0.25)


def test_no_rim_shift_if_brightness_does_not_separate_a_colour():
    """A bound on brightness that the whole picture meets, and an overexposed ground."""
    image = np.full((60, 60, 3), (200, 190, 185), np.uint8)
    cv2.circle(image, (30, 30), 10, (20, 20, 190), -1)
    red = {"red": ColourSettings(hue_min=340.0, hue_max=14.0, value_min=40.0)}
    assert colour_fields(image, red, ("red",), known=PictureColours(127.0, np.zeros(1))).rim[0] == 0.0
    image[:] = 255
    cv2.circle(image, (30, 30), 10, (20, 20, 255), -1)
    with np.errstate(all="raise"):
        assert colour_fields(image, red, ("red",), known=PictureColours(127.0, np.zeros(1))).rim[0] == 0.0


def glaring(strength):
    """Return a white patch with a red disc, 24 px across, and the sun's image at its rim; and the disc's pixels."""
    v, u = np.mgrid[0:96, 0:128]
    disc = (u - 64.0) ** 2 + (v - 48.0) ** 2 < 12.0**2
    light = np.where(disc[..., None], np.array([0.02, 0.02, 0.5]), 0.62)
    lobe = strength * np.exp(-0.5 * ((u - 64.0) ** 2 + (v - 40.0) ** 2) / 5.0**2)
    return np.rint(255.0 * np.clip(light + lobe[..., None], 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8), disc


@pytest.mark.parametrize("strength", [1.5, 3.0, 6.0])
def test_glare_covers_the_print_that_it_makes_pale(strength):
    """Nearly all pale pixels of the disc are glare, and no distant pixel is."""
    image, disc = glaring(strength)
    found = colour_fields(image, DEFAULT_COLOURS, NAMES)
    pale = disc & (found.binary[1] == 0)
    inner = pale & (cv2.erode(disc.astype(np.uint8), np.ones((5, 5))) > 0)  # without the mixed light of its rim
    assert inner.sum() > 40
    assert np.mean(found.glare[0][inner] > 127) > 0.9
    assert not found.glare[0][:, :30].any()
    assert not found.glare[0][80:].any()
    coloured = disc & (found.weight[1] == 255)
    assert not found.glare[0][coloured].any()


def test_a_white_wall_a_lit_disc_and_a_matt_ball_are_no_glare():
    image, _ = glaring(0.0)
    assert len(colour_fields(image, DEFAULT_COLOURS, NAMES).glare) == 0
    image = np.full((96, 128, 3), 90, dtype=np.uint8)
    image[20:80, 30:110] = 255
    assert len(colour_fields(image, DEFAULT_COLOURS, NAMES).glare) == 0
    image[:] = 90
    image[40:52, 40:52] = 255
    assert colour_fields(image, DEFAULT_COLOURS, NAMES).glare[0][46, 46] == 255
    assert len(colour_fields(image, DEFAULT_COLOURS, ("light",)).glare) == 0


# ---- native functions and their twins ----


def hue_and_spread(image):
    """Return hue in degrees, spread and greatest channel, (h, w) each."""
    b, g, r = np.moveaxis(image.astype(np.int32), 2, 0)
    high, low = np.max(image, axis=2).astype(np.int32), np.min(image, axis=2)
    spread = high - low
    ratio = np.float32(60.0) * np.select([high == r, high == g], [g - b, b - r], r - g).astype(np.float32)
    ratio = ratio / np.maximum(spread, 1).astype(np.float32)
    hue = ratio + np.select([high == r, high == g], [0.0, 120.0], 240.0).astype(np.float32)
    return np.where(hue < 0, hue + np.float32(360.0), hue), spread.astype(np.float32), high.astype(np.float32)


def between(hue, low, top):
    return (low <= hue) & (hue <= top) if low <= top else (hue >= low) | (hue <= top)


def select_colours(image, bounds):
    """Twin: the bounds of each colour on all pixels, then overexposed pixels of no colour."""
    hue, spread, high = hue_and_spread(image)
    some = spread * 256 >= int(256 * min(1.0, *bounds[:, 2])) * high  # least saturation of any colour
    found = np.array(
        [
            some & between(hue, k[0], k[1]) & (k[2] * high <= spread) & (spread <= k[3] * high)
            & (k[4] <= high) & (high <= k[5])
            for k in bounds
        ]
    )  # fmt: skip
    white = (np.min(image, axis=2) >= 250) & ~found.any(axis=0)
    return found, white


def grow_glare(image, bounds, distance, reach):
    """Twin: dilate by one pixel within the pale print until nothing changes."""
    hue, spread, high = hue_and_spread(image)
    tinted = np.zeros(hue.shape, dtype=bool)
    for low, top, least in bounds[:, :3]:
        tinted |= (np.float32(0.25) * (least * high) < spread) & (spread < least * high) & between(hue, low, top)
    pale = distance <= reach
    while True:
        more = pale | (cv2.dilate(pale.astype(np.uint8), np.ones((3, 3))) > 0) & tinted & (distance <= 8.0)
        if np.array_equal(more, pale):
            return pale
        pale = more


BOUNDS = np.array(
    [
        [340.0, 14.0, 0.37, 1.0, 25.0, 400.0],
        [205.0, 262.0, 0.3, 0.9, 10.0, 200.0],
        [0.0, 360.0, 0.0, 1.0, 215.0, 300.0],
    ],
    dtype=np.float32,
)


@pytest.mark.parametrize("size", [(0, 7), (1, 1), (48, 64)])
@pytest.mark.parametrize("colours", [0, 1, 2, 3])
def test_selection_equals_its_twin(size, colours):
    rng = np.random.default_rng(5)
    image = rng.choice(np.array([0, 1, 90, 128, 249, 250, 255], dtype=np.uint8), (*size, 3))
    bounds = BOUNDS[:colours]
    binary, count, white, some = kernels.select_colours(image, bounds)
    found, overexposed = select_colours(image, bounds) if colours else (binary > 0, np.min(image, axis=2) >= 250)
    np.testing.assert_array_equal(binary, np.where(found, 255, 0))
    np.testing.assert_array_equal(count, found.sum(axis=(1, 2)))
    np.testing.assert_array_equal(white, np.where(overexposed, 255, 0))
    assert some == overexposed.sum()


@pytest.mark.parametrize("reach", [-1.0, 0.0, 2.0, 9.0])
def test_growth_of_glare_equals_its_twin(reach):
    rng = np.random.default_rng(6)
    image = np.asarray(cv2.resize(rng.integers(120, 256, (9, 12, 3), dtype=np.uint8), (48, 36)))
    spot = np.ones((36, 48), dtype=np.uint8)
    spot[15:19, 20:26] = 0
    distance = np.asarray(cv2.distanceTransform(spot, cv2.DIST_L2, 5))
    pale = np.zeros((36, 48), dtype=np.uint8)
    kernels.grow_glare(image, BOUNDS[:2], distance[5:30, 8:44].copy(), 5, 8, reach, pale)
    expected = grow_glare(image[5:30, 8:44], BOUNDS[:2], distance[5:30, 8:44], reach)
    np.testing.assert_array_equal(pale[5:30, 8:44], np.where(expected, 255, 0))
    assert pale.sum() == 255 * expected.sum()


def test_distances_outside_of_the_image_are_refused():
    image, pale = np.zeros((4, 4, 3), dtype=np.uint8), np.zeros((4, 4), dtype=np.uint8)
    with pytest.raises(TypeError, match=r"^distance: must lie in image"):
        kernels.grow_glare(image, BOUNDS, np.zeros((4, 4), dtype=np.float32), 1, 0, 2.0, pale)


@pytest.mark.parametrize("diagonal", [False, True])
@pytest.mark.parametrize("density", [0.0, 0.02, 0.4, 0.6, 1.0])
def test_connected_areas_equal_those_of_opencv(diagonal, density):
    binary = np.where(np.random.default_rng(2).random((40, 57)) < density, np.uint8(255), np.uint8(0))
    areas, pixels, first = kernels.connected_areas(binary, diagonal)
    n, label, stats, centre = cv2.connectedComponentsWithStats(binary, connectivity=8 if diagonal else 4)
    of = [label[tuple(pixels[k])] for k in first[:-1]]  # OpenCV's numbers
    assert sorted(of) == list(range(1, n))
    np.testing.assert_array_equal(areas[:, :5], stats[of])
    np.testing.assert_allclose(areas[:, 5:], centre[of])
    np.testing.assert_array_equal(label[tuple(pixels.T)], np.repeat(of, np.diff(first)))
