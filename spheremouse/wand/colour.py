"""A picture in, one weight field per colour out: how near a place is to pixels of that colour, 0 to 255.

HSV with the brightness normalised to a mean of 127, six bounds per colour, binary images convolved with a 5 x 5
Gaussian (Grzonka 2005, section 3.4.2 and 3.4.3). Only a region of interest need be looked at, and a large ball is
looked at in a reduced picture, so that the work does not depend on its size. Where glare has washed the colours out, a
further field says that nothing is known.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.wand.rims import BRIGHTEST, ColourSettings, Image, rim_shift, shift_by_brightness

Region = tuple[int, int, int, int]  # left, top, right, bottom px; right and bottom excluded

MEAN_BRIGHTNESS = 127.0
FIELD_SIGMA = 1.2  # px of the field: the kernel's 1.1 and half a pixel of thresholding and interpolation
_KERNEL = (5, 5)
_SAMPLE = 16  # every so many rows and columns tell the mean brightness, from thousands of pixels
# Glare is the sun's mirror image, as wide as the gloss is rough. All is paler around the spot that is overexposed.
# Print is known to be by its hue without its saturation; of the rest nobody knows.
_HALO = 1.0  # radii of an overexposed spot around it of which nobody knows: a lobe has fallen to a tenth at twice its
_HALO_LEAST, _HALO_MOST = 2.0, 8.0  # half width; px. Pale print is looked for as far as the greatest
_PALE = 0.25  # of a colour's least saturation: above it is a tint, below noise and white
_GLARE_ACROSS = 38  # px, beyond which a spot is no mirror image on a ball of at most 128 px, but white or sky or a lamp
_GLARE_LEAST = 3  # px; fewer are noise
_GLARE_SPOTS = 24  # the largest that are looked at
_ACROSS = 64.0  # px, a ball's diameter beyond which the picture is reduced: its rims then outweigh the pixels' noise


# Of print on white, light mixes before it becomes grey values: a pixel half disc, half white has 0.2 of full saturation
# only, as pale things of a room have. The bound lies at 0.37, where three quarters are disc: the rim is selected a
# third of a pixel too far inward, which `rim_shift` tells. Hues: red keeps clear of skin and wood (20 to 35°), blue of
# teal and purple.
DEFAULT_COLOURS: dict[str, ColourSettings] = {
    "red": ColourSettings(hue_min=340.0, hue_max=14.0, saturation_min=95.0, value_min=25.0),
    "blue": ColourSettings(hue_min=205.0, hue_max=262.0, saturation_min=95.0, value_min=25.0),
    "dark": ColourSettings(value_max=75.0),
    "light": ColourSettings(value_min=215.0),
}


@dataclass(frozen=True, slots=True)
class Fields:
    """Weight fields of part of a picture, reduced `factor` times."""

    weight: NDArray[np.uint8]  # (c, h, w), 255 deep within the colour
    binary: NDArray[np.uint8]  # (c, h, w), 255 or 0
    left: int  # px of the whole picture, where the fields begin
    top: int
    factor: int
    share: Array  # (c,) part of the whole picture's pixels that have the colour
    colours: tuple[str, ...]
    rim: Array  # (c,) px of the field that a rim between print and white is selected outward of where it is
    glare: NDArray[np.uint8]  # (1, h, w) 255 where glare hides all colours, blurred as `weight`; (0, 1, 1): nowhere

    def place(self) -> Array:
        """(3,): left, top, factor, for compiled code."""
        return np.array([self.left, self.top, self.factor], dtype=float)


@dataclass(frozen=True, slots=True)
class Tone:
    """What the whole picture says of a region: told by every sixteenth row and column."""

    mean: float  # of the HSV brightness
    share: Array  # (c,) part of the pixels that have each colour


def tone(image: Image, colours: dict[str, ColourSettings], names: tuple[str, ...]) -> Tone:
    """Brightness and colours of a BGR picture, (h, w, 3)."""
    sample = np.ascontiguousarray(image[_SAMPLE // 2 :: _SAMPLE, _SAMPLE // 2 :: _SAMPLE])
    mean = float(_mean_value(sample))
    _, count, _ = _selected(sample, _bounds(colours, names, mean))
    return Tone(mean, count / sample[:, :, 0].size)


def fields(
    image: Image,
    colours: dict[str, ColourSettings],
    names: tuple[str, ...],
    region: Region | None = None,
    factor: int = 1,
    known: Tone | None = None,
) -> Fields:
    """Weight fields of the colours `names` in a BGR picture, (h, w, 3), or in a region of it.

    `known` is the picture's `tone` where it is known already.
    """
    h, w = image.shape[:2]
    known = known or tone(image, colours, names)
    left, top, right, bottom = region or (0, 0, w, h)
    part = image[top:bottom, left:right]
    if factor > 1:
        part = cv2.resize(part, (part.shape[1] // factor, part.shape[0] // factor), interpolation=cv2.INTER_AREA)
    part = np.ascontiguousarray(part, dtype=np.uint8)
    bounds = _bounds(colours, names, known.mean)
    binary, count, white = _selected(part, bounds)
    weight = np.empty_like(binary)
    for one, to in zip(binary, weight, strict=True):
        cv2.GaussianBlur(one, _KERNEL, 0.0, dst=to, borderType=cv2.BORDER_REPLICATE)
    glare = np.zeros((0, 1, 1), dtype=np.uint8) if white is None else _glare(part, bounds, white, binary)
    share = known.share if region else count / max(binary[0].size, 1)
    rim = [
        rim_shift(colours[name]) / factor
        if colours[name].saturation_min > 0.0
        else shift_by_brightness(part, one, bound, factor)
        for name, one, bound in zip(names, binary, bounds, strict=True)
    ]
    return Fields(weight, binary, left, top, factor, share, names, np.array(rim), glare)


def _bounds(colours: dict[str, ColourSettings], names: tuple[str, ...], mean: float) -> NDArray[np.float32]:
    """A row as of `_row` for each colour, in a picture of a mean brightness."""
    gain = MEAN_BRIGHTNESS / max(mean, 1.0)
    return np.array([_row(colours[name], gain) for name in names], dtype=np.float32)


def _selected(
    image: Image, bounds: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8] | None]:
    """Binary pictures, (c, h, w), how many pixels each has, and pixels that are overexposed and of none, if any."""
    binary = np.zeros((len(bounds), *image.shape[:2]), dtype=np.uint8)
    count = np.zeros(len(bounds), dtype=np.int64)
    white = np.zeros(image.shape[:2], dtype=np.uint8)
    some = _select(image, bounds, binary, count, white)
    return binary, count, white if some >= _GLARE_LEAST else None


def _glare(
    image: Image, bounds: NDArray[np.float32], white: NDArray[np.uint8], binary: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Blurred picture, (1, h, w) or (0, 1, 1), of what glare makes pale: overexposed spots `white` and around them."""
    n, label, stats, _ = cv2.connectedComponentsWithStats(white, connectivity=8)
    width, height, area = (stats[:, k] for k in (cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT, cv2.CC_STAT_AREA))
    spots = 1 + np.flatnonzero(
        (width[1:n] <= _GLARE_ACROSS) & (height[1:n] <= _GLARE_ACROSS) & (area[1:n] >= _GLARE_LEAST)
    )
    if len(spots) == 0:
        return np.zeros((0, 1, 1), dtype=np.uint8)
    pale = np.zeros(white.shape, dtype=np.uint8)
    margin = int(_HALO_MOST) + 1
    for i in spots[np.argsort(-area[spots], kind="stable")][:_GLARE_SPOTS]:
        reach = min(max(_HALO * np.sqrt(area[i] / np.pi), _HALO_LEAST), _HALO_MOST)
        x, y = stats[i, cv2.CC_STAT_LEFT], stats[i, cv2.CC_STAT_TOP]
        top, left = max(y - margin, 0), max(x - margin, 0)
        part = np.s_[top : y + height[i] + margin, left : x + width[i] + margin]
        away = cv2.distanceTransform(np.where(label[part] == i, np.uint8(0), np.uint8(1)), cv2.DIST_L2, 5)
        _spread(image, bounds, away, top, left, reach, pale)
    for one in binary:
        pale[one > 0] = 0
    return np.asarray(cv2.GaussianBlur(pale, _KERNEL, 0.0, borderType=cv2.BORDER_REPLICATE), dtype=np.uint8)[None]


