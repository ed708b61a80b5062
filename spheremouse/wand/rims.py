"""How far the rims of discs in a picture are from where they should be."""

from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.settings import param

Image = NDArray[np.uint8]
BRIGHTEST = 250.0  # a pixel this bright is overexposed: bright enough whatever the mean of a bright picture asks
_GAMMA = 2.2  # of grey values
_PRINT = 0.65  # light of a print's greatest channel over that of white paper: 0.58 to 0.7
_FULL = 255.0  # grey values
_COVER = 0.1  # and all but this: a rim is not looked for further out, where the lens decides how far the blur reaches
_NEAR_RIM, _FAR_FROM_RIM = np.ones((5, 5), np.uint8), np.ones((11, 11), np.uint8)  # px: beyond blur; a little further
_WITHIN = _NEAR_RIM, np.ones((3, 3), np.uint8), np.ones((1, 1), np.uint8)  # px: what small discs have of that
_FEW, _LEVEL_LEAST = 4, 9  # pixels, to tell how bright it is in a disc; and altogether
_CONTRAST = 4.0  # of light between print and ground: two stops
_ACROSS_RIM = 0.2, 0.9  # of the light between ground and the most that a picture shows: how wide a rim is
_LIGHTS = 2.0 ** np.arange(0.0, 4.1, 0.25)  # that overexposed discs may have, of that most
_DISC_MOST = 64  # px across: half of the greatest ball in a picture that is not reduced; more is no disc
_DISCS = 48  # that tell how bright it is: the largest, of a room full of small things
_LENS, _PIXEL = 0.47, 0.29  # px, blur of an edge in a picture in focus: half a pixel of the lens, a pixel's own width


@dataclass(frozen=True, slots=True)
class ColourSettings:
    """Six bounds that select a colour (Grzonka 2005, section 3.4.2)."""

    hue_min: float = param(0.0, "deg", "least hue, 0 to 360; above hue_max the range passes through 0", ge=0, le=360)
    hue_max: float = param(360.0, "deg", "greatest hue", ge=0, le=360)
    saturation_min: float = param(0.0, "-", "least saturation, 0 to 255", ge=0, le=255)
    saturation_max: float = param(255.0, "-", "greatest saturation", ge=0, le=255)
    value_min: float = param(0.0, "-", "least brightness after normalisation to a mean of 127", ge=0, le=1e4)
    value_max: float = param(1e4, "-", "greatest brightness after normalisation", ge=0, le=1e4)


def rim_shift(colour: ColourSettings) -> float:
    """Pixels that a rim between print and white moves outward, where a bound on saturation selects it.

    Light mixes before it becomes grey values: of a pixel with the part c of print, the least channel gives 1 - c of the
    white's light, and the greatest that and c times the print's. Their ratio, to the power of 1 / 2.2, is 1 less the
    saturation. So the bound tells the cover from which on pixels are selected, and the blur where that is.
    """
    if colour.saturation_min <= 0.0:
        return 0.0
    least = (1.0 - colour.saturation_min / 255.0) ** _GAMMA  # light of the least channel over that of the greatest
    return _outward((1.0 - least) / (1.0 - least + least * _PRINT))


def _outward(cover: float, factor: int = 1) -> float:
    """Pixels by which a rim is selected outward of where it is, when pixels count from such a cover on.

    In a reduced picture they are its own: there a pixel's width is as before, and the lens' blur less.
    """
    edge = np.hypot(_LENS / factor, _PIXEL)
    return float(-edge * NormalDist().inv_cdf(min(max(cover, _COVER), 1.0 - _COVER)))


