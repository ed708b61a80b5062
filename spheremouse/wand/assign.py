"""Assignment of spots to the discs of a ball, by two and by three spots, and the pose of each assignment."""

import numpy as np
from numba import njit

_MAX_NEIGHBOURS = 8  # of a spot: as many discs as one side of a ball shows


@njit(cache=True, error_model="numpy")
def assign_spots(
    xy, area, colour, direction, angle, colours, limits, pixels, min_score, glare, begin, max_assignments, found
):
    """Write poses to `found`, (k, 13): score, centre in radii of the ball, rotation. Return their number.

    The second result is the spot at which `max_assignments` were reached, or 0. Spots are `xy` (n, 2) reduced
    coordinates, `area` and index of `colour`; discs are `direction` (m, 3), angular radius `angle` and index in
    `colours`; `limits` are those of the ball's radius over its distance; `pixels` is the tolerance of a centroid.
    """
    n, m = len(xy), len(direction)
    kept = 0
    near = np.empty(n, dtype=np.int64)
    gap = np.empty(n)
    R = np.empty((3, 3))
    E = np.empty((3, 3))
    q = np.empty((n, 2))
    glare_q = np.empty((len(glare), 3))
    pairs = np.empty((m, m))
    spots, discs, axes = (q, area, colour, near, glare_q), (direction, angle, colours, pairs), (R, E)
    by_colour = np.zeros(max(np.max(colours), np.max(colour)) + 1, dtype=np.int64)
    for i in range(m):
        by_colour[colours[i]] += 1
    for i in range(m):
        for j in range(m):
            pairs[i, j] = _row_product(direction, i, direction, j)
    spent = 0
    for at in range(n):
        s0 = (begin + at) % n
        if spent >= max_assignments:
            return kept, s0
        # plane tangent to the unit sphere at this spot's ray: nearby, perspective has no effect
        x, y = xy[s0, 0], xy[s0, 1]
        length = np.sqrt(x * x + y * y + 1.0)
        across = np.sqrt(1.0 + x * x)
        E[0, 0], E[1, 0], E[2, 0] = 1.0 / across, 0.0, -x / across
        E[0, 2], E[1, 2], E[2, 2] = x / length, y / length, 1.0 / length
        E[0, 1] = E[1, 2] * E[2, 0] - E[2, 2] * E[1, 0]
        E[1, 1] = E[2, 2] * E[0, 0] - E[0, 2] * E[2, 0]
        E[2, 1] = E[0, 2] * E[1, 0] - E[1, 2] * E[0, 0]
        for s in range(len(glare)):
            depth = _project_to_plane(glare[s, 0], glare[s, 1], E, glare_q[s])
            glare_q[s, 2] = glare[s, 2] if depth > 0.0 else 0.0
        for s in range(n):
            depth = _project_to_plane(xy[s, 0], xy[s, 1], E, q[s])
            gap[s] = q[s, 0] ** 2 + q[s, 1] ** 2
            if depth <= 0.0:
                gap[s] = 1e9
        near[:] = np.argsort(gap)
        count = min(n, _MAX_NEIGHBOURS + 1)
        for i1 in range(1, count):
            s1 = near[i1]
            if s1 > s0 and gap[s1] < 4.0 * limits[1] ** 2:
                spent += by_colour[colour[s0]] * by_colour[colour[s1]]
                kept = _assign_two(s0, s1, spots, discs, axes, limits, pixels, min_score, count, found, kept)
            for i2 in range(i1 + 1, count):
                s2 = near[i2]
                if gap[s2] > 4.0 * limits[1] ** 2 or (s1 < s0 and s2 < s0):
                    continue
                spent += by_colour[colour[s0]] * by_colour[colour[s1]] * by_colour[colour[s2]]
                kept = _assign_three(s0, s1, s2, spots, discs, axes, limits, pixels, min_score, count, found, kept)
    return kept, 0


@njit(cache=True, error_model="numpy", inline="always")
def _row_product(A, i, B, j):
    """Return the scalar product of row i of A and row j of B, (n, 3)."""
    return A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]


