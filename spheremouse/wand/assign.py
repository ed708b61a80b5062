"""Spots assigned to the discs of a ball."""

import numpy as np
from numba import njit

_NEIGHBOURS = 8  # of a spot that triples are made with: as many as a side of a ball shows


@njit(cache=True, error_model="numpy")
def search(xy, area, colour, direction, angle, colours, limits, pixels, least, glare, begin, effort, found):
    """Hypotheses into `found`: score, centre in radii of the ball, rotation. Gives their number.

    And the spot at which the effort was spent, or 0.
    """
    n, m = len(xy), len(direction)
    kept = 0
    near = np.empty(n, dtype=np.int64)
    gap = np.empty(n)
    R = np.empty((3, 3))
    E = np.empty((3, 3))
    q = np.empty((n, 2))
    pale = np.empty((len(glare), 3))
    pairs = np.empty((m, m))
    by_colour = np.zeros(max(np.max(colours), np.max(colour)) + 1, dtype=np.int64)
    for i in range(m):
        by_colour[colours[i]] += 1
    for i in range(m):
        for j in range(m):
            pairs[i, j] = (
                direction[i, 0] * direction[j, 0]
                + direction[i, 1] * direction[j, 1]
                + direction[i, 2] * direction[j, 2]
            )
    spent = 0
    for at in range(n):
        s0 = (begin + at) % n
        if spent >= effort:
            return kept, s0
        # a tangent plane at this spot's ray, in which the picture is a small, undistorted plan
        x, y = xy[s0, 0], xy[s0, 1]
        length = np.sqrt(x * x + y * y + 1.0)
        across = np.sqrt(1.0 + x * x)
        E[0, 0], E[1, 0], E[2, 0] = 1.0 / across, 0.0, -x / across
        E[0, 2], E[1, 2], E[2, 2] = x / length, y / length, 1.0 / length
        E[0, 1] = E[1, 2] * E[2, 0] - E[2, 2] * E[1, 0]
        E[1, 1] = E[2, 2] * E[0, 0] - E[0, 2] * E[2, 0]
        E[2, 1] = E[0, 2] * E[1, 0] - E[1, 2] * E[0, 0]
        for s in range(len(glare)):
            depth = _plan(glare[s, 0], glare[s, 1], E, pale[s])
            pale[s, 2] = glare[s, 2] if depth > 0.0 else 0.0
        for s in range(n):
            depth = _plan(xy[s, 0], xy[s, 1], E, q[s])
            gap[s] = q[s, 0] ** 2 + q[s, 1] ** 2
            if depth <= 0.0:
                gap[s] = 1e9
        near[:] = np.argsort(gap)
        count = min(n, _NEIGHBOURS + 1)
        for i1 in range(1, count):
            s1 = near[i1]
            if s1 > s0 and gap[s1] < 4.0 * limits[1] ** 2:
                spent += by_colour[colour[s0]] * by_colour[colour[s1]]
                kept = _assign_two(
                    s0, s1, q, area, colour, direction, angle, colours, pairs, limits, pixels, least, pale, E, R,
                    near, count, found, kept,
                )  # fmt: skip
            for i2 in range(i1 + 1, count):
                s2 = near[i2]
                if gap[s2] > 4.0 * limits[1] ** 2 or (s1 < s0 and s2 < s0):
                    continue
                spent += by_colour[colour[s0]] * by_colour[colour[s1]] * by_colour[colour[s2]]
                kept = _assign(
                    s0, s1, s2, q, area, colour, direction, angle, colours, pairs, limits, pixels, least, pale, E, R,
                    near, count, found, kept,
                )  # fmt: skip
    return kept, 0


@njit(cache=True, error_model="numpy")
def _plan(x, y, E, q):
    """A ray's place in the tangent plane E, into q, (2,) or longer; gives its depth."""
    depth = E[0, 2] * x + E[1, 2] * y + E[2, 2]
    q[0] = (E[0, 0] * x + E[1, 0] * y + E[2, 0]) / depth
    q[1] = (E[0, 1] * x + E[1, 1] * y + E[2, 1]) / depth
    return depth


@njit(cache=True, error_model="numpy")
def _assign(
    s0, s1, s2, q, area, colour, direction, angle, colours, pairs, limits, pixels, least, pale, E, R, near, count,
    found, kept,
):  # fmt: skip
    m = len(direction)
    d00, d01 = q[s1, 0] - q[s0, 0], q[s1, 1] - q[s0, 1]
    d10, d11 = q[s2, 0] - q[s0, 0], q[s2, 1] - q[s0, 1]
    # the largest of the three is not much smaller than its disc seen from the front: bounds the scale from below
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
                b0x, b0y, b0z = (
                    direction[b, 0] - direction[a, 0],
                    direction[b, 1] - direction[a, 1],
                    direction[b, 2] - direction[a, 2],
                )
                b1x, b1y, b1z = (
                    direction[c, 0] - direction[a, 0],
                    direction[c, 1] - direction[a, 1],
                    direction[c, 2] - direction[a, 2],
                )
                g00, g01, g11 = (
                    b0x * b0x + b0y * b0y + b0z * b0z,
                    b0x * b1x + b0y * b1y + b0z * b1z,
                    b1x * b1x + b1y * b1y + b1z * b1z,
                )
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
                # the area of each spot is not larger than its disc
                largest = 1.6 * np.pi * scale * scale
                if (
                    area[s0] > largest * angle[a] ** 2 + 9.0 * pixels**2
                    or area[s1] > largest * angle[b] ** 2 + 9.0 * pixels**2
                    or area[s2] > largest * angle[c] ** 2 + 9.0 * pixels**2
                ):
                    continue
                # the part of both rows along the triangle's normal: eigenvector of the smaller eigenvalue
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
                        facing = (
                            facing
                            and R[2, 0] * direction[d, 0] + R[2, 1] * direction[d, 1] + R[2, 2] * direction[d, 2]
                            < -0.05
                        )
                    if not facing:
                        continue
                    cx = q[s0, 0] - scale * (
                        R[0, 0] * direction[a, 0] + R[0, 1] * direction[a, 1] + R[0, 2] * direction[a, 2]
                    )
                    cy = q[s0, 1] - scale * (
                        R[1, 0] * direction[a, 0] + R[1, 1] * direction[a, 1] + R[1, 2] * direction[a, 2]
                    )
                    kept = _keep(
                        cx, cy, scale, R, E, q, area, colour, direction, angle, colours, pixels, least, pale, near,
                        count, found, kept,
                    )  # fmt: skip
    return kept


