"""Image rays meet the ball: disc centres in pixels in, points on the sphere with covariances out.

Wittich 2017, section 3.8 (eq. 110-120), by implicit differentiation in closed form instead of a Gauss-Helmert
adjustment per disc; both give the same covariance (tests/test_intersect.py).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.camera import Pose
from spheremouse.detect.detections import Detections
from spheremouse.rig import Rig, first_hits
from spheremouse.rotation import Array, hat


@dataclass(frozen=True, slots=True)
class SpherePoints:
    """First intersections of image rays with the ball, for the n detections whose rays meet it."""

    position: Array  # (n, 3) m, obj
    covariance: Array  # (n, 3, 3) m², obj: image noise, camera pose and ball together
    direction: Array  # (n, 3) unit vectors from the ball's centre, obj
    image_covariance: Array  # (n, 3, 3) m², obj: the part that is new in every frame (image noise alone)
    dposition_dpose: Array  # (n, 3, 6) of the pose's error model: m, rad
    dposition_dball: Array  # (n, 3, 4) of centre and radius
    index: NDArray[np.intp]  # (n,) into the detections

    def __len__(self) -> int:
        return len(self.position)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> "SpherePoints":
        """Those of a mask or of indices."""
        return SpherePoints(
            self.position[keep],
            self.covariance[keep],
            self.direction[keep],
            self.image_covariance[keep],
            self.dposition_dpose[keep],
            self.dposition_dball[keep],
            self.index[keep],
        )


def intersect(detections: Detections, rig: Rig, pose: Pose) -> SpherePoints:
    """Intersect the rays of all detections with the ball; rays that miss it are left out (`index` says which remain).

    The nearer of the two points is taken (Wittich 2017, eq. 110-113). With F(B) = |B - K| - R = 0 and B = P + s r,
    differentiation gives dB = (I - r nᵀ / (nᵀ r)) (dP + s dr) + r / (nᵀ r) (nᵀ dK + dR), n the outward normal.
    Close to the limb nᵀ r goes to zero and the covariance grows without bound, as it should.
    """
    hits = first_hits(detections.centre, rig, pose)
    ray, s, index = hits.ray, hits.scale, hits.index
    position = pose.position + s[:, None] * ray
    normal = (position - rig.ball.centre) / rig.ball.radius
    along = np.sum(normal * ray, axis=1)  # negative: the near side faces the camera
    to_surface = ray / along[:, None]
    slide = np.eye(3) - to_surface[:, :, None] * normal[:, None, :]

    dray_duv = pose.rotation[:, :2] @ hits.dxy_duv
    J_image = slide @ (s[:, None, None] * dray_duv)
    J_pose = np.concatenate([slide, slide @ (-s[:, None, None] * hat(ray))], axis=2)
    J_ball = np.concatenate(
        [to_surface[:, :, None] * normal[:, None, :], to_surface[:, :, None] * np.ones((1, 1, 1))], axis=2
    )
    image = J_image @ detections.covariance[index] @ J_image.transpose(0, 2, 1)
    covariance = (
        image
        + J_pose @ pose.covariance @ J_pose.transpose(0, 2, 1)
        + J_ball @ rig.ball.covariance @ J_ball.transpose(0, 2, 1)
    )
    return SpherePoints(position, covariance, normal, image, J_pose, J_ball, index)
