"""Diagnosis of a picture: the reason for detecting no disc or pattern on a ball.

The checks follow the order in which a person corrects the faults: light, focus, then spots unlike the rig's discs.
The search for spots uses grey closing and opening, as the detector does. It also accepts other sizes, either polarity
and fainter spots. It takes milliseconds, so use it only while the ball is not tracked.
"""

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from spheremouse.ball.detect.appearance import ball_mask, largest_disc
from spheremouse.ball.detect.blur import blur_of
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose
from spheremouse.native import kernels

_ONE_CHANNEL = np.ones(1, dtype=np.float32)
_PRINT_CONTRAST = 0.8  # contrast of black print on white
_CLIPPED_GREY = 254  # grey value: overexposed pixels have this one or 255
_REDUCED_DIAMETER = 14.0  # px, diameter of a disc in the reduced picture: a finer picture shows no more spots
_MAX_SPOT_SIZE = 3.0  # largest diameter of a spot, in diameters of a disc
_MIN_SPOT_CONTRAST = 0.05  # contrast of the faintest spots: uneven paint has less
_MIN_ROUNDNESS = 0.8  # least area of a spot over that of the ellipse in its box; a strut's corner has less
_MAX_BLUR = 2.4  # px: in such blur slivers and ring targets are lost; `blur_of` saturates at 3 to 4
_MAX_RELATIVE_BLUR = 0.25  # of a disc's diameter: so wide a Gaussian removes a seventh of the contrast, and the rim
_MIN_SPOTS = 3  # spots: fewer are no evidence for the whole ball


class Cause(StrEnum):
    """Reason for detecting no disc."""

    DARK = "dark"  # the ball is nearly black
    BRIGHT = "bright"  # the ball is overexposed
    BLURRED = "blurred"  # the lens is out of focus
    LIGHTER = "lighter"  # spots are lighter than the ball; the settings expect darker ones
    DARKER = "darker"  # spots are darker than the ball; the settings expect lighter ones
    FAINT = "faint"  # spots have less contrast than the settings require
    SIZE = "size"  # spots have another size than the rig's discs
    SHAPE = "shape"  # the darker or lighter regions are not discs
    PLAIN = "plain"  # the ball is of one brightness
    UNTURNED = "unturned"  # of a pattern: nothing has turned as the ball does
    UNPATTERNED = "unpatterned"  # of a pattern: much of the ball shows none
    UNLIKE = "unlike"  # of a pattern: the picture does not fit it


@dataclass(frozen=True, slots=True)
class Absence:
    """Reason for detecting no disc, with the measurements that support it."""

    cause: Cause
    grey: float  # median of the ball
    spots: int = 0  # number that support the cause
    contrast: float = 0.0  # median of the spots
    size: float = 0.0  # px: diameter of the spots, or standard deviation of the blur
    disc: float = 0.0  # px, diameter of a disc of the rig
    plain: float = 0.0  # part of the ball in view, 0 to 1, without a pattern above the noise


@dataclass(frozen=True, slots=True)
class _Spot:
    """Compact region that is darker or lighter than the ball around it."""

    size: float  # longer axis over the diameter of a disc
    contrast: float


def why_no_disc(image: Image, rig: Rig, pose: Pose, settings: DiscSettings) -> Absence:
    """Return the reason for detecting no disc in an image, (h, w, 3) BGR or (h, w), from a camera at `pose`."""
    grey, mask = _ball(image, rig, pose)
    middle, noise, fault = _exposure(grey, mask)
    disc = largest_disc(rig, pose)
    if fault is not None:
        return Absence(fault, middle, disc=disc)
    dark, light = (_spots(g, mask, disc, noise) for g in (grey, cv2.bitwise_not(grey)))
    if settings.polarity == "light":
        own, reverse, wrong = light, _discs(dark, settings), Cause.DARKER
    else:
        own, reverse, wrong = dark, _discs(light, settings), Cause.LIGHTER
    if settings.polarity == "auto" and len(reverse) > len(_discs(own, settings)):
        own = light  # the detector accepts both polarities
    elif len(reverse) >= _MIN_SPOTS and len(reverse) > len(_discs(own, settings)):
        return _with_evidence(wrong, reverse, middle, disc)
    blur = blur_of(grey)
    if blur > min(_MAX_BLUR, _MAX_RELATIVE_BLUR * disc):
        return Absence(Cause.BLURRED, middle, size=blur, disc=disc)
    return _by_spots(own, middle, disc, settings)


def why_no_pattern(image: Image, rig: Rig, pose: Pose, known: bool) -> Absence:
    """Return the reason for not following a ball by its pattern, which is `known` once the ball has turned."""
    grey, mask = _ball(image, rig, pose)
    middle, _, fault = _exposure(grey, mask)
    blur = blur_of(grey)
    if fault is None and blur > _MAX_BLUR:
        return Absence(Cause.BLURRED, middle, size=blur)
    return Absence(fault or (Cause.UNLIKE if known else Cause.UNTURNED), middle)


def _ball(image: Image, rig: Rig, pose: Pose) -> tuple[Image, Image]:
    """Return grey values and mask, (h, w), of the ball's bounding box."""
    mask = cv2.erode(ball_mask(rig, pose), np.ones((3, 3), np.uint8))
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    grey = image[window] if image.ndim == 2 else cv2.cvtColor(image[window], cv2.COLOR_BGR2GRAY)
    return np.ascontiguousarray(grey, dtype=np.uint8), mask[window]


