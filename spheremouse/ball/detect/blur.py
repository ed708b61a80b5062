"""Blur of a picture by its edges."""

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image

_ADDED_BLUR = 1.5  # px, standard deviation of the blur that is added
_NOISE_BLUR = 1.0  # px, of a blur before all else, against noise; taken off again
_DIFFERENCE_VARIANCE = 1.0 / 3.0  # px², of a central difference, which is a blur, too
_STEEPEST_SHARE = 1e-3  # part of the picture, whose slope is the measure of others
_MIN_RELATIVE_SLOPE = 0.5  # of that slope, from which on an edge counts
_MIN_SLOPE_OVER_NOISE = 6.0  # times the median slope, which is that of noise


def blur_of(image: Image) -> float:
    """Return the standard deviation, px, of the blur of the steepest edges in an image, (h, w, 3) BGR or (h, w).

    Returns nan without edges. The blur is that of the lens, without the pixels' own.

    A lens in focus gives 0.3 to 0.7. Rings of 4 px are lost in a blur of 2. An edge that is blurred once more loses the
    more of its slope, the sharper it was (Zhuo, Sim 2011, "Defocus map estimation from a single image", eq. 4-6).
    """
    grey = (image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)).astype(np.float32)
    calm = cv2.GaussianBlur(grey, (0, 0), _NOISE_BLUR)
    slope, slope_again = _slope(calm), _slope(cv2.GaussianBlur(calm, (0, 0), _ADDED_BLUR))
    least = max(
        _MIN_RELATIVE_SLOPE * float(np.quantile(slope, 1.0 - _STEEPEST_SHARE)),
        _MIN_SLOPE_OVER_NOISE * float(np.median(slope)),
        1.0,
    )
    steep = (slope >= cv2.dilate(slope, np.ones((3, 3), np.uint8))) & (slope >= least)
    if not steep.any():
        return float("nan")
    ratio = float(np.median(slope[steep] / np.maximum(slope_again[steep], 1e-6)))
    whole = _ADDED_BLUR**2 / max(ratio**2 - 1.0, 1e-6)
    return float(np.sqrt(max(whole - _NOISE_BLUR**2 - _DIFFERENCE_VARIANCE, 0.0)))


def _slope(grey: Image) -> Image:
    """Grey values a pixel, by central differences."""
    x, y = (cv2.Sobel(grey, cv2.CV_32F, *way, ksize=1, scale=0.5) for way in ((1, 0), (0, 1)))
    return cv2.magnitude(x, y)
