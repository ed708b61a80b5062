"""Refinement of a pose to a peak of the likelihood, with its curvature, for proposals.

Gauss-Newton steps on the residuals of fields and outline, with the weights of `likelihood` and `limb` and the common
offsets of rims and outline as further unknowns. The inverse normal matrix is the covariance of the Gaussian at the peak
(Laplace's approximation). Derivatives are differences over half a pixel, which average the effect of single pixels.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from spheremouse.geometry.rotation import Array, exp_into
from spheremouse.wand import limb
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import (
    FULL_FACING,
    MIN_FACING,
    OUTLIER,
    RIM_OFFSET,
    SIGMA,
    bounded_fractions,
    expected_field,
    interpolate,
    point_weight,
)
from spheremouse.wand.model import Model, rotate, to_pixel

_COARSE_SIGMAS = (0.6, 0.4, 0.25, 0.13)  # of the field's range, in the first rounds, far from the peak
_MAX_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class Peak:
    """Maximum of the likelihood, with the Gaussian that approximates it."""

    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad: position + d, exp(theta) @ rotation, in cam axes
    edges: Array  # (24, 5) of the outline, `limb.measure_edges`
    slope: float  # twice the gain in log-likelihood that a further round promises: small at the peak


def refine_pose(
    position: Array, rotation: Array, model: Model, fields: Fields, edges: Array, rounds: int = _MAX_ROUNDS
) -> Peak:
    """Return the peak near a pose, (3,) m in cam and R_cam_ball (3, 3), after at most `rounds` steps.

    `edges` (24, 5) are those of the outline, or 0.
    """
    p, R, covariance = position.copy(), rotation.copy(), np.empty((6, 6))
    points = model.points
    slope = _refine(
        p, R, points.table, points.colour, model.radius, model.lens, fields.weight, fields.glare,
        fields.place(), bounded_fractions(fields), fields.rim, edges, rounds, covariance,
    )  # fmt: skip
    return Peak(p, R, covariance, edges, slope)


@njit(cache=True, fastmath=True, error_model="numpy")
def field_residuals(c, R, table, colour, radius, lens, weight, glare, place, rim, w, r, g, e_of, m_of):
    """Write the residuals m - e of all points to r, (p,), or 0 if glare explains them.

    w is the weight, 0 of a point that is turned away; g is de / d(rim offset). The field m of a bare point is the
    greatest of all colours.
    """
    count, field_h, field_w = weight.shape
    f = place[2]
    disc_weight = 1.0
    for q in range(len(table)):
        w[q] = 0.0
        r[q] = 0.0
        g[q] = 0.0
        nx, ny, nz = rotate(R, table, q, 0)
        x, y, z = c[0] + radius * nx, c[1] + radius * ny, c[2] + radius * nz
        towards = nx * x + ny * y + nz * z
        if towards >= 0.0 and table[q, 9] == 0.0:
            continue
        per_length = 1.0 / np.sqrt(x * x + y * y + z * z)
        facing = -towards * per_length
        if table[q, 9] > 0.0:
            disc_weight = point_weight(facing, lens[0] * radius * per_length / f, table[q, 9])
        if z <= 0.0:
            continue
        if facing <= MIN_FACING:
            continue
        u, v = to_pixel(x, y, z, lens)
        px, py = (u - place[0] + 0.5) / f - 0.5, (v - place[1] + 0.5) / f - 0.5
        if not (px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1):
            continue
        j, i = np.int64(px), np.int64(py)
        hidden = interpolate(glare, 0, i, j, px - j, py - i) if len(glare) > 0 else 0.0
        w[q] = disc_weight * min((facing - MIN_FACING) / (FULL_FACING - MIN_FACING), 1.0) * (1.0 - hidden)
        if colour[q] < 0:
            m = 0.0
            for k in range(count):
                m = max(m, interpolate(weight, k, i, j, px - j, py - i))
            m_of[q], e_of[q], r[q] = m, 0.0, m
            continue
        m = interpolate(weight, colour[q], i, j, px - j, py - i)
        tx, ty, tz = rotate(R, table, q, 3)
        along = (tx * x + ty * y + tz * z) * per_length
        # tangent x normal points out of the disc
        outward = ((ty * nz - tz * ny) * x + (tz * nx - tx * nz) * y + (tx * ny - ty * nx) * z) * per_length
        scale = lens[0] * radius * per_length / f
        e, slope = expected_field(along, outward, facing, scale, table[q, 6], table[q, 7], table[q, 8], rim[colour[q]])
        m_of[q], e_of[q], r[q], g[q] = m, e, m - e, slope
        if hidden > 0.0 and m < e:
            r[q] = min(m + hidden - e, 0.0)
            e_of[q] = m - r[q]
            g[q] = slope if r[q] < 0.0 else 0.0


@njit(cache=True, fastmath=True, error_model="numpy")
def _outline_residuals(c, radius, lens, edges, r):
    for k in range(len(edges)):
        r[k] = 0.0
        if edges[k, 4] > 0.0:
            u, v, _, _, _ = limb.outline_point(c, radius, lens, k)
            r[k] = (edges[k, 0] - u) * edges[k, 2] + (edges[k, 1] - v) * edges[k, 3]


@njit(cache=True, fastmath=True, error_model="numpy")
def _refine(c, R, table, colour, radius, lens, weight, glare, place, fraction, rim, edges, rounds, covariance):
    n, count, f = len(table), len(weight), place[2]
    size = 6 + count + 1
    w, r, g, e, m = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    side = np.empty((2, n))
    seen = np.empty((2, n))
    spare = np.empty((3, n))
    J = np.empty((n, 6))
    outline_r, outline_side, outline_J = np.empty(len(edges)), np.empty((2, len(edges))), np.empty((len(edges), 6))
    theta, dR, at, turned = np.zeros(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    A, b = np.empty((size, size)), np.empty(size)
    row = np.empty(size)
    offsets = np.zeros(count + 1)
    slope = 0.0
    B = np.empty((3, 3))
    prior_sigma = np.array([0.5 * radius, 0.5 * radius, 2.0 * radius, 0.3, 0.3, 0.3])
    for iteration in range(rounds + 1):
        field_residuals(c, R, table, colour, radius, lens, weight, glare, place, rim, w, r, g, e, m)
        _outline_residuals(c, radius, lens, edges, outline_r)
        distance = np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
        half = 0.5 * f * distance / lens[0]  # m of half a pixel
        _ray_basis(c, distance, B)
        for k in range(6):
            step = half if k < 2 else (half * min(distance / radius, 40.0) if k == 2 else 0.5 * half / radius)
            for s in range(2):
                sign = 1.0 - 2.0 * s
                at[:] = c
                theta[:] = 0.0
                if k < 3:
                    for i in range(3):
                        at[i] += sign * step * B[i, k]
                    turned[:] = R
                else:
                    theta[k - 3] = sign * step
                    exp_into(theta, dR)
                    turned[:] = dR @ R
                field_residuals(
                    at, turned, table, colour, radius, lens, weight, glare, place, rim, seen[s], side[s], spare[0],
                    spare[1], spare[2],
                )  # fmt: skip
                if k < 3:
                    _outline_residuals(at, radius, lens, edges, outline_side[s])
            for q in range(n):
                J[q, k] = 0.0
                if seen[0, q] > 0.0 and seen[1, q] > 0.0:
                    J[q, k] = (side[0, q] - side[1, q]) / (2.0 * step)
            for q in range(len(edges)):
                outline_J[q, k] = (outline_side[0, q] - outline_side[1, q]) / (2.0 * step) if k < 3 else 0.0
        A[:] = 0.0
        b[:] = 0.0
        coarse = iteration < rounds - 4
        for q in range(n):
            if w[q] == 0.0:
                continue
            k = colour[q]
            width = SIGMA
            if coarse:
                width = _COARSE_SIGMAS[min(iteration, 3)]
            p = fraction[max(k, 0)]
            inlier = (1.0 - OUTLIER) * np.exp(-0.5 * (r[q] / width) ** 2)
            inlier /= (1.0 - p) * np.exp(-0.5 * (e[q] / width) ** 2) + p
            row_weight = w[q] * inlier / (inlier + OUTLIER) / SIGMA**2
            row[:] = 0.0
            row[:6] = J[q]
            if k >= 0:
                row[6 + k] = -g[q]
            residual = r[q] - (g[q] * offsets[k] if k >= 0 else 0.0)
            for i in range(size):
                if row[i] != 0.0:
                    b[i] -= row_weight * row[i] * residual
                    for j in range(size):
                        A[i, j] += row_weight * row[i] * row[j]
        for q in range(len(edges)):
            if edges[q, 4] == 0.0:
                continue
            s2 = (limb.SIGMA * f) ** 2
            inlier = (
                (1.0 - limb.HIDDEN)
                * np.exp(-0.5 * outline_r[q] ** 2 / s2 / (4.0 if coarse else 1.0))
                / limb.UNIFORM_DENSITY
            )
            row_weight = inlier / (inlier + limb.HIDDEN) / s2
            row[:] = 0.0
            row[:6] = outline_J[q]
            row[size - 1] = -1.0
            residual = outline_r[q] - offsets[count]
            for i in range(size):
                if row[i] != 0.0:
                    b[i] -= row_weight * row[i] * residual
                    for j in range(size):
                        A[i, j] += row_weight * row[i] * row[j]
        for k in range(count):
            A[6 + k, 6 + k] += 1.0 / RIM_OFFSET**2
            b[6 + k] -= offsets[k] / RIM_OFFSET**2
        A[size - 1, size - 1] += 1.0 / (limb.OFFSET_SIGMA * f) ** 2
        b[size - 1] -= offsets[count] / (limb.OFFSET_SIGMA * f) ** 2
        for k in range(6):
            A[k, k] += 1.0 / prior_sigma[k] ** 2
        dx = np.linalg.solve(A, b)
        if iteration == rounds:
            slope = np.sum(dx * b)
            break
        longest = max(abs(dx[0]), abs(dx[1]))
        excess = max(longest / (0.5 * radius), abs(dx[2]) / (0.15 * distance))
        for k in range(3):
            excess = max(excess, abs(dx[3 + k]) / 0.4)
        scale = 1.0 / max(excess, 1.0)
        for k in range(3):
            for i in range(3):
                c[i] += scale * dx[k] * B[i, k]
            theta[k] = scale * dx[3 + k]
        exp_into(theta, dR)
        R[:] = dR @ R
        for k in range(count + 1):
            offsets[k] += dx[6 + k]
    full = np.eye(6)
    full[:3, :3] = B
    covariance[:] = full @ np.ascontiguousarray(np.linalg.inv(A)[:6, :6]) @ full.T
    return slope


@njit(cache=True, error_model="numpy")
def _ray_basis(c, distance, B):
    """Write two columns across the line of sight and one along it to B, (3, 3). The third one moves no image point."""
    n = np.sqrt(c[0] * c[0] + c[2] * c[2])
    B[0, 0], B[1, 0], B[2, 0] = c[2] / n, 0.0, -c[0] / n
    for i in range(3):
        B[i, 2] = c[i] / distance
    B[0, 1] = B[1, 2] * B[2, 0] - B[2, 2] * B[1, 0]
    B[1, 1] = B[2, 2] * B[0, 0] - B[0, 2] * B[2, 0]
    B[2, 1] = B[0, 2] * B[1, 0] - B[1, 2] * B[0, 0]
