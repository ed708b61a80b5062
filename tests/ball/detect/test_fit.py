"""The fit of a disc: against ellipses that are rendered another way (supersampled, then blurred), with known noise."""

from dataclasses import fields

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.detect.fit import Fits, FitSettings, measure
from spheremouse.ball.detect.fit_model import ellipse_of, noise_of, smoothing_kernel
from spheremouse.ball.detect.projection import GREY, NEGATIVE

LENS = 0.4  # px of the whole picture, the blur of an ordinary lens
BALL, PRINT = 150.0, 40.0  # grey values
ONE = np.ones(1, dtype=np.float32)  # the weight of a grey picture's only channel
OVER = 6  # subpixels along each side of a pixel


def settings(**changes):
    values = {
        "projection": GREY,
        "kernel": smoothing_kernel(0.8),
        "blur": float(np.sqrt(0.8**2 + 1.0 / 12.0 + LENS**2)),
        "contrast": 0.25,
        "size_tolerance": 0.25,
        "rim": 0.7,
        "sigma": 0.0,
    }
    known = {f.name for f in fields(FitSettings)}
    return FitSettings(**{k: v for k, v in (values | changes).items() if k in known})


def ellipse(a, b, angle):
    """Shape, (2, 2), of semi-axes a, b."""
    c, s = np.cos(angle), np.sin(angle)
    U = np.array([[c, -s], [s, c]])
    return U @ np.diag([a * a, b * b]) @ U.T


def blank(side):
    """Subpixel coordinates, (h, w), of a picture; pixel (0, 0) has its middle at 0."""
    x = (np.arange(side * OVER) + 0.5) / OVER - 0.5
    return np.meshgrid(x, x)


def seen(fine, lens=LENS):
    """Pixels of a picture given by subpixels."""
    if lens > 0.0:
        fine = cv2.GaussianBlur(fine, (0, 0), lens * OVER)
    h, w = fine.shape
    return fine.reshape(h // OVER, OVER, w // OVER, OVER).mean(axis=(1, 3))


def inside(x, y, centre, shape):
    q = np.linalg.inv(shape)
    dx, dy = x - centre[0], y - centre[1]
    return q[0, 0] * dx * dx + 2.0 * q[0, 1] * dx * dy + q[1, 1] * dy * dy < 1.0


def disc(side, centre, shape, ball=BALL, ink=PRINT, lens=LENS):
    """(side, side) grey values of one disc; `ball` and `ink` are numbers or pictures of subpixels."""
    x, y = blank(side)
    return seen(np.where(inside(x, y, centre, shape), ink, ball), lens)


def digital(grey, noise, rng):
    """(h, w, 1) uint8."""
    return np.clip(np.rint(grey + noise * rng.normal(size=grey.shape)), 0, 255).astype(np.uint8)[:, :, None]


def fit(image, place, shape, noise=0.5, chosen=None, **more) -> Fits:
    """One disc."""
    mask = np.full(image.shape[:2], 255, np.uint8)
    chosen = settings() if chosen is None else chosen
    return measure(image, mask, np.array([place], dtype=float), shape[None], noise, chosen, **more)


def off_centre(rng, n, minor, ratio, noise=0.3):
    """Errors, (n, 2) px along the minor and the major axis, of one ellipse at random angles and subpixel places."""
    a, b = minor * ratio, minor
    side = int(2 * a + 16)
    errors = []
    for _ in range(n):
        shape = ellipse(a, b, rng.uniform(0.0, np.pi))
        c = side / 2 + rng.uniform(-0.5, 0.5, 2)
        image = digital(disc(side, c, shape), noise, rng)
        found = fit(image, c + 0.3 * rng.uniform(-1, 1, 2), shape, 0.5)
        assert found.ok[0]
        errors.append((found.centroid[0] - c) @ np.linalg.eigh(shape)[1])
    return np.array(errors)


# --- centre ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("minor", "ratio"),
    [
        (1.0, 1.0),
        (1.5, 1.3),
        (2.0, 2.0),
        (3.0, 1.2),
        (3.0, 2.5),
        (5.0, 1.6),
        (8.0, 1.0),
        (8.0, 1.5),
        (14.0, 1.6),
    ],
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


def test_centres_of_slivers_are_good_along_the_sliver_too():
    errors = np.concatenate([off_centre(np.random.default_rng(2), 40, minor, 4.0) for minor in (1.2, 1.7)])
    across, along = np.sqrt(np.mean(errors**2, axis=0))
    assert across < 0.03
    assert along < 0.06


def test_where_the_search_begins_does_not_matter():
    rng = np.random.default_rng(3)
    shape = ellipse(5.0, 3.5, 0.4)
    c = np.array([16.3, 15.8])
    image = digital(disc(32, c, shape), 1.0, rng)
    found = [fit(image, c + d, shape).centroid[0] for d in ([0.0, 0.0], [1.0, 0.5], [-0.8, 1.0], [0.0, -1.2])]
    assert_allclose(found, np.broadcast_to(found[0], (4, 2)), atol=0.02)


@pytest.mark.parametrize("slope", [(1.5, 0.0), (-1.0, 1.0), (0.0, -2.0)])
def test_a_sloped_background_does_not_draw_the_centre(slope):
    """Up to 2 grey values per pixel: the shade of a ball far from the light. The print is darker there, too."""
    shape, c = ellipse(6.0, 4.0, -0.5), np.array([20.2, 19.6])
    x, y = blank(40)
    shade = 1.0 + (slope[0] * (x - 20) + slope[1] * (y - 20)) / BALL
    grey = disc(40, c, shape, ball=BALL * shade, ink=PRINT * shade)
    found = fit(digital(grey, 0.3, np.random.default_rng(4)), c + 0.3, shape)
    assert found.ok[0]
    assert_allclose(found.centroid[0], c, atol=0.025)
    threshold = grey < 0.5 * (BALL + PRINT)
    v, u = np.nonzero(threshold)
    assert np.linalg.norm([u.mean() - c[0], v.mean() - c[1]]) > 0.02  # a plain threshold is drawn


@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5])
def test_gloss_that_lightens_one_side_does_not_draw_the_centre(angle):
    """By a third of the contrast from rim to rim."""
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    x, y = blank(40)
    light = (BALL - PRINT) / 6.0 * ((x - c[0]) * np.cos(angle) + (y - c[1]) * np.sin(angle)) / 6.0
    grey = disc(40, c, shape, ink=PRINT + light)
    found = fit(digital(grey, 0.3, np.random.default_rng(5)), c + 0.3, shape)
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
    found = fit(digital(disc(40, c, shape, ball, ink), 0.5, np.random.default_rng(6)), c + 0.3, shape)
    assert found.ok[0]
    assert found.rim[0] < 0.97
    assert_allclose(found.centroid[0], c, atol=0.12)


