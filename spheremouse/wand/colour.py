"""Weight fields of the colours in a picture: 255 inside an area of the colour, 0 farther from it than 2 px.

HSV with the brightness normalised to a mean of 127, six bounds for each colour, binary pictures convolved with a 5 x 5
Gaussian (Grzonka 2005, sections 3.4.2 and 3.4.3). A region of interest and a reduced picture for a large ball keep the
time independent of the ball's size. A further field marks glare, which hides all colours.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.wand.rims import (
    IN_FOCUS,
    OVEREXPOSED,
    RIM_SIGMA,
    Image,
    edge_blur,
    least_cover,
    lens_blur_of,
    rim_shift,
    rim_shift_by_brightness,
)
from spheremouse.wand.settings import ColourSettings

Region = tuple[int, int, int, int]  # left, top, right, bottom px; right and bottom excluded

MEAN_BRIGHTNESS = 127.0
_MIN_FRACTION, _MAX_FRACTION = 0.003, 0.5  # of a colour in the likelihood ratio
_MIN_RIM = 0.2  # of the blur: a rim nearer the true one says little about the blur
_BLUR_GAIN = 0.1  # of a picture: some ten count, as for the exposure
_SHORT_EXPOSURE_S = 0.005  # a longer one shows in the exposure that the tracker estimates
_MIN_LENS_BLUR, _MAX_LENS_BLUR = 0.2, 3.0  # px: the lens cannot be much sharper than a pixel; small discs vanish
FIELD_SIGMA = 1.2  # px of the field: 1.1 of the kernel, 0.5 of thresholding and interpolation
_KERNEL = (5, 5)
_SAMPLE_STEP = 16  # rows and columns, for mean brightness and colours: thousands of pixels suffice
# Glare is the mirror image of the sun, as wide as the gloss is rough. Around an overexposed spot all colours are paler:
# there print shows by its hue, and any other pixel may be print or white.
_HALO_RADII = 1.0  # of an overexposed spot, around it: a gloss lobe has fallen to a tenth at twice its half width
_MIN_HALO, _MAX_HALO = 2.0, 8.0  # px; pale print counts as glare up to the greatest
_MAX_GLARE_SIZE = 38  # px: a larger spot is no mirror image on a ball of at most 128 px, but white, sky or a lamp
_MIN_GLARE_PIXELS = 3  # fewer are noise
_MAX_GLARE_SPOTS = 24  # the largest
_MAX_DIAMETER = 64.0  # px of a ball; a picture of a larger one is reduced: its rims still outweigh the pixels' noise

# Light mixes before the camera's gamma, so a pixel half print, half white has 0.2 of full saturation, as pale things in
# a room have. The bound at 0.37 selects pixels of three quarters print: the rim is a third of a pixel too far inside,
# which `rim_shift` corrects. Red avoids the hues of skin and wood (20 to 35°), blue those of teal and purple.
DEFAULT_COLOURS: dict[str, ColourSettings] = {
    "red": ColourSettings(hue_min=340.0, hue_max=14.0, saturation_min=95.0, value_min=25.0),
    "blue": ColourSettings(hue_min=205.0, hue_max=262.0, saturation_min=95.0, value_min=25.0),
    "dark": ColourSettings(value_max=75.0),
    "light": ColourSettings(value_min=215.0),
}


@dataclass(frozen=True, slots=True)
class Fields:
    """Weight fields of part of a picture that is reduced `factor` times."""

    weight: NDArray[np.uint8]  # (c, h, w), 255 deep within the colour
    binary: NDArray[np.uint8]  # (c, h, w), 255 or 0
    left: int  # px of the whole picture, first column of the fields
    top: int
    factor: int
    fraction: Array  # (c,) of the whole picture's pixels that have the colour
    colours: tuple[str, ...]
    rim: Array  # (c,) px of the field by which a rim between print and white is selected too far outward
    rim_sigma: Array  # (c,) px, its standard deviation
    edge: Array  # (c,) px of the field, standard deviation of a rim's blur
    cover: Array  # (c,) least fraction of print in a selected pixel
    glare: NDArray[np.uint8]  # (1, h, w) 255 inside glare, blurred as `weight`; (0, 1, 1) without glare
    exposure_motion: Array = field(default_factory=lambda: np.zeros(6))  # m, rad in cam: of the ball; 0 if unknown

    kernel: kernels.FieldsView = field(init=False)  # the same for native functions

    def __post_init__(self) -> None:
        place = np.array([self.left, self.top, self.factor], dtype=float)
        fraction = np.clip(self.fraction, _MIN_FRACTION, _MAX_FRACTION)
        rims = np.column_stack([self.rim, self.rim_sigma, self.edge, self.cover])
        view = kernels.FieldsView(self.weight, self.glare, place, fraction, rims, self.exposure_motion)
        object.__setattr__(self, "kernel", view)

    def with_lens_blur(self, lens_blur: Array) -> "Fields":
        """Return the fields with the rims that blur selects.

        `lens_blur` is its standard deviation in each colour, (c,), or in all, (), px of the whole picture.
        """
        edge = np.broadcast_to(edge_blur(lens_blur, self.factor), self.edge.shape)
        wider = edge / self.edge
        return replace(self, rim=wider * self.rim, rim_sigma=wider * self.rim_sigma, edge=edge)

    def learnt_lens_blur(self, offset: Array, speed: float | None) -> Array:
        """Return the blur in each colour, (c,), after a picture whose rims are `offset` px of the field farther out.

        A wrong bound or print moves a rim as blur does, so that each colour has its own. So does motion: a picture in
        which the ball moves at `speed` (px of the whole picture per s) counts less. The first one, without a speed,
        counts in full.
        """
        edge, known = self.edge, np.abs(self.rim) > _MIN_RIM * self.edge
        ratio = np.divide(self.rim + offset, self.rim, out=np.ones(len(edge)), where=known)
        gain = 1.0
        if speed is not None:
            gain = _BLUR_GAIN / (1.0 + (speed * _SHORT_EXPOSURE_S / self.factor / edge) ** 2)
        edge = edge * np.clip(ratio, 0.5, 2.0) ** gain
        return np.clip(lens_blur_of(edge, self.factor), _MIN_LENS_BLUR, _MAX_LENS_BLUR)


@dataclass(frozen=True, slots=True)
class PictureColours:
    """Brightness and colours of a whole picture, from every sixteenth row and column."""

    mean: float  # HSV brightness, 0 to 255
    fraction: Array  # (c,) of the pixels that have each colour


def picture_colours(image: Image, colours: dict[str, ColourSettings], names: tuple[str, ...]) -> PictureColours:
    """Return brightness and colours of a BGR picture, (h, w, 3)."""
    sample = np.ascontiguousarray(image[_SAMPLE_STEP // 2 :: _SAMPLE_STEP, _SAMPLE_STEP // 2 :: _SAMPLE_STEP])
    mean = float(np.mean(np.max(sample, axis=2)))
    _, count, _ = _binary_pictures(sample, _bounds(colours, names, mean))
    return PictureColours(mean, count / sample[:, :, 0].size)


def colour_fields(
    image: Image,
    colours: dict[str, ColourSettings],
    names: tuple[str, ...],
    region: Region | None = None,
    factor: int = 1,
    known: PictureColours | None = None,
) -> Fields:
    """Return weight fields of the colours `names` in a BGR picture, (h, w, 3), or in a region of it.

    The picture is reduced `factor` times. `known` is the result of `picture_colours`, computed here if missing.
    """
    h, w = image.shape[:2]
    known = known or picture_colours(image, colours, names)
    left, top, right, bottom = region or (0, 0, w, h)
    part = image[top:bottom, left:right]
    if factor > 1:
        rows, columns = part.shape[0] // factor, part.shape[1] // factor
        part = part[: rows * factor, : columns * factor]  # a remainder would change the scale
        part = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
    part = np.ascontiguousarray(part, dtype=np.uint8)
    bounds = _bounds(colours, names, known.mean)
    binary, count, white = _binary_pictures(part, bounds)
    weight = np.empty_like(binary)
    for picture, blurred in zip(binary, weight, strict=True):
        cv2.GaussianBlur(picture, _KERNEL, 0.0, dst=blurred, borderType=cv2.BORDER_REPLICATE)
    glare = np.zeros((0, 1, 1), dtype=np.uint8) if white is None else _glare(part, bounds, white, binary)
    fraction = known.fraction if region else count / max(binary[0].size, 1)
    rim = [
        (rim_shift(colours[name]) / factor, RIM_SIGMA, least_cover(colours[name]))
        if colours[name].saturation_min > 0.0
        else rim_shift_by_brightness(part, picture, bound, factor)
        for name, picture, bound in zip(names, binary, bounds, strict=True)
    ]
    shift, sigma, cover = (np.array(each, dtype=float) for each in zip(*rim, strict=True))
    edge = np.full(len(names), edge_blur(IN_FOCUS, factor))
    return Fields(weight, binary, left, top, factor, fraction, names, shift, sigma, edge, cover, glare)


def _bounds(colours: dict[str, ColourSettings], names: tuple[str, ...], mean: float) -> NDArray[np.float32]:
    """Return the bounds of hue, saturation and brightness of each colour, (c, 6), in a picture of a mean brightness."""
    gain = MEAN_BRIGHTNESS / max(mean, 1.0)
    rows = []
    for c in [colours[name] for name in names]:
        saturation = c.saturation_min / 255.0, c.saturation_max / 255.0
        rows.append((c.hue_min, c.hue_max, *saturation, min(c.value_min / gain, OVEREXPOSED), c.value_max / gain))
    return np.array(rows, dtype=np.float32)


def _binary_pictures(
    image: Image, bounds: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8] | None]:
    """Return binary pictures, (c, h, w), their numbers of pixels, and overexposed pixels of no colour, if any."""
    binary, count, white, count_white = kernels.select_colours(image, bounds)
    return binary, count, white if count_white >= _MIN_GLARE_PIXELS else None


def _glare(
    image: Image, bounds: NDArray[np.float32], white: NDArray[np.uint8], binary: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Return the field of glare, (1, h, w), or (0, 1, 1) without any: overexposed spots `white` and their halos."""
    areas, pixels, first = kernels.connected_areas(white, diagonal=True)
    left, top, width, height, area = areas[:, :5].astype(int).T
    spots = np.flatnonzero((width <= _MAX_GLARE_SIZE) & (height <= _MAX_GLARE_SIZE) & (area >= _MIN_GLARE_PIXELS))
    if len(spots) == 0:
        return np.zeros((0, 1, 1), dtype=np.uint8)
    pale = np.zeros(white.shape, dtype=np.uint8)
    margin, (h, w) = int(_MAX_HALO) + 1, white.shape
    for i in spots[np.argsort(-area[spots], kind="stable")][:_MAX_GLARE_SPOTS]:
        reach = float(np.clip(_HALO_RADII * np.sqrt(area[i] / np.pi), _MIN_HALO, _MAX_HALO))
        y, x = max(top[i] - margin, 0), max(left[i] - margin, 0)
        beside = np.ones((min(top[i] + height[i] + margin, h) - y, min(left[i] + width[i] + margin, w) - x), np.uint8)
        beside[tuple((pixels[first[i] : first[i + 1]] - (y, x)).T)] = 0
        distance = np.asarray(cv2.distanceTransform(beside, cv2.DIST_L2, 5), dtype=np.float32)
        kernels.grow_glare(image, bounds, distance, y, x, reach, pale)
    for one in binary:
        pale[one > 0] = 0
    return np.asarray(cv2.GaussianBlur(pale, _KERNEL, 0.0, borderType=cv2.BORDER_REPLICATE), dtype=np.uint8)[None]


def reduction_factor(diameter: float) -> int:
    """Return the factor by which to reduce the picture of a ball of this diameter, px."""
    return max(int(diameter / _MAX_DIAMETER), 1)
