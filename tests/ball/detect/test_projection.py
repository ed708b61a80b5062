"""Projections of colours: their values, Fisher's weights against known pixels, and the choice between them."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import BALL, DISCS, INK, POSE, RIG, TRUTH, errors, match, ray_cast

from spheremouse.ball.detect.choose_projection import best_projection
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.projection import (
    CANDIDATES,
    GREY,
    NEGATIVE,
    colour_contrast,
    normalise,
    offset_of,
    projected,
    weights_of,
)

DETECTOR = disc_detector(DiscSettings(), RIG, POSE)
COVER = (BALL - ray_cast(DISCS)) / (BALL - INK)  # 1 on a disc, 0 on the ball, 0.6 in the room
BLACK, WHITE, RED, BLUE, DARK = (20, 20, 20), (230, 230, 230), (30, 30, 200), (180, 40, 40), (40, 40, 40)
PAIRS = {"white-black": (WHITE, BLACK), "dark-white": (DARK, WHITE), "red-black": (RED, BLACK), "red-blue": (RED, BLUE),
         "red-white": (RED, WHITE)}  # fmt: skip
pairs = pytest.mark.parametrize("pair", PAIRS)


def picture(pair, noise=4.0, seed=0, light=1.0, share=1.0):
    """(h, w, 3) uint8 of a ball with discs of two colours, blue, green and red; `share`: of the discs' contrast."""
    ball, disc = (np.array(c, dtype=float) for c in PAIRS[pair])
    image = light * (ball + share * COVER[:, :, None] * (disc - ball))
    image += noise * np.random.default_rng(seed).normal(size=image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("projection", CANDIDATES)
def test_values_are_the_weighted_sum_of_the_channels(projection):
    image = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    assert sum(map(abs, projection.weights)) == pytest.approx(1.0)
    expected = image @ np.array(projection.weights) + offset_of(projection, 3)
    assert expected.min() >= 0.0
    assert expected.max() <= 255.0
    assert_allclose(projected(image, projection), expected, atol=1.0)


@pytest.mark.parametrize(("projection", "weight"), [(GREY, 1.0), (NEGATIVE, -1.0)])
def test_a_grey_picture_is_taken_as_it_is_or_as_its_negative(projection, weight):
    image = np.random.default_rng(1).integers(0, 256, (20, 30), dtype=np.uint8)
    assert_array_equal(weights_of(projection, 1), [weight])
    assert_array_equal(projected(image, projection), image if weight > 0 else 255 - image)


ON_BALL = np.full((240, 240), 255, np.uint8)


def blocks(difference, covariance, seed):
    """A picture of 16 discs 12 px across that differ from the ball by `difference`, with noise, and where they are."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :240].astype(float)
    noise = rng.multivariate_normal(np.zeros(3), covariance, size=u.shape)
    slope = np.stack([0.1 * u, 0.05 * v, 0.08 * (u + v)], axis=2)  # of the light
    centre = np.stack(np.meshgrid(30.0 + 60.0 * np.arange(4), 30.0 + 60.0 * np.arange(4)), axis=2).reshape(-1, 2)
    inside = np.zeros(u.shape, dtype=bool)
    for x, y in centre:
        inside |= np.hypot(u - x, v - y) < 6.0
    image = 90.0 + slope - inside[:, :, None] * np.array(difference) + noise
    n = len(centre)
    found = Detections(centre, np.tile(np.eye(2), (n, 1, 1)), np.full(n, np.pi * 36.0))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), found


@pytest.mark.parametrize(
    "difference", [(30.0, 30.0, 30.0), (0.0, 0.0, 40.0), (-30.0, 5.0, 25.0), (-20.0, -40.0, -10.0)]
)
def test_fisher_weights_are_those_of_the_noise_whatever_the_slope_of_the_light(difference):
    """w = S^-1 d of the noise that was drawn, with channels that are noisy alike."""
    covariance = np.array([[16.0, 6.0, 2.0], [6.0, 9.0, 3.0], [2.0, 3.0, 25.0]])
    image, found = blocks(difference, covariance, 3)
    mask = ON_BALL.copy()
    mask[:, 222:] = 0  # the room, half of it white
    image[::2, 222:] = 255
    contrast = colour_contrast(image, mask, found, 12.0)
    ideal = normalise(np.linalg.solve(covariance + np.eye(3) / 12.0, np.array(difference)))
    assert contrast is not None
    assert_allclose(contrast.fisher.weights, ideal.weights, atol=0.05)


def test_two_discs_are_too_few_for_fisher_and_so_are_three_that_are_aslant():
    image, found = blocks((30.0, 30.0, 30.0), np.eye(3), 3)
    assert colour_contrast(image, ON_BALL, found.take(np.arange(2)), 12.0) is None
    assert colour_contrast(image, ON_BALL, found.take(np.arange(3)), 12.0) is not None
    assert colour_contrast(image, ON_BALL, found.take(np.arange(3)), 24.0) is None


@pairs
@pytest.mark.parametrize(("light", "noise"), [(1.0, 4.0), (1.0, 0.7), (0.25, 1.5)])
def test_the_projection_chosen_shows_every_disc(pair, light, noise):
    """In full light and in a quarter of it, with the noise of cameras: each disc, and nothing else."""
    projection, _ = best_projection(picture(pair, noise, 1, light), DETECTOR, GREY)
    seen = DETECTOR.with_projection(projection).detect(picture(pair, noise, 2, light))
    assert len(match(seen, TRUTH)) == len(seen) == len(DISCS)
    assert np.sqrt(np.mean(errors(seen, TRUTH) ** 2)) < 0.1
    if noise > 1.0:  # with less, rounding to integers decides
        assert projection.needs_colour == pair.startswith("red")


@pairs
def test_no_projection_has_much_more_signal_over_noise_than_the_one_chosen(pair):
    """With equal noise in all channels the most is the length of the colours' difference."""
    difference = np.subtract(*PAIRS[pair])
    for seed in range(3):
        weights = np.array(best_projection(picture(pair, 4.0, seed), DETECTOR, GREY)[0].weights)
        assert weights @ difference / np.linalg.norm(weights) > np.linalg.norm(difference) / np.sqrt(1.5)


def test_black_on_white_stays_grey_and_what_is_nearly_as_good_stays():
    for seed in range(5):
        assert best_projection(picture("white-black", 4.0, seed), DETECTOR, GREY)[0] == GREY
        green = normalise(np.array([0.0, 1.0, 0.0]))
        assert best_projection(picture("white-black", 4.0, seed), DETECTOR, green)[0] == green


@pairs
def test_without_discs_nothing_is_chosen(pair):
    """Nor by what is too faint to be a disc."""
    for share in (0.0, 0.05):
        assert best_projection(picture(pair, 4.0, 3, share=share), DETECTOR, NEGATIVE)[0] == NEGATIVE


def test_light_discs_are_chosen_in_grey_pictures_too():
    image = cv2.cvtColor(picture("dark-white"), cv2.COLOR_BGR2GRAY)
    assert best_projection(image, DETECTOR, GREY)[0] == NEGATIVE
    assert best_projection(cv2.bitwise_not(image), DETECTOR, NEGATIVE)[0] == GREY


@pytest.mark.parametrize("count", [1, 2])
def test_a_disc_or_two_in_view_are_enough(count):
    """Well in view; a picture of the red ball shows them by its blue and green."""
    cover = (BALL - ray_cast(DISCS[:count])) / (BALL - INK)
    red, white = (np.array(c, dtype=float) for c in PAIRS["red-white"])
    image = red + cover[:, :, None] * (white - red)
    noisy = np.clip(np.rint(image + 4.0 * np.random.default_rng(5).normal(size=image.shape)), 0, 255).astype(np.uint8)
    projection, told = best_projection(noisy, DETECTOR, GREY)
    assert len(match(DETECTOR.with_projection(projection).detect(noisy), TRUTH[:count])) == count
    assert told > 0.05 * count


def test_the_settings_fix_the_projection():
    assert DiscSettings().projection is None
    assert DiscSettings(polarity="dark").projection == GREY
    assert DiscSettings(polarity="light").projection == NEGATIVE
    assert DiscSettings(weights=(-1.0, 0.0, 1.0)).projection == normalise(np.array([-1.0, 0.0, 1.0]))
    for wrong in ({"weights": (1.0, 0.0)}, {"weights": (0.0, 0.0, 0.0)}, {"weights": (0, 1, 0), "polarity": "light"}):
        with pytest.raises(ValueError, match=r"^weights: "):
            DiscSettings(**wrong)