STEPS = (np.arange(24) + 0.5) / 24 - 0.5  # of the exposure, of 24 pictures along a way


@pytest.mark.parametrize("bend", [(0.0, 0.0), (2.0, 3.0)])
@pytest.mark.parametrize("way", [(4.0, 0.0), (3.0, -3.0), (0.0, 6.0), (9.0, 9.0)])
def test_the_centre_of_a_moving_disc_is_that_of_mid_exposure(way, bend):
    """The mean of 24 pictures along its way, straight or bent; told the way, the fit is as good as for one at rest."""
    shape, c, way, bend = ellipse(7.0, 5.0, 0.4), np.array([20.2, 19.7]), np.array(way), np.array(bend)
    grey = np.mean([disc(40, c + t * way + t * t * bend, shape) for t in STEPS], axis=0)
    image = digital(grey, 0.5, np.random.default_rng(17))
    path = np.concatenate([way, bend, np.zeros(3)])
    found = fit(image, c + 0.4, shape, path=path[None])
    assert found.ok[0]
    assert_allclose(found.centroid[0], c, atol=0.04)
    still, moved = (
        fit(digital(picture, 4.0, np.random.default_rng(17)), c, shape, 4.0, path=p[None])
        for picture, p in ((disc(40, c, shape), np.zeros(7)), (grey, path))
    )
    u = way / np.linalg.norm(way)
    assert u @ moved.covariance[0] @ u > u @ still.covariance[0] @ u  # a blurred rim says less


