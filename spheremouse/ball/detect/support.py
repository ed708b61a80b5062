"""Pixels of a picture that a detector reads: a masked recording keeps them, so that it gives the same track.

The margins are the reach of the filters:

- around the ball's outline, within the ball's bounding box, one and a half discs: the reach of the closing that
  estimates the brightness of the ball beside a disc;
- for a ball with a pattern, one pixel, by interpolation;
- in the box that the detector takes of the picture, sixteen lines, one pixel high, for measuring the noise.
"""

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscDetector

_NOISE_LINES = 16  # by which the detector measures the noise
# px of the reduced picture around a pixel of the ball: kernel of the fit, and a block cut by the outline
_FIT_BLOCK_PX = 4


def disc_support(detector: DiscDetector, clipped: bool) -> Image:
    """Return a mask, (h, w), of pixels that the disc detector reads; `clipped`: it reads none outside its window."""
    f = detector.lattice.reduction
    rows, columns = detector.window
    closing = 2 * int(np.ceil(0.75 * detector.model.diameter / f))
    smoothing = int(np.ceil(3.0 * detector.settings.smoothing)) + 1
    wide = dilate(detector.model.mask, f * (closing + smoothing + 1))
    mask = dilate(detector.model.mask, f * _FIT_BLOCK_PX)
    if clipped:
        mask[detector.window] |= wide[detector.window]
    else:
        mask |= wide
    return with_noise_lines(mask, rows, columns)


def with_noise_lines(mask: Image, rows: slice, columns: slice) -> Image:
    """Return a mask, (h, w), with the lines of a window by which `kernels.noise_of` measures its noise."""
    step = max((rows.stop - rows.start) // _NOISE_LINES, 1)
    mask[rows.start + step // 2 : rows.stop : step, columns] = 255
    return mask


def dilate(mask: Image, radius_px: int) -> Image:
    """Return a mask, (h, w), with all pixels up to `radius_px` beside its own."""
    side = 2 * radius_px + 1
    return np.asarray(cv2.dilate(mask, np.ones((side, side), np.uint8)), dtype=np.uint8)
