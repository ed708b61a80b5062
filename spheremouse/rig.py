"""The rig: everything calibration knows of a device, with covariances. Made by calibration or from a dataset."""

from dataclasses import dataclass, field

import numpy as np

from spheremouse.camera import InteriorOrientation, Pose
from spheremouse.rotation import Array

COLOURS = "CMY"
CODES = ("CMY", "CYM", "MCY", "MYC", "YCM", "YMC")  # inside to outside


@dataclass(frozen=True, slots=True)
class Ball:
    """The sphere, in `obj`. Its centre is the origin by definition; it is uncertain all the same."""

    radius: float  # m, or 1.0 where the scale is free
    centre: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m
    covariance: Array = field(default_factory=lambda: np.zeros((4, 4)))  # (4, 4) m², centre x, y, z and radius


@dataclass(frozen=True, slots=True)
class Targets:
    """Ring targets on the frame; their circles face +Z of `obj`."""

    ids: tuple[int, ...]
    codes: tuple[str, ...]  # colours inside to outside, one of CODES each
    position: Array  # (n, 3) m, obj
    covariance: Array  # (n, 3, 3) m², obj
    radii: Array  # (3,) m: inner disc, middle ring, outer ring


@dataclass(frozen=True, slots=True)
class Rig:
    """A device: camera, ball, frame targets, and what is known of its discs."""

    camera: InteriorOrientation
    ball: Ball
    targets: Targets
    disc_radius: float  # m, along the ball's surface
    readout_s: float = 0.0  # s, time a rolling shutter takes over all rows
    pose: Pose | None = None  # camera pose where it is known beforehand: no targets are needed then
    disc_directions: Array | None = None  # (m, 3) unit vectors in ball, a disc map made earlier
