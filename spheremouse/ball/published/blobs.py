"""The published disc detector: several grey-value masks, contours, bounds on area and convexity.

Wittich 2017, section 3.6.1 and table 4. Kept as published, as the reference for the default detector: fixed grey
bounds, centroids of contours without any correction, one standard deviation for all.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Detections, Image, no_detections
from spheremouse.ball.settings import BlobSettings

_MEDIAN_PX = 5  # width of the median filter; the thesis does not state it
_OPENING_PX = 3  # width of the opening's square; the thesis does not state it
_SIGMA_PX = 0.1  # sigma_b, standard deviation of a centre per axis (section 4.5)


@dataclass(frozen=True, slots=True)
class BlobDetector:
    """The detector with its settings; it uses no data of the ball."""

    settings: BlobSettings

    def detect(self, image: Image) -> Detections:
        """Blobs in an image (h, w, 3) BGR or (h, w); centres are centroids of contours (eq. 96)."""
        s = self.settings
        grey = image if image.ndim == 2 else _mean_of_channels(image)
        grey = cv2.medianBlur(grey, _MEDIAN_PX)
        kept: list[tuple[float, tuple[float, float], Image]] = []
        for i in range(s.masks):
            mask = cv2.inRange(grey, np.array(s.mask_step * i), np.array(s.mask_step * i + s.mask_width))
            mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((_OPENING_PX, _OPENING_PX), np.uint8))
            contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)  # outlines of holes too
            kept += [blob for c in contours if (blob := self._blob(c)) is not None]
        unique = _without_contained(kept)
        if not unique:
            return no_detections()
        n = len(unique)
        return Detections(
            np.array([centre for _, centre, _ in unique]),
            np.broadcast_to(_SIGMA_PX**2 * np.eye(2), (n, 2, 2)).copy(),
            np.array([area for area, _, _ in unique]),
        )

    def _blob(self, contour: Image) -> tuple[float, tuple[float, float], Image] | None:
        """Area, centroid and outline of a contour that passes eq. 97, 98 and the bound on convexity."""
        area = cv2.contourArea(contour)
        least, largest = self.settings.area
        if not least <= area <= largest:
            return None
        if area < self.settings.convexity * cv2.contourArea(cv2.convexHull(contour)):
            return None
        m = cv2.moments(contour)
        return area, (m["m10"] / m["m00"], m["m01"] / m["m00"]), contour


def _mean_of_channels(image: Image) -> Image:
    """Grey as (r + g + b) / 3."""
    return cv2.transform(image, np.full((1, 3), 1.0 / 3.0))


def _without_contained(
    blobs: list[tuple[float, tuple[float, float], Image]],
) -> list[tuple[float, tuple[float, float], Image]]:
    """Return the largest of the contours that contain each other's centroid: the same blob in several masks."""
    unique: list[tuple[float, tuple[float, float], Image]] = []
    for blob in sorted(blobs, key=lambda b: -b[0]):
        if all(cv2.pointPolygonTest(other[2], blob[1], measureDist=False) < 0 for other in unique):
            unique.append(blob)
    return unique
