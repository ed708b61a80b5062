"""How well poses of a ball agree with the weight fields: one compiled pass over particles x points.

Each disc is its centre, the four points of Grzonka 2005 (section 3.4.1), points on its rim and just outside; bare
points of the ball belong to no disc. For a point that faces the camera the field m should have the value e of a blurred
rim at its distance. Its log-likelihood ratio against a picture without the ball,

    l = log((1 - o) N(m - e) / B(e) + o),   B(e) = (1 - p) N(e) + p,

with the part p of the picture that has the colour and the part o of points that something hides, is 0 where the point
is turned away: hiding points does not pay, which the product over visible points (Grzonka 2005, table 3) rewards. Nor
does showing them: each counts by the part of the picture it stands for, in areas of the Gaussian kernel, within which
pixels repeat each other, so that the sum is one over the picture, however many points crowd near the limb.
The rim's offset, common to a colour (a bound on saturation moves every rim outward), is marginalised.
Glare hides colours: with a part v of glare at a point, its field is anything from m to m + v, and it counts 1 - v.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.camera import distorted
from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import FIELD_SIGMA, Fields
from spheremouse.wand.model import NONE, ONE, Model, normals, turn

# Of the field's range. A rim goes through pixels anywhere: 0.29 px each, over the 4 px along it that the kernel takes
# together 0.14, at a slope of a third per pixel 0.05; 0.04 more for print, gloss and motion
SIGMA = 0.065
OUTLIER = 0.08  # part of the points that a finger, a highlight or a stick hides
RIM_OFFSET = 0.25  # px, standard deviation of the rims' common offset about that of `rim_shift`: paint, light, focus
BEGINS, FULLY = 0.08, 0.25  # cosine of the angle of view where a point begins to count, and counts fully
_ASKED = 0.3  # of the field's range: points expected above it tell how well a pose matches
_NEAR = 0.25  # of the field's range, three quarters of a pixel: a point so far off shows all the same
_TABLE = 511
_SHOWN, _FLOOR = 20.0, 0.02  # published: points of four discs in view; least weight of one, a product's zero undone
_KERNEL_AREA = 2.0 * np.pi * FIELD_SIGMA**2  # px²
_LEAST, _MOST = 0.003, 0.5  # part of a picture of one colour, as far as the ratio believes it
_PER_SIGMA, _HALF_SIGMA = np.float32(1.0 / FIELD_SIGMA), np.float32(0.5 * FIELD_SIGMA)
_LEAST_ACROSS, _MOST_MOVED, _TINY = np.float32(0.02), np.float32(0.8), np.float32(1e-6)
_NO_COUNTS, _NONE_OF_THEM = np.zeros((0, 1)), np.zeros(0, dtype=np.int64)


def log_likelihood(
    position: Array,
    rotation: Array,
    model: Model,
    fields: Fields,
    sigma: float = SIGMA,
    matches: bool = True,
    counted_as: tuple[Array, NDArray[np.int64]] | None = None,
) -> tuple[Array, Array]:
    """Of n poses, (n, 3) m and (n, 3, 3) R_cam_ball: log-likelihood ratio, (n,), and match, (n,) or (0,) if not asked.

    `sigma`: of the field, more than `SIGMA` for poses that are only near. `counted_as`: `counts` of some poses, (k, d),
    and which of them each pose is near to, (n,), -1 for none. By its own counts a ball that shows well would seem
    nearer than it is: what is nearer is larger, and shows more. That is right between poses far apart, not about a
    peak.

    The match is the part of the coloured points in view that show their colour; points that show it and should not
    count against it.
    """
    out, match = np.empty(len(position)), np.empty(len(position) if matches else 0)
    p = model.points
    fixed, which = counted_as or (_NO_COUNTS, _NONE_OF_THEM)
    _weigh(
        position, rotation, p.table, p.colour, model.radius, model.lens, fields.weight, fields.glare,
        fields.place(), shares(fields), fields.rim, sigma, fixed, which, out, match,
    )  # fmt: skip
    return out, match


def counts(position: Array, rotation: Array, model: Model, factor: int) -> Array:
    """How far the points of each disc, and the bare ones, count in a picture reduced by `factor`: (k, d) of k poses."""
    first = model.points.table[model.points.table[:, 9] > 0.0]
    normal = np.einsum("kij,qj->kqi", rotation, first[:, :3])
    place = position[:, None] + model.radius * normal
    length = np.linalg.norm(place, axis=2)
    facing = -np.sum(normal * place, axis=2) / length
    scale = model.lens[0] * model.radius / (factor * length)
    return np.minimum(np.maximum(facing, BEGINS) * scale**2 * first[:, 9] / _KERNEL_AREA, 1.0)


def published(position: Array, rotation: Array, model: Model, fields: Fields) -> tuple[Array, Array]:
    """The thesis' weight, as logarithm, (n,), and the mean field at the points in view, (n,).

    Grzonka 2005, table 3: the product of the fields at the five points of each disc that face the camera; here its
    mean logarithm times the points that a ball shows, so that hiding points does not pay.
    """
    out, mean = np.empty(len(position)), np.empty(len(position))
    p = model.points
    _weigh_published(
        position, rotation, p.table, p.colour, model.radius, model.lens, fields.weight, fields.place(), out, mean
    )
    return out, mean


def shares(fields: Fields) -> Array:
    """Parts of a picture that colours have, as the ratio believes them, (c,)."""
    return np.clip(fields.share, _LEAST, _MOST)


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh(
    position, rotation, table, colour, radius, lens, weight, glare, place, share, rim, sigma, fixed, which, out, match
):
    """`log_likelihood` into out, (n,), and match, (n,) or (0,). All points of a pose in plain loops: they vectorise."""
    count, field_h, field_w = weight.shape
    number = len(table)
    rg, gg = np.zeros(count), np.zeros(count)
    straight = True
    for k in range(4, 9):
        straight = straight and lens[k] == 0.0
    left, top, f = place[0], place[1], place[2]
    agree = np.empty(_TABLE + 1)  # (1 - o) N(m - e) by |m - e|
    for i in range(_TABLE + 1):
        agree[i] = (1.0 - OUTLIER) * np.exp(-0.5 * (i / _TABLE / sigma) ** 2)
    bare = np.log(agree + OUTLIER)
    other = np.empty((count, _TABLE + 1))  # 1 / B(e)
    for k in range(count):
        for i in range(_TABLE + 1):
            other[k, i] = 1.0 / ((1.0 - share[k]) * np.exp(-0.5 * (i / _TABLE / sigma) ** 2) + share[k])
    matched, hides = len(match) > 0, len(glare) > 0
    variance = sigma * sigma
    scale_x, shift_x = lens[0] / f, (lens[2] - left + 0.5) / f - 0.5
    scale_y, shift_y = lens[1] / f, (lens[3] - top + 0.5) / f - 0.5
    # columns: direction, tangent, way out of the disc, rim, far rim, curvature, offset
    column = np.empty((13, number), dtype=np.float32)
    disc = np.zeros(number, dtype=np.uint64)
    last = -1
    for q in range(number):
        for i in range(6):
            column[i, q] = table[q, i]
        column[6, q] = table[q, 4] * table[q, 2] - table[q, 5] * table[q, 1]
        column[7, q] = table[q, 5] * table[q, 0] - table[q, 3] * table[q, 2]
        column[8, q] = table[q, 3] * table[q, 1] - table[q, 4] * table[q, 0]
        for i in range(3):
            column[9 + i, q] = table[q, 6 + i]
        column[12, q] = rim[max(colour[q], 0)]
        last += table[q, 9] > 0.0
        disc[q] = last
    seen = np.empty((7, number), dtype=np.float32)  # facing, x, y, along, outward, px per rad, depth
    kept = np.empty((8, number), dtype=np.float32)  # what the expected field takes
    expected = np.empty((2, number), dtype=np.float32)
    value = np.empty(number, dtype=np.float32)
    part = np.empty(number, dtype=np.float32)
    veil = np.zeros(number, dtype=np.float32)
    whole = np.empty(number, dtype=np.bool_)
    index = np.empty(number + 1, dtype=np.uint64)  # as all that is looked up in a loop: an eighth faster
    first = np.flatnonzero(table[:, 9] > 0.0)
    counts_of = np.empty(last + 1)
    product = np.empty(last + 1)
    for n in range(len(position)):
        x0, y0, z0 = np.float32(position[n, 0]), np.float32(position[n, 1]), np.float32(position[n, 2])
        r00, r01, r02 = np.float32(rotation[n, 0, 0]), np.float32(rotation[n, 0, 1]), np.float32(rotation[n, 0, 2])
        r10, r11, r12 = np.float32(rotation[n, 1, 0]), np.float32(rotation[n, 1, 1]), np.float32(rotation[n, 1, 2])
        r20, r21, r22 = np.float32(rotation[n, 2, 0]), np.float32(rotation[n, 2, 1]), np.float32(rotation[n, 2, 2])
        # the centre in the ball's own axes: what a point faces is then one product with its direction
        cx0 = r00 * x0 + r10 * y0 + r20 * z0
        cx1 = r01 * x0 + r11 * y0 + r21 * z0
        cx2 = r02 * x0 + r12 * y0 + r22 * z0
        a = np.float32(radius)
        squared = x0 * x0 + y0 * y0 + z0 * z0 - a * a
        px_per_rad = np.float32(lens[0] * radius / f)
        for q in range(number):
            u0, u1, u2 = column[0, q], column[1, q], column[2, q]
            towards = u0 * cx0 + u1 * cx1 + u2 * cx2 + a
            per_length = np.float32(1.0) / np.sqrt(squared + (a + a) * towards)
            depth = z0 + a * (r20 * u0 + r21 * u1 + r22 * u2)
            per_z = np.float32(1.0) / depth
            seen[0, q] = -towards * per_length
            seen[1, q] = (x0 + a * (r00 * u0 + r01 * u1 + r02 * u2)) * per_z
            seen[2, q] = (y0 + a * (r10 * u0 + r11 * u1 + r12 * u2)) * per_z
            seen[3, q] = per_length * (column[3, q] * cx0 + column[4, q] * cx1 + column[5, q] * cx2)
            seen[4, q] = per_length * (column[6, q] * cx0 + column[7, q] * cx1 + column[8, q] * cx2)
            seen[5, q] = px_per_rad * per_length
            seen[6, q] = depth
        total, hit, asked = 0.0, 0.0, 0.0
        for k in range(count):
            rg[k] = 0.0
            gg[k] = 0.0
        for k in range(last + 1):
            if len(fixed) > 0 and which[n] >= 0:
                counts_of[k] = fixed[which[n], k]
            else:
                counts_of[k] = counted(seen[0, first[k]], seen[5, first[k]], table[first[k], 9])
            product[k] = 1.0
        facing_ones = 0
        for q in range(number):  # without a branch, which would be guessed wrong
            index[facing_ones] = q
            facing_ones += (seen[0, q] > BEGINS) & (seen[6, q] > 0.0)
        points = 0
        for at in range(facing_ones):
            q = index[at]
            px, py = np.float64(seen[1, q]), np.float64(seen[2, q])
            if not straight:
                px, py, _, _, _ = distorted(px, py, lens[4:])
            px, py = scale_x * px + shift_x, scale_y * py + shift_y
            if not (px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1):
                continue
            j, i = np.int64(px), np.int64(py)
            ramp = min((seen[0, q] - BEGINS) * (1.0 / (FULLY - BEGINS)), 1.0)
            hidden = between(glare, 0, i, j, px - j, py - i) if hides else 0.0
            counts = ramp * counts_of[disc[q]] * (1.0 - hidden)
            k = colour[q]
            if k < 0:
                for one in range(count):
                    m = between(weight, one, i, j, px - j, py - i)
                    if m > 0.0:
                        total += counts * bare[np.uint64(m * _TABLE + 0.5)]
                        if m > 0.5:
                            asked += counts
                continue
            value[points] = between(weight, k, i, j, px - j, py - i)
            part[points] = counts
            veil[points] = hidden
            whole[points] = ramp == 1.0 and hidden == 0.0
            index[points] = q
            points += 1
        for at in range(points):
            q = index[at]
            kept[0, at], kept[1, at], kept[2, at], kept[3, at] = seen[3, q], seen[4, q], seen[0, q], seen[5, q]
            kept[4, at], kept[5, at], kept[6, at] = column[9, q], column[10, q], column[11, q]
            kept[7, at] = column[12, q]
        for q in range(points):
            expected[0, q], expected[1, q] = expected_field(
                kept[0, q], kept[1, q], kept[2, q], kept[3, q], kept[4, q], kept[5, q], kept[6, q], kept[7, q]
            )
        for q in range(points):
            k, m = np.uint64(colour[index[q]]), np.float64(value[q])
            e, g = np.float64(expected[0, q]), np.float64(expected[1, q])
            r = m - e
            if veil[q] > 0.0 and r < 0.0:
                r = min(r + veil[q], 0.0)
                g = g if r < 0.0 else 0.0
            near = agree[np.uint64(min(abs(r), 1.0) * _TABLE + 0.5)]
            # what the ball is taken to show there, e but for glare, is what a picture without it shows by chance
            ratio = near * other[k, np.uint64(min(max(m - r, 0.0), 1.0) * _TABLE + 0.5)] + OUTLIER
            counts = np.float64(part[q])
            if whole[q]:
                product[disc[index[q]]] *= ratio
            else:
                total += counts * np.log(ratio)
            sure = counts * near / (near + OUTLIER)  # the offset explains rims that are nearly right, not missing ones
            rg[k] += sure * r * g
            gg[k] += sure * g * g
            if not matched or (veil[q] > 0.0 and m < _ASKED):  # glare shows nothing
                continue
            if e > _ASKED:
                asked += counts
                hit += counts * (1.0 if abs(r) < _NEAR else min(m / e, 1.0))
            elif m > 0.5:
                asked += counts
        for k in range(last + 1):  # one logarithm for all points of a disc
            total += counts_of[k] * np.log(product[k])
        for k in range(count):
            information = 1.0 / RIM_OFFSET**2 + gg[k] / variance
            total += 0.5 * (rg[k] / variance) ** 2 / information - 0.5 * np.log(information * RIM_OFFSET**2)
        out[n] = total
        if matched:
            match[n] = hit / asked if asked > 0.0 else 0.0


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh_published(position, rotation, table, colour, radius, lens, weight, place, out, mean):
    """`published` into out and mean, (n,)."""
    _, field_h, field_w = weight.shape
    for n in range(len(position)):
        c, R = position[n], rotation[n]
        total, shown, number = 0.0, 0.0, 0
        for q in range(len(table)):
            if colour[q] < 0 or table[q, 6] <= 0.0:
                continue
            nx = R[0, 0] * table[q, 0] + R[0, 1] * table[q, 1] + R[0, 2] * table[q, 2]
            ny = R[1, 0] * table[q, 0] + R[1, 1] * table[q, 1] + R[1, 2] * table[q, 2]
            nz = R[2, 0] * table[q, 0] + R[2, 1] * table[q, 1] + R[2, 2] * table[q, 2]
            x, y, z = c[0] + radius * nx, c[1] + radius * ny, c[2] + radius * nz
            if z <= 0.0 or nx * x + ny * y + nz * z >= 0.0:
                continue
            xd, yd, _, _, _ = distorted(x / z, y / z, lens[4:])
            px = (lens[0] * xd + lens[2] - place[0] + 0.5) / place[2] - 0.5
            py = (lens[1] * yd + lens[3] - place[1] + 0.5) / place[2] - 0.5
            m = 0.0
            if px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1:
                j, i = np.int64(px), np.int64(py)
                m = between(weight, colour[q], i, j, px - j, py - i)
            total += np.log(max(m, _FLOOR))
            shown += m
            number += 1
        out[n] = _SHOWN * total / number if number else _SHOWN * np.log(_FLOOR)
        mean[n] = shown / number if number else 0.0


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def counted(facing, scale, solid_angle):
    """How far each point of a disc counts: by its part of the picture. The disc's centre faces the camera so far."""
    return min(max(facing, BEGINS) * scale * scale * solid_angle / _KERNEL_AREA, 1.0)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def between(fields, k, i, j, a, b):
    """Bilinear between pixels of field k, 0 to 1."""
    k, i, j, one = np.uint64(k), np.uint64(i), np.uint64(j), np.uint64(1)  # signed ones might count from the end
    high = (1.0 - a) * fields[k, i, j] + a * fields[k, i, j + one]
    low = (1.0 - a) * fields[k, i + one, j] + a * fields[k, i + one, j + one]
    return ((1.0 - b) * high + b * low) * (1.0 / 255.0)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def expected_field(along, outward, facing, scale, inside, width, bend, offset):
    """Field e that a point of a disc should have, and de / d(offset of the rim in px of the field).

    `along` is the rim's tangent times the line of sight, `outward` the same of the way out of the disc, `scale` px per
    rad seen from the front, `inside` the way to the rim and `width` that to the far side, rad; `bend` is the
    curvature's 1 / tan(angle), `offset` how far, px, bounds put the rim outward.
    """
    per_root = ONE / np.sqrt(max(ONE - along * along, _LEAST_ACROSS))
    across = scale * facing * per_root * _PER_SIGMA  # field sigmas per rad, across the projected rim
    # a blurred rim of curvature k moves inward by k s² / 2
    moved = min(_HALF_SIGMA * facing * bend * per_root * per_root * per_root / scale, _MOST_MOVED)
    moved -= offset * _PER_SIGMA
    disc, g = normals(inside * across - moved)
    beyond, slope = normals(width * across - moved)
    disc, g = max(disc + beyond - ONE, NONE), g + slope
    # the ball ends at its limb: two half planes, two Gaussian variables; exact where the point lies on both edges
    aside = np.sqrt(max(ONE - facing * facing, _TINY))
    ball, _ = normals(scale * (ONE - aside) * _PER_SIGMA)
    w = turn(outward / aside * per_root)
    both, slope = disc * ball, g * ball
    same_way = min(disc, ball) if w > NONE else max(disc + ball - ONE, NONE)
    counts = disc < ball if w > NONE else disc + ball > ONE
    share = abs(w)
    e = (ONE - share) * both + share * same_way
    g = (ONE - share) * slope + (share * g if counts else NONE)
    return e, g * _PER_SIGMA
