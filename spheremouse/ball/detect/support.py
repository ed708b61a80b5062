"""Pixels of a picture that a detector reads: a masked recording keeps them, so that it gives the same track.

The margins are the reach of the filters:

- around the ball's outline, within the ball's bounding box, one and a half discs: the reach of the closing that
  estimates the brightness of the ball beside a disc;
- in that box, also for a ball with a pattern, sixteen lines, one pixel high, for measuring the noise of the picture.
"""

import cv2
import numpy as np

from spheremouse.ball.detect.appearance import clear_mask
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose

_NOISE_LINES = 16  # by which the detector measures the noise
_FIT = 4  # px of the reduced picture around a pixel of the ball: kernel of the fit, and a block cut by the outline


def disc_support(detector: DiscDetector, clipped: bool) -> Image:
    """Return a mask, (h, w), of pixels that the disc detector reads; `clipped`: it reads none outside its window."""
    f = detector.lattice.reduction
    rows, columns = detector.window
    closing = 2 * int(np.ceil(0.75 * detector.model.diameter / f))
    smoothing = int(np.ceil(3.0 * detector.settings.smoothing)) + 1
    wide = _grown(detector.model.mask, f * (closing + smoothing + 1))
    mask = _grown(detector.model.mask, f * _FIT)
    if clipped:
        mask[detector.window] |= wide[detector.window]
    else:
        mask |= wide
    return _with_noise_lines(mask, rows, columns)


def pattern_support(rig: Rig, pose: Pose) -> Image:
    """Return a mask, (h, w), of pixels that are read for the ball's pattern."""
    mask = clear_mask(rig, pose)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return _with_noise_lines(mask, slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))


def _with_noise_lines(mask: Image, rows: slice, columns: slice) -> Image:
    step = max((rows.stop - rows.start) // _NOISE_LINES, 1)
    mask[rows.start + step // 2 : rows.stop : step, columns] = 255
    return mask


def _grown(mask: Image, by: int) -> Image:
    side = 2 * by + 1
    return np.asarray(cv2.dilate(mask, np.ones((side, side), np.uint8)), dtype=np.uint8)