@njit(cache=True, error_model="numpy", inline="always")
def _difference(A, i, j):
    """Return row i less row j of A, (n, 3)."""
    return A[i, 0] - A[j, 0], A[i, 1] - A[j, 1], A[i, 2] - A[j, 2]


@njit(cache=True, error_model="numpy")
def _project_to_plane(x, y, E, q):
    """Write a ray's coordinates in the tangent plane E to q, (2,) or longer; return its depth."""
    depth = E[0, 2] * x + E[1, 2] * y + E[2, 2]
    q[0] = (E[0, 0] * x + E[1, 0] * y + E[2, 0]) / depth
    q[1] = (E[0, 1] * x + E[1, 1] * y + E[2, 1]) / depth
    return depth


@njit(cache=True, error_model="numpy")
def _assign_three(s0, s1, s2, spots, discs, axes, limits, pixels, min_score, count, found, kept):
    """Assign three spots to triples of discs."""
    q, area, colour, _, _ = spots
    direction, angle, colours, pairs = discs
    R, m = axes[0], len(direction)
    d00, d01 = q[s1, 0] - q[s0, 0], q[s1, 1] - q[s0, 1]
    d10, d11 = q[s2, 0] - q[s0, 0], q[s2, 1] - q[s0, 1]
    for a in range(m):
        if colours[a] != colour[s0]:
            continue
        for b in range(m):
            if b == a or colours[b] != colour[s1] or pairs[a, b] < -0.9:
                continue
            for c in range(m):
                if c in (a, b) or colours[c] != colour[s2] or pairs[a, c] < -0.9 or pairs[b, c] < -0.9:
                    continue
                # M (3 columns) with M (n_b - n_a) = d0, M (n_c - n_a) = d1: rows of R times the scale
                b0x, b0y, b0z = _difference(direction, b, a)
                b1x, b1y, b1z = _difference(direction, c, a)
                g00, g01 = b0x * b0x + b0y * b0y + b0z * b0z, b0x * b1x + b0y * b1y + b0z * b1z
                g11 = b1x * b1x + b1y * b1y + b1z * b1z
                det = g00 * g11 - g01 * g01
                if det < 1e-3:
                    continue
                i00, i01, i11 = g11 / det, -g01 / det, g00 / det
                # rows of D G^-1
                p00, p01 = d00 * i00 + d10 * i01, d00 * i01 + d10 * i11
                p10, p11 = d01 * i00 + d11 * i01, d01 * i01 + d11 * i11
                a00, a01, a11 = p00 * d00 + p01 * d10, p00 * d01 + p01 * d11, p10 * d01 + p11 * d11
                half, root = 0.5 * (a00 + a11), np.sqrt(0.25 * (a00 - a11) ** 2 + a01 * a01)
                scale = np.sqrt(half + root)
                if not limits[0] < scale < limits[1]:
                    continue
                # no spot is larger than its disc
                largest = 1.6 * np.pi * scale * scale
                if (
                    area[s0] > largest * angle[a] ** 2 + 9.0 * pixels**2
                    or area[s1] > largest * angle[b] ** 2 + 9.0 * pixels**2
                    or area[s2] > largest * angle[c] ** 2 + 9.0 * pixels**2
                ):
                    continue
                # part of both rows along the triangle's normal: eigenvector of the smaller eigenvalue
                ex, ey = a01, half - root - a00
                if abs(ex) + abs(ey) < 1e-12 * half:
                    ex, ey = (1.0, 0.0) if a00 < a11 else (0.0, 1.0)
                norm = np.sqrt(ex * ex + ey * ey)
                size = np.sqrt(2.0 * root)
                ex, ey = ex / norm * size, ey / norm * size
                kx, ky, kz = b0y * b1z - b0z * b1y, b0z * b1x - b0x * b1z, b0x * b1y - b0y * b1x
                norm = np.sqrt(kx * kx + ky * ky + kz * kz)
                kx, ky, kz = kx / norm, ky / norm, kz / norm
                for way in range(2):
                    sign = 1.0 - 2.0 * way
                    R[0, 0] = (p00 * b0x + p01 * b1x + sign * ex * kx) / scale
                    R[0, 1] = (p00 * b0y + p01 * b1y + sign * ex * ky) / scale
                    R[0, 2] = (p00 * b0z + p01 * b1z + sign * ex * kz) / scale
                    R[1, 0] = (p10 * b0x + p11 * b1x + sign * ey * kx) / scale
                    R[1, 1] = (p10 * b0y + p11 * b1y + sign * ey * ky) / scale
                    R[1, 2] = (p10 * b0z + p11 * b1z + sign * ey * kz) / scale
                    R[2, 0] = R[0, 1] * R[1, 2] - R[0, 2] * R[1, 1]
                    R[2, 1] = R[0, 2] * R[1, 0] - R[0, 0] * R[1, 2]
                    R[2, 2] = R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0]
                    facing = True
                    for d in (a, b, c):
                        facing = facing and _row_product(R, 2, direction, d) < -0.05
                    if not facing:
                        continue
                    cx = q[s0, 0] - scale * _row_product(R, 0, direction, a)
                    cy = q[s0, 1] - scale * _row_product(R, 1, direction, a)
                    kept = _keep(cx, cy, scale, spots, discs, axes, pixels, min_score, count, found, kept)
    return kept


