"""The fit of a disc: against ellipses that are rendered another way (supersampled, then blurred), with known noise."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from spheremouse.ball.detect.projection import GREY
from spheremouse.ball.detect.windows import FitSettings
from spheremouse.native.kernels import fit_discs, noise_of

LENS = 0.4  # px of the whole picture, the blur of an ordinary lens
BALL, PRINT = 150.0, 40.0  # grey values
ONE = np.ones(1, dtype=np.float32)  # the weight of a grey picture's only channel
OVER = 6  # subpixels along each side of a pixel


class Fits(NamedTuple):
    """Results of `fit_discs`."""

    ok: np.ndarray
    centroid: np.ndarray
    covariance: np.ndarray
    rim: np.ndarray


SETTINGS = FitSettings(
    GREY,
    0.8,
    float(np.sqrt(0.8**2 + 1.0 / 12.0 + LENS**2)),
    0.25,
    size_tolerance=0.25,
    rim=0.7,
    sigma=0.0,
)


def ellipse(a, b, angle):
    """Shape, (2, 2), of semi-axes a, b."""
    c, s = np.cos(angle), np.sin(angle)
    U = np.array([[c, -s], [s, c]])
    return U @ np.diag([a * a, b * b]) @ U.T


def blank(side):
    """Subpixel coordinates, (h, w), of a picture; pixel (0, 0) has its middle at 0."""
    x = (np.arange(side * OVER) + 0.5) / OVER - 0.5
    return np.meshgrid(x, x)


def seen(fine):
    """Pixels of a picture given by subpixels."""
    fine = cv2.GaussianBlur(fine, (0, 0), LENS * OVER)
    h, w = fine.shape
    return fine.reshape(h // OVER, OVER, w // OVER, OVER).mean(axis=(1, 3))


def inside(x, y, centre, shape):
    q = np.linalg.inv(shape)
    dx, dy = x - centre[0], y - centre[1]
    return q[0, 0] * dx * dx + 2.0 * q[0, 1] * dx * dy + q[1, 1] * dy * dy < 1.0


def disc(side, centre, shape, ball=BALL, ink=PRINT):
    """(side, side) grey values of one disc; `ball` and `ink` are numbers or pictures of subpixels."""
    x, y = blank(side)
    return seen(np.where(inside(x, y, centre, shape), ink, ball))


def digital(grey, noise, rng):
    """(h, w, 1) uint8."""
    return np.clip(np.rint(grey + noise * rng.normal(size=grey.shape)), 0, 255).astype(np.uint8)[:, :, None]


def fits_of(image, places, shape, noise=0.5, *, mask=None, settings=SETTINGS, path=None):
    """Fits of discs of one shape."""
    places = np.atleast_2d(np.asarray(places, dtype=float))
    mask = np.full(image.shape[:2], 255, np.uint8) if mask is None else mask
    path = np.zeros((len(places), 7)) if path is None else path
    shapes = np.repeat(shape[None], len(places), axis=0)
    expected = places, shapes, path
    return Fits(*fit_discs(image, mask, expected, noise, settings, settings.contrast, 0.0)[:4])


def off_centre(rng, n, minor, ratio):
    """Errors, (n, 2) px along the minor and the major axis, of one ellipse at random angles and subpixel places."""
    a, b = minor * ratio, minor
    side = int(2 * a + 16)
    errors = []
    for _ in range(n):
        shape = ellipse(a, b, rng.uniform(0.0, np.pi))
        c = side / 2 + rng.uniform(-0.5, 0.5, 2)
        image = digital(disc(side, c, shape), 0.3, rng)
        found = fits_of(image, c + 0.3 * rng.uniform(-1, 1, 2), shape, 0.5)
        assert found.ok[0]
        errors.append((found.centroid[0] - c) @ np.linalg.eigh(shape)[1])
    return np.array(errors)


@pytest.mark.parametrize(
    ("minor", "ratio"),
    [(1.0, 1.0), (1.5, 1.3), (1.5, 4.0), (2.0, 2.0), (3.0, 2.5), (5.0, 1.6), (8.0, 1.0), (14.0, 1.6)],
)
def test_centres_are_unbiased(minor, ratio):
    """Mean over angles and places within 0.02 px, or what chance allows the mean; noise of 0.3 grey values."""
    n = 40
    errors = off_centre(np.random.default_rng(1), n, minor, ratio)
    allowed = np.maximum(0.02, 3.5 * errors.std(axis=0) / np.sqrt(n))
    assert np.all(np.abs(errors.mean(axis=0)) < allowed)
    if minor >= 2.0:
        # and no place by itself is far off: a fiftieth of a pixel
        assert np.sqrt(np.mean(errors**2)) < 0.02


@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("kind", ["shade", "gloss"])
def test_a_slope_of_light_does_not_draw_the_centre(kind, angle):
    """Shade by 2 grey values per pixel of ball and print, or gloss that takes a third of the print's contrast."""
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    x, y = blank(40)
    along = (x - c[0]) * np.cos(angle) + (y - c[1]) * np.sin(angle)
    shade = 1.0 + (2.0 * along / BALL if kind == "shade" else 0.0)
    gloss = (BALL - PRINT) / 36.0 * along if kind == "gloss" else 0.0
    grey = disc(40, c, shape, ball=BALL * shade, ink=PRINT * shade + gloss)
    found = fits_of(digital(grey, 0.3, np.random.default_rng(5)), c + 0.3, shape)
    assert found.ok[0]
    assert_allclose(found.centroid[0], c, atol=0.04)
    dark = (BALL - grey) * inside(*np.meshgrid(np.arange(40.0), np.arange(40.0)), c, 1.5 * shape)
    v, u = np.mgrid[:40, :40]
    centroid = np.array([np.sum(dark * u), np.sum(dark * v)]) / np.sum(dark)
    assert np.linalg.norm(centroid - c) > 0.15  # that of the darkness is drawn


