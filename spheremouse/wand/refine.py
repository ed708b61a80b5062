"""From a pose near the truth to the peak of the same likelihood, with its curvature: for proposals, not for estimates.

Gauss-Newton on the residuals of fields and outline that `likelihood` and `limb` weigh, points weighted as there, the
common offsets of rims and outline as further unknowns. The inverse normal matrix is the Gaussian that fits the peak
(Laplace). Derivatives are differences over about half a pixel, which smooths what single pixels add.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from spheremouse.geometry.camera import distorted
from spheremouse.geometry.rotation import Array, exp_into
from spheremouse.wand import limb
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import (
    BEGINS,
    FULLY,
    OUTLIER,
    RIM_OFFSET,
    SIGMA,
    between,
    counted,
    expected_field,
    shares,
)
from spheremouse.wand.model import Model

_SOFT = (0.6, 0.4, 0.25, 0.13)  # of the field's range: residuals believed in the first rounds, far from the peak
_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class Peak:
    """A maximum of the likelihood, with the Gaussian that fits it."""

    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad: position + d, exp(theta) @ rotation, in cam axes
    edges: Array  # (24, 5) of the outline, `limb.measure`
    slope: float  # twice the log-likelihood that a further round would gain: small at the peak


def refine(position: Array, rotation: Array, model: Model, fields: Fields, edges: Array, rounds: int = _ROUNDS) -> Peak:
    """The peak near a pose; `edges` of the outline, (24, 5), as far as known."""
    p, R, covariance = position.copy(), rotation.copy(), np.empty((6, 6))
    points = model.points
    slope = _refine(
        p, R, points.table, points.colour, model.radius, model.lens, fields.weight, fields.glare,
        fields.place(), shares(fields), fields.rim, edges, rounds, covariance,
    )  # fmt: skip
    return Peak(p, R, covariance, edges, slope)


@njit(cache=True, fastmath=True, error_model="numpy")
def _residuals(c, R, table, colour, radius, lens, weight, glare, place, rim, counts, r, g, e_of, m_of):
    """m - e of every point, 0 where glare may make up for it; `counts` 0 where it is turned away.

    Bare points: the greatest of all colours.
    """
    count, field_h, field_w = weight.shape
    f = place[2]
    disc_counts = 1.0
    for q in range(len(table)):
        counts[q] = 0.0
        r[q] = 0.0
        g[q] = 0.0
        nx = R[0, 0] * table[q, 0] + R[0, 1] * table[q, 1] + R[0, 2] * table[q, 2]
        ny = R[1, 0] * table[q, 0] + R[1, 1] * table[q, 1] + R[1, 2] * table[q, 2]
        nz = R[2, 0] * table[q, 0] + R[2, 1] * table[q, 1] + R[2, 2] * table[q, 2]
        x, y, z = c[0] + radius * nx, c[1] + radius * ny, c[2] + radius * nz
        towards = nx * x + ny * y + nz * z
        if towards >= 0.0 and table[q, 9] == 0.0:
            continue
        per_length = 1.0 / np.sqrt(x * x + y * y + z * z)
        facing = -towards * per_length
        if table[q, 9] > 0.0:
            disc_counts = counted(facing, lens[0] * radius * per_length / f, table[q, 9])
        if z <= 0.0:
            continue
        if facing <= BEGINS:
            continue
        xd, yd, _, _, _ = distorted(x / z, y / z, lens[4:])
        px = (lens[0] * xd + lens[2] - place[0] + 0.5) / f - 0.5
        py = (lens[1] * yd + lens[3] - place[1] + 0.5) / f - 0.5
        if not (px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1):
            continue
        j, i = np.int64(px), np.int64(py)
        hidden = between(glare, 0, i, j, px - j, py - i) if len(glare) > 0 else 0.0
        counts[q] = disc_counts * min((facing - BEGINS) / (FULLY - BEGINS), 1.0) * (1.0 - hidden)
        if colour[q] < 0:
            m = 0.0
            for k in range(count):
                m = max(m, between(weight, k, i, j, px - j, py - i))
            m_of[q], e_of[q], r[q] = m, 0.0, m
            continue
        m = between(weight, colour[q], i, j, px - j, py - i)
        tx = R[0, 0] * table[q, 3] + R[0, 1] * table[q, 4] + R[0, 2] * table[q, 5]
        ty = R[1, 0] * table[q, 3] + R[1, 1] * table[q, 4] + R[1, 2] * table[q, 5]
        tz = R[2, 0] * table[q, 3] + R[2, 1] * table[q, 4] + R[2, 2] * table[q, 5]
        along = (tx * x + ty * y + tz * z) * per_length
        # tangent x normal: the way out of the disc
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
            u, v, _, _, _ = limb.outline(c, radius, lens, k)
            r[k] = (edges[k, 0] - u) * edges[k, 2] + (edges[k, 1] - v) * edges[k, 3]


@njit(cache=True, fastmath=True, error_model="numpy")
def _refine(c, R, table, colour, radius, lens, weight, glare, place, share, rim, edges, rounds, covariance):
    n, count, f = len(table), len(weight), place[2]
    size = 6 + count + 1
    counts, r, g, e, m = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    side = np.empty((2, n))
    seen = np.empty((2, n))
    spare = np.empty((3, n))
    J = np.empty((n, 6))
    lr, lside, lJ = np.empty(len(edges)), np.empty((2, len(edges))), np.empty((len(edges), 6))
    theta, turn, at, turned = np.zeros(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    A, b = np.empty((size, size)), np.empty(size)
    row = np.empty(size)
    offsets = np.zeros(count + 1)
    slope = 0.0
    B = np.empty((3, 3))
    free = np.array([0.5 * radius, 0.5 * radius, 2.0 * radius, 0.3, 0.3, 0.3])
    for turn_of in range(rounds + 1):
        _residuals(c, R, table, colour, radius, lens, weight, glare, place, rim, counts, r, g, e, m)
        _outline_residuals(c, radius, lens, edges, lr)
        distance = np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
        half = 0.5 * f * distance / lens[0]  # m that are half a pixel
        _along_ray(c, distance, B)
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
                    exp_into(theta, turn)
                    turned[:] = turn @ R
                _residuals(
                    at,
                    turned,
                    table,
                    colour,
                    radius,
                    lens,
                    weight,
                    glare,
                    place,
                    rim,
                    seen[s],
                    side[s],
                    spare[0],
                    spare[1],
                    spare[2],
                )
                if k < 3:
                    _outline_residuals(at, radius, lens, edges, lside[s])
            for q in range(n):
                J[q, k] = 0.0
                if seen[0, q] > 0.0 and seen[1, q] > 0.0:
                    J[q, k] = (side[0, q] - side[1, q]) / (2.0 * step)
            for q in range(len(edges)):
                lJ[q, k] = (lside[0, q] - lside[1, q]) / (2.0 * step) if k < 3 else 0.0
        A[:] = 0.0
        b[:] = 0.0
        soft = turn_of < rounds - 4
        for q in range(n):
            if counts[q] == 0.0:
                continue
            k = colour[q]
            width = SIGMA
            if soft:
                width = _SOFT[min(turn_of, 3)]
            p = share[max(k, 0)]
            believed = (1.0 - OUTLIER) * np.exp(-0.5 * (r[q] / width) ** 2)
            believed /= (1.0 - p) * np.exp(-0.5 * (e[q] / width) ** 2) + p
            w = counts[q] * believed / (believed + OUTLIER) / SIGMA**2
            row[:] = 0.0
            row[:6] = J[q]
            if k >= 0:
                row[6 + k] = -g[q]
            residual = r[q] - (g[q] * offsets[k] if k >= 0 else 0.0)
            for i in range(size):
                if row[i] != 0.0:
                    b[i] -= w * row[i] * residual
                    for j in range(size):
                        A[i, j] += w * row[i] * row[j]
        for q in range(len(edges)):
            if edges[q, 4] == 0.0:
                continue
            s2 = (limb.SIGMA * f) ** 2
            believed = (1.0 - limb.HIDDEN) * np.exp(-0.5 * lr[q] ** 2 / s2 / (4.0 if soft else 1.0)) / limb.FLAT
            w = believed / (believed + limb.HIDDEN) / s2
            row[:] = 0.0
            row[:6] = lJ[q]
            row[size - 1] = -1.0
            residual = lr[q] - offsets[count]
            for i in range(size):
                if row[i] != 0.0:
                    b[i] -= w * row[i] * residual
                    for j in range(size):
                        A[i, j] += w * row[i] * row[j]
        for k in range(count):
            A[6 + k, 6 + k] += 1.0 / RIM_OFFSET**2
            b[6 + k] -= offsets[k] / RIM_OFFSET**2
        A[size - 1, size - 1] += 1.0 / (limb.OFFSET * f) ** 2
        b[size - 1] -= offsets[count] / (limb.OFFSET * f) ** 2
        for k in range(6):
            A[k, k] += 1.0 / free[k] ** 2
        step_of = np.linalg.solve(A, b)
        if turn_of == rounds:
            slope = np.sum(step_of * b)
            break
        longest = max(abs(step_of[0]), abs(step_of[1]))
        most = max(longest / (0.5 * radius), abs(step_of[2]) / (0.15 * distance))
        for k in range(3):
            most = max(most, abs(step_of[3 + k]) / 0.4)
        scale = 1.0 / max(most, 1.0)
        for k in range(3):
            for i in range(3):
                c[i] += scale * step_of[k] * B[i, k]
            theta[k] = scale * step_of[3 + k]
        exp_into(theta, turn)
        R[:] = turn @ R
        for k in range(count + 1):
            offsets[k] += step_of[6 + k]
    full = np.eye(6)
    full[:3, :3] = B
    covariance[:] = full @ np.ascontiguousarray(np.linalg.inv(A)[:6, :6]) @ full.T
    return slope


@njit(cache=True, error_model="numpy")
def _along_ray(c, distance, B):
    """Two columns across the line of sight and one along it, into B, (3, 3): distance then moves no image."""
    n = np.sqrt(c[0] * c[0] + c[2] * c[2])
    B[0, 0], B[1, 0], B[2, 0] = c[2] / n, 0.0, -c[0] / n
    for i in range(3):
        B[i, 2] = c[i] / distance
    B[0, 1] = B[1, 2] * B[2, 0] - B[2, 2] * B[1, 0]
    B[1, 1] = B[2, 2] * B[0, 0] - B[0, 2] * B[2, 0]
    B[2, 1] = B[0, 2] * B[1, 0] - B[1, 2] * B[0, 0]
