"""Project circles and spheres to ellipses."""

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation, reduced_to_pixel
from spheremouse.geometry.rotation import Array


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
