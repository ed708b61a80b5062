"""Models of rig.yaml and camera.yaml: keys, units and bounds; and matrices from their rows."""

from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from spheremouse.ball.rig import CODES, MAX_DISCS
from spheremouse.files.validate import Part, Provenance
from spheremouse.geometry.camera import MAX_SIDE
from spheremouse.geometry.rotation import Array

Code = Literal["CMY", "CYM", "MCY", "MYC", "YCM", "YMC"]
assert get_args(Code) == CODES

# Lengths are in metres, or in any unit where the scale is free: a millionth and a million hold a ball of millimetres as
# well as one of kilometres, and their squares and quotients remain finite.
_MAX_MAGNITUDE = 1e6
Length = Annotated[float, Field(ge=1.0 / _MAX_MAGNITUDE, le=_MAX_MAGNITUDE)]
Coordinate = Annotated[float, Field(ge=-_MAX_MAGNITUDE, le=_MAX_MAGNITUDE)]
Variance = Annotated[float, Field(ge=-(_MAX_MAGNITUDE**2), le=_MAX_MAGNITUDE**2)]
Focal = Annotated[float, Field(ge=1.0, le=_MAX_MAGNITUDE)]  # px: the smallest picture at 170°, and a telescope's
Principal = Annotated[float, Field(ge=-MAX_SIDE, le=2 * MAX_SIDE)]  # px
# Of a long lens, k3 may come out as anything
Distortion = Annotated[float, Field(ge=-_MAX_MAGNITUDE, le=_MAX_MAGNITUDE)]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Row = Annotated[tuple[Variance, ...], Field(max_length=3 * len(CODES))]
Matrix = Annotated[tuple[Row, ...], Field(max_length=3 * len(CODES))]


class CameraPart(Part):
    width: int = Field(gt=0, le=MAX_SIDE, description="width of the images in px")
    height: int = Field(gt=0, le=MAX_SIDE, description="height of the images in px")
    fx: Focal = Field(description="focal length in px")
    fy: Focal = Field(description="focal length in px")
    cx: Principal = Field(description="principal point in px, 0 the centre of the leftmost column")
    cy: Principal = Field(description="principal point in px, 0 the centre of the topmost row")
    dist: tuple[Distortion, Distortion, Distortion, Distortion, Distortion] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0), description="lens distortion [k1, k2, p1, p2, k3], OpenCV's order"
    )
    covariance: Matrix | None = Field(None, description="9 x 9 of fx, fy, cx, cy, k1, k2, p1, p2, k3")


class BallPart(Part):
    radius: Length = Field(description="radius of the ball in m")
    center: Vector3 = Field((0.0, 0.0, 0.0), description="centre [x, y, z] in m, obj; the origin by definition")
    covariance: Matrix | None = Field(None, description="4 x 4 of centre x, y, z and radius in m²")


class TargetPart(Part):
    id: int = Field(ge=-(2**31), lt=2**31, description="a whole number that names the target")
    code: Code = Field(description="colours inside to outside")
    position: Vector3 = Field(description="[x, y, z] in m, obj")
    covariance: Matrix | None = Field(None, description="3 x 3 in m², where the targets are not correlated")


class CameraFile(Part):
    camera: CameraPart = Field(description="width, height, fx, fy, cx, cy and dist of the camera")
    provenance: Provenance | None = Field(None, description="where the numbers come from: a section, for people")


class RigFile(CameraFile):
    ball: BallPart = Field(description="radius of the ball, and its covariance")
    scale: Literal["metric", "free"] = Field(
        "metric", description="metric: lengths are in m; free: in a unit of their own, such as the ball's radius"
    )
    disc_radius: Length | None = Field(
        None, description="radius of a disc in m, along the ball's surface; left out for a ball without discs"
    )
    readout_s: float | None = Field(
        None, ge=0, lt=1, description="time a rolling shutter takes over all rows in s; 0: global; null: unknown"
    )
    exposure_s: float = Field(
        0.0, ge=0, lt=1, description="exposure time in s, for the blur of a fast ball; 0: unknown"
    )
    target_radii: tuple[Length, Length, Length] | None = Field(
        None, description="[inner disc, middle ring, outer ring] in m"
    )
    target_normal: Vector3 = Field(
        (0.0, 0.0, 1.0), description="unit vector [x, y, z] that the targets face, obj; other axes by `calibrate tie`"
    )
    targets: tuple[TargetPart, ...] = Field((), max_length=len(CODES), description="list of {id, code, position}")
    targets_covariance: Matrix | None = Field(
        None, description="3n x 3n in m², x, y, z of the first target, x, y, z of the second, ..."
    )
    targets_ball_covariance: Matrix | None = Field(
        None, description="3n x 4 in m² of the targets' coordinates with the ball's centre x, y, z and radius"
    )
    T_obj_cam: Matrix | None = Field(None, description="4 x 4, a point in camera coordinates to obj")
    pose_covariance: Matrix | None = Field(None, description="6 x 6 of camera position (m) and rotation (rad) in obj")
    pose_ball_covariance: Matrix | None = Field(
        None, description="6 x 4 of the pose with the ball's centre x, y, z and radius"
    )
    pose_by_focal: tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate] | None = Field(
        None, description="error of camera position (m) and rotation (rad) in obj by a relative one of fx and fy"
    )
    discs: tuple[Vector3, ...] = Field((), max_length=MAX_DISCS, description="list of unit vectors [x, y, z] in ball")


def matrix(rows: Matrix | None, n: int, m: int | None = None) -> Array:
    """Return the rows of a file as a matrix, (n, m or n); zeros if it has none."""
    return np.zeros((n, m or n)) if rows is None else np.array(rows, dtype=float)


def block_diagonal(covariance: Array) -> Array:
    """Return the joint covariance, (3n, 3n), of n independent positions with covariances (n, 3, 3)."""
    n = len(covariance)
    joint = np.zeros((n, 3, n, 3))
    joint[np.arange(n), :, np.arange(n)] = covariance
    return joint.reshape(3 * n, 3 * n)


def targets_covariance(file: RigFile) -> Array:
    """Return the covariance of the targets' coordinates, (3n, 3n) m², joint or of independent targets."""
    n = len(file.targets)
    if file.targets_covariance is not None or n == 0:
        return matrix(file.targets_covariance, 3 * n)
    return block_diagonal(np.array([matrix(t.covariance, 3) for t in file.targets]))
