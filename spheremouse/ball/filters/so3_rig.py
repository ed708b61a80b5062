"""The errors of a rig as the filter has them: of focal length, the ball's centre, the axes of obj, and the readout.

A picture does not show all errors of camera, pose and ball. `Station` reduces them to those that it shows.
"""

from dataclasses import dataclass, field

import numpy as np

from spheremouse.ball.filters.so3_motion import CAMERA_DIM, RIG_DIM
from spheremouse.geometry.rotation import Array, hat

_EXACT_RIG = 1e-6, 1e-5  # relative, and in radii: an exact rig costs nothing, yet the filter learns what depends on it
# relative: a lens of 4 mm that focuses at 2 m in place of 4 m, or that warms by 10 to 20 K (Smith, Cope 2010, "The
# effects of temperature variation on single-lens-reflex digital camera calibration parameters")
_LEAST_FOCAL_SIGMA = 1e-3
_TAPE_ERROR = 0.01  # of a length that is measured by tape


@dataclass(frozen=True, slots=True)
class Station:
    """A camera's place, which determines the visible discs, and the errors of its rig."""

    towards: Array  # (3,) unit vector from the ball's centre to the camera, obj
    horizon: float  # radius over distance: least cosine with it of a visible disc
    radius: float  # m, of the ball
    considered: Array = field(default_factory=lambda: np.zeros((10, 10)))  # covariance of pose, centre, radius
    readout_sigma: float = 0.0  # s, of the rolling shutter's time
    focal_sigma: float = 0.0  # relative, of the focal length
    pose_by_focal: Array = field(default_factory=lambda: np.zeros(6))  # m, rad: as `Pose.by_focal` has it
    along_axis: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, obj, from the camera to the ball's depth
    size_error: float = 0.0  # relative, of the radius, by the ball's outline

    def common_by_pose_and_ball(self) -> Array:
        """Return the matrix, (7, 10), from errors of pose, centre and radius to those of the rig and the axes.

        A picture depends on the camera's axes, and on its place seen from the ball's centre, in radii. So ten errors
        act like six. The rows are focal length (zero), centre (3, m), and turn of the axes of obj (3, rad).
        """
        towards = self.towards / self.horizon  # radii
        A = np.zeros((7, 10))
        A[4:, 3:6] = A[1:4, 6:9] = np.eye(3)
        A[1:4, :3], A[1:4, 3:6], A[1:4, 9] = -np.eye(3), -self.radius * hat(towards), towards
        return A

    def common_by_focal(self) -> Array:
        """Return the effect, (4,), of a relative error of the focal length on the errors of the rig.

        The error of the centre is the part that a picture shows, as `SpherePoints` has it. `ddirection_drig` contains
        the turn of the axes.
        """
        by_pose = self.common_by_pose_and_ball()[:RIG_DIM, :6]
        return np.concatenate([[1.0], -self.along_axis]) + by_pose @ self.pose_by_focal

    def common_by_size(self) -> Array:
        """Return the effect, (4,), of a relative error of the radius on the errors of the rig."""
        return self.radius * self.common_by_pose_and_ball()[:RIG_DIM, 9]

    def covariance(self) -> Array:
        """Return the covariance, (8, 8), of rig, axes (rad) and readout (s), before a frame shows anything."""
        A, covariance = self.common_by_pose_and_ball(), np.zeros((CAMERA_DIM, CAMERA_DIM))
        covariance[:7, :7], covariance[7, 7] = A @ self.considered @ A.T, self.readout_sigma**2
        least = _LEAST_FOCAL_SIGMA if self.pose_by_focal.any() else 0.0  # no picture determined a true pose
        effect = max(self.focal_sigma, least) * self.common_by_focal()
        covariance[:RIG_DIM, :RIG_DIM] += np.outer(effect, effect)
        if self.size_error != 0.0:
            size = self.common_by_size()
            direction = size / float(size @ size)
            known = float(direction @ covariance[:RIG_DIM, :RIG_DIM] @ direction)
            covariance[:RIG_DIM, :RIG_DIM] += max(self.size_error**2 - known, 0.0) * np.outer(size, size)
            covariance[0, 0] += _TAPE_ERROR**2  # the focal length may be the wrong one
        exact = np.flatnonzero(covariance.diagonal()[:RIG_DIM] == 0.0)
        focal, centre = _EXACT_RIG
        covariance[exact, exact] = np.array([focal, *[centre * self.radius] * 3])[exact] ** 2
        return covariance

    def shared_covariance(self, other: "Station") -> Array:
        """Return the covariance, (8, 8), of those errors with those of another camera, whose rig has the same ball."""
        covariance, ball = np.zeros((CAMERA_DIM, CAMERA_DIM)), self.considered[6:, 6:]
        covariance[:7, :7] = self._common_by_ball() @ ball @ other._common_by_ball().T
        return covariance

    def _common_by_ball(self) -> Array:
        """Return the matrix, (7, 4), from errors of centre and radius to the expected ones of rig and axes."""
        A, C = self.common_by_pose_and_ball(), self.considered
        return A[:, :6] @ C[:6, 6:] @ np.linalg.pinv(C[6:, 6:], hermitian=True) + A[:, 6:]

    def covariance_by_tape(self, size_sigma: float) -> Array:
        """Return the covariance, (4, 4), that a radius and a focal length by tape add to that of the rig.

        With a wrong focal length, pictures place the camera so that the ball has its place and size. `size_sigma` is
        the relative standard deviation of the radius by the ball's outline.
        """
        size, focal = min(size_sigma, _TAPE_ERROR) * self.common_by_size(), _TAPE_ERROR * np.eye(RIG_DIM)[0]
        return np.outer(size, size) + np.outer(focal, focal)