@njit(cache=True, error_model="numpy")
def _spread(image, bounds, away, top, left, reach, pale):
    """Pixels of `pale` to 255: within `reach` of an overexposed spot, and pale print next to those.

    `away` is the distance from the spot, of the pixels from `top`, `left` on.
    """
    h, w = away.shape
    stack = np.empty((h * w, 2), dtype=np.int64)
    n = 0
    for i in range(h):
        for j in range(w):
            if away[i, j] <= reach:
                pale[top + i, left + j] = 255
                stack[n, 0], stack[n, 1] = i, j
                n += 1
    while n > 0:
        n -= 1
        i, j = stack[n, 0], stack[n, 1]
        for k in range(max(i - 1, 0), min(i + 2, h)):
            for l in range(max(j - 1, 0), min(j + 2, w)):
                u, v = left + l, top + k
                if pale[v, u] == 0 and away[k, l] <= _HALO_MOST and _tinted(image[v, u], bounds):
                    pale[v, u] = 255
                    stack[n, 0], stack[n, 1] = k, l
                    n += 1


@njit(cache=True, error_model="numpy")
def _tinted(pixel, bounds):
    """Has a pixel the hue of a colour, and less saturation than it takes, yet some?"""
    b, g, r = np.int32(pixel[0]), np.int32(pixel[1]), np.int32(pixel[2])
    high = max(b, g, r)
    spread = high - min(b, g, r)
    if spread == 0:
        return False
    hue = _hue(b, g, r, high, spread)
    for c in range(len(bounds)):
        if _PALE * bounds[c, 2] * high < spread < bounds[c, 2] * high and _inside(hue, bounds[c, 0], bounds[c, 1]):
            return True
    return False


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _hue(b, g, r, high, spread):
    """Hue in degrees, 0 to 360; `high` the greatest of the channels, `spread` above 0 that less the least."""
    if high == r:
        hue = np.float32(60.0) * np.float32(g - b) / np.float32(spread)
    elif high == g:
        hue = np.float32(60.0) * np.float32(b - r) / np.float32(spread) + np.float32(120.0)
    else:
        hue = np.float32(60.0) * np.float32(r - g) / np.float32(spread) + np.float32(240.0)
    return hue + np.float32(360.0) if hue < 0.0 else hue


