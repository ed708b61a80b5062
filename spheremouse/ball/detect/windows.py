"""Measurement of discs, each in its own window: directions on the ball to centres in the image.

The geometry (detect.appearance) gives each disc's place when its row is read, its shape, and its motion during the
exposure. `fit.cpp` measures it. The fit of a known disc begins at the expected place, and a part of the contrast
suffices. The fit of a dark spot begins at the spot. Discs that are not wholly in the image are left out.
"""

from typing import NamedTuple

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.projection import Projection
from spheremouse.ball.rig import BallView
from spheremouse.geometry.rotation import Array


class FitSettings(NamedTuple):
    """Parameters of the discs and the camera for the fit."""

    projection: Projection  # of colours, in which discs are darker than the ball
    smoothing: float  # px, standard deviation of a Gaussian of seven pixels
    blur: float  # px, standard deviation of a rim's blur: pixels, lens and smoothing
    contrast: float  # least contrast over the light of the lighter of disc and ball
    size_tolerance: float  # largest deviation of fitted over expected size from 1
    rim: float  # least part of the rim that fits
    sigma: float  # px, floor of a centre's standard deviation


class DiscModel(NamedTuple):
    """Discs, camera and ball of a detector for one camera pose, for the kernels."""

    ball: BallView
    mask: Image  # (h, w) 255 on the ball, a little within its outline
    exposure: float  # s
    fit: FitSettings
    min_area: float  # px², smaller discs are left out
    diameter: float  # px, of the largest disc


class Motion(NamedTuple):
    """Motion of the ball during a frame."""

    rate: Array  # (3,) rad/s, w_obj
    readout: float  # s, of all rows
    interval: float = 0.0  # s since the same discs were measured before; 0: they were not


ANYWHERE = np.zeros((0, 2))
AT_REST = Motion(np.zeros(3), 0.0)
