"""Why no disc is found on the ball: what its picture shows in place of discs.

The picture of the ball is judged in the order of what a person mends first: light, focus, and then spots that are no
discs of the rig. Spots are looked for as the detector does (grey closing and opening), but of other sizes, both darker
and lighter than the ball, and fainter. It takes milliseconds: for balls that are not tracked.
"""

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from spheremouse.ball.detect.appearance import ball_mask, largest_disc
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.fit_model import noise_of
from spheremouse.ball.detect.sharpness import blur_of
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose

_ONE_CHANNEL = np.ones(1, dtype=np.float32)
_PRINT = 0.8  # contrast of black print on white
_CLIPPED = 254  # grey value: the last two hold what is blown out
_FINE = 14.0  # px, diameter of a disc in the reduced picture: spots are found as well no finer
_LARGEST = 3.0  # diameter of a spot over that of a disc, at most
_FAINT = 0.05  # contrast of the faintest spots: the unevenness of painted balls is less
_ROUND = 0.8  # area of a spot over that of the ellipse that its box holds; a strut's corner has less
_BLURRED = 2.4  # px: the detector finds few discs of any size in such blur; `blur_of` saturates at 3 to 4
_BLURRED_PART = 0.25  # of a disc's diameter: a Gaussian so wide takes a seventh of its contrast, and its rim
_SOME = 3  # spots: fewer say nothing of all


class Cause(StrEnum):
    """Why no disc is found."""

    DARK = "dark"  # the ball is nearly black
    BRIGHT = "bright"  # the ball is overexposed
    BLURRED = "blurred"  # the lens is out of focus
    LIGHTER = "lighter"  # spots are lighter than the ball; the settings say darker
    DARKER = "darker"  # the reverse
    FAINT = "faint"  # spots have less contrast than the settings ask
    SIZE = "size"  # spots have another size than the rig's discs
    SHAPE = "shape"  # what is darker, or lighter, is no disc
    PLAIN = "plain"  # the ball is of one brightness


@dataclass(frozen=True, slots=True)
class Absence:
    """Why no disc is found, with the figures that show it."""

    cause: Cause
    grey: float  # of the ball, median
    spots: int = 0  # that show it
    contrast: float = 0.0  # of the spots, median
    size: float = 0.0  # px: diameter of the spots, or standard deviation of the blur
    disc: float = 0.0  # px, diameter of a disc of the rig


@dataclass(frozen=True, slots=True)
class _Spot:
    """A compact region of another brightness than the ball around it."""

    size: float  # longer axis over the diameter of a disc
    contrast: float


def why_no_disc(image: Image, rig: Rig, pose: Pose, settings: DiscSettings) -> Absence:
    """Why no disc is found in an image (h, w, 3) BGR or (h, w) whose camera is at `pose`."""
    mask = cv2.erode(ball_mask(rig, pose), np.ones((3, 3), np.uint8))
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    grey = image[window] if image.ndim == 2 else cv2.cvtColor(image[window], cv2.COLOR_BGR2GRAY)
    grey, mask, disc = np.ascontiguousarray(grey), mask[window], largest_disc(rig, pose)
    values = grey[mask > 0]
    middle, noise = float(np.median(values)), noise_of(grey[:, :, None], _ONE_CHANNEL, 0, len(grey), 0, grey.shape[1])
    if np.percentile(values, 95.0) < (4.0 * noise + 1.0) / (0.5 * _PRINT):  # as the detector asks of a disc's edge
        return Absence(Cause.DARK, middle, disc=disc)
    if np.mean(values >= _CLIPPED) > 0.5:
        return Absence(Cause.BRIGHT, middle, disc=disc)
    dark, light = (_spots(g, mask, disc, noise) for g in (grey, cv2.bitwise_not(grey)))
    if settings.polarity == "light":
        own, reverse, wrong = light, _discs(dark, settings), Cause.DARKER
    else:
        own, reverse, wrong = dark, _discs(light, settings), Cause.LIGHTER
    if settings.polarity == "auto" and len(reverse) > len(_discs(own, settings)):
        own = light  # the detector looks for both
    elif len(reverse) >= _SOME and len(reverse) > len(_discs(own, settings)):
        return _shown(wrong, reverse, middle, disc)
    blur = blur_of(grey)
    if blur > min(_BLURRED, _BLURRED_PART * disc):
        return Absence(Cause.BLURRED, middle, size=blur, disc=disc)
    return _by_spots(own, middle, disc, settings)


