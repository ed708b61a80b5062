"""The camera: interior orientation (pinhole with OpenCV's five distortion terms), exterior orientation, projection.

Takes points in `cam` or pixels, gives pixels or rays, each with its Jacobian. Pixel (0, 0) is the centre of the
top-left pixel. Model: Wittich 2017, eq. 69-76 (with the errata of docs/conventions); OpenCV's order k1 k2 p1 p2 k3.
"""

from dataclasses import dataclass, field

import numpy as np

from spheremouse.rotation import Array


@dataclass(frozen=True, slots=True)
class InteriorOrientation:
    """What the calibration of the camera gives, for images of one size."""

    width: int  # px
    height: int  # px
    fx: float  # px
    fy: float  # px
    cx: float  # px
    cy: float  # px
    distortion: Array = field(default_factory=lambda: np.zeros(5))  # (5,) k1, k2, p1, p2, k3

    @property
    def matrix(self) -> Array:
        """Camera matrix, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Pose:
    """Exterior orientation: the camera in `obj`.

    Error model of the covariance: position + d, exp(theta) @ rotation, with (d, theta) in `obj` axes.
    """

    rotation: Array  # (3, 3) R_obj_cam
    position: Array  # (3,) m, projection centre in obj
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))  # (6, 6) m, rad

    def to_cam(self, points: Array) -> Array:
        """Points in `obj`, (..., 3) m, to `cam`."""
        return (points - self.position) @ self.rotation

    def matrix(self) -> Array:
        """T_obj_cam, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.rotation
        T[:3, 3] = self.position
        return T


def pose_from_matrix(T: Array, covariance: Array | None = None) -> Pose:
    """Pose of a homogeneous T_obj_cam, (4, 4); the rotation is made orthonormal."""
    u, _, vt = np.linalg.svd(np.asarray(T, dtype=float)[:3, :3])
    return Pose(u @ vt, np.array(T, dtype=float)[:3, 3], np.zeros((6, 6)) if covariance is None else covariance)


