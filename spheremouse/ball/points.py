"""Intersection of image rays with the ball: disc centres in pixels to points on the sphere with covariances.

Wittich 2017, section 3.8 (eq. 110-120), by implicit differentiation in closed form instead of a Gauss-Helmert
adjustment per disc; both give the same covariance (tests/ball/test_points.py).
"""

from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import BallView, Rig, view_of
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, exp
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
    ddirection_drig: Array  # (n, 3, 4) of focal length (relative) and centre (m), as `SpherePoints` has it
    radius: float  # m
    rig_error: Array  # (4,) error of the rig for which the directions hold


@dataclass(frozen=True, slots=True)
class SpherePoints:
    """First intersections of image rays with the ball, for the n detections with rays that meet it.

    A rig error (4,) is a relative error of the focal length, and one of the ball's centre (m, obj). An error f of the
    focal length also moves the ball away by f times its depth along the optical axis, and turns the axes of obj as a
    pose by targets with that focal length is turned. So the ball keeps its place and size in the picture. The error of
    the centre is the remaining shift, which a picture shows.
    """

    position: Array  # (n, 3) m, obj
    covariance: Array  # (n, 3, 3) m², obj: image noise, camera pose and ball together
    direction: Array  # (n, 3) unit vectors from the ball's centre, obj
    image_covariance: Array  # (n, 3, 3) m², obj: the part that is new in every frame (image noise alone)
    ddirection_drig: Array  # (n, 3, 4) of focal length and centre, rad and rad/m
    delay: Array  # (n,) s from the frame's stamp to the exposure of the point's row (rolling shutter)
    row: Array  # (n,) that row, from -1/2 at the top of the image to 1/2 at its bottom
    index: NDArray[np.intp]  # (n,) into the detections
    rig_error: Array = field(default_factory=lambda: np.zeros(4))  # (4,) for which position and direction hold

    def __len__(self) -> int:
        return len(self.position)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "SpherePoints":
        """Return the entries of a mask (n,), of indices (k,) or of a slice."""
        return replace(self, **{f.name: getattr(self, f.name)[keep] for f in fields(self)[:-1]})

    def seen_with(self, rig_error: Array) -> Array:
        """Return the directions, (n, 3), if the error of the rig is `rig_error` (4,), to first order."""
        change = rig_error - self.rig_error
        if not change.any():
            return self.direction
        moved = self.direction + self.ddirection_drig @ change
        return moved / np.linalg.norm(moved, axis=1, keepdims=True)

    def measurement(self, radius: float) -> Measurement:
        """Return the points on a ball of `radius` m as the filter takes them."""
        noise, J = self.image_covariance, self.ddirection_drig
        return Measurement(self.direction, noise, self.delay, self.row, J, radius, self.rig_error)


def intersect(
    detections: Centres, rig: Rig, pose: Pose, rig_error: Array | None = None, which: NDArray[np.intp] | None = None
) -> SpherePoints:
    """Intersect the rays of all detections with the ball; `index` lists those that meet it.

    `rig_error` (4,) is the rig's error, as `SpherePoints` has it; None: none. `which` (k,) are the indices of the
    detections that count; None: all.

    The result is the nearer of the two points (Wittich 2017, eq. 110-113). With F(B) = |B - K| - R = 0 and B = P + s r,
    differentiation gives dB = (I - r nᵀ / (nᵀ r)) (dP + s dr) + r / (nᵀ r) (nᵀ dK + dR), n the outward normal.
    Close to the limb nᵀ r goes to zero and the covariance grows without bound, as it should.
    """
    centre, noise = detections.centre, np.ascontiguousarray(detections.covariance)
    if which is not None:
        centre, noise = centre[which], noise[which]
    view, rig_error = view_of(rig, pose), np.zeros(4) if rig_error is None else rig_error
    if any(rig_error.tolist()):
        view = _with_error(view, rig_error)
    points = SpherePoints(*kernels.intersect(centre, noise, view), rig_error)
    return points if which is None else replace(points, index=which[points.index])


def _with_error(view: BallView, rig_error: Array) -> BallView:
    """Return the view by a camera whose focal length, place about the ball and axes of obj differ by a rig error."""
    focal, (fx, fy, cx, cy), axis = rig_error[0], view.intrinsic, view.rotation[:, 2]
    receding = axis * (axis @ (view.centre - view.position))
    turn, centre = exp(focal * view.focal_turn), view.centre + focal * receding + rig_error[1:]
    return view._replace(
        centre=centre,
        intrinsic=((1.0 + focal) * fx, (1.0 + focal) * fy, cx, cy),
        rotation=turn @ view.rotation,
        position=centre + turn @ (view.position - centre),
    )


def directions_at(uv: Array, rig: Rig, pose: Pose) -> tuple[Array, NDArray[np.intp]]:
    """Return the directions, (k, 3) unit vectors in obj, of the points seen at pixels (n, 2), and their k indices."""
    return kernels.directions_at(np.ascontiguousarray(uv, dtype=np.float64), view_of(rig, pose))
