"""The blur of a picture: of pictures that were blurred by so many pixels, whatever they show and in whatever light."""

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places
from numpy.testing import assert_allclose

from spheremouse.ball.detect.blobs import BlobDetector, BlobSettings
from spheremouse.calibrate.camera.corners import Pattern, find_board
from spheremouse.calibrate.photographing.edges import BLURRED, blur_of_board, blur_of_spots, not_sharp
from spheremouse.geometry.camera import project

PIXEL = 1.0 / 12.0  # px², variance of the light that a pixel gathers


def grid(seen, pattern):
    uv = np.full((pattern.columns * pattern.rows, 2), np.nan)
    uv[seen.ids] = seen.uv
    return uv.reshape(pattern.rows, pattern.columns, 2)


@pytest.mark.parametrize("blur", [0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("contrast", [1.0, 0.4])
def test_the_blur_of_a_board_is_told(blur, contrast):
    rng = np.random.default_rng(1)
    R, t = (part[0] for part in places(1, rng))
    grey = 20.0 + contrast * picture(R, t, rng=rng, noise=1.0, blur=blur).astype(float)
    uv, _ = project(PATTERN.corners() @ R.T + t, CAMERA)  # where the corners are, not where they were found
    found = blur_of_board(np.rint(grey).astype(np.uint8), uv.reshape(PATTERN.rows, PATTERN.columns, 2))
    # squares of 25 px: a blur of 3 px has not ended where the neighbouring edge begins
    assert_allclose(found, np.hypot(blur, np.sqrt(PIXEL)), rtol=0.08 if blur < 2.0 else 0.16)


def test_markers_between_the_corners_are_no_edges_of_the_board():
    pattern = Pattern(9, 6, 0.03, 0.0225)
    rng = np.random.default_rng(2)
    R, t = (part[0] for part in places(1, rng))
    grey = picture(R, t, pattern, rng=rng, noise=1.0, blur=0.8)
    uv = grid(find_board(grey, pattern), pattern)
    assert_allclose(blur_of_board(grey, uv, 0.4 * 0.25), np.hypot(0.8, np.sqrt(PIXEL)), rtol=0.15)


def spotted(blur, rng):
    """Dark ellipses on a bright ground that shades off."""
    n, fine = 400, 4
    v, u = np.mgrid[: n * fine, : n * fine] / fine
    grey = 170.0 + 0.1 * u
    for x in range(40, n, 80):
        for y in range(40, n, 80):
            a, b, turn = rng.uniform(9.0, 16.0), rng.uniform(7.0, 9.0), rng.uniform(0.0, np.pi)
            p, q = (u - x) * np.cos(turn) + (v - y) * np.sin(turn), (v - y) * np.cos(turn) - (u - x) * np.sin(turn)
            grey[(p / a) ** 2 + (q / b) ** 2 < 1.0] = 30.0
    image = cv2.GaussianBlur(cv2.resize(grey, (n, n), interpolation=cv2.INTER_AREA), (0, 0), blur)
    return np.clip(np.rint(image + rng.normal(0.0, 1.5, image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("blur", [0.5, 1.0, 2.0])
def test_the_blur_of_dark_spots_is_told(blur):
    grey = spotted(blur, np.random.default_rng(3))
    spots = BlobDetector(BlobSettings(masks=24, min_area=100.0, max_area=900.0)).detect(grey)
    assert len(spots) >= 20
    assert_allclose(blur_of_spots(grey, spots), np.hypot(blur, np.sqrt(PIXEL)), rtol=0.12)


def test_where_there_is_no_edge_nothing_is_told():
    grey = np.full((480, 640), 90, np.uint8)
    uv = np.stack(np.meshgrid(np.linspace(100.0, 500.0, 9), np.linspace(100.0, 350.0, 6)), axis=-1)
    assert np.isnan(blur_of_board(grey, uv))
    assert "cannot be made out" in not_sharp(np.nan, 1.0)


def test_sharp_is_as_sharp_as_the_camera_can():
    assert not_sharp(0.9, 0.5) == ""  # no lens has to be better than its pixels
    assert not_sharp(1.4, 1.0) == ""
    assert "edges of 1.6 px, 1.0 px at best" in not_sharp(1.6, 1.0)
    assert "blurred" in not_sharp(1.1 * BLURRED, 1.1 * BLURRED)  # even where it never was better
