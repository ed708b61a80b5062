"""Offset of the rims that a bound selects from the true rims of the discs."""

from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.wand.settings import ColourSettings

Image = NDArray[np.uint8]
OVEREXPOSED = 250.0  # grey value of an overexposed pixel, which passes any lower bound on brightness
# grey value above which cameras compress highlights, so that it does not give the light: 80 to 90 % of full scale
_KNEE = 230.0
RIM_SIGMA = 0.25  # px, standard deviation of a rim's shift: print and the picture's blur vary
_COMPRESSED_SIGMA = 0.5  # px, the same of lights above the knee: their rims are as wide at one and at twice the light
_GAMMA = 2.2  # of grey values
_PRINT_REFLECTANCE = 0.65  # of a print's greatest channel over that of white paper: 0.58 to 0.7
_MAX_GREY = 255.0
_UNKNOWN_RIM = 0.0, RIM_SIGMA, 0.5  # shift, standard deviation, cover
_MIN_COVER = 0.1  # of a pixel, and the same from 1: farther out the rim depends on how far the lens blurs
_BLUR_KERNEL, _GROUND_KERNEL = np.ones((5, 5), np.uint8), np.ones((11, 11), np.uint8)  # px: blur; ground beside it
_INNER_KERNELS = _BLUR_KERNEL, np.ones((3, 3), np.uint8), np.ones((1, 1), np.uint8)  # px: less for small discs
_MIN_DISC_PIXELS, _MIN_PIXELS = 4, 9  # to measure the brightness of one disc, and of all
_MIN_CONTRAST = 4.0  # of light between print and ground: two stops
_RIM_LEVELS = 0.2, 0.9  # of the light between ground and full scale, which delimit a rim
_OVEREXPOSED_LIGHTS = 2.0 ** np.arange(0.0, 4.1, 0.25)  # of full scale: candidates for overexposed discs
_MAX_DISC_SIZE = 64  # px: half of the greatest ball in a picture that is not reduced
_MAX_DISCS = 48  # the largest, for a room full of small things
IN_FOCUS, _PIXEL_BLUR = 0.47, 0.29  # px, standard deviations of a lens in focus: half a pixel; of one pixel's width


def rim_shift(colour: ColourSettings) -> float:
    """Return the px by which a bound on saturation selects a rim between print and white too far outward."""
    return _outward(least_cover(colour)) if colour.saturation_min > 0.0 else 0.0


def least_cover(colour: ColourSettings) -> float:
    """Return the least fraction of print in a pixel between print and white that a bound on saturation selects.

    Light mixes before the camera's gamma. In a pixel with the fraction c of print, the least channel has 1 - c of the
    white's light, and the greatest has that plus c times the print's. Their ratio to the power of 1 / 2.2 is one minus
    the saturation. The bound therefore gives the least c of a selected pixel, and the blur gives the place of that c.
    """
    least = (1.0 - colour.saturation_min / 255.0) ** _GAMMA  # of the least channel's light over the greatest's
    return (1.0 - least) / (1.0 - least + least * _PRINT_REFLECTANCE)


def edge_blur(lens_blur: Array | float, factor: int = 1) -> Array:
    """Return the standard deviation of an edge's blur, px of a picture that is reduced `factor` times."""
    return np.hypot(np.asarray(lens_blur) / factor, _PIXEL_BLUR)


def lens_blur_of(edge: Array, factor: int) -> Array:
    """Return the blur of the lens, px of the whole picture, that gives an `edge_blur`; 0 for less than a pixel's."""
    return factor * np.sqrt(np.maximum(edge**2 - _PIXEL_BLUR**2, 0.0))


def _outward(cover: float, factor: int = 1) -> float:
    """Return the px by which a rim is selected too far outward if pixels of more than `cover` are selected.

    A picture reduced `factor` times has the lens' blur reduced, but a pixel's blur unchanged; px are those of the
    reduced picture.
    """
    return float(-edge_blur(IN_FOCUS, factor) * NormalDist().inv_cdf(min(max(cover, _MIN_COVER), 1.0 - _MIN_COVER)))