def test_a_highlight_on_the_rim_is_weighted_down():
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    x, y = blank(40)
    glare = inside(x, y, c + np.array([4.6, -1.0]), ellipse(1.6, 1.6, 0.0))
    ink, ball = np.where(glare, 255.0, PRINT), np.where(glare, 255.0, BALL)
    found = fits_of(digital(disc(40, c, shape, ball, ink), 0.5, np.random.default_rng(6)), c + 0.3, shape)
    assert found.ok[0]
    assert found.rim[0] < 0.97
    assert_allclose(found.centroid[0], c, atol=0.12)


STEPS = (np.arange(24) + 0.5) / 24 - 0.5  # of the exposure, of 24 pictures along a way


def test_a_long_smear_on_a_sloped_shade_does_not_draw_the_centre():
    """Across a smear a slope of the contrast and a shift of the centre look alike: the ball's shade tells the slope."""
    shape, way = ellipse(7.0, 6.0, 0.4), np.array([12.0, 0.0])
    places = np.array([[20.2, 19.7], [58.4, 20.1], [20.0, 58.3], [58.0, 58.0]])
    x, y = blank(80)
    shade = 1.0 + 0.006 * (x - 40.0)
    lit = np.zeros((80, 80))
    for t in STEPS:
        ink = np.any([inside(x, y, c + t * way, shape) for c in places], axis=0)
        lit += seen(np.where(ink, PRINT, BALL) * shade) / len(STEPS)
    path = np.tile(np.concatenate([way, np.zeros(5)]), (4, 1))
    errors = []
    for seed in range(8):
        image = digital(lit, 2.0, np.random.default_rng(seed))
        found = fits_of(image, places + 0.4, shape, 2.0, path=path)
        assert found.ok.all()
        errors.append(found.centroid - places)
    assert abs(np.mean(errors, axis=(0, 1))[0]) < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 0.04


@pytest.mark.parametrize(
    ("a", "b", "noise", "most"),
    [(5.0, 4.0, 4.0, 1.45), (8.0, 7.0, 8.0, 1.45), (8.0, 7.0, 2.0, 2.5), (24.0, 21.0, 8.0, 2.5)],
)
def test_covariance_is_the_scatter(a, b, noise, most):
    """Along both axes. What print and lens leave uneven counts, too, which these pictures do not have."""
    rng = np.random.default_rng(7)
    shape = ellipse(a, b, 0.5)
    side = int(2 * a + 16)
    c = side / 2 + np.array([0.2, -0.1])
    grey = disc(side, c, shape)
    errors, said = [], []
    for _ in range(120):
        found = fits_of(digital(grey, noise, rng), c + 0.2 * rng.uniform(-1, 1, 2), shape, noise)
        assert found.ok[0]
        errors.append(found.centroid[0] - c)
        said.append(found.covariance[0])
    V = np.linalg.eigh(shape)[1]
    actual = np.sqrt(np.diag(V.T @ np.cov(np.array(errors).T) @ V))
    expected = np.sqrt(np.diag(V.T @ np.mean(said, axis=0) @ V))
    assert np.all(expected > 0.8 * actual)
    assert np.all(expected < most * actual)


