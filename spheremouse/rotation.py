"""Rotations in three dimensions: vectors and angles in, matrices out, and back.

Arrays carry leading batch axes: (..., 3) vectors, (..., 3, 3) matrices. Angles in radians.
Closed forms: Sola, Deray, Atchuthan 2018, "A micro Lie theory", section VII; Euler angles: Wittich 2017, eq. 9.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SMALL = 1e-6  # rad: below, series truncated after the second term are exact to double precision


def hat(v: Array) -> Array:
    """Skew-symmetric matrix, (..., 3) -> (..., 3, 3), so that hat(a) @ b = a x b."""
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
    """Rotation matrix of a rotation vector, (..., 3) rad -> (..., 3, 3) (Rodrigues)."""
    v = np.asarray(v, dtype=float)
    angle = np.sqrt(np.sum(v * v, axis=-1))[..., None, None]
    safe = np.where(angle < _SMALL, 1.0, angle)
    a = np.where(angle < _SMALL, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(angle < _SMALL, 0.5 - angle**2 / 24.0, 2.0 * (np.sin(safe / 2.0) / safe) ** 2)
    k = hat(v)
    return np.eye(3) + a * k + b * (k @ k)


def log(R: Array) -> Array:
    """Rotation vector of a rotation matrix, (..., 3, 3) -> (..., 3) rad, length in [0, pi].

    Goes through the unit quaternion (Shepperd 1978), which keeps full precision near pi.
    """
    R = np.asarray(R, dtype=float)
    m = R.reshape(-1, 3, 3)
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    diagonal = np.stack([m[:, 0, 0], m[:, 1, 1], m[:, 2, 2], trace], axis=1)
    case = np.argmax(diagonal, axis=1)
    q = np.empty((len(m), 4))  # w, x, y, z, not yet of unit length
    skew = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1)
    w = case == 3
    q[w, 0] = 1.0 + trace[w]
    q[w, 1:] = skew[w]
    for i in range(3):
        c = case == i
        if not np.any(c):
            continue
        j, k = (i + 1) % 3, (i + 2) % 3
        q[c, 0] = skew[c, i]
        q[c, 1 + i] = 1.0 + m[c, i, i] - m[c, j, j] - m[c, k, k]
        q[c, 1 + j] = m[c, i, j] + m[c, j, i]
        q[c, 1 + k] = m[c, i, k] + m[c, k, i]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    q *= np.where(q[:, :1] < 0.0, -1.0, 1.0)
    s = np.linalg.norm(q[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(s, q[:, 0])
    scale = np.where(s < _SMALL, 2.0, angle / np.where(s < _SMALL, 1.0, s))
    return (q[:, 1:] * scale[:, None]).reshape(R.shape[:-1])


def left_jacobian(v: Array) -> Array:
    """Jl with exp(v + dv) = exp(Jl(v) dv) exp(v) to first order, (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, dtype=float)
    angle = np.sqrt(np.sum(v * v, axis=-1))[..., None, None]
    small = angle < 1e-4  # the cubic coefficient cancels badly below; its series is exact there
    safe = np.where(small, 1.0, angle)
    b = np.where(small, 0.5 - angle**2 / 24.0, 2.0 * (np.sin(safe / 2.0) / safe) ** 2)
    c = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    k = hat(v)
    return np.eye(3) + b * k + c * (k @ k)


def from_euler(angles: Array) -> Array:
    """R = Rx(omega) Ry(phi) Rz(kappa), active and right-handed, (..., 3) rad -> (..., 3, 3).

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
    """omega, phi, kappa of from_euler, (..., 3, 3) -> (..., 3) rad, phi in [-pi/2, pi/2].

    Within 1e-9 of phi = +-90 deg only omega +- kappa is determined: kappa is set to 0.
    """
    R = np.asarray(R, dtype=float)
    phi = np.arctan2(R[..., 0, 2], np.hypot(R[..., 0, 0], R[..., 0, 1]))
    singular = np.hypot(R[..., 0, 0], R[..., 0, 1]) < 1e-9
    omega = np.where(singular, np.arctan2(R[..., 2, 1], R[..., 1, 1]), np.arctan2(-R[..., 1, 2], R[..., 2, 2]))
    kappa = np.where(singular, 0.0, np.arctan2(-R[..., 0, 1], R[..., 0, 0]))
    return np.stack([omega, phi, kappa], axis=-1)


def euler_rate_matrix(angles: Array) -> Array:
    """E with w_obj = E @ d(omega, phi, kappa)/dt, (..., 3) -> (..., 3, 3).

    Its determinant is cos(phi): it loses rank at phi = +-90 deg, where Euler rates say nothing of one axis.
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
    """Two orthonormal columns perpendicular to each unit vector, (..., 3) -> (..., 3, 2).

    Smooth on either side of z = 0, where it jumps; no such basis is smooth on the whole sphere.
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


def align(a: Array, b: Array, weights: Array | None = None) -> Array:
    """Rotation R, (3, 3), that minimises sum w |b - R a|^2 over pairs of vectors, both (n, 3).

    Wahba's problem by singular value decomposition (Markley 1988). At least two directions must differ;
    with fewer the result is one of many.
    """
    w = np.ones(len(a)) if weights is None else weights
    u, _, vt = np.linalg.svd((b * w[:, None]).T @ a)
    d = np.sign(np.linalg.det(u @ vt))
    return u @ np.diag([1.0, 1.0, d]) @ vt
