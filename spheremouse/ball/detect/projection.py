"""Linear projection of colours to one value, in which discs are darker than the ball.

The value is w·(B, G, R) without an offset. No light gives 0, so a contrast is a fraction of the light.
Black discs on a white ball need grey, and light discs its negative. A coloured ball needs one channel or a difference
of two. Once discs are known, Fisher's linear discriminant (Fisher 1936) gives the weights with the most signal over
noise.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.geometry.rotation import Array

# In radii of a disc: pixels of the disc and of the ball around it, without the rim
_CORE_RADII, _SURROUND_RADII = 0.5, (1.5, 2.2)
_MIN_PIXELS = 6  # per disc, and per ring around it: smaller discs have mostly mixed pixels
_MIN_DISCS = 3
_ROW_STEP = 4  # the noise is measured in every fourth row
_MIN_FACING_AREA = 0.3  # of the largest disc's area: a disc seen more obliquely has no core without blur


class Projection(NamedTuple):
    """Weights of blue, green and red. Their absolute values sum to 1, so the projected values stay in -255..255."""

    weights: tuple[float, float, float]

    @property
    def needs_colour(self) -> bool:
        """True if grey frames cannot give this projection."""
        return self not in (GREY, NEGATIVE)


GREY = Projection((0.114, 0.587, 0.299))  # ITU-R BT.601, as in OpenCV's grey
NEGATIVE = Projection((-0.114, -0.587, -0.299))


def normalise(weights: Array) -> Projection:
    """Return the projection with weights proportional to `weights`, (3,), of which at least one is not 0."""
    blue, green, red = (weights / np.abs(weights).sum() + 0.0).tolist()  # no -0
    return Projection((blue, green, red))


def _candidates() -> tuple[Projection, ...]:
    single = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    differences = [axis - other for axis in np.eye(3) for other in np.eye(3) if axis is not other]
    apart = [d for d in differences if d.any()]
    return (GREY, NEGATIVE, *(normalise(w) for w in single + apart))


CANDIDATES = _candidates()  # grey, each channel and each difference of two channels, with both signs


@lru_cache(maxsize=64)
def weights_of(projection: Projection, channels: int) -> NDArray[np.float32]:
    """Return the weights of a picture's channels, (channels,): 3 of BGR, or 1 or -1 for a grey picture."""
    if channels == 3:
        return np.array(projection.weights, dtype=np.float32)
    return np.array([1.0 if sum(projection.weights) >= 0.0 else -1.0], dtype=np.float32)


@lru_cache(maxsize=64)
def sample_weights_of(projection: Projection, channels: int) -> NDArray[np.float32]:
    """Return the weights for samples of single pixels, (channels,).

    For grey and its negative they select green alone, which has the largest weight. This takes a third of the time.
    """
    if channels == 3 and not projection.needs_colour:
        return np.array([0.0, np.sign(projection.weights[1]), 0.0], dtype=np.float32)
    return weights_of(projection, channels)


def offset_of(projection: Projection, channels: int) -> float:
    """Return the offset of `projected`, which makes its least value 0. It is the value of no light."""
    return -255.0 * float(np.minimum(weights_of(projection, channels), 0.0).sum())


def projected(image: Image, projection: Projection) -> Image:
    """Return the projection of a picture, (h, w, 3) BGR or (h, w), as (h, w) uint8, plus the offset of `offset_of`."""
    if projection == GREY:
        return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    channels = 1 if image.ndim == 2 else 3
    matrix = np.append(weights_of(projection, channels), offset_of(projection, channels)).astype(np.float64)
    return cv2.transform(image, matrix[None])


class ColourContrast(NamedTuple):
    """Mean difference of ball and discs in blue, green and red, and the noise of one pixel."""

    difference: Array  # (3,) grey values, ball minus disc
    covariance: Array  # (3, 3) of the noise alone, because the fit of a disc models a gradient of the light

    def signal_to_noise(self, projection: Projection) -> float:
        """Return the contrast in a projection over the standard deviation of its noise."""
        w = np.array(projection.weights)
        return float(w @ self.difference / np.sqrt(w @ self.covariance @ w))

    @property
    def fisher(self) -> Projection:
        """The projection with the most signal to noise: w = S^-1 (m_ball - m_disc) (Fisher 1936)."""
        return normalise(np.asarray(np.linalg.solve(self.covariance, self.difference), dtype=np.float64))


def colour_contrast(image: Image, mask: Image, found: Detections, diameter: float) -> ColourContrast | None:
    """Return the mean difference of ball less discs in a picture, (h, w, 3) BGR of 8 bits, and the noise covariance.

    `fisher` of the result is the projection to grey with the most contrast. `mask`, (h, w), is not 0 on the ball, and
    `diameter` px is that of a disc that faces the camera. Discs that are seen too obliquely or show too few pixels do
    not count. Returns None if fewer than `_MIN_DISCS` count, or if the difference is exactly 0.
    """
    by_disc = []
    facing = found.take(found.area > _MIN_FACING_AREA * 0.25 * np.pi * diameter**2)
    for centre, area in zip(facing.centre, facing.area, strict=True):
        core, around = _core_and_ring(image, mask, centre, float(np.sqrt(area / np.pi)))
        if min(len(core), len(around)) >= _MIN_PIXELS:
            by_disc.append(np.median(around, axis=0) - np.median(core, axis=0))
    difference = np.mean(by_disc, axis=0) if by_disc else np.zeros(3)
    if len(by_disc) < _MIN_DISCS or not difference.any():
        return None
    # 1/12 is the variance of rounding to integers; without it a picture without noise has no inverse covariance
    return ColourContrast(difference, _noise_covariance(image, mask) + np.eye(3) / 12.0)


def _noise_covariance(image: Image, mask: Image) -> Array:
    """Return the noise covariance of a pixel's blue, green and red, (3, 3), on the ball.

    It comes from second differences along rows, of every other pixel, because cameras share one chroma sample between
    two neighbours. Differences that are large in any channel are edges and do not count.
    """
    on = [np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0)]
    ball = np.s_[on[0][0] // _ROW_STEP * _ROW_STEP : on[0][-1] + 1 : _ROW_STEP, max(on[1][0] - 2, 0) : on[1][-1] + 3]
    rows = image[ball].astype(np.int16)
    second = (2 * rows[:, 2:-2] - rows[:, :-4] - rows[:, 4:])[mask[ball][:, 2:-2] > 0].astype(float)
    spread = 1.4826 * np.median(np.abs(second), axis=0)
    flat = second[np.all(np.abs(second) <= 3.0 * spread + 1.0, axis=1)]
    return flat.T @ flat / (6.0 * max(len(flat), 1))


def _core_and_ring(image: Image, mask: Image, centre: Array, radius: float) -> tuple[Array, Array]:
    """Return the colours of a disc's pixels, (n, 3), and of the ball around it, (m, 3)."""
    half = int(np.ceil(_SURROUND_RADII[1] * radius)) + 1
    u, v = round(centre[0]), round(centre[1])
    top, left = max(v - half, 0), max(u - half, 0)
    patch = image[top : v + half + 1, left : u + half + 1].astype(float)
    y, x = np.mgrid[top : top + patch.shape[0], left : left + patch.shape[1]]
    distance = np.hypot(x - centre[0], y - centre[1]) / radius
    on_ball = mask[top : v + half + 1, left : u + half + 1] > 0
    return patch[on_ball & (distance < _CORE_RADII)], patch[
        on_ball & (distance > _SURROUND_RADII[0]) & (distance < _SURROUND_RADII[1])
    ]
