"""Intersection of image rays with the ball: disc centres in pixels to points on the sphere with covariances.

Wittich 2017, section 3.8 (eq. 110-120), by implicit differentiation in closed form instead of a Gauss-Helmert
adjustment per disc; both give the same covariance (tests/ball/test_points.py).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.rig import Rig, view_of
from spheremouse.geometry.camera import Pose, row_of, unprojected
from spheremouse.geometry.rotation import Array


class Centres(Protocol):
    """Points in an image, as `Detections` has them."""

    @property
    def centre(self) -> Array: ...  # (n, 2) px
    @property
    def covariance(self) -> Array: ...  # (n, 2, 2) px²


@dataclass(frozen=True, slots=True)
class SpherePoints:
    """First intersections of image rays with the ball, for the n detections with rays that meet it."""

    position: Array  # (n, 3) m, obj
    covariance: Array  # (n, 3, 3) m², obj: image noise, camera pose and ball together
    direction: Array  # (n, 3) unit vectors from the ball's centre, obj
    image_covariance: Array  # (n, 3, 3) m², obj: the part that is new in every frame (image noise alone)
    dposition_dpose: Array  # (n, 3, 6) of the pose's error model: m, rad
    dposition_dball: Array  # (n, 3, 4) of centre and radius
    delay: Array  # (n,) s from the frame's stamp to the exposure of the point's row (rolling shutter)
    row: Array  # (n,) that row, from -1/2 at the top of the image to 1/2 at its bottom
    index: NDArray[np.intp]  # (n,) into the detections

    def __len__(self) -> int:
        return len(self.position)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "SpherePoints":
        """Return the entries of a mask (n,), of indices (k,) or of a slice."""
        return SpherePoints(*(getattr(self, name)[keep] for name in self.__slots__))


def intersect(detections: Centres, rig: Rig, pose: Pose) -> SpherePoints:
    """Intersect the rays of all detections with the ball, without rays that miss it (`index` lists the others).

    The result is the nearer of the two points (Wittich 2017, eq. 110-113). With F(B) = |B - K| - R = 0 and B = P + s r,
    differentiation gives dB = (I - r nᵀ / (nᵀ r)) (dP + s dr) + r / (nᵀ r) (nᵀ dK + dR), n the outward normal.
    Close to the limb nᵀ r goes to zero and the covariance grows without bound, as it should.
    """
    return SpherePoints(
        *_intersect(
            detections.centre,
            np.ascontiguousarray(detections.covariance),
            view_of(rig, pose),
            rig.readout_s,
            pose.covariance,
            rig.ball.covariance,
            pose.ball_covariance,
        )
    )


def directions_at(uv: Array, rig: Rig, pose: Pose) -> tuple[Array, NDArray[np.intp]]:
    """Return the directions, (k, 3) unit vectors in obj, of the points seen at pixels (n, 2), and their k indices."""
    return directions_in(np.ascontiguousarray(uv, dtype=np.float64), view_of(rig, pose))


@njit(cache=True, error_model="numpy")
def directions_in(uv, view):
    """Return the result of `directions_at` for pixels, (n, 2), in the BallView `view`."""
    n = len(uv)
    xy, dxy_duv = np.empty((n, 2)), np.empty((n, 2, 2))
    unprojected(uv, view.intrinsic, view.distortion, view.fold_r2, xy, dxy_duv)
    direction, index, ray = np.empty((n, 3)), np.empty(n, dtype=np.intp), np.empty(3)
    met = 0
    for i in range(n):
        s = _first_hit(xy[i], view, ray)
        if np.isfinite(s):
            for j in range(3):
                direction[met, j] = (view.position[j] + s * ray[j] - view.centre[j]) / view.radius
            index[met] = i
            met += 1
    return direction[:met], index[:met]


@njit(cache=True, error_model="numpy")
def _first_hit(xy, view, ray):
    """Return the scale at which the ray of reduced coordinates `xy`, (2,), first meets the ball; nan if it misses.

    The point is position + scale * ray, with `ray`, (3,), of unit depth in cam, written in obj. The nearer of two
    points is taken (Wittich 2017, eq. 110-113).
    """
    rotation, P, K = view.rotation, view.position, view.centre
    a, b, far = 0.0, 0.0, -view.radius * view.radius
    for j in range(3):
        ray[j] = rotation[j, 0] * xy[0] + rotation[j, 1] * xy[1] + rotation[j, 2]
        a += ray[j] * ray[j]
        b += ray[j] * (K[j] - P[j])
        far += (K[j] - P[j]) ** 2
    root = b * b - a * far
    if root > 0.0 and b > 0.0:  # nan (a pixel no ray maps to) compares false: a miss
        return (b - np.sqrt(root)) / a
    return np.nan


@njit(cache=True, error_model="numpy")
def _intersect(centre, noise, view, readout, pose_covariance, ball_covariance, cross_covariance):
    """Return the fields of SpherePoints for the rays that meet the ball."""
    rotation, P, K, R = view.rotation, view.position, view.centre, view.radius
    n, correlated = len(centre), cross_covariance.any()
    xy, dxy_duv = np.empty((n, 2)), np.empty((n, 2, 2))
    unprojected(centre, view.intrinsic, view.distortion, view.fold_r2, xy, dxy_duv)
    position, covariance, direction = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    image_covariance, J_pose, J_ball = np.empty((n, 3, 3)), np.empty((n, 3, 6)), np.empty((n, 3, 4))
    row, index = np.empty(n), np.empty(n, dtype=np.intp)
    met = 0
    ray, normal, J_image = np.empty(3), np.empty(3), np.empty((3, 2))
    slide = np.empty((3, 3))
    for i in range(len(xy)):
        s = _first_hit(xy[i], view, ray)
        if not np.isfinite(s):
            continue
        along = 0.0
        for j in range(3):
            position[met, j] = P[j] + s * ray[j]
            normal[j] = (position[met, j] - K[j]) / R
            direction[met, j] = normal[j]
            along += normal[j] * ray[j]  # negative: the near side faces the camera
        for j in range(3):
            for k in range(3):
                slide[j, k] = (1.0 if j == k else 0.0) - ray[j] / along * normal[k]
                J_pose[met, j, k] = slide[j, k]
                J_ball[met, j, k] = ray[j] / along * normal[k]
            J_ball[met, j, 3] = ray[j] / along
        for j in range(3):
            # -s hat(ray), turned into the surface
            J_pose[met, j, 3] = -s * (slide[j, 1] * ray[2] - slide[j, 2] * ray[1])
            J_pose[met, j, 4] = -s * (slide[j, 2] * ray[0] - slide[j, 0] * ray[2])
            J_pose[met, j, 5] = -s * (slide[j, 0] * ray[1] - slide[j, 1] * ray[0])
            for k in range(2):
                total = 0.0
                for m in range(3):
                    dray = rotation[m, 0] * dxy_duv[i, 0, k] + rotation[m, 1] * dxy_duv[i, 1, k]
                    total += slide[j, m] * s * dray
                J_image[j, k] = total
        for j in range(3):
            for k in range(j + 1):
                value = 0.0
                for a in range(2):
                    for b in range(2):
                        value += J_image[j, a] * noise[i, a, b] * J_image[k, b]
                image_covariance[met, j, k] = value
                image_covariance[met, k, j] = value
                for a in range(6):
                    for b in range(6):
                        value += J_pose[met, j, a] * pose_covariance[a, b] * J_pose[met, k, b]
                for a in range(4):
                    for b in range(4):
                        value += J_ball[met, j, a] * ball_covariance[a, b] * J_ball[met, k, b]
                if correlated:
                    for a in range(6):
                        for b in range(4):
                            both = J_pose[met, j, a] * J_ball[met, k, b] + J_pose[met, k, a] * J_ball[met, j, b]
                            value += both * cross_covariance[a, b]
                covariance[met, j, k] = value
                covariance[met, k, j] = value
        row[met] = row_of(centre[i, 1], view.height)
        index[met] = i
        met += 1
    return (
        position[:met],
        covariance[:met],
        direction[:met],
        image_covariance[:met],
        J_pose[:met],
        J_ball[:met],
        readout * row[:met],
        row[:met],
        index[:met],
    )
