"""The default disc detector: local contrast finds them, a fit of the expected image measures them.

A disc is where the image is darker than its surroundings (grey closing wider than a disc) by a part of them: a ratio,
so that neither the level of the light nor its slope matters. Around each such place the image is fitted by a sloped
background minus a blurred ellipse whose shape the geometry gives; centre, size and contrast come out of the fit, with a
covariance. Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight); a fit that lost
its rim is none.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.camera import Pose
from spheremouse.detect.cap import Appearance, appearance, ball_mask, largest_disc
from spheremouse.detect.detections import Detections, Image, no_detections
from spheremouse.detect.fit import DiscFit
from spheremouse.rig import Rig, directions_at
from spheremouse.rotation import Array
from spheremouse.settings import param

_LENS_BLUR = 0.4  # px, standard deviation of an ordinary lens in focus; the fitted size takes up what differs
_SLIVER = 2.0  # px, semi-minor axis below which both rims are one blur
_SLIVER_BIAS = 0.15  # px at a semi-minor axis of one pixel
_SIZE = 0.02  # discs cut from one sheet differ by this part of their size
_RIM_OFF = 0.35  # px by which lens blur and gloss may shift a rim: to a sliver's size that is a lot


@dataclass(frozen=True, slots=True)
class DiscSettings:
    """What a disc is, beyond its geometry."""

    polarity: Literal["dark", "light"] = param("dark", "-", "discs darker or lighter than the ball")
    contrast: float = param(
        0.25,
        "-",
        "least darkness against the background; print is 0.8, haze and gloss halve it, its edge is at half of that",
        gt=0,
        lt=1,
    )
    smoothing: float = param(0.8, "px", "standard deviation of the Gaussian before all else: about one pixel", ge=0)
    size_tolerance: float = param(
        0.25,
        "-",
        "fitted over expected size may differ from 1 by this part: hand-cut discs, glare on a rim",
        gt=0,
        lt=1,
    )
    rim: float = param(
        0.7,
        "-",
        "least part of a disc's rim that must fit: with a fifth hidden, a cut still passes for a rim",
        gt=0,
        le=1,
    )
    min_area: float = param(10.0, "px²", "smaller discs are not looked for: 3.6 px across, the size of noise", gt=0)
    sigma: float = param(
        0.03, "px", "floor of a centre's standard deviation: sampling, unevenness of light, print", gt=0
    )


@dataclass(frozen=True, slots=True)
class DiscDetector:
    """Everything that stays the same while the camera stands."""

    settings: DiscSettings
    rig: Rig
    pose: Pose
    window: tuple[slice, slice]  # rows and columns of the ball's bounding box
    mask: Image  # 255 on the ball within the window
    diameter: float  # px, of the largest disc

    def detect(self, image: Image) -> Detections:
        """Disc candidates in an image (h, w, 3) BGR or (h, w), look-alikes included."""
        grey, noise = self._grey(image)
        places, size, background = self._dark_places(grey, noise)
        directions, index = directions_at(places + self.origin, self.rig, self.pose)
        seen = appearance(directions, self.rig, self.pose)
        share = size[index] / seen.area
        # half a disc to one with its shadow; of several regions in one place that which covers a disc best
        plausible = (seen.area >= self.settings.min_area) & (share > 0.3) & (share < 2.5) & self._inside(seen)
        best = np.flatnonzero(plausible)[np.argsort(np.abs(np.log(share[plausible])), kind="stable")]
        best = best[_first_of_each(places[index][best], 0.3 * self.diameter)]
        return self._fit(grey, noise, places[index][best], background[index][best], seen.take(best))

    def _grey(self, image: Image) -> tuple[Image, float]:
        """Smoothed grey of the window, dark discs, and the noise of one pixel before smoothing, grey values."""
        grey = image[self.window]
        if grey.ndim == 3:
            grey = cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY)
        if self.settings.polarity == "light":
            grey = cv2.bitwise_not(grey)
        grey = grey.astype(np.float32)
        noise = _noise(grey)
        if self.settings.smoothing > 0:
            grey = cv2.GaussianBlur(grey, (0, 0), self.settings.smoothing)
        return grey, noise

    def _dark_places(self, grey: Image, noise: float) -> tuple[Array, Array, Array]:
        """Compact regions darker than what surrounds them: centroids (n, 2) px in the window, areas, backgrounds.

        Looked for at three levels: the low one finds slivers at the limb, the high one parts a disc from a shadow.
        """
        flat = grey.astype(np.uint8)
        width = 2 * int(np.ceil(0.75 * self.diameter)) + 1
        background = cv2.morphologyEx(flat, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
        deep = cv2.inRange(cv2.subtract(background, flat), np.array(4.0 * noise + 1.0), np.array(255.0))
        deep = cv2.bitwise_and(deep, self.mask)
        places, sizes = [], []
        for share in (0.6, 1.2, 2.4):
            level = cv2.convertScaleAbs(background, alpha=max(1.0 - share * self.settings.contrast, 0.0))
            dark = cv2.bitwise_and(cv2.compare(flat, level, cv2.CMP_LT), deep)
            contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            for contour in contours:
                if len(contour) < 4:
                    continue
                _, _, w, h = cv2.boundingRect(contour)
                if max(w, h) > 1.2 * self.diameter + 3:
                    continue
                # the outline runs through pixel centres: Pick's theorem gives the pixels it holds
                area = cv2.contourArea(contour) + 0.5 * len(contour) + 1.0
                if area < 0.3 * self.settings.min_area:
                    continue
                places.append(_centroid(contour))
                sizes.append(area)
        where = np.array(places, dtype=float).reshape(-1, 2)
        at = np.rint(where).astype(int)
        return where, np.array(sizes, dtype=float), background[at[:, 1], at[:, 0]].astype(float)

    def _fit(self, grey: Image, noise: float, start: Array, background: Array, seen: Appearance) -> Detections:
        """Fit the expected image around each start, (n, 2) px in the window; keep what is a disc.

        First with the size free, which tells discs from other things and the size all discs share; then with that size
        held, so that a disc cut by a strut is seen as cut, not as smaller.
        """
        if len(start) == 0:
            return no_detections()
        at = np.rint(start).astype(int)
        contrast = background - grey[at[:, 1], at[:, 0]]
        fit = DiscFit.begin(grey, self.mask, start, seen.shape, background, contrast, noise, self._blur, self.diameter)
        fit = fit.step(1.0, 0.4 * self.settings.size_tolerance, np.inf)
        keep = fit.deep(0.5 * self.settings.contrast) & (np.abs(fit.size - 1.0) < 2.0 * self.settings.size_tolerance)
        if not np.any(keep):
            return no_detections()
        fit, seen = fit.take(keep), seen.take(keep)  # what is hopeless costs no more than one step
        fit = fit.step(1.0, 0.4 * self.settings.size_tolerance, 0.5)
        sliver = np.sqrt(np.linalg.eigvalsh(seen.shape)[:, 0])  # semi-minor axis, px
        off = np.abs(fit.size - 1.0)
        keep = fit.deep(self.settings.contrast) & (off < np.maximum(self.settings.size_tolerance, _RIM_OFF / sliver))
        if not np.any(keep):
            return no_detections()
        fit, seen, sliver = fit.take(keep), seen.take(keep), sliver[keep]
        common = _common_size(fit.size, sliver)
        for limit in (0.5, 0.35, 0.25, 0.25):
            fit = fit.step(common, _SIZE + _RIM_OFF / 3.0 / sliver, limit)
        whole = 2.0 * np.pi * np.sqrt(np.trace(seen.shape, axis1=1, axis2=2) / 2.0)  # px, the rim integrated across
        rim = fit.rim() / whole
        # the far rim of a sliver drowns in the limb; half of it, with the known size, still fixes the centre
        least = np.where(sliver < _SLIVER, min(0.45, self.settings.rim), self.settings.rim)
        ok = fit.deep(self.settings.contrast) & (rim > least) & fit.settled()
        centre = fit.centre + self.origin - (seen.centroid - seen.centre)
        # where both rims are one blur the limb's own shade draws the centre: from experience with rendered limbs
        floor = self.settings.sigma**2 + (_SLIVER_BIAS / sliver**2) ** 2
        covariance = fit.covariance() + floor[:, None, None] * np.eye(2)
        best = np.flatnonzero(ok)[np.argsort(-rim[ok], kind="stable")]
        return Detections(centre, covariance, seen.area).take(best[_first_of_each(centre[best], 0.3 * self.diameter)])

    @property
    def _blur(self) -> float:
        """Standard deviation of a rim's blur, px: pixels, lens, and our own smoothing."""
        return float(np.sqrt(self.settings.smoothing**2 + 1.0 / 12.0 + _LENS_BLUR**2))

    def _inside(self, seen: Appearance) -> NDArray[np.bool_]:
        """Whose whole ellipse lies in the window."""
        half = np.sqrt(np.stack([seen.shape[:, 0, 0], seen.shape[:, 1, 1]], axis=1))
        p = seen.centroid - self.origin
        with np.errstate(invalid="ignore"):
            return np.all((p - half > -0.5) & (p + half < np.array(self.mask.shape[::-1]) - 0.5), axis=1)

    @property
    def origin(self) -> Array:
        """(2,) px, the window's first column and row."""
        return np.array([self.window[1].start, self.window[0].start], dtype=float)


