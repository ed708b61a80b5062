"""Camera model: interior orientation (pinhole with OpenCV's five distortion terms), exterior orientation, projection.

The functions convert points, circles and spheres in `cam` to pixels, and pixels to rays, and return the Jacobian. Pixel
(0, 0) is the centre of the top-left pixel. Model: Wittich 2017, eq. 69-76 (errata in docs/theses.md), in OpenCV's
order k1 k2 p1 p2 k3.
"""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

# 8K has 7680x4320 pixels, webcams have fewer, and a telephone's photo has 50 million. An image of the largest size
# takes 200 MB in colour, and its processing a few times as much.
MAX_SIDE = 16_384  # px
MAX_PIXELS = 1 << 26  # 67 million
_FOLD_GRID = 65  # pixels of the test for a fold along each side of the image, its corners included


def too_large(width: int, height: int) -> str:
    """Return the problem of an image's size in words; empty if the size is allowed."""
    if max(width, height) <= MAX_SIDE and width * height <= MAX_PIXELS:
        return ""
    return f"{width}x{height} is more than can be worked on: at most {MAX_SIDE} a side, {MAX_PIXELS} pixels in all"


@dataclass(frozen=True, slots=True)
class InteriorOrientation:
    """Focal lengths, principal point and distortion of a calibrated camera, for images of one size."""

    width: int  # px
    height: int  # px
    fx: float  # px
    fy: float  # px
    cx: float  # px
    cy: float  # px
    distortion: Array = field(default_factory=lambda: np.zeros(5))  # (5,) k1, k2, p1, p2, k3
    covariance: Array = field(default_factory=lambda: np.zeros((9, 9)))  # (9, 9) of fx, fy, cx, cy, k1, k2, p1, p2, k3

    @property
    def matrix(self) -> Array:
        """Camera matrix, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def intrinsic(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy in px."""
        return self.fx, self.fy, self.cx, self.cy

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the scale of an image, the mean of fx and fy."""
        return float(np.sqrt(self.covariance[:2, :2].sum())) / (self.fx + self.fy)

    @property
    def fold_r2(self) -> float:
        """Squared reduced radius at which the distorted radius stops growing; inf if it always grows.

        Beyond this radius a pixel has a second solution, which is not its ray.
        """
        k1, k2, _, _, k3 = self.distortion.tolist()
        return _fold_r2(k1, k2, k3)


@cache
def _fold_r2(k1: float, k2: float, k3: float) -> float:
    roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # d/dr of r (1 + k1 r² + k2 r⁴ + k3 r⁶), in r²
    r2 = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
    return float(np.min(r2, initial=np.inf))


@dataclass(frozen=True, slots=True)
class Pose:
    """Exterior orientation: the camera in `obj`.

    Error model of the covariance: position + d, exp(theta) @ rotation, with (d, theta) in `obj` axes.
    """

    rotation: Array  # (3, 3) R_obj_cam
    position: Array  # (3,) m, projection centre in obj
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))  # (6, 6) m, rad
    ball_covariance: Array = field(default_factory=lambda: np.zeros((6, 4)))  # (6, 4) with the ball's centre, radius
    by_focal: Array = field(default_factory=lambda: np.zeros(6))  # (6,) m, rad, its error by a relative one of fx, fy

    def to_cam(self, points: Array) -> Array:
        """Transform points (..., 3) m from `obj` to `cam`."""
        return (points - self.position) @ self.rotation

    def along_axis(self, point: Array) -> Array:
        """Return the part along the optical axis, (3,) m in `obj`, of the way from the camera to a point (3,) m."""
        axis = self.rotation[:, 2]
        return axis * (axis @ (point - self.position))

    def matrix(self) -> Array:
        """Return T_obj_cam, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.rotation
        T[:3, 3] = self.position
        return T


def pose_from_matrix(T: Array, covariance: Array | None = None) -> Pose:
    """Return the pose of a homogeneous T_obj_cam, (4, 4), with the nearest orthonormal rotation.

    `covariance` (6, 6) is that of `Pose`; None: zero.
    """
    u, _, vt = np.linalg.svd(np.asarray(T, dtype=float)[:3, :3])
    return Pose(u @ vt, np.array(T, dtype=float)[:3, 3].copy(), np.zeros((6, 6)) if covariance is None else covariance)


def distort(xy: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Distort ideal reduced coordinates x/z, y/z, (n, 2); also return the Jacobian, (n, 2, 2)."""
    return kernels.distort(np.ascontiguousarray(xy, dtype=float), camera.distortion)


def reduced_to_pixel(xy: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Convert ideal reduced coordinates (n, 2) to pixels (n, 2); also return duv_dxy, (n, 2, 2)."""
    d, J = distort(xy, camera)
    f = np.array([camera.fx, camera.fy])
    return d * f + (camera.cx, camera.cy), J * f[:, None]


def interior_vector(camera: InteriorOrientation) -> Array:
    """Return fx, fy, cx, cy, k1, k2, p1, p2, k3, (9,)."""
    return np.array([*camera.intrinsic, *camera.distortion])


def with_interior(camera: InteriorOrientation, vector: Array) -> InteriorOrientation:
    """Return the camera with new values (9,) in the order of `interior_vector`, and its old covariance."""
    fx, fy, cx, cy = (float(v) for v in vector[:4])
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=vector[4:].copy())


