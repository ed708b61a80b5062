"""Measurement of discs, each in its own window: directions on the ball to centres in the image, in one compiled call.

The geometry (detect.appearance) gives each disc's place when its row is read, its shape, and its motion during the
exposure. detect.fit measures it.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance_of, pixels_of
from spheremouse.ball.detect.detections import Detections, Image, no_detections
from spheremouse.ball.detect.fit import FitSettings, measure
from spheremouse.ball.detect.fit_model import PATH
from spheremouse.ball.detect.projection import weights_of
from spheremouse.ball.rig import BallView
from spheremouse.geometry.camera import row_of
from spheremouse.geometry.rotation import Array, exp_into


class DiscModel(NamedTuple):
    """Discs, camera and ball of a detector for one camera pose, for compiled code."""

    ball: BallView
    mask: Image  # (h, w) 255 on the ball, a little within its outline
    exposure: float  # s
    fit: FitSettings
    min_area: float  # px², smaller discs are left out
    diameter: float  # px, of the largest disc


class Motion(NamedTuple):
    """Motion of the ball during a frame."""

    rate: Array  # (3,) rad/s, w_obj
    readout: float  # s, of all rows


_EXPECTED = 0.3  # of the contrast suffices at a place that the map predicts: glare, deep shade
_APART = 0.3  # of a disc's diameter: of two nearer discs, the one with the worse fit is left out
_ANYWHERE = np.zeros((0, 2))
_AT_REST = Motion(np.zeros(3), 0.0)


def measure_discs(
    image: Image,
    directions: Array,
    model: DiscModel,
    noise: float,
    places: Array = _ANYWHERE,
    motion: Motion = _AT_REST,
    size: float = 0.0,
) -> tuple[Detections, float]:
    """Measure the discs at `directions`, (n, 3) unit vectors in obj, in an image (h, w, c) of uint8.

    Each fit begins at its place of `places`, (n, 2) px, the centre of a dark spot. Without `places` it begins at the
    expected place, and a part of the contrast suffices. `noise` is that of a pixel. Discs that are not wholly in the
    image are left out. The ball's `motion` carries the discs to the time when their row is read. The exposure smears
    them. If `size`, fitted over expected, is not 0, the fit fixes the size at it. The second result is the common size
    of the discs, or 0 if too few discs determine it.
    """
    if len(directions) == 0:
        return no_detections(), size
    weights = weights_of(model.fit.projection, image.shape[2])
    directions, places = np.ascontiguousarray(directions), np.ascontiguousarray(places)
    centre, covariance, area, told = _measure_discs(image, directions, model, noise, weights, places, motion, size)
    return Detections(centre, covariance, area), told


@njit(cache=True)
def _suppress(points: Array, radius: float) -> NDArray[np.bool_]:
    """Return True for points (n, 2), the best first, that no better kept point has within a radius, as `suppress`."""
    kept = np.ones(len(points), dtype=np.bool_)
    for i in range(len(points)):
        for k in range(i):
            if kept[k] and np.hypot(points[i, 0] - points[k, 0], points[i, 1] - points[k, 1]) <= radius:
                kept[i] = False
                break
    return kept


@njit(cache=True, error_model="numpy")
def _measure_discs(image, directions, model, noise, weights, places, motion, size):
    n = len(directions)
    view = model.ball
    height, width = model.mask.shape
    if motion.readout != 0.0:
        uv, turn, R = pixels_of(directions, view), np.empty(3), np.empty((3, 3))
        moved = directions.copy()
        for i in range(n):
            if np.isfinite(uv[i, 1]):
                late = motion.readout * row_of(uv[i, 1], height)
                for j in range(3):
                    turn[j] = motion.rate[j] * late
                exp_into(turn, R)
                moved[i] = R @ directions[i]
        directions = moved
    centre, centroid, shape, area, _ = appearance_of(directions, view)
    path = np.zeros((n, PATH))
    if model.exposure > 0.0:
        _paths(directions, model.exposure * motion.rate, view, centre, path)
    index = np.empty(n, dtype=np.int64)
    k = 0
    for i in range(n):
        if not area[i] >= model.min_area:
            continue
        dx, dy = np.sqrt(shape[i, 0, 0]), np.sqrt(shape[i, 1, 1])
        x, y = centroid[i, 0], centroid[i, 1]
        if x - dx > -0.5 and x + dx < width - 0.5 and y - dy > -0.5 and y + dy < height - 0.5:
            index[k] = i
            k += 1
    index = index[:k]
    start = (places if len(places) else centroid)[index]
    contrast = model.fit.contrast * (1.0 if len(places) else _EXPECTED)
    fits, told = measure(image, model.mask, start, shape[index], path[index], noise, weights, model.fit, contrast, size)
    found = fits.centroid - (centroid[index] - centre[index])  # the eccentricity
    ok = np.flatnonzero(fits.ok)
    best = ok[np.argsort(-fits.rim[ok], kind="mergesort")]
    kept = best[_suppress(found[best], _APART * model.diameter)]
    return found[kept], fits.covariance[kept], area[index[kept]], told


@njit(cache=True, error_model="numpy")
def _paths(directions, turn, view, centre, path):
    """Write the motion of n discs at `directions` during the exposure, a `turn`, (3,) rad, into `path`, (n, 7).

    `centre` (n, 2) px are their places at mid-exposure. The path follows from the places and shapes at the start and
    end of the exposure (`moving_ellipse_of`). The shape of a disc that is not whole at both ends counts as constant.
    """
    n = len(directions)
    R = np.empty((3, 3))
    exp_into(0.5 * turn, R)
    ends = np.empty((2, n, 3))
    for i in range(n):
        ends[0, i] = R.T @ directions[i]
        ends[1, i] = R @ directions[i]
    uv, inverse = np.empty((2, n, 2)), np.empty((2, n, 3))
    for end in range(2):
        uv[end] = pixels_of(ends[end], view)
        shape = appearance_of(ends[end], view).shape
        for i in range(n):
            det = shape[i, 0, 0] * shape[i, 1, 1] - shape[i, 0, 1] ** 2
            inverse[end, i, 0], inverse[end, i, 2] = shape[i, 1, 1] / det, shape[i, 0, 0] / det
            inverse[end, i, 1] = -shape[i, 0, 1] / det
    for i in range(n):
        if not np.isfinite(uv[0, i, 0] + uv[1, i, 0]):
            continue
        path[i, :2] = uv[1, i] - uv[0, i]
        path[i, 2:4] = 2.0 * (uv[1, i] + uv[0, i] - 2.0 * centre[i])
        if np.isfinite(inverse[0, i, 0] + inverse[1, i, 0]):
            path[i, 4:] = inverse[1, i] - inverse[0, i]
