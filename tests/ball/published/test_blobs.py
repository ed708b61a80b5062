"""The published detector: what its masks, bounds and duplicates do, on drawn blobs."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.settings import BlobSettings

DETECTOR = BlobDetector(BlobSettings())
FINE = 8  # samples per pixel and axis


def blank(level=180.0, height=120, width=160):
    return np.full((height, width), level)


def ellipse(image, centre, axes, level, angle=0.0):
    """Paint an ellipse by the share of each pixel that it covers."""
    h, w = image.shape
    sub = (np.arange(FINE) + 0.5) / FINE - 0.5
    x = (np.arange(w)[:, None] + sub).ravel() - centre[0]
    y = (np.arange(h)[:, None] + sub).ravel() - centre[1]
    c, s = np.cos(angle), np.sin(angle)
    u, v = (c * x[None] + s * y[:, None]) / axes[0], (-s * x[None] + c * y[:, None]) / axes[1]
    cover = (u * u + v * v < 1.0).reshape(h, FINE, w, FINE).mean(axis=(1, 3))
    image[:] = (1.0 - cover) * image + cover * level


def photo(image):
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("level", [10.0, 55.0, 100.0])
@pytest.mark.parametrize("radius", [6.0, 7.3, 8.5])
def test_a_disc_is_found_once_wherever_the_masks_are(level, radius):
    """Several masks overlap every grey value: of one disc's contours the largest is kept."""
    image = blank()
    centre = np.array([80.3, 60.6])
    ellipse(image, centre, (radius, radius), level)
    seen = DETECTOR.detect(photo(image))
    assert len(seen) == 1
    assert np.abs(seen.centre[0] - centre).max() < 0.25
    assert_allclose(seen.covariance[0], 0.1**2 * np.eye(2))
    assert np.pi * (radius - 1.5) ** 2 < seen.area[0] < np.pi * (radius + 0.5) ** 2


def test_grey_and_colour_agree_and_grey_is_the_mean_of_the_channels():
    image = blank()
    ellipse(image, (50.2, 40.7), (6.0, 5.0), 40.0)
    grey = photo(image)
    colour = np.repeat(grey[..., None], 3, axis=2)
    a, b = DETECTOR.detect(grey), DETECTOR.detect(colour)
    assert len(a) == 1
    assert_allclose(a.centre, b.centre)
    # a saturated blue disc: luma 29, mean 85, of which only the latter is within a mask of (80, 110)
    paint = np.full((120, 160, 3), 200, np.uint8)
    cv2.circle(paint, (80, 60), 6, (255, 0, 0), -1)
    one = BlobDetector(BlobSettings(mask_step=80, mask_width=30, masks=2))  # 0..30 and 80..110
    assert len(one.detect(paint)) == 1
    luma = cv2.cvtColor(paint, cv2.COLOR_BGR2GRAY)
    high = BlobDetector(BlobSettings(mask_step=80, mask_width=10, masks=2))
    assert len(high.detect(paint)) == 1
    assert luma[60, 80] < 30


@pytest.mark.parametrize(("radius", "found"), [(3.0, False), (6.5, True), (9.0, True), (12.0, False)])
def test_bounds_on_area(radius, found):
    image = blank()
    ellipse(image, (80.0, 60.0), (radius, radius), 20.0)
    assert (len(DETECTOR.detect(photo(image))) == 1) == found


def test_shapes_that_are_not_convex_are_dropped():
    image = blank(height=200)
    ellipse(image, (40.0, 60.0), (7.0, 7.0), 20.0)
    crescent = blank(height=200)
    ellipse(crescent, (100.0, 60.0), (9.0, 9.0), 20.0)
    ellipse(crescent, (104.0, 60.0), (8.0, 8.0), 180.0)
    ell = np.minimum(image, crescent)
    ell[120:138, 40:44] = ell[134:138, 40:58] = 20.0
    seen = DETECTOR.detect(photo(ell))
    assert len(seen) == 1
    assert np.abs(seen.centre[0] - [40.0, 60.0]).max() < 0.2
    loose = BlobDetector(BlobSettings(convexity=0.3))
    assert len(loose.detect(photo(ell))) >= 3  # one whose centroid is not within it may count more than once


def test_holes_count_and_nested_contours_are_one():
    """A bright spot in a dark plate is the outline of a hole; with the ring around it, it is one blob."""
    image = blank()
    image[40:80, 40:80] = 20.0
    ellipse(image, (60.0, 60.0), (7.0, 7.0), 180.0)
    seen = DETECTOR.detect(photo(image))
    assert len(seen) == 1
    assert np.abs(seen.centre[0] - 60.0).max() < 0.2


def test_fixed_masks_miss_what_is_too_bright():
    """Its known weakness: dark is 0 to 120, whatever the light."""
    image = blank(level=250.0)
    ellipse(image, (80.0, 60.0), (6.0, 6.0), 150.0)
    assert len(DETECTOR.detect(photo(image))) == 0