def shift_by_brightness(image: Image, one: NDArray[np.uint8], bound: NDArray[np.float32], factor: int) -> float:
    """`rim_shift` where a bound on brightness selects: the picture shows how bright it is on either side of rims.

    As there, light mixes: a bound half way between the grey values of print and white lies near all white. In pixels of
    the picture, which is reduced `factor` times.
    """
    if bound[4] <= 0.0 and bound[5] >= _FULL:
        return 0.0
    rims = _rims(image, one)
    if min(len(rims.within), len(rims.beside)) < _LEVEL_LEAST:
        return 0.0
    ours, theirs = float(np.median(rims.within)), float(np.median(rims.beside))
    if min(ours, theirs) >= BRIGHTEST:
        return 0.0
    low, high = _light(min(ours, theirs)), _light(max(ours, theirs))
    if max(ours, theirs) >= BRIGHTEST:
        high = _beyond(rims, low, factor)
    selects = _light(float(bound[4] if ours > theirs else bound[5]))
    if not low < selects < high:  # it is not brightness that tells them apart
        return 0.0
    cover = (selects - low) / (high - low)
    return _outward(cover if ours > theirs else 1.0 - cover, factor)


@dataclass(frozen=True, slots=True)
class _Rims:
    """Grey values near the rims of things that may be discs."""

    within: NDArray[np.uint8]  # (n,) of those things, away from their rims
    beside: NDArray[np.uint8]  # (m,) a little way outside
    across: NDArray[np.uint8]  # (k,) all of that, and what lies between
    length: float  # px, of all rims


def _rims(image: Image, one: NDArray[np.uint8]) -> _Rims:
    """What lies about the things that a binary picture shows, without those that are too large for discs."""
    n, label, stats, _ = cv2.connectedComponentsWithStats(one, connectivity=8)
    size, area = stats[1:n, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]], stats[1:n, cv2.CC_STAT_AREA]
    small = 1 + np.flatnonzero(np.max(size, axis=1) <= _DISC_MOST)
    small = small[np.argsort(-area[small - 1], kind="stable")][:_DISCS]
    within, beside, across, length = [], [], [], 0.0
    margin = len(_FAR_FROM_RIM) // 2 + 1
    for i in small:
        x, y, w, h = stats[i, :4]
        part = np.s_[max(y - margin, 0) : y + h + margin, max(x - margin, 0) : x + w + margin]
        disc = np.where(label[part] == i, np.uint8(1), np.uint8(0))
        value = np.max(image[part], axis=2)
        near, far = (np.asarray(cv2.dilate(disc, k)) for k in (_NEAR_RIM, _FAR_FROM_RIM))
        inner = next(
            v for k in _WITHIN if len(v := value[np.asarray(cv2.erode(disc, k)) > 0]) >= min(_FEW, area[i - 1])
        )
        outer = value[(far > near) & (one[part] == 0)]
        if len(outer) == 0 or not _differ(float(np.median(inner)), float(np.median(outer))):
            continue
        within.append(inner)
        beside.append(outer)
        across.append(value[far > 0])
        length += 2.0 * float(np.sqrt(np.pi * area[i - 1]))
    none = np.zeros(0, dtype=np.uint8)
    return _Rims(
        np.concatenate([none, *within]), np.concatenate([none, *beside]), np.concatenate([none, *across]), length
    )


def _differ(grey: float, other: float) -> bool:
    """Is one of two grey values so much lighter as print and white are, not as a shadow and its edge?"""
    return max(_light(grey), _light(other)) > _CONTRAST * min(_light(grey), _light(other))


def _light(grey: float) -> float:
    """Light of a grey value; 1 is the most that a picture shows."""
    return float((grey / _FULL) ** _GAMMA)


def _beyond(rims: _Rims, low: float, factor: int) -> float:
    """Light of what is overexposed beside light `low`: the brighter, the narrower the rims between them seem."""
    begins, ends = (low + part * (1.0 - low) for part in _ACROSS_RIM)
    first, last = (_FULL * x ** (1.0 / _GAMMA) for x in (begins, ends))
    width = np.count_nonzero((rims.across >= first) & (rims.across < last)) / rims.length
    expected = np.array(
        [_outward((begins - low) / (x - low), factor) - _outward((ends - low) / (x - low), factor) for x in _LIGHTS]
    )
    return float(_LIGHTS[int(np.argmin(np.abs(expected - width)))])