def rim_shift_by_brightness(
    image: Image, one: NDArray[np.uint8], bound: NDArray[np.float32], factor: int
) -> tuple[float, float, float]:
    """Return `rim_shift`, its standard deviation, and `least_cover` for a bound on brightness.

    Print and ground are as bright as the picture shows them. The cover is a half if that is unknown or inexact.

    `one` (h, w) is the binary picture of the colour, and `bound` (6,) has its bounds of hue, saturation and brightness.
    Light mixes before the camera's gamma. So a bound half way between the grey values of print and white selects pixels
    that are nearly all white. px are those of the picture, which is reduced `factor` times.
    """
    if bound[4] <= 0.0 and bound[5] >= _MAX_GREY:
        return _UNKNOWN_RIM
    rims = _sample_rims(image, one)
    if min(len(rims.within), len(rims.beside)) < _MIN_PIXELS:
        return _UNKNOWN_RIM
    ours, theirs = float(np.median(rims.within)), float(np.median(rims.beside))
    if min(ours, theirs) >= _KNEE:
        return _UNKNOWN_RIM
    low, high = _light(min(ours, theirs)), _light(max(ours, theirs))
    compressed = max(ours, theirs) >= _KNEE
    if compressed:
        high = _overexposed_light(rims, low, factor)
    selects = _light(float(bound[4] if ours > theirs else bound[5]))
    if not low < selects < high:  # the bound does not separate the two
        return _UNKNOWN_RIM
    bright = (selects - low) / (high - low)
    cover = bright if ours > theirs else 1.0 - bright
    return _outward(cover, factor), *((_COMPRESSED_SIGMA, 0.5) if compressed else (RIM_SIGMA, cover))


@dataclass(frozen=True, slots=True)
class _RimSamples:
    """Grey values near the rims of areas that can be discs."""

    within: NDArray[np.uint8]  # (n,) inside, away from the rims
    beside: NDArray[np.uint8]  # (m,) of the ground outside
    across: tuple[NDArray[np.uint8], ...]  # (k,) inside, ground and rim of each area
    length: Array  # (m,) px, of each rim


def _sample_rims(image: Image, one: NDArray[np.uint8]) -> _RimSamples:
    """Return samples about the areas of a binary picture, (h, w), without those that are too large for discs."""
    n, label, stats, _ = cv2.connectedComponentsWithStats(one, connectivity=8)
    size, area = stats[1:n, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]], stats[1:n, cv2.CC_STAT_AREA]
    small = 1 + np.flatnonzero(np.max(size, axis=1) <= _MAX_DISC_SIZE)
    small = small[np.argsort(-area[small - 1], kind="stable")][:_MAX_DISCS]
    within, beside, across, length = [], [], [], []
    margin = len(_GROUND_KERNEL) // 2 + 1
    for i in small:
        x, y, w, h = stats[i, :4]
        part = np.s_[max(y - margin, 0) : y + h + margin, max(x - margin, 0) : x + w + margin]
        disc = np.where(label[part] == i, np.uint8(1), np.uint8(0))
        value = np.max(image[part], axis=2)
        near, far = (np.asarray(cv2.dilate(disc, k)) for k in (_BLUR_KERNEL, _GROUND_KERNEL))
        inner = next(
            v
            for k in _INNER_KERNELS
            if len(v := value[np.asarray(cv2.erode(disc, k)) > 0]) >= min(_MIN_DISC_PIXELS, area[i - 1])
        )
        outer = value[(far > near) & (one[part] == 0)]
        if len(outer) == 0 or not _differ(float(np.median(inner)), float(np.median(outer))):
            continue
        within.append(inner)
        beside.append(outer)
        across.append(value[near > 0])
        length.append(2.0 * np.sqrt(np.pi * area[i - 1]))
    none = np.zeros(0, dtype=np.uint8)
    return _RimSamples(
        np.concatenate([none, *within]), np.concatenate([none, *beside]), tuple(across), np.array(length)
    )


def _differ(grey: float, other: float) -> bool:
    """Return true if two grey values differ as print and white do, more than a shadow and its edge."""
    return max(_light(grey), _light(other)) > _MIN_CONTRAST * min(_light(grey), _light(other))


def _light(grey: float) -> float:
    """Return the light of a grey value; 1 is full scale."""
    return float((grey / _MAX_GREY) ** _GAMMA)


def _overexposed_light(rims: _RimSamples, low: float, factor: int) -> float:
    """Return the light of overexposed areas, 1 at full scale, beside light `low`, in a picture reduced `factor` times.

    The brighter an area, the narrower is its rim. The median width counts, since glare and background beside an area
    widen its rim.
    """
    begin, end = (low + part * (1.0 - low) for part in _RIM_LEVELS)
    first, last = (_MAX_GREY * x ** (1.0 / _GAMMA) for x in (begin, end))
    count = [np.count_nonzero((grey >= first) & (grey < last)) for grey in rims.across]
    width = np.median(count / rims.length)
    expected = np.array(
        [
            _outward((begin - low) / (x - low), factor) - _outward((end - low) / (x - low), factor)
            for x in _OVEREXPOSED_LIGHTS
        ]
    )
    return float(_OVEREXPOSED_LIGHTS[int(np.argmin(np.abs(expected - width)))])