def test_a_moving_disc_that_turns_aslant_is_where_it_is_at_mid_exposure():
    """It grows by a third along 9 px: the larger end draws the centroid of the darkness by 0.2 px, the fit not."""
    c, way = np.array([20.2, 19.7]), np.array([9.0, 0.0])
    shapes = [ellipse(5.0 * (1.0 + t / 3.0), 7.0, 0.0) for t in STEPS]
    grey = np.mean([disc(40, c + t * way, shape) for t, shape in zip(STEPS, shapes, strict=True)], axis=0)
    image = digital(grey, 0.5, np.random.default_rng(18))
    ends = [np.linalg.inv(ellipse(5.0 * (1.0 + t / 3.0), 7.0, 0.0)) for t in (-0.5, 0.5)]
    turn = (ends[1] - ends[0])[[0, 0, 1], [0, 1, 1]]
    path = np.concatenate([way, np.zeros(2), turn])
    found = fit(image, c + 0.4, ellipse(5.0, 7.0, 0.0), path=path[None])
    assert found.ok[0]
    assert_allclose(found.centroid[0], c, atol=0.06)
    u = np.arange(40.0)
    dark = BALL - grey
    assert np.sum(dark * u) / np.sum(dark) - c[0] > 0.2


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
    mask, shapes = np.full((80, 80), 255, np.uint8), np.repeat(shape[None], 4, axis=0)
    errors = []
    for seed in range(8):
        image = digital(lit, 2.0, np.random.default_rng(seed))
        found = measure(image, mask, places + 0.4, shapes, 2.0, settings(), path)
        assert found.ok.all()
        errors.append(found.centroid - places)
    assert abs(np.mean(errors, axis=(0, 1))[0]) < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 0.04


# --- covariance ------------------------------------------------------------------------------------------------------


def scatter(a, b, noise, n=120):
    """Standard deviations, (2,) px along the axes, of fits to n pictures, and those reported."""
    rng = np.random.default_rng(7)
    shape = ellipse(a, b, 0.5)
    side = int(2 * a + 16)
    c = side / 2 + np.array([0.2, -0.1])
    grey = disc(side, c, shape)
    errors, said = [], []
    for _ in range(n):
        found = fit(digital(grey, noise, rng), c + 0.2 * rng.uniform(-1, 1, 2), shape, noise)
        assert found.ok[0]
        errors.append(found.centroid[0] - c)
        said.append(found.covariance[0])
    V = np.linalg.eigh(shape)[1]
    return np.sqrt(np.diag(V.T @ np.cov(np.array(errors).T) @ V)), np.sqrt(np.diag(V.T @ np.mean(said, axis=0) @ V))


CASES = [(5.0, 4.0, 4.0), (8.0, 7.0, 2.0), (8.0, 7.0, 8.0), (16.0, 12.0, 8.0), (24.0, 21.0, 8.0)]


@pytest.mark.parametrize(("a", "b", "noise"), CASES)
def test_no_centre_is_less_certain_than_its_covariance_says(a, b, noise):
    actual, said = scatter(a, b, noise)
    assert np.all(actual < 1.2 * said)
    assert np.all(actual > 0.4 * said)


@pytest.mark.parametrize(("a", "b", "noise"), [CASES[0], CASES[2]])
def test_covariance_is_the_scatter(a, b, noise):
    """What print and lens leave uneven counts, too, which these pictures do not have: a little more than chance."""
    actual, said = scatter(a, b, noise)
    assert np.all(said > 0.8 * actual)
    assert np.all(said < 1.45 * actual)


def test_covariance_grows_with_noise_and_falls_with_size():
    sd = {}
    for a, noise in ((4.0, 3.0), (4.0, 6.0), (8.0, 6.0)):
        shape, c = ellipse(a, a, 0.0), np.array([20.2, 19.9])
        found = fit(digital(disc(40, c, shape), noise, np.random.default_rng(8)), c, shape, noise)
        sd[a, noise] = np.sqrt(np.trace(found.covariance[0]) / 2.0)
    assert 1.6 < sd[4.0, 6.0] / sd[4.0, 3.0] < 2.2
    assert sd[8.0, 6.0] < 0.8 * sd[4.0, 6.0]  # a longer rim: the root of two


def test_covariance_has_the_axes_of_the_ellipse():
    """Across a long ellipse much more rim tells the centre than along it."""
    shape, c = ellipse(9.0, 4.0, 0.7), np.array([20.2, 19.9])
    found = fit(digital(disc(40, c, shape), 3.0, np.random.default_rng(9)), c, shape, 3.0)
    _, V = np.linalg.eigh(found.covariance[0])
    _, U = np.linalg.eigh(shape)
    assert abs(V[:, 1] @ U[:, 1]) > 0.98
    assert_allclose(found.covariance[0], found.covariance[0].T, rtol=1e-3)


# --- the model -------------------------------------------------------------------------------------------------------