def _by_spots(spots: list[_Spot], grey: float, disc: float, settings: DiscSettings) -> Absence:
    """What spots of the right polarity lack."""
    clear = [s for s in spots if s.contrast >= settings.contrast]
    alike = _largest_group(clear, settings.size_tolerance)
    size = float(np.median([s.size for s in alike])) if alike else 1.0
    if len(alike) >= _SOME and abs(size - 1.0) > settings.size_tolerance:
        return _shown(Cause.SIZE, alike, grey, disc)
    faint = [s for s in spots if s.contrast < settings.contrast and abs(s.size - 1.0) < settings.size_tolerance]
    if len(faint) >= max(_SOME, len(clear)):
        return _shown(Cause.FAINT, faint, grey, disc)
    return _shown(Cause.SHAPE if spots else Cause.PLAIN, spots, grey, disc)


def _largest_group(spots: list[_Spot], tolerance: float) -> list[_Spot]:
    """Spots of about one size: of all sizes the one with the most and largest of them, clear ones first."""
    groups = [[s for s in spots if abs(s.size / one.size - 1.0) < tolerance] for one in spots]
    return max(groups, key=lambda group: sum(s.size * s.contrast for s in group), default=[])


def _discs(spots: list[_Spot], settings: DiscSettings) -> list[_Spot]:
    """Those of a disc's contrast and size."""
    return [s for s in spots if s.contrast >= settings.contrast and abs(s.size - 1.0) < settings.size_tolerance]


def _shown(cause: Cause, spots: list[_Spot], grey: float, disc: float) -> Absence:
    """A cause with the figures of the spots that show it."""
    if not spots:
        return Absence(cause, grey, disc=disc)
    contrast, size = float(np.median([s.contrast for s in spots])), float(np.median([s.size for s in spots]))
    return Absence(cause, grey, len(spots), contrast, size * disc, disc)


def _spots(grey: Image, mask: Image, disc: float, noise: float) -> list[_Spot]:
    """Compact regions of `grey`, (h, w), darker than what surrounds them, wholly on the ball; `disc` px across."""
    f = max(int(np.rint(disc / _FINE)), 1)
    if f > 1:
        size = (grey.shape[1] // f, grey.shape[0] // f)
        grey, mask = (cv2.resize(g, size, interpolation=cv2.INTER_AREA) for g in (grey, mask))
    on = mask == 255
    calm = cv2.GaussianBlur(grey, (0, 0), 0.8)
    calm[~on] = 0  # the room makes no ball dark
    width = 2 * int(np.ceil(0.5 * _LARGEST * disc / f)) + 1
    around = cv2.morphologyEx(calm, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8)).astype(np.float32)
    depth = around - calm
    contrast = depth / np.maximum(around, 1.0)
    seen = (depth > np.maximum(_FAINT * around, 4.0 * noise / f + 1.0)) & on
    spots = []
    for contour in cv2.findContours(seen.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        x, y, w, h = cv2.boundingRect(contour)
        if max(w, h) < 0.2 * disc / f or min(x, y) == 0:  # noise; or it ends at the edge of the picture
            continue
        box = slice(y - 1, y + h + 1), slice(x - 1, x + w + 1)
        spot = _spot(contour - (x - 1, y - 1), contrast[box], on[box], disc / f)
        if spot is not None:
            spots.append(spot)
    return spots


def _spot(contour: Image, contrast: Image, on: Image, disc: float) -> _Spot | None:
    """The spot in an outline, in the box of that: where half of its contrast is reached.

    None if it is not round, or reaches the limb.
    """
    filled = np.zeros(on.shape, np.uint8)
    cv2.drawContours(filled, [contour], -1, 1, cv2.FILLED)
    strength = float(contrast[filled > 0].max())
    core = ((contrast > 0.5 * strength) & (filled > 0)).astype(np.uint8)
    outline = max(cv2.findContours(core, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
    (_, _), (a, b), _ = cv2.minAreaRect(outline)
    a, b = a + 1.0, b + 1.0  # the outline runs through pixel centres
    area = cv2.contourArea(outline) + 0.5 * len(outline) + 1.0
    inside = on[cv2.dilate(core, np.ones((3, 3), np.uint8)) > 0].all()
    if not inside or area < _ROUND * 0.25 * np.pi * a * b or max(a, b) > _LARGEST * disc:
        return None
    return _Spot(max(a, b) / disc, strength)