@pytest.mark.parametrize("shade", [0.9, 1.0])
@pytest.mark.parametrize("b", [1.5, 2.0])
def test_the_hidden_end_of_a_thin_disc_counts_in_its_covariance(b, shade):
    """Up to 2.5 px of an end lie behind a cover as light as the ball, which leaves no edge to see."""
    rng = np.random.default_rng(3)
    (x, y), mask, squares = blank(40), np.full((40, 40), 255, np.uint8), []
    for _ in range(150):
        angle, c = rng.uniform(0.0, np.pi), 20.0 + rng.uniform(-0.5, 0.5, 2)
        shape = ellipse(6.5, b, angle)
        along = (x - c[0]) * np.cos(angle) + (y - c[1]) * np.sin(angle)
        grey = np.where(inside(x, y, c, shape), PRINT, BALL)
        grey[along > 6.5 - rng.uniform(0.3, 2.5)] = shade * BALL
        expected = c[None] + rng.uniform(-0.3, 0.3, (1, 2)), shape[None], np.zeros((1, 7))
        settings = SETTINGS._replace(sigma=0.03)
        found = Fits(*fit_discs(digital(seen(grey), 3.0, rng), mask, expected, 3.0, settings, 0.25, 1.0)[:4])
        if found.ok[0]:
            e = found.centroid[0] - c
            squares.append(e @ np.linalg.solve(found.covariance[0], e))
    assert len(squares) > 140
    assert np.mean(squares) < 2.2
    assert np.mean(np.array(squares) > chi2.ppf(0.99, 2)) < 0.05


def test_what_is_no_disc_is_refused():
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    rng = np.random.default_rng(11)
    plain = digital(np.full((40, 40), BALL), 3.0, rng)
    assert not fits_of(plain, c, shape, 3.0).ok[0]
    small = digital(disc(40, c, ellipse(3.0, 2.5, 0.3)), 1.0, rng)
    large = digital(disc(40, c, ellipse(10.0, 9.0, 0.3)), 1.0, rng)
    pale = digital(disc(40, c, shape, ink=0.85 * BALL), 1.0, rng)
    for image in (small, large, pale):
        assert not fits_of(image, c, shape, 1.0).ok[0]
    assert fits_of(pale, c, shape, 1.0, settings=SETTINGS._replace(contrast=0.1)).ok[0]
    bar = np.full((40, 40), BALL)
    bar[:, 16:24] = PRINT
    assert not fits_of(digital(bar, 1.0, rng), c, shape, 1.0).ok[0]


def test_what_is_off_the_mask_or_off_the_picture_does_not_take_part():
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    rng = np.random.default_rng(12)
    grey = disc(40, c, shape)
    grey[:, 29:] = 0.0  # the room beside the ball
    image = digital(grey, 0.5, rng)
    mask = np.full((40, 40), 255, np.uint8)
    mask[:, 28:] = 0
    found = fits_of(image, c + 0.3, shape, mask=mask)
    assert found.ok[0]
    assert_allclose(found.centroid[0], c, atol=0.02)
    assert not fits_of(image, c, shape, mask=np.zeros_like(mask)).ok[0]
    away = np.array([[-30.0, 10.0], [10.0, 1e6], [np.nan, 3.0], [39.0, 39.0]])
    assert not fits_of(image, away, shape, mask=mask).ok.any()
    assert len(fits_of(image, np.zeros((0, 2)), shape).ok) == 0


@pytest.mark.parametrize("sigma", [0.6, 1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("channels", [1, 3])
def test_noise_is_found(sigma, channels):
    rng = np.random.default_rng(15)
    x = np.arange(320.0)
    shade = 90.0 + 0.2 * x  # a slope has no second difference
    image = np.clip(np.rint(shade[None, :, None] + sigma * rng.normal(size=(240, 320, channels))), 0, 255)
    weights = np.array([1.0] if channels == 1 else [-0.2, 0.5, -0.3], dtype=np.float32)
    found = noise_of(image.astype(np.uint8), weights, 10, 230, 10, 310)
    assert_allclose(found, np.linalg.norm(weights) * np.sqrt(sigma**2 + 1.0 / 12.0), rtol=0.06, atol=0.06)


def test_edges_do_not_raise_the_noise_much():
    """A disc every 24 pixels, a quarter of them edges; the median shrugs."""
    rng = np.random.default_rng(16)
    x, y = np.meshgrid(np.arange(320.0), np.arange(240.0))
    dots = np.hypot(x % 24 - 12, y % 24 - 12) < 7
    image = digital(cv2.GaussianBlur(np.where(dots, PRINT, BALL), (0, 0), 0.6), 3.0, rng)
    edges = np.abs(np.diff(cv2.GaussianBlur(np.where(dots, PRINT, BALL), (0, 0), 0.6), 2, axis=1)) > 10
    assert edges.mean() > 0.1
    found = noise_of(image, ONE, 0, 240, 0, 320)
    assert 3.0 < found < 4.5


def test_noise_of_a_still_or_empty_picture_is_that_of_rounding():
    """An exact picture has noise all the same: its grey values are whole numbers."""
    for image in (np.full((40, 40, 1), 90, np.uint8), np.zeros((40, 40, 3), np.uint8)):
        weights = np.ones(image.shape[2], dtype=np.float32)
        assert_allclose(noise_of(image, weights, 0, 40, 0, 40), np.sqrt(1.0 / 12.0), atol=0.01)
    assert_allclose(noise_of(np.zeros((40, 40, 1), np.uint8), ONE, 5, 5, 5, 5), np.sqrt(1.0 / 12.0), atol=0.01)
