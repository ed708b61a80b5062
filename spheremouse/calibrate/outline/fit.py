"""Fit the outline of a ball in a picture, and make a rig without discs of it: lengths in radii, a fixed camera.

The rays that touch a ball are a cone about the direction u of its centre, with the ball's angular radius a: u·r = cos a
for each unit ray r. So n = u / cos a solves the linear equations n·r = 1, which give the first values.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.ball.rig import NO_TARGETS, UNKNOWN_READOUT, Ball, Rig, found_from_picture
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, Pose, sphere_outline, unproject
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.geometry.statistics import mad_sigma

# Camera axes as `obj` has them: X right, Y up, Z towards the camera.
R_OBJ_CAM = np.diag([1.0, -1.0, -1.0])

_MAX_ROUNDS = 20
_CONVERGENCE_RAD = 1e-9  # rad
_NO_OUTLINE = ("the points are on no outline of a ball", "give points all around it, not on a line")
_TUKEY_SIGMAS = 4.685  # standard deviations beyond which an edge has no weight (Huber 1981, section 4.8)


@dataclass(frozen=True, slots=True)
class Outline:
    """The cone of rays that touch a ball."""

    direction: Array  # (3,) unit vector to the ball's centre, cam
    angle: float  # rad, angular radius of the ball
    covariance: Array  # (3, 3) rad², of the direction along the two axes of `tangent_basis`, and of the angle

    @property
    def centre(self) -> Array:
        """Centre of a ball of radius 1, (3,) in cam."""
        return self.direction / np.sin(self.angle)

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of the direction, the larger one, and of the angular radius, rad."""
        across = float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1])
        return across**0.5, float(self.covariance[2, 2]) ** 0.5

    def pixels(self, camera: InteriorOrientation) -> Array:
        """Return points of the outline in the picture, (360, 2) px."""
        return sphere_outline(self.centre, 1.0, camera, 360)


def pinhole(size: tuple[int, int], vfov: float) -> InteriorOrientation:
    """Return a camera without distortion that sees `vfov` degrees from the upper to the lower edge of its picture."""
    width, height = size
    f = 0.5 * height / np.tan(0.5 * np.radians(vfov))
    return InteriorOrientation(width, height, f, f, 0.5 * (width - 1), 0.5 * (height - 1))


def rays_of(pixels: Array, camera: InteriorOrientation) -> Array:
    """Return the unit rays of pixels, (n, 3) in cam; nan for a pixel without a ray."""
    xy = unproject(pixels, camera)[0]
    rays = np.column_stack([xy, np.ones(len(xy))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def fit_outline(rays: Array, sigma: float, start: Outline | None = None, robust: bool = False) -> Outline:
    """Return the outline through unit rays, (n, 3), with errors of `sigma` rad across it.

    If the rays scatter more, the covariance grows by the factor that they show. `robust` gives rays that do not fit
    less weight or none (Tukey's), and takes sigma from the rays. Raises CalibrationError if they are on no cone.
    """
    outline = start or _first(rays)
    for _ in range(_MAX_ROUNDS):
        residual, J = residuals(outline, rays), _jacobian(outline, rays)
        limit = _TUKEY_SIGMAS * max(float(mad_sigma(residual)), 1e-9)
        weight = np.clip(1.0 - (residual / limit) ** 2, 0.0, None) ** 2 if robust else np.ones(len(rays))
        Q = np.asarray(np.linalg.inv((J * weight[:, None]).T @ J), float)
        step = -Q @ (J.T @ (weight * residual))
        u = outline.direction + tangent_basis(outline.direction) @ step[:2]
        freedom = max(float(weight.sum()) - 3.0, 1.0)
        scatter = float(weight @ residual**2) / freedom
        variance = scatter if robust else sigma**2 if len(rays) == 3 else max(sigma**2, scatter)
        outline = Outline(np.asarray(u / np.linalg.norm(u), float), outline.angle + float(step[2]), variance * Q)
        if not (0.0 < outline.angle < 1.5 and outline.direction[2] > 1.01 * np.sin(outline.angle)):
            raise CalibrationError(*_NO_OUTLINE)
        if np.abs(step).max() < _CONVERGENCE_RAD:
            break
    return outline


def _first(rays: Array) -> Outline:
    """Return the circular cone through rays, (n, 3), by linear least squares. CalibrationError if there is none."""
    n, _, rank, _ = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=1e-9)
    size = float(np.linalg.norm(n))
    if rank < 3 or not size > 1.0:
        raise CalibrationError(*_NO_OUTLINE)
    return Outline(np.asarray(n / size, float), float(np.arccos(1.0 / size)), np.zeros((3, 3)))


def _jacobian(outline: Outline, rays: Array) -> Array:
    """Return how the residuals change with the direction along both axes of its basis, and with the angle, (n, 3)."""
    across = rays @ tangent_basis(outline.direction)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.column_stack([-across, -np.ones(len(rays))])


def residuals(outline: Outline, rays: Array) -> Array:
    """Return how far rays are outside of the outline, (n,) rad."""
    return np.arccos(np.clip(rays @ outline.direction, -1.0, 1.0)) - outline.angle


def rig_of(outline: Outline, camera: InteriorOrientation, R_obj_cam: Array = R_OBJ_CAM) -> Rig:
    """Return the rig of a ball of radius 1 without discs, and of a camera that stays where it is.

    The axes of `obj` are exact by definition. The camera's place in them has the covariance of the outline.
    """
    E, a = tangent_basis(outline.direction), outline.angle
    J = np.column_stack([E, -outline.direction / np.tan(a)]) / np.sin(a)  # of the centre in cam
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = R_obj_cam @ J @ outline.covariance @ J.T @ R_obj_cam.T
    return Rig(
        camera=camera,
        ball=Ball(1.0),
        targets=NO_TARGETS,
        disc_radius=None,
        readout_sigma_s=UNKNOWN_READOUT,
        pose=found_from_picture(Pose(R_obj_cam, -R_obj_cam @ outline.centre, covariance), np.zeros(3)),
        scale_free=True,
    )


def rotation_scale(outline: Outline, factor: float) -> float:
    """Return the factor on measured rotations across the view if the true focal length is `factor` times the assumed.

    In the middle of the ball, f sin a / (1 - sin a) pixels are a radian. About the line of sight nothing changes.
    """
    assumed, true = outline.angle, np.arctan(np.tan(outline.angle) / factor)
    return float(_pixels(true) / _pixels(assumed))


def _pixels(angle: float) -> float:
    """Return the pixels of a radian in the middle of a ball, over f tan a, which the picture shows."""
    return float(np.cos(angle) / (1.0 - np.sin(angle)))