def model(side, shape, centre, size, blur, smear=(0.0, 0.0)):
    """e, (side²,), of the pixels around the middle and its derivatives by centre and size, (3, side²)."""
    x, y = np.meshgrid(np.arange(side) - side // 2, np.arange(side) - side // 2)
    px, py = x.ravel().astype(np.float32), y.ravel().astype(np.float32)
    q = np.linalg.inv(shape).astype(np.float32)
    e, d = np.empty(side**2, np.float32), np.empty((3, side**2), np.float32)
    cx, cy, s, b = (np.float32(v) for v in (*centre, size, blur))
    ellipse_of(side**2, px, py, q[0, 0], q[0, 1], q[1, 1], cx, cy, s, b, np.array(smear), e, d)
    return e, d


@pytest.mark.parametrize(
    ("a", "b", "limit"), [(1.0, 1.0, 0.01), (3.0, 3.0, 0.01), (8.0, 8.0, 0.01), (6.0, 5.0, 0.03), (9.0, 6.0, 0.06)]
)
def test_derivatives_of_the_ellipse_are_finite_differences(a, b, limit):
    """By the centre they hold the scale of rho as it is: exact for circles, near enough for a step with others."""
    shape, c, blur, h = ellipse(a, b, 0.8), np.array([0.2, -0.1]), 0.94, 0.01
    _, d = model(29, shape, c, 1.0, blur)
    for i, step in enumerate(h * np.eye(3)):
        ends = [model(29, shape, c + s * step[:2], 1.0 + s * step[2], blur)[0].astype(float) for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2.0 * h)
        assert np.abs(slope).max() > 0.05
        assert_allclose(d[i], slope, atol=(limit if i < 2 else 0.01) * np.abs(slope).max())


@pytest.mark.parametrize(
    ("a", "b", "limit"), [(3.0, 3.0, 0.08), (5.0, 4.0, 0.07), (8.0, 6.0, 0.06), (14.0, 13.0, 0.03)]
)
def test_the_ellipse_is_the_blurred_one(a, b, limit):
    """Against subpixels, blurred. The rim counts as straight: the rounder the disc, the more that leaves out."""
    shape, blur = ellipse(a, b, 0.8), 0.94
    e, _ = model(41, shape, (0.2, -0.1), 1.0, blur)
    x, y = blank(41)
    fine = np.where(inside(x, y, (20.2, 19.9), shape), 1.0, 0.0)
    truth = seen(fine, np.sqrt(blur**2 - 1.0 / 12.0))  # a pixel's own width is part of the blur
    assert_allclose(e.reshape(41, 41), truth, atol=limit)
    assert_allclose(e.sum(), truth.sum(), rtol=0.11)


def test_smoothing_kernel_is_a_gaussian():
    k = smoothing_kernel(0.8)
    assert_allclose(k.sum(), 1.0, rtol=1e-6)
    x = np.arange(-3, 4)
    assert_allclose(np.sum(k * x), 0.0, atol=1e-6)
    assert_allclose(np.sum(k * x**2), 0.8**2, rtol=0.02)
    assert_allclose(smoothing_kernel(0.0), x == 0)


# --- what is a disc --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", np.linspace(0.0, 2.0 * np.pi, 5, endpoint=False))
def test_a_disc_half_hidden_is_refused(angle):
    """By a straight edge through its centre, as dark as the print, as light as the ball, or lighter.

    Three others tell the size: without it a half disc could pass for a smaller one. What is just half way between
    print and ball looks like a blurred rim: it may pass, but must not draw the centre.
    """
    shape = ellipse(6.0, 5.0, 0.3)
    places = np.array([[20.2, 19.6], [60.4, 20.1], [20.0, 60.3], [60.0, 60.0]])
    x, y = blank(80)
    fine = np.full(x.shape, BALL)
    for c in places:
        fine[inside(x, y, c, shape)] = PRINT
    behind = (x - places[0][0]) * np.cos(angle) + (y - places[0][1]) * np.sin(angle) > 0.0
    near = inside(x, y, places[0], ellipse(18.0, 18.0, 0.0))
    for strut in (PRINT, 0.5 * (PRINT + BALL), BALL, 230.0):
        image = digital(seen(np.where(behind & near, strut, fine)), 1.0, np.random.default_rng(10))
        mask = np.full((80, 80), 255, np.uint8)
        found = measure(image, mask, places, np.repeat(shape[None], 4, axis=0), 1.0, settings())
        assert_array_equal(found.ok[1:], True)
        if strut == 0.5 * (PRINT + BALL):
            assert not found.ok[0] or np.linalg.norm(found.centroid[0] - places[0]) < 0.2
        else:
            assert not found.ok[0]


def test_what_is_no_disc_is_refused():
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    rng = np.random.default_rng(11)
    plain = digital(np.full((40, 40), BALL), 3.0, rng)
    assert not fit(plain, c, shape, 3.0).ok[0]
    small = digital(disc(40, c, ellipse(3.0, 2.5, 0.3)), 1.0, rng)
    large = digital(disc(40, c, ellipse(10.0, 9.0, 0.3)), 1.0, rng)
    pale = digital(disc(40, c, shape, ink=0.85 * BALL), 1.0, rng)
    for image in (small, large, pale):
        assert not fit(image, c, shape, 1.0).ok[0]
    assert fit(pale, c, shape, 1.0, settings(contrast=0.1)).ok[0]
    bar = np.full((40, 40), BALL)
    bar[:, 16:24] = PRINT
    assert not fit(digital(bar, 1.0, rng), c, shape, 1.0).ok[0]


def test_what_is_off_the_mask_or_off_the_picture_does_not_take_part():
    shape, c = ellipse(6.0, 5.0, 0.3), np.array([20.2, 19.6])
    rng = np.random.default_rng(12)
    grey = disc(40, c, shape)
    grey[:, 29:] = 0.0  # the room beside the ball
    image = digital(grey, 0.5, rng)
    mask = np.full((40, 40), 255, np.uint8)
    mask[:, 28:] = 0
    found = measure(image, mask, c[None] + 0.3, shape[None], 0.5, settings())
    assert found.ok[0]
    assert_allclose(found.centroid[0], c, atol=0.02)
    nothing = measure(image, np.zeros((40, 40), np.uint8), c[None], shape[None], 0.5, settings())
    assert not nothing.ok[0]
    away = np.array([[-30.0, 10.0], [10.0, 1e6], [np.nan, 3.0], [39.0, 39.0]])
    assert not measure(image, mask, away, np.repeat(shape[None], 4, axis=0), 0.5, settings()).ok.any()
    assert len(measure(image, mask, np.zeros((0, 2)), np.zeros((0, 2, 2)), 0.5, settings()).ok) == 0


# --- kinds of pictures -----------------------------------------------------------------------------------------------


def test_light_discs_on_a_dark_ball_are_the_negative():
    shape, c = ellipse(6.0, 4.0, 0.3), np.array([20.2, 19.6])
    image = digital(disc(40, c, shape), 1.0, np.random.default_rng(13))
    dark, light = fit(image, c + 0.3, shape), fit(255 - image, c + 0.3, shape, chosen=settings(projection=NEGATIVE))
    assert dark.ok[0]
    assert light.ok[0]
    assert_allclose(light.centroid, dark.centroid, atol=1e-3)
    assert_allclose(light.covariance, dark.covariance, rtol=1e-2)
    assert not fit(255 - image, c + 0.3, shape).ok[0]
    assert not fit(image, c + 0.3, shape, chosen=settings(projection=NEGATIVE)).ok[0]


@pytest.mark.parametrize("f", [1, 2])
def test_colour_is_taken_as_grey(f):
    """Three equal channels give the very result of one; coloured print that of OpenCV's grey, but for its rounding."""
    shape, c = ellipse(6.0 * f, 4.0 * f, 0.3), np.array([20.2, 19.6]) * f
    rng = np.random.default_rng(14)
    grey = disc(40 * f, c, shape)
    image = digital(grey, 1.0, rng)
    one = fit(image, c + 0.3, shape, chosen=settings())
    three = fit(np.repeat(image, 3, axis=2), c + 0.3, shape, chosen=settings())
    assert_allclose(three.centroid, one.centroid, atol=1e-3)
    assert_allclose(three.covariance, one.covariance, rtol=1e-2)
    cover = (BALL - grey) / (BALL - PRINT)
    ball, ink = np.array([120.0, 160.0, 200.0]), np.array([150.0, 40.0, 30.0])
    colour = np.concatenate([digital(ball[i] + cover * (ink[i] - ball[i]), 1.0, rng) for i in range(3)], axis=2)
    a = fit(colour, c + 0.3, shape, chosen=settings())
    b = fit(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)[:, :, None], c + 0.3, shape, chosen=settings())
    assert a.ok[0]
    assert_allclose(a.centroid, b.centroid, atol=0.01)
    assert_allclose(a.centroid[0], c, atol=0.04 * f)


# --- noise -----------------------------------------------------------------------------------------------------------


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
        assert_allclose(noise_of(image, ONE, 0, 40, 0, 40), np.sqrt(1.0 / 12.0), atol=0.01)
    assert_allclose(noise_of(np.zeros((40, 40, 1), np.uint8), ONE, 5, 5, 5, 5), np.sqrt(1.0 / 12.0), atol=0.01)