def distort(xy: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Ideal reduced coordinates x/z, y/z, (n, 2), to distorted ones, (n, 2), and their Jacobian, (n, 2, 2)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))  # d radial / d x = slope x
    out = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=1,
    )
    J = np.empty((len(xy), 2, 2))
    J[:, 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    J[:, 0, 1] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    J[:, 1, 0] = J[:, 0, 1]
    J[:, 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return out, J


def reduced_to_pixel(xy: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Ideal reduced coordinates, (n, 2), to pixels, (n, 2), and duv_dxy, (n, 2, 2)."""
    d, J = distort(xy, camera)
    f = np.array([camera.fx, camera.fy])
    return d * f + (camera.cx, camera.cy), J * f[:, None]


def project(points: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Points in `cam`, (n, 3) m, to pixels, (n, 2), and duv_dpoint, (n, 2, 3).

    Points at or behind the projection centre (z <= 0) give nan.
    """
    z = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
    xy = points[:, :2] / z[:, None]
    uv, duv_dxy = reduced_to_pixel(xy, camera)
    dxy = np.zeros((len(points), 2, 3))
    dxy[:, 0, 0] = dxy[:, 1, 1] = 1.0 / z
    dxy[:, :, 2] = -xy / z[:, None]
    return uv, duv_dxy @ dxy


def unproject(uv: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Pixels, (n, 2), to ideal reduced coordinates x/z, y/z, (n, 2), and dxy_duv, (n, 2, 2).

    Newton's method on the distortion, in place of the fixed point of Wittich 2017, eq. 81-83. Where the lens model
    folds back (no ray maps to that pixel) the result is nan: a miss, not a guess.
    """
    f = np.array([camera.fx, camera.fy])
    target = (np.asarray(uv, dtype=float).reshape(-1, 2) - (camera.cx, camera.cy)) / f
    if not np.any(camera.distortion):
        return target, np.broadcast_to(np.diag(1.0 / f), (len(target), 2, 2)).copy()
    xy = target.copy()
    J = np.broadcast_to(np.eye(2), (len(xy), 2, 2))
    step = np.full(len(xy), np.inf)
    for _ in range(30):
        d, J = distort(xy, camera)
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        e = target - d
        safe = np.where(np.abs(det) > 1e-9, det, np.nan)
        dx = np.stack(
            [J[:, 1, 1] * e[:, 0] - J[:, 0, 1] * e[:, 1], J[:, 0, 0] * e[:, 1] - J[:, 1, 0] * e[:, 0]], axis=1
        )
        dx /= safe[:, None]
        length = np.linalg.norm(dx, axis=1, keepdims=True)
        dx *= np.minimum(1.0, 0.3 / np.maximum(length, 1e-300))  # a step limit keeps Newton on the near branch
        xy = xy + dx
        step = np.linalg.norm(dx, axis=1)
        if not np.any(step > 1e-13):
            break
    _, J = distort(xy, camera)
    folded = ~(step < 1e-9) | (np.linalg.det(np.nan_to_num(J)) <= 0.0) | (np.sum(xy * xy, axis=1) >= _fold_r2(camera))
    xy = np.where(folded[:, None], np.nan, xy)
    J = np.where(folded[:, None, None], np.eye(2), J)
    return xy, np.linalg.inv(J) / f  # columns: d/du, d/dv


def _fold_r2(camera: InteriorOrientation) -> float:
    """Squared reduced radius at which the radial distortion stops growing, inf if it never does.

    Beyond it pixels are met a second time, and some lens models grow once more: a solution there is not the ray.
    """
    k1, k2, _, _, k3 = camera.distortion
    roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # d/dr of r (1 + k1 r² + k2 r⁴ + k3 r⁶), in r²
    r2 = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
    return float(np.min(r2, initial=np.inf))


def project_circle(centre: Array, normal: Array, radius: Array | float) -> tuple[Array, Array]:
    """Ellipses that circles in space project to, in ideal reduced coordinates.

    `centre` (n, 3) m and `normal` (n, 3) unit in `cam`, `radius` m. Gives the ellipse's centre, (n, 2), and its shape
    S, (n, 2, 2), with (x - c)^T S^-1 (x - c) = 1 on the outline; the area is pi sqrt(det S). The centre of the
    ellipse is not the projection of the circle's centre: the difference is the eccentricity.
    From the dual conic C C^T - r^2 (I - n n^T) of the projected circle (Hartley, Zisserman 2004, section 8.3).
    """
    r2 = np.broadcast_to(np.asarray(radius, dtype=float) ** 2, (len(centre),))[:, None, None]
    D = centre[:, :, None] * centre[:, None, :] - r2 * (np.eye(3) - normal[:, :, None] * normal[:, None, :])
    return _dual_conic_centre_shape(D)


def project_sphere(centre: Array, radius: float) -> tuple[Array, Array]:
    """Outline of a sphere at `centre`, (3,) m in `cam`: ellipse centre, (2,), and shape, (2, 2), as project_circle."""
    c, S = _dual_conic_centre_shape((np.outer(centre, centre) - radius**2 * np.eye(3))[None])
    return c[0], S[0]


def ellipse_to_pixel(centre: Array, shape: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Centroid, (n, 2) px, and shape, (n, 2, 2) px², of ellipses given in reduced coordinates, (n, 2), (n, 2, 2).

    The lens bends an ellipse; its centroid is taken of the bent outline, its shape from the Jacobian at the centre.
    """
    uv, J = reduced_to_pixel(centre, camera)
    S = J @ shape @ J.transpose(0, 2, 1)
    if not np.any(camera.distortion) or len(centre) == 0:
        return uv, S
    angle = np.arange(24) * (2.0 * np.pi / 24)
    L = np.linalg.cholesky(shape)
    outline = centre[:, None] + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ L.transpose(0, 2, 1)
    p = reduced_to_pixel(outline.reshape(-1, 2), camera)[0].reshape(outline.shape) - uv[:, None]
    q = np.roll(p, -1, axis=1)
    cross = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    return uv + np.sum((p + q) * cross[..., None], axis=1) / (3.0 * np.sum(cross, axis=1)[:, None]), S


def _dual_conic_centre_shape(D: Array) -> tuple[Array, Array]:
    c = D[:, :2, 2] / D[:, 2, 2, None]
    return c, c[:, :, None] * c[:, None, :] - D[:, :2, :2] / D[:, 2, 2, None, None]