@njit(cache=True, error_model="numpy")
def _assign_two(s0, s1, spots, discs, axes, limits, pixels, min_score, count, found, kept):
    """Assign two spots to pairs of discs. The area of a spot gives the angle by which its disc is turned away."""
    q, area, colour, _, _ = spots
    direction, angle, colours, pairs = discs
    R, m = axes[0], len(direction)
    dx, dy = q[s1, 0] - q[s0, 0], q[s1, 1] - q[s0, 1]
    gap = dx * dx + dy * dy
    inner, outer = np.empty((3, 3)), np.empty((3, 3))
    for a in range(m):
        for b in range(m):
            if b == a or colours[a] != colour[s0] or colours[b] != colour[s1] or pairs[a, b] < -0.9:
                continue
            chord = 2.0 - 2.0 * pairs[a, b]
            turned_a, turned_b = area[s0] / (np.pi * angle[a] ** 2), area[s1] / (np.pi * angle[b] ** 2)
            square = (gap + np.sqrt(gap * gap + 4.0 * chord * (turned_a - turned_b) ** 2)) / (2.0 * chord)
            scale = np.sqrt(square)
            if not limits[0] < scale < limits[1]:
                continue
            za, zb = turned_a / square, turned_b / square
            if za > 1.25 or zb > 1.25:  # spots larger than discs seen from the front
                continue
            za, zb = min(za, 0.999), min(zb, 0.999)
            # in units of the radius: x of a with |a| = 1, |a + d| = 1
            length = np.sqrt(gap) / scale
            ux, uy = dx / (length * scale), dy / (length * scale)
            along = ((1.0 - zb * zb) - (1.0 - za * za) - length * length) / (2.0 * length)
            aside = np.sqrt(max(1.0 - za * za - along * along, 0.0))
            for way in range(2):
                sign = 1.0 - 2.0 * way
                ax, ay = along * ux - sign * aside * uy, along * uy + sign * aside * ux
                bx, by = ax + length * ux, ay + length * uy
                nx, ny, nz = direction[a]
                mx, my, mz = direction[b]
                _frame(nx, ny, nz, mx, my, mz, inner)
                _frame(ax, ay, -za, bx, by, -zb, outer)
                R[:] = outer @ inner.T
                cx, cy = q[s0, 0] - scale * ax, q[s0, 1] - scale * ay
                kept = _keep(cx, cy, scale, spots, discs, axes, pixels, min_score, count, found, kept)
    return kept


@njit(cache=True, error_model="numpy")
def _frame(ax, ay, az, bx, by, bz, F):
    """Write orthonormal columns along a + b, a - b and across both to F, (3, 3). a and b are unit vectors."""
    sx, sy, sz = ax + bx, ay + by, az + bz
    n = np.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / n, sy / n, sz / n
    dx, dy, dz = ax - bx, ay - by, az - bz
    dot = dx * sx + dy * sy + dz * sz
    dx, dy, dz = dx - dot * sx, dy - dot * sy, dz - dot * sz
    n = np.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / n, dy / n, dz / n
    F[0, 0], F[1, 0], F[2, 0] = sx, sy, sz
    F[0, 1], F[1, 1], F[2, 1] = dx, dy, dz
    F[0, 2], F[1, 2], F[2, 2] = sy * dz - sz * dy, sz * dx - sx * dz, sx * dy - sy * dx


