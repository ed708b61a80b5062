"""Intersection of image rays with the ball: disc centres in pixels to points on the sphere with covariances.

Wittich 2017, section 3.8 (eq. 110-120), by implicit differentiation in closed form instead of a Gauss-Helmert
adjustment per disc; both give the same covariance (tests/ball/test_points.py).
"""

from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import Rig, view_of
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels


class Centres(Protocol):
    """Points in an image, as `Detections` has them."""

    @property
    def centre(self) -> Array: ...  # (n, 2) px
    @property
    def covariance(self) -> Array: ...  # (n, 2, 2) px²


class Measurement(NamedTuple):
    """Points of a frame as the filter and `kernels` take them. Their places on its map give residual and Jacobian."""

    direction: Array  # (n, 3) unit vectors from the ball's centre, obj
    noise: Array  # (n, 3, 3) m², obj: covariance that is new in every frame
    delay: Array  # (n,) s from the frame's stamp to the exposure of the point's row
    row: Array  # (n,) that row, from -1/2 to 1/2
    dposition_dball: Array  # (n, 3, 4) of centre and radius
    radius: float  # m
    centre: Array  # (3,) m, of the ball from its calibrated place, for which the directions hold


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
    centre: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, of the ball from its calibrated place

    def __len__(self) -> int:
        return len(self.position)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "SpherePoints":
        """Return the entries of a mask (n,), of indices (k,) or of a slice."""
        return replace(self, **{f.name: getattr(self, f.name)[keep] for f in fields(self)[:-1]})

    def seen_from(self, centre: Array, radius: float) -> Array:
        """Return the directions, (n, 3), from another centre, (3,) m, of a ball of `radius` m, to first order."""
        shift = centre - self.centre
        if not shift.any():
            return self.direction
        moved = self.direction + (self.dposition_dball[:, :, :3] - np.eye(3)) @ (shift / radius)
        return moved / np.linalg.norm(moved, axis=1, keepdims=True)

    def measurement(self, radius: float) -> Measurement:
        """Return the points on a ball of `radius` m as the filter takes them."""
        noise, J = self.image_covariance, self.dposition_dball
        return Measurement(self.direction, noise, self.delay, self.row, J, radius, self.centre)


def intersect(
    detections: Centres, rig: Rig, pose: Pose, shift: Array | None = None, which: NDArray[np.intp] | None = None
) -> SpherePoints:
    """Intersect the rays of all detections with the ball, without rays that miss it (`index` lists the others).

    The ball's centre is off its calibrated place by `shift` (3,) m; None: not at all. `which` (k,) are the indices of
    the detections that count; None: all.

    The result is the nearer of the two points (Wittich 2017, eq. 110-113). With F(B) = |B - K| - R = 0 and B = P + s r,
    differentiation gives dB = (I - r nᵀ / (nᵀ r)) (dP + s dr) + r / (nᵀ r) (nᵀ dK + dR), n the outward normal.
    Close to the limb nᵀ r goes to zero and the covariance grows without bound, as it should.
    """
    centre, noise = detections.centre, np.ascontiguousarray(detections.covariance)
    if which is not None:
        centre, noise = centre[which], noise[which]
    view, shift = view_of(rig, pose), np.zeros(3) if shift is None else shift
    points = SpherePoints(*kernels.intersect(centre, noise, view._replace(centre=view.centre + shift)), shift)
    return points if which is None else replace(points, index=which[points.index])


def directions_at(uv: Array, rig: Rig, pose: Pose) -> tuple[Array, NDArray[np.intp]]:
    """Return the directions, (k, 3) unit vectors in obj, of the points seen at pixels (n, 2), and their k indices."""
    return kernels.directions_at(np.ascontiguousarray(uv, dtype=np.float64), view_of(rig, pose))