@njit(cache=True, error_model="numpy", inline="always")
def _inside(hue, low, top):
    """Does a hue lie between two, through 0 where the first is the greater?"""
    return (low <= hue <= top) if low <= top else (hue >= low or hue <= top)


def reduction(diameter: float) -> int:
    """How often to reduce the picture for a ball so many pixels across."""
    return max(int(diameter / _ACROSS), 1)


def _row(colour: ColourSettings, gain: float) -> tuple[float, ...]:
    """Bounds for one picture: hue, saturation, brightness of its own pixels."""
    return (
        colour.hue_min,
        colour.hue_max,
        colour.saturation_min / 255.0,
        colour.saturation_max / 255.0,
        min(colour.value_min / gain, BRIGHTEST),
        colour.value_max / gain,
    )


@njit(cache=True)
def _mean_value(image):
    total = 0
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            total += max(image[i, j, 0], image[i, j, 1], image[i, j, 2])
    return total / (image.shape[0] * image.shape[1])


@njit(cache=True, fastmath=True, error_model="numpy")
def _select(image, bounds, binary, count, white):
    """Pixels of each colour to 255 where the bounds, as `_row` gives them, are met; overexposed others to `white`.

    Gives the number of the latter.
    """
    h, w, _ = image.shape
    n = len(bounds)
    least, darkest, brightest = np.float32(1.0), np.float32(255.0), np.float32(0.0)
    for c in range(n):
        least = min(least, bounds[c, 2])
        darkest = min(darkest, bounds[c, 4])
        brightest = max(brightest, bounds[c, 5])
    grey = np.int32(least * np.float32(256.0))  # of 256: below, no colour whatever the hue
    overexposed, some = np.int32(BRIGHTEST), 0
    low_value, high_value = np.int32(min(darkest, np.float32(255.0))), np.int32(min(brightest, np.float32(255.0)))
    for i in range(h):
        for j in range(w):
            b, g, r = np.int32(image[i, j, 0]), np.int32(image[i, j, 1]), np.int32(image[i, j, 2])
            high = max(b, g, r)
            spread = high - min(b, g, r)
            if high - spread >= overexposed:
                white[i, j] = 255
                some += 1
            if spread * 256 < grey * high or high < low_value or high > high_value:
                continue
            hue = _hue(b, g, r, high, spread) if spread > 0 else np.float32(0.0)
            for c in range(n):
                if (
                    _inside(hue, bounds[c, 0], bounds[c, 1])
                    and bounds[c, 2] * high <= spread <= bounds[c, 3] * high
                    and bounds[c, 4] <= high <= bounds[c, 5]
                ):
                    binary[c, i, j] = 255
                    count[c] += 1
                    some -= white[i, j] > 0
                    white[i, j] = 0
    return some