@njit(cache=True, error_model="numpy")
def _keep(cx, cy, scale, spots, discs, axes, pixels, min_score, count, found, kept):
    """Write a pose of sufficient score to `found`, over the worst one if it is full. Return the number of poses."""
    R, E = axes
    score, number = _score(cx, cy, scale, R, spots, discs, pixels, count)
    if score < min_score:
        return kept
    score *= number  # two discs can agree by chance, five cannot
    row = kept
    if kept == len(found):
        row = np.argmin(found[:, 0])
        if found[row, 0] >= score:
            return kept
    else:
        kept += 1
    found[row, 0] = score
    for i in range(3):
        found[row, 1 + i] = (E[i, 0] * cx + E[i, 1] * cy + E[i, 2]) / scale
        for j in range(3):
            found[row, 4 + 3 * i + j] = E[i, 0] * R[0, j] + E[i, 1] * R[1, j] + E[i, 2] * R[2, j]
    return kept


@njit(cache=True, error_model="numpy")
def _score(cx, cy, scale, R, spots, discs, pixels, count):
    """Return the fraction, by area, of the visible discs with a spot of their colour and size, and their number.

    A spot on the ball without a disc reduces the fraction. The part of a disc that glare hides does not.
    """
    q, area, colour, near, glare_q = spots
    direction, angle, colours, _ = discs
    found_area, expected_area, number = 0.0, 0.0, 0
    used_spots = 0  # bits of the spots that belong to a disc
    within = (0.15 * scale + pixels) ** 2
    for d in range(len(direction)):
        z = -_row_product(R, 2, direction, d)
        if z < 0.0:
            continue
        x, y = cx + scale * _row_product(R, 0, direction, d), cy + scale * _row_product(R, 1, direction, d)
        expected = np.pi * (scale * angle[d]) ** 2 * z
        shown = expected
        for g in range(len(glare_q)):
            gap = np.sqrt((glare_q[g, 0] - x) ** 2 + (glare_q[g, 1] - y) ** 2)
            shown -= _overlap(np.sqrt(expected / np.pi), glare_q[g, 2], gap)
        shown = max(shown, 0.0)
        if z > 0.25:
            expected_area += shown
        # a highlight or a finger leaves part of a disc, with a centroid anywhere inside its outline
        length = max(np.sqrt((x - cx) ** 2 + (y - cy) ** 2), 1e-9)
        ux, uy = (x - cx) / length, (y - cy) / length
        inside = (scale * angle[d]) ** 2
        for i in range(count):
            s = near[i]
            if colour[s] != colours[d]:
                continue
            dx, dy = q[s, 0] - x, q[s, 1] - y
            across, aside = dx * ux + dy * uy, dy * ux - dx * uy
            part = area[s] < expected and (across / max(z, 0.25)) ** 2 + aside**2 < inside
            if part or dx * dx + dy * dy < within:
                used_spots |= 1 << i
                if z > 0.25:
                    # the reach of glare is inexact: any area from the rest to the whole disc agrees
                    found_area += shown * min(area[s] / max(shown, 1e-12), expected / area[s], 1.0)
                    number += 1
                break
    for i in range(count):
        s = near[i]
        if not used_spots & (1 << i) and (q[s, 0] - cx) ** 2 + (q[s, 1] - cy) ** 2 < (0.9 * scale) ** 2:
            expected_area += area[s]
    return (found_area / expected_area if expected_area > 0.0 else 0.0), number


@njit(cache=True, error_model="numpy")
def _overlap(a, b, gap):
    """Return the common area of two circles of radii a and b at a distance `gap`."""
    if gap >= a + b:
        return 0.0
    if gap <= abs(a - b):
        return np.pi * min(a, b) ** 2
    u = (gap * gap + a * a - b * b) / (2.0 * gap)
    v = gap - u
    return a * a * np.arccos(u / a) - u * np.sqrt(a * a - u * u) + b * b * np.arccos(v / b) - v * np.sqrt(b * b - v * v)
