"""The width of edges, against edges of a known one."""

import cv2
import numpy as np
import pytest

from spheremouse.ball.detect.sharpness import blur_of

FINE = 8  # samples per pixel and axis


def picture(sigma, noise=0.0):
    """Dark discs on white, blurred by `sigma` px before they are sampled; (240, 320)."""
    y, x = np.mgrid[0 : 240 * FINE, 0 : 320 * FINE] / FINE
    fine = np.full(x.shape, 200.0, np.float32)
    for u, v, r in ((100, 100, 60), (220, 140, 70), (250, 40, 20)):
        fine[(x - u) ** 2 + (y - v) ** 2 < r * r] = 40.0
    if sigma > 0.0:
        fine = cv2.GaussianBlur(fine, (0, 0), sigma * FINE)
    image = cv2.resize(fine, (320, 240), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(image + noise * np.random.default_rng(1).normal(size=image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 1.5, 2.0, 3.0])
def test_the_blur_is_the_one_that_was_made(sigma):
    assert blur_of(picture(sigma)) == pytest.approx(sigma, abs=0.06)
    assert blur_of(cv2.cvtColor(picture(sigma), cv2.COLOR_GRAY2BGR)) == pytest.approx(sigma, abs=0.06)


def test_a_sharp_picture_is_below_half_a_pixel_and_an_empty_one_has_none():
    assert blur_of(picture(0.0)) < 0.4
    assert np.isnan(blur_of(np.full((120, 160), 90, np.uint8)))