def disc_detector(settings: DiscSettings, rig: Rig, pose: Pose) -> DiscDetector:
    """Prepare the detector for a camera that stands still."""
    mask = cv2.erode(ball_mask(rig, pose), np.ones((3, 3), np.uint8))  # pixels on the outline mix with the room
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    window = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    return DiscDetector(settings, rig, pose, window, mask[window].copy(), largest_disc(rig, pose))


def _first_of_each(points: Array, radius: float) -> NDArray[np.intp]:
    """Indices of points, (n, 2), that have no earlier one within `radius`."""
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < radius
    return np.flatnonzero(~np.tril(near, -1).any(axis=1))


def _noise(grey: Image) -> float:
    """Standard deviation of a pixel, grey values, from second differences along every eighth row."""
    rows = grey[::8]
    difference = rows[:, 1:-1] - 0.5 * (rows[:, :-2] + rows[:, 2:])
    return max(float(np.median(np.abs(difference))) * 1.4826 / np.sqrt(1.5), 0.29)


def _centroid(contour: Image) -> tuple[float, float]:
    m = cv2.moments(contour)
    if m["m00"] > 0:
        return m["m10"] / m["m00"], m["m01"] / m["m00"]
    x, y = contour[:, 0].mean(axis=0)
    return float(x), float(y)


def _common_size(size: Array, sliver: Array) -> float:
    """The size all discs share, from those large enough to tell; 1 where fewer than three do."""
    large = size[sliver > 3.0]
    return float(np.median(large)) if len(large) >= 3 else 1.0