def _exposure(grey: Image, mask: Image) -> tuple[float, float, Cause | None]:
    """Return the ball's median grey value, the picture's noise, and the fault if the ball is too dark or bright.

    `grey` and `mask`, (h, w), are those of `_ball`. The noise is a standard deviation, in grey values. The ball is too
    dark if the detector would not see the edge of a printed disc in its brightest part.
    """
    values = grey[mask > 0]
    noise = kernels.noise_of(grey[:, :, None], _ONE_CHANNEL, 0, len(grey), 0, grey.shape[1])
    fault = None
    least_edge = 4.0 * noise + 1.0  # grey values: the detector's limit, at half of a disc's contrast
    if np.percentile(values, 95.0) < least_edge / (0.5 * _PRINT_CONTRAST):
        fault = Cause.DARK
    elif np.mean(values >= _CLIPPED_GREY) > 0.5:
        fault = Cause.BRIGHT
    return float(np.median(values)), noise, fault


def _by_spots(spots: list[_Spot], grey: float, disc: float, settings: DiscSettings) -> Absence:
    """Return the cause that spots of the expected polarity show."""
    clear = [s for s in spots if s.contrast >= settings.contrast]
    alike = _largest_group(clear, settings.size_tolerance)
    size = float(np.median([s.size for s in alike])) if alike else 1.0
    if len(alike) >= _MIN_SPOTS and abs(size - 1.0) > settings.size_tolerance:
        return _with_evidence(Cause.SIZE, alike, grey, disc)
    faint = [s for s in spots if s.contrast < settings.contrast and abs(s.size - 1.0) < settings.size_tolerance]
    if len(faint) >= max(_MIN_SPOTS, len(clear)):
        return _with_evidence(Cause.FAINT, faint, grey, disc)
    return _with_evidence(Cause.SHAPE if spots else Cause.PLAIN, spots, grey, disc)


def _largest_group(spots: list[_Spot], tolerance: float) -> list[_Spot]:
    """Return the spots of similar size, within a relative `tolerance`, with the largest sum of size times contrast."""
    groups = [[s for s in spots if abs(s.size / one.size - 1.0) < tolerance] for one in spots]
    return max(groups, key=lambda group: sum(s.size * s.contrast for s in group), default=[])


def _discs(spots: list[_Spot], settings: DiscSettings) -> list[_Spot]:
    """Return the spots with a disc's contrast and size."""
    return [s for s in spots if s.contrast >= settings.contrast and abs(s.size - 1.0) < settings.size_tolerance]


def _with_evidence(cause: Cause, spots: list[_Spot], grey: float, disc: float) -> Absence:
    """Return a cause with the median contrast and size of the spots that support it."""
    if not spots:
        return Absence(cause, grey, disc=disc)
    contrast, size = float(np.median([s.contrast for s in spots])), float(np.median([s.size for s in spots]))
    return Absence(cause, grey, len(spots), contrast, size * disc, disc)


def _spots(grey: Image, mask: Image, disc: float, noise: float) -> list[_Spot]:
    """Return the compact regions of `grey`, (h, w), that are darker than their surroundings and wholly on the ball.

    `disc` px is the diameter of a disc of the rig.
    """
    f = max(int(np.rint(disc / _REDUCED_DIAMETER)), 1)
    if f > 1:
        size = (grey.shape[1] // f, grey.shape[0] // f)
        grey, mask = (cv2.resize(g, size, interpolation=cv2.INTER_AREA) for g in (grey, mask))
    on = mask == 255
    calm = cv2.GaussianBlur(grey, (0, 0), 0.8)
    calm[~on] = 0  # so that a bright background does not make the limb a dark region
    width = 2 * int(np.ceil(0.5 * _MAX_SPOT_SIZE * disc / f)) + 1
    around = cv2.morphologyEx(calm, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8)).astype(np.float32)
    depth = around - calm
    contrast = depth / np.maximum(around, 1.0)
    seen = (depth > np.maximum(_MIN_SPOT_CONTRAST * around, 4.0 * noise / f + 1.0)) & on
    spots = []
    for contour in cv2.findContours(seen.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        x, y, w, h = cv2.boundingRect(contour)
        if max(w, h) < 0.2 * disc / f or min(x, y) == 0:  # noise, or a region at the edge of the picture
            continue
        box = slice(y - 1, y + h + 1), slice(x - 1, x + w + 1)
        spot = _spot(contour - (x - 1, y - 1), contrast[box], on[box], disc / f)
        if spot is not None:
            spots.append(spot)
    return spots


def _spot(contour: Image, contrast: Image, on: Image, disc: float) -> _Spot | None:
    """Return the spot within a contour, limited to pixels above half of its peak contrast.

    The contour and the arrays `contrast` and `on`, (h, w), share the coordinates of the contour's box. `disc` px is
    the diameter of a disc. Returns None if the spot is not round, is too large or reaches the limb.
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
    if not inside or area < _MIN_ROUNDNESS * 0.25 * np.pi * a * b or max(a, b) > _MAX_SPOT_SIZE * disc:
        return None
    return _Spot(max(a, b) / disc, strength)