def interior_jacobian(xy: Array, camera: InteriorOrientation) -> Array:
    """Return duv_dinterior, (n, 2, 9), by fx, fy, cx, cy, k1, k2, p1, p2, k3, at ideal reduced coordinates (n, 2)."""
    d, _ = distort(xy, camera)
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    J = np.zeros((len(xy), 2, 9))
    J[:, 0, 0], J[:, 1, 1] = d[:, 0], d[:, 1]
    J[:, 0, 2] = J[:, 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
        J[:, :, column] = xy * power[:, None]
    J[:, 0, 6], J[:, 1, 6] = 2.0 * x * y, r2 + 2.0 * y * y
    J[:, 0, 7], J[:, 1, 7] = r2 + 2.0 * x * x, 2.0 * x * y
    J[:, :, 4:] *= np.array([camera.fx, camera.fy])[:, None]
    return J


def project(points: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Project points (n, 3) m in `cam` to pixels (n, 2); also return duv_dpoint, (n, 2, 3).

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
    """Convert pixels (n, 2) to ideal reduced coordinates x/z, y/z, (n, 2); also return dxy_duv, (n, 2, 2).

    Newton's method in place of the fixed-point iteration of Wittich 2017, eq. 81-83. A pixel to which the lens model
    maps no ray gives nan.
    """
    uv = np.ascontiguousarray(uv, dtype=float).reshape(-1, 2)
    return kernels.unproject(uv, camera.intrinsic, camera.distortion, camera.fold_r2)


def fold_in_picture(camera: InteriorOrientation) -> tuple[float, float]:
    """Return the share of the image in which the lens model is not one-to-one, and where that begins.

    There a pixel has no ray, or the Jacobian determinant of the distortion is not positive. The second value is the
    distance (px) from the principal point to the nearest such pixel of a grid, inf if there is none.
    """
    u = np.linspace(0.0, camera.width - 1.0, _FOLD_GRID)
    v = np.linspace(0.0, camera.height - 1.0, _FOLD_GRID)
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy, _ = unproject(uv, camera)
    has_ray = np.all(np.isfinite(xy), axis=1)
    _, J = distort(np.where(has_ray[:, None], xy, 0.0), camera)
    folded = np.flatnonzero(~(has_ray & (np.linalg.det(J) > 0.0)))
    distance = np.linalg.norm(uv[folded] - (camera.cx, camera.cy), axis=1)
    return len(folded) / len(uv), float(distance.min(initial=np.inf))


def row_of(v, height):
    """Return the readout time of row v as a fraction of all rows, from -1/2 at the top to 1/2 at the bottom."""
    return (v + 0.5) / height - 0.5


# ---- circles and spheres ----


def project_circle(centre: Array, normal: Array, radius: Array | float) -> tuple[Array, Array]:
    """Return the ellipses of projected circles in ideal reduced coordinates.

    `centre` (n, 3) m and `normal` (n, 3) unit in `cam`, `radius` m. The result is the ellipse's centre, (n, 2), and its
    shape S, (n, 2, 2), with (x - c)^T S^-1 (x - c) = 1 on the outline and the area pi sqrt(det S). The ellipse's centre
    differs from the projection of the circle's centre by the eccentricity.
    The dual conic of the projected circle is C C^T - r^2 (I - n n^T) (Hartley, Zisserman 2004, section 8.3).
    """
    r2 = np.broadcast_to(np.asarray(radius, dtype=float) ** 2, (len(centre),))[:, None, None]
    D = centre[:, :, None] * centre[:, None, :] - r2 * (np.eye(3) - normal[:, :, None] * normal[:, None, :])
    return _dual_conic_centre_shape(D)


def project_rings(centre: Array, normal: Array, radii: Array, camera: InteriorOrientation) -> Array:
    """Mean centroids, (n, 2) px, of the images of concentric circles: `centre` and unit `normal` (n, 3) in `cam`.

    Raises LinAlgError for circles that are seen edge-on.
    """
    return np.mean([ellipse_to_pixel(*project_circle(centre, normal, float(r)), camera)[0] for r in radii], axis=0)


def project_sphere(centre: Array, radius: float) -> tuple[Array, Array]:
    """Return centre (2,) and shape (2, 2) of a sphere's outline, as `project_circle`; `centre` (3,) m in `cam`."""
    c, S = _dual_conic_centre_shape((np.outer(centre, centre) - radius**2 * np.eye(3))[None])
    return c[0], S[0]


def sphere_outline(centre: Array, radius: float, camera: InteriorOrientation, points: int = 180) -> Array:
    """Return the outline of a sphere in the image, (points, 2) px. The whole sphere must be in front of the camera."""
    ellipse_centre, shape = project_sphere(centre, radius)
    angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    rim = ellipse_centre + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ np.linalg.cholesky(shape).T
    return reduced_to_pixel(rim, camera)[0]


def ellipse_to_pixel(centre: Array, shape: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Convert ellipses from reduced coordinates, (n, 2) and (n, 2, 2), to centroids (n, 2) px and shapes (n, 2, 2) px².

    The lens distorts an ellipse. The centroid is that of the distorted outline, and the shape follows from the Jacobian
    at the centre.
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