@njit(cache=True, error_model="numpy")
def _assign_two(
    s0, s1, q, area, colour, direction, angle, colours, pairs, limits, pixels, least, pale, E, R, near, count, found,
    kept,
):  # fmt: skip
    """Two spots with their areas: how far a disc is turned away shows in its area."""
    m = len(direction)
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
            if za > 1.25 or zb > 1.25:  # larger than their discs seen from the front
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
                _frame(
                    direction[a, 0],
                    direction[a, 1],
                    direction[a, 2],
                    direction[b, 0],
                    direction[b, 1],
                    direction[b, 2],
                    inner,
                )
                _frame(ax, ay, -za, bx, by, -zb, outer)
                R[:] = outer @ inner.T
                kept = _keep(
                    q[s0, 0] - scale * ax, q[s0, 1] - scale * ay, scale, R, E, q, area, colour, direction, angle,
                    colours, pixels, least, pale, near, count, found, kept,
                )  # fmt: skip
    return kept


@njit(cache=True, error_model="numpy")
def _frame(ax, ay, az, bx, by, bz, F):
    """Orthonormal columns along a + b, a - b and across both; exact for unit vectors."""
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
def _keep(
    cx, cy, scale, R, E, q, area, colour, direction, angle, colours, pixels, least, pale, near, count, found, kept
):
    """Put a pose into `found` if it explains enough, in place of the worst where it is full. Gives the number kept."""
    score, number = _score(cx, cy, scale, R, q, area, colour, direction, angle, colours, pixels, pale, near, count)
    if score < least:
        return kept
    score *= number  # two discs agree by chance, five do not
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
def _score(cx, cy, scale, R, q, area, colour, direction, angle, colours, pixels, pale, near, count):
    """Part of the discs in view, by area, that have a spot of their colour and size where they should be; their number.

    A spot on the ball that is no disc counts against it. What glare hides of a disc is not asked for.
    """
    have, asked, number = 0.0, 0.0, 0
    used = 0  # bits of the spots that are a disc
    within = (0.15 * scale + pixels) ** 2
    for d in range(len(direction)):
        z = -(R[2, 0] * direction[d, 0] + R[2, 1] * direction[d, 1] + R[2, 2] * direction[d, 2])
        if z < 0.0:
            continue
        x = cx + scale * (R[0, 0] * direction[d, 0] + R[0, 1] * direction[d, 1] + R[0, 2] * direction[d, 2])
        y = cy + scale * (R[1, 0] * direction[d, 0] + R[1, 1] * direction[d, 1] + R[1, 2] * direction[d, 2])
        expected = np.pi * (scale * angle[d]) ** 2 * z
        shown = expected
        for g in range(len(pale)):
            gap = np.sqrt((pale[g, 0] - x) ** 2 + (pale[g, 1] - y) ** 2)
            shown -= _overlap(np.sqrt(expected / np.pi), pale[g, 2], gap)
        shown = max(shown, 0.0)
        if z > 0.25:
            asked += shown
        # a highlight or a finger leaves a part of a disc, whose centroid lies anywhere within its outline
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
                used |= 1 << i
                if z > 0.25:
                    # glare's reach is not known to the pixel: any area from what it leaves to the whole disc will do
                    have += shown * min(area[s] / max(shown, 1e-12), expected / area[s], 1.0)
                    number += 1
                break
    for i in range(count):
        s = near[i]
        if not used & (1 << i) and (q[s, 0] - cx) ** 2 + (q[s, 1] - cy) ** 2 < (0.9 * scale) ** 2:
            asked += area[s]
    return (have / asked if asked > 0.0 else 0.0), number


@njit(cache=True, error_model="numpy")
def _overlap(a, b, gap):
    """Area that two circles of radii a and b share, their centres `gap` apart."""
    if gap >= a + b:
        return 0.0
    if gap <= abs(a - b):
        return np.pi * min(a, b) ** 2
    u = (gap * gap + a * a - b * b) / (2.0 * gap)
    v = gap - u
    return a * a * np.arccos(u / a) - u * np.sqrt(a * a - u * u) + b * b * np.arccos(v / b) - v * np.sqrt(b * b - v * v)
