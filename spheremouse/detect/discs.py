"""The default disc detector: local contrast finds them, a fit of the expected image measures them.

A disc is where the image is darker than its surroundings (grey closing wider than a disc) by a part of them: a ratio,
so that neither the level of the light nor its slope matters. Around each such place the image is fitted by a sloped
background minus a blurred ellipse whose shape the geometry gives; centre, size and contrast come out of the fit, with a
covariance (detect.fit); a fit that lost its rim is none. In use, when the map says where discs must be, each is measured
in a window of its own, and the whole picture is left alone.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.camera import Pose
from spheremouse.detect.cap import Appearance, appearance, ball_mask, largest_disc
from spheremouse.detect.detections import Detections, Image, no_detections
from spheremouse.detect.fit import FitSettings, measure, noise_of, smoothing_kernel
from spheremouse.rig import Rig, directions_at
from spheremouse.rotation import Array
from spheremouse.settings import param

_LENS_BLUR = 0.4  # px, standard deviation of an ordinary lens in focus; the fitted size takes up what differs
_SLIVER_BIAS = 0.15  # px at a semi-minor axis of one pixel
_FINE = 14.0  # px, diameter of a disc that the fit needs no finer: larger pictures are reduced to about that


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
    mask: Image  # (h, w) 255 on the ball, a little within its outline
    window: tuple[slice, slice]  # rows and columns of the ball's bounding box, whole pixels of the reduced picture
    diameter: float  # px, of the largest disc
    fit: FitSettings

    def detect(self, image: Image) -> Detections:
        """Disc candidates in an image (h, w, 3) BGR or (h, w), look-alikes included."""
        places, size = self._dark_places(self._grey(image), self.noise(image))
        directions, index = directions_at(places, self.rig, self.pose)
        seen = appearance(directions, self.rig, self.pose)
        share = size[index] / seen.area
        # half a disc to one with its shadow; of several regions in one place that which covers a disc best
        plausible = (seen.area >= self.settings.min_area) & (share > 0.3) & (share < 2.5) & self._inside(seen)
        best = np.flatnonzero(plausible)[np.argsort(np.abs(np.log(share[plausible])), kind="stable")]
        best = best[_first_of_each(places[index][best], 0.3 * self.diameter)]
        return self.measure(image, places[index][best], seen.take(best))

    def measure(self, image: Image, place: Array, seen: Appearance, share: float = 1.0) -> Detections:
        """Those of n discs that are in an image, expected at centroids `place`, (n, 2) px, and to look like `seen`.

        Of the least contrast that is asked for elsewhere, `share` is enough.
        """
        colours = image if image.ndim == 3 else image[:, :, None]
        fits = measure(colours, self.mask, place, seen.shape, self.noise(image), self.fit, share)
        centre = fits.centroid - (seen.centroid - seen.centre)
        minor = np.sqrt(np.linalg.eigvalsh(seen.shape)[:, 0]) if len(place) else np.zeros(0)
        # where both rims are one blur the limb's own shade draws the centre: from experience with rendered limbs
        floor = self.settings.sigma**2 + (_SLIVER_BIAS / minor**2) ** 2
        covariance = fits.covariance + floor[:, None, None] * np.eye(2)
        best = np.flatnonzero(fits.ok)[np.argsort(-fits.rim[fits.ok], kind="stable")]
        return Detections(centre, covariance, seen.area).take(best[_first_of_each(centre[best], 0.3 * self.diameter)])

    def noise(self, image: Image) -> float:
        """Standard deviation of one pixel, grey values."""
        rows, columns = self.window
        colours = image if image.ndim == 3 else image[:, :, None]
        return noise_of(colours, rows.start, rows.stop, columns.start, columns.stop)

    def _grey(self, image: Image) -> Image:
        """Smoothed grey of the window, reduced, dark discs."""
        grey = image[self.window]
        if grey.ndim == 3:
            grey = cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY)
        f = self.fit.reduction
        if f > 1:
            grey = cv2.resize(grey, (grey.shape[1] // f, grey.shape[0] // f), interpolation=cv2.INTER_AREA)
        if self.settings.polarity == "light":
            grey = cv2.bitwise_not(grey)
        return cv2.GaussianBlur(grey, (0, 0), self.settings.smoothing) if self.settings.smoothing > 0 else grey

    def _dark_places(self, grey: Image, noise: float) -> tuple[Array, Array]:
        """Compact regions darker than what surrounds them: centroids (n, 2) px and areas, px², of the whole picture.

        Looked for at three levels: the low one finds slivers at the limb, the high one parts a disc from a shadow.
        """
        f = self.fit.reduction
        diameter, least = self.diameter / f, 0.3 * self.settings.min_area / f**2
        width = 2 * int(np.ceil(0.75 * diameter)) + 1
        background = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
        deep = cv2.inRange(cv2.subtract(background, grey), np.array(4.0 * noise / f + 1.0), np.array(255.0))
        deep = cv2.bitwise_and(deep, self.mask[self.window][f // 2 :: f, f // 2 :: f])
        places, sizes = [], []
        for share in (0.6, 1.2, 2.4):
            level = cv2.convertScaleAbs(background, alpha=max(1.0 - share * self.settings.contrast, 0.0))
            dark = cv2.bitwise_and(cv2.compare(grey, level, cv2.CMP_LT), deep)
            contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            for contour in contours:
                if len(contour) < 4:
                    continue
                _, _, w, h = cv2.boundingRect(contour)
                if max(w, h) > 1.2 * diameter + 3:
                    continue
                # the outline runs through pixel centres: Pick's theorem gives the pixels it holds
                area = cv2.contourArea(contour) + 0.5 * len(contour) + 1.0
                if area < least:
                    continue
                places.append(_centroid(contour))
                sizes.append(area)
        origin = (self.window[1].start, self.window[0].start)
        return np.array(places).reshape(-1, 2) * f + 0.5 * (f - 1) + origin, np.array(sizes) * f**2

    def _inside(self, seen: Appearance) -> NDArray[np.bool_]:
        """Whose whole ellipse lies in the picture."""
        half = np.sqrt(np.stack([seen.shape[:, 0, 0], seen.shape[:, 1, 1]], axis=1))
        p = seen.centroid
        with np.errstate(invalid="ignore"):
            return np.all((p - half > -0.5) & (p + half < np.array(self.mask.shape[::-1]) - 0.5), axis=1)


def disc_detector(settings: DiscSettings, rig: Rig, pose: Pose) -> DiscDetector:
    """Prepare the detector for a camera that stands still."""
    diameter = largest_disc(rig, pose)
    f = max(int(np.rint(diameter / _FINE)), 1)
    # pixels on the outline mix with the room
    mask = cv2.erode(ball_mask(rig, pose), np.ones((2 * f + 1, 2 * f + 1), np.uint8))
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    height, width = mask.shape
    window = (
        slice(int(rows[0]) // f * f, min((int(rows[-1]) // f + 1) * f, height // f * f)),
        slice(int(columns[0]) // f * f, min((int(columns[-1]) // f + 1) * f, width // f * f)),
    )
    fit = FitSettings(
        f,
        settings.polarity == "light",
        smoothing_kernel(settings.smoothing),
        # rims are blurred by pixels, lens and our own smoothing
        float(np.sqrt(settings.smoothing**2 + 1.0 / 12.0 + (_LENS_BLUR / f) ** 2)),
        settings.contrast,
        settings.size_tolerance,
        settings.rim,
    )
    return DiscDetector(settings, rig, pose, mask, window, diameter, fit)


def _first_of_each(points: Array, radius: float) -> NDArray[np.intp]:
    """Indices of points, (n, 2), that have no earlier one within `radius`."""
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < radius
    return np.flatnonzero(~np.tril(near, -1).any(axis=1))


def _centroid(contour: Image) -> tuple[float, float]:
    m = cv2.moments(contour)
    if m["m00"] > 0:
        return m["m10"] / m["m00"], m["m01"] / m["m00"]
    x, y = contour[:, 0].mean(axis=0)
    return float(x), float(y)
