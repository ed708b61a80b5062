"""The rig: everything calibration knows of a device, with covariances. Made by calibration or from a dataset."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.camera import InteriorOrientation, Pose, unproject
from spheremouse.rotation import Array

COLOURS = "CMY"
CODES = ("CMY", "CYM", "MCY", "MYC", "YCM", "YMC")  # inside to outside


UNKNOWN_READOUT = 0.015  # s: none with a global shutter, up to 30 ms with a slow rolling one


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
    readout_sigma_s: float = 0.0  # s, its standard deviation; UNKNOWN_READOUT where nobody measured it
    exposure_s: float = 0.0  # s, time the shutter is open; 0 where it is short or unknown
    pose: Pose | None = None  # camera pose where it is known beforehand: no targets are needed then
    disc_directions: Array | None = None  # (m, 3) unit vectors in ball, a disc map made earlier


@dataclass(frozen=True, slots=True)
class RayHits:
    """Where image rays first meet the ball, for those of n pixels that do: position = P + scale * ray."""

    ray: Array  # (k, 3) obj, with unit depth in cam
    scale: Array  # (k,) m
    dxy_duv: Array  # (k, 2, 2) Jacobian of the reduced coordinates
    index: NDArray[np.intp]  # (k,) into the pixels


def first_hits(uv: Array, rig: Rig, pose: Pose) -> RayHits:
    """Intersect the rays of pixels, (n, 2), with the ball; the nearer of two points (Wittich 2017, eq. 110-113)."""
    xy, dxy_duv = unproject(uv, rig.camera)
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ pose.rotation.T
    to_centre = rig.ball.centre - pose.position
    a = np.sum(ray * ray, axis=1)
    b = ray @ to_centre
    root = b * b - a * (to_centre @ to_centre - rig.ball.radius**2)
    with np.errstate(invalid="ignore"):
        index = np.flatnonzero((root > 0.0) & (b > 0.0))  # nan (a pixel no ray maps to) compares false: a miss
    return RayHits(ray[index], (b[index] - np.sqrt(root[index])) / a[index], dxy_duv[index], index)


def directions_at(uv: Array, rig: Rig, pose: Pose) -> tuple[Array, NDArray[np.intp]]:
    """Directions from the ball's centre, (k, 3) unit vectors in obj, seen at pixels (n, 2), and the k indices."""
    hits = first_hits(uv, rig, pose)
    return (pose.position + hits.scale[:, None] * hits.ray - rig.ball.centre) / rig.ball.radius, hits.index


def row_delay(v: Array, readout: float, camera: InteriorOrientation) -> Array:
    """Time, s, from a frame's stamp to the exposure of rows v, px: the stamp is that of the middle row."""
    return readout * ((v + 0.5) / camera.height - 0.5)
