"""Rotations in three dimensions: conversions between rotation vectors, Euler angles and matrices.

Arrays have leading batch axes: (..., 3) vectors, (..., 3, 3) matrices. Angles are in radians. Closed forms: Sola,
Deray, Atchuthan 2018, "A micro Lie theory", section VII. Euler angles: Wittich 2017, eq. 9.
"""

import numpy as np

from spheremouse.geometry import Array
from spheremouse.native import kernels


def hat(v: Array) -> Array:
    """Return the skew-symmetric matrix with hat(a) @ b = a x b, (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, dtype=float)
    m = np.zeros((*v.shape, 3))
    m[..., 0, 1] = -v[..., 2]
    m[..., 0, 2] = v[..., 1]
    m[..., 1, 0] = v[..., 2]
    m[..., 1, 2] = -v[..., 0]
    m[..., 2, 0] = -v[..., 1]
    m[..., 2, 1] = v[..., 0]
    return m


def exp(v: Array) -> Array:
    """Return the rotation matrix of a rotation vector, (..., 3) rad -> (..., 3, 3) (Rodrigues)."""
    v = np.ascontiguousarray(v, dtype=float)
    return kernels.exp(v.reshape(-1, 3)).reshape(*v.shape, 3)


def log(R: Array) -> Array:
    """Return the rotation vector of a rotation matrix, (..., 3, 3) -> (..., 3) rad, length in [0, pi].

    The way by the unit quaternion (Shepperd 1978) has full precision near pi.
    """
    R = np.ascontiguousarray(R, dtype=float)
    return kernels.log(R.reshape(-1, 3, 3)).reshape(R.shape[:-1])


def left_jacobian(v: Array) -> Array:
    """Return Jl with exp(v + dv) = exp(Jl(v) dv) exp(v) to first order, (..., 3) -> (..., 3, 3)."""
    v = np.ascontiguousarray(v, dtype=float)
    return kernels.left_jacobian(v.reshape(-1, 3)).reshape(*v.shape, 3)


def from_euler(angles: Array) -> Array:
    """Return R = Rx(omega) Ry(phi) Rz(kappa), active and right-handed, (..., 3) rad -> (..., 3, 3).

    Wittich 2017, eq. 9 expanded; equals SciPy's Rotation.from_euler("XYZ", angles).
    """
    angles = np.asarray(angles, dtype=float)
    so, sp, sk = np.moveaxis(np.sin(angles), -1, 0)
    co, cp, ck = np.moveaxis(np.cos(angles), -1, 0)
    R = np.empty((*angles.shape[:-1], 3, 3))
    R[..., 0, 0] = cp * ck
    R[..., 0, 1] = -cp * sk
    R[..., 0, 2] = sp
    R[..., 1, 0] = co * sk + so * sp * ck
    R[..., 1, 1] = co * ck - so * sp * sk
    R[..., 1, 2] = -so * cp
    R[..., 2, 0] = so * sk - co * sp * ck
    R[..., 2, 1] = so * ck + co * sp * sk
    R[..., 2, 2] = co * cp
    return R


def to_euler(R: Array) -> Array:
    """Return omega, phi, kappa of `from_euler`, (..., 3, 3) -> (..., 3) rad, phi in [-pi/2, pi/2].

    Within 1e-9 of phi = +-90 deg only omega +- kappa is determined, and kappa is 0.
    """
    R = np.asarray(R, dtype=float)
    phi = np.arctan2(R[..., 0, 2], np.hypot(R[..., 0, 0], R[..., 0, 1]))
    singular = np.hypot(R[..., 0, 0], R[..., 0, 1]) < 1e-9
    omega = np.where(singular, np.arctan2(R[..., 2, 1], R[..., 1, 1]), np.arctan2(-R[..., 1, 2], R[..., 2, 2]))
    kappa = np.where(singular, 0.0, np.arctan2(-R[..., 0, 1], R[..., 0, 0]))
    return np.stack([omega, phi, kappa], axis=-1)


def euler_rate_matrix(angles: Array) -> Array:
    """Return E with w_obj = E @ d(omega, phi, kappa)/dt, (..., 3) -> (..., 3, 3).

    Its determinant is cos(phi), so it is singular at phi = +-90 deg.
    """
    angles = np.asarray(angles, dtype=float)
    so, sp, _ = np.moveaxis(np.sin(angles), -1, 0)
    co, cp, _ = np.moveaxis(np.cos(angles), -1, 0)
    zero = np.zeros_like(so)
    rows = [
        np.stack([zero + 1.0, zero, sp], axis=-1),
        np.stack([zero, co, -so * cp], axis=-1),
        np.stack([zero, so, co * cp], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def tangent_basis(u: Array) -> Array:
    """Return two orthonormal columns perpendicular to each unit vector, (..., 3) -> (..., 3, 2).

    The basis jumps at z = 0; no such basis is smooth on the whole sphere.
    Duff et al. 2017, "Building an orthonormal basis, revisited".
    """
    u = np.asarray(u, dtype=float)
    x, y, z = np.moveaxis(u, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second], axis=-1)


def fibonacci_sphere(n: int) -> Array:
    """Return unit vectors (n, 3), evenly spread on a spiral of the golden angle (González 2010)."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def align(a: Array, b: Array, weights: Array | None = None) -> Array:
    """Return the rotation R, (3, 3), that minimises sum w |b - R a|^2 over pairs of vectors (n, 3) with weights (n,).

    Wahba's problem by singular value decomposition (Markley 1988). The result is unique if two directions differ.
    """
    w = np.ones(len(a)) if weights is None else weights
    u, _, vt = np.linalg.svd((b * w[:, None]).T @ a)
    d = np.sign(np.linalg.det(u @ vt))
    return u @ np.diag([1.0, 1.0, d]) @ vt


def rotation_between(before: Array, after: Array) -> Array:
    """Return the rotation vector in `obj`, (3,) rad, from attitude `before` to `after`, both R_obj_ball, (3, 3)."""
    return log(after @ before.T)
