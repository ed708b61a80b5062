"""Log-likelihood ratio of poses of a ball, given the weight fields: one compiled pass over particles x points.

The points of each disc are its centre, the four points of Grzonka 2005 (section 3.4.1), points on its rim and just
outside; bare points belong to no disc. A point that faces the camera should have the value e of a blurred rim at its
distance. The field m there has the log-likelihood ratio against a picture without the ball

    l = log((1 - o) N(m - e) / B(e) + o),   B(e) = (1 - p) N(e) + p,

with the fraction p of the picture that has the colour and the fraction o of hidden points. A point that is turned away
has the ratio 0, so a pose gains nothing by hiding points, unlike under the product over visible points (Grzonka 2005,
table 3). A pose gains nothing by showing points either: the weight of a point is the area that it represents in the
picture, in areas of the Gaussian kernel, within which pixels repeat each other. The sum is therefore one over the
picture, even if many points crowd near the limb.
The rim offset, common to a colour (a bound on saturation moves every rim outward), is marginalised.
Glare hides colours: at a point with the fraction v of glare the field is between m and m + v, and its weight 1 - v.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.camera import distorted
from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import FIELD_SIGMA, Fields
from spheremouse.wand.model import ONE, ZERO, Model, normal_cdf_pdf, scaled_asin

# Of the field's range. A rim crosses a pixel anywhere: 0.29 px, or 0.14 px over the 4 px along it that the kernel
# combines, at a slope of a third per pixel 0.05; 0.04 more for print, gloss and motion
SIGMA = 0.065
OUTLIER = 0.08  # fraction of the points that a finger, a highlight or a stick hides
RIM_OFFSET = 0.25  # px, standard deviation of the rims' common offset from `rim_shift`: paint, light, focus
MIN_FACING, FULL_FACING = 0.08, 0.25  # cosine of the viewing angle at which a point has weight, and full weight
_MIN_EXPECTED = 0.3  # of the field's range, for points that enter the match
_MATCH_TOLERANCE = 0.25  # of the field's range, three quarters of a pixel
_TABLE_SIZE = 511  # of |m - e|, in steps
_KERNEL_AREA = 2.0 * np.pi * FIELD_SIGMA**2  # px²
_MIN_FRACTION, _MAX_FRACTION = 0.003, 0.5  # p of a colour in the ratio
_PER_SIGMA, _HALF_SIGMA = np.float32(1.0 / FIELD_SIGMA), np.float32(0.5 * FIELD_SIGMA)
_MIN_SQUARE, _MAX_RIM_SHIFT, _TINY = np.float32(0.02), np.float32(0.8), np.float32(1e-6)
_NOT_FIXED = np.zeros((0, 1)), np.zeros(0, dtype=np.int64)


def log_likelihood(
    position: Array,
    rotation: Array,
    model: Model,
    fields: Fields,
    sigma: float = SIGMA,
    matches: bool = True,
    fixed_weights: tuple[Array, NDArray[np.int64]] | None = None,
) -> tuple[Array, Array]:
    """Return log-likelihood ratios, (n,), and matches, (n,) or (0,) without `matches`, of n poses.

    The poses are (n, 3) m and (n, 3, 3) R_cam_ball. `sigma` of the field exceeds `SIGMA` for poses near a peak only.
    `fixed_weights` has `disc_weights` of k poses, (k, d), and the index of one of them for each pose, (n,), or -1 for
    the pose's own weights. Poses about one peak need the same weights: a closer ball is larger and has larger weights,
    so its own weights would draw the distance of a well visible ball towards the camera.

    The match is the fraction of the visible coloured points that show their colour. Points that show it but should not
    reduce it.
    """
    out, match = np.empty(len(position)), np.empty(len(position) if matches else 0)
    p = model.points
    fixed, which = fixed_weights or _NOT_FIXED
    _weigh(
        position, rotation, p.table, p.colour, model.radius, model.lens, fields.weight, fields.glare,
        fields.place(), bounded_fractions(fields), fields.rim, sigma, fixed, which, out, match,
    )  # fmt: skip
    return out, match


def disc_weights(position: Array, rotation: Array, model: Model, factor: int) -> Array:
    """Return the weight of a point of each disc, and of a bare one, in a picture reduced by `factor`: (k, d).

    The k poses are (k, 3) m in cam and R_cam_ball (k, 3, 3).
    """
    first = model.points.table[model.points.table[:, 9] > 0.0]
    normal = np.einsum("kij,qj->kqi", rotation, first[:, :3])
    place = position[:, None] + model.radius * normal
    length = np.linalg.norm(place, axis=2)
    facing = -np.sum(normal * place, axis=2) / length
    scale = model.lens[0] * model.radius / (factor * length)
    return np.minimum(np.maximum(facing, MIN_FACING) * scale**2 * first[:, 9] / _KERNEL_AREA, 1.0)


def bounded_fractions(fields: Fields) -> Array:
    """Return the fractions p of the picture that have each colour, as the ratio uses them, (c,)."""
    return np.clip(fields.fraction, _MIN_FRACTION, _MAX_FRACTION)


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh(
    position, rotation, table, colour, radius, lens, weight, glare, place, fraction, rim, sigma, fixed, which, out,
    match,
):  # fmt: skip
    """Write `log_likelihood` to out, (n,), and match, (n,) or (0,). Plain loops over the points vectorise."""
    count, field_h, field_w = weight.shape
    number = len(table)
    rg, gg = np.zeros(count), np.zeros(count)
    straight = True
    for k in range(4, 9):
        straight = straight and lens[k] == 0.0
    left, top, f = place[0], place[1], place[2]
    agree = np.empty(_TABLE_SIZE + 1)  # (1 - o) N(m - e) by |m - e|
    for i in range(_TABLE_SIZE + 1):
        agree[i] = (1.0 - OUTLIER) * np.exp(-0.5 * (i / _TABLE_SIZE / sigma) ** 2)
    bare = np.log(agree + OUTLIER)
    other = np.empty((count, _TABLE_SIZE + 1))  # 1 / B(e)
    for k in range(count):
        for i in range(_TABLE_SIZE + 1):
            other[k, i] = 1.0 / ((1.0 - fraction[k]) * np.exp(-0.5 * (i / _TABLE_SIZE / sigma) ** 2) + fraction[k])
    matched, hides = len(match) > 0, len(glare) > 0
    variance = sigma * sigma
    scale_x, shift_x = lens[0] / f, (lens[2] - left + 0.5) / f - 0.5
    scale_y, shift_y = lens[1] / f, (lens[3] - top + 0.5) / f - 0.5
    # columns: direction, tangent, outward direction, rim, far rim, curvature, offset
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
    kept = np.empty((8, number), dtype=np.float32)  # arguments of the expected field
    expected = np.empty((2, number), dtype=np.float32)
    value = np.empty(number, dtype=np.float32)
    part = np.empty(number, dtype=np.float32)
    veil = np.zeros(number, dtype=np.float32)
    whole = np.empty(number, dtype=np.bool_)
    index = np.empty(number + 1, dtype=np.uint64)  # unsigned, as every index in a loop: an eighth faster
    first = np.flatnonzero(table[:, 9] > 0.0)
    disc_weight = np.empty(last + 1)
    product = np.empty(last + 1)
    for n in range(len(position)):
        x0, y0, z0 = np.float32(position[n, 0]), np.float32(position[n, 1]), np.float32(position[n, 2])
        r00, r01, r02 = np.float32(rotation[n, 0, 0]), np.float32(rotation[n, 0, 1]), np.float32(rotation[n, 0, 2])
        r10, r11, r12 = np.float32(rotation[n, 1, 0]), np.float32(rotation[n, 1, 1]), np.float32(rotation[n, 1, 2])
        r20, r21, r22 = np.float32(rotation[n, 2, 0]), np.float32(rotation[n, 2, 1]), np.float32(rotation[n, 2, 2])
        # centre in the ball's axes, so that one product with a point's direction gives its viewing angle
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
        total, matched_weight, expected_weight = 0.0, 0.0, 0.0
        for k in range(count):
            rg[k] = 0.0
            gg[k] = 0.0
        for k in range(last + 1):
            if len(fixed) > 0 and which[n] >= 0:
                disc_weight[k] = fixed[which[n], k]
            else:
                disc_weight[k] = point_weight(seen[0, first[k]], seen[5, first[k]], table[first[k], 9])
            product[k] = 1.0
        visible = 0
        for q in range(number):  # without a branch, which the processor would mispredict
            index[visible] = q
            visible += (seen[0, q] > MIN_FACING) & (seen[6, q] > 0.0)
        points = 0
        for at in range(visible):
            q = index[at]
            px, py = np.float64(seen[1, q]), np.float64(seen[2, q])
            if not straight:
                px, py, _, _, _ = distorted(px, py, lens[4:])
            px, py = scale_x * px + shift_x, scale_y * py + shift_y
            if not (px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1):
                continue
            j, i = np.int64(px), np.int64(py)
            ramp = min((seen[0, q] - MIN_FACING) * (1.0 / (FULL_FACING - MIN_FACING)), 1.0)
            hidden = interpolate(glare, 0, i, j, px - j, py - i) if hides else 0.0
            w = ramp * disc_weight[disc[q]] * (1.0 - hidden)
            k = colour[q]
            if k < 0:
                for one in range(count):
                    m = interpolate(weight, one, i, j, px - j, py - i)
                    if m > 0.0:
                        total += w * bare[np.uint64(m * _TABLE_SIZE + 0.5)]
                        if m > 0.5:
                            expected_weight += w
                continue
            value[points] = interpolate(weight, k, i, j, px - j, py - i)
            part[points] = w
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
            near = agree[np.uint64(min(abs(r), 1.0) * _TABLE_SIZE + 0.5)]
            # a picture without the ball has by chance the value e, or less in glare
            ratio = near * other[k, np.uint64(min(max(m - r, 0.0), 1.0) * _TABLE_SIZE + 0.5)] + OUTLIER
            w = np.float64(part[q])
            if whole[q]:
                product[disc[index[q]]] *= ratio
            else:
                total += w * np.log(ratio)
            inlier = w * near / (near + OUTLIER)  # the offset explains a displaced rim, not a missing one
            rg[k] += inlier * r * g
            gg[k] += inlier * g * g
            if not matched or (veil[q] > 0.0 and m < _MIN_EXPECTED):  # glare shows no colour
                continue
            if e > _MIN_EXPECTED:
                expected_weight += w
                matched_weight += w * (1.0 if abs(r) < _MATCH_TOLERANCE else min(m / e, 1.0))
            elif m > 0.5:
                expected_weight += w
        for k in range(last + 1):  # one logarithm for all points of a disc
            total += disc_weight[k] * np.log(product[k])
        for k in range(count):
            information = 1.0 / RIM_OFFSET**2 + gg[k] / variance
            total += 0.5 * (rg[k] / variance) ** 2 / information - 0.5 * np.log(information * RIM_OFFSET**2)
        out[n] = total
        if matched:
            match[n] = matched_weight / expected_weight if expected_weight > 0.0 else 0.0


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def point_weight(facing, scale, solid_angle):
    """Return the weight of a point of a disc, 0 to 1, by its area in the picture relative to the kernel's.

    `facing` is the cosine at the disc's centre, `scale` px of the field per rad, `solid_angle` sr of the point.
    """
    return min(max(facing, MIN_FACING) * scale * scale * solid_angle / _KERNEL_AREA, 1.0)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def interpolate(fields, k, i, j, a, b):
    """Interpolate field k bilinearly between pixels; return 0 to 1."""
    k, i, j, one = np.uint64(k), np.uint64(i), np.uint64(j), np.uint64(1)  # signed ones might count from the end
    high = (1.0 - a) * fields[k, i, j] + a * fields[k, i, j + one]
    low = (1.0 - a) * fields[k, i + one, j] + a * fields[k, i + one, j + one]
    return ((1.0 - b) * high + b * low) * (1.0 / 255.0)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def expected_field(along, outward, facing, scale, inside, width, bend, offset):
    """Return the expected field e of a point of a disc, and de / d(rim offset in px of the field).

    `along` is the scalar product of the rim's tangent and the line of sight, `outward` that of the direction out of the
    disc; `scale` is px per rad seen from the front; `inside` and `width` are the distances to the near and the far rim,
    rad; `bend` is the rim's curvature 1 / tan(angle); `offset` is the px by which bounds select the rim outward.
    """
    per_root = ONE / np.sqrt(max(ONE - along * along, _MIN_SQUARE))
    across = scale * facing * per_root * _PER_SIGMA  # field sigmas per rad, across the projected rim
    # a blurred rim of curvature k moves inward by k s² / 2
    shift = min(_HALF_SIGMA * facing * bend * per_root * per_root * per_root / scale, _MAX_RIM_SHIFT)
    shift -= offset * _PER_SIGMA
    disc, g = normal_cdf_pdf(inside * across - shift)
    far, slope = normal_cdf_pdf(width * across - shift)
    disc, g = max(disc + far - ONE, ZERO), g + slope
    # disc and limb are two half planes, hence two Gaussian variables; exact for a point on both edges
    aside = np.sqrt(max(ONE - facing * facing, _TINY))
    ball, _ = normal_cdf_pdf(scale * (ONE - aside) * _PER_SIGMA)
    w = scaled_asin(outward / aside * per_root)
    both, slope = disc * ball, g * ball
    same_way = min(disc, ball) if w > ZERO else max(disc + ball - ONE, ZERO)
    rim_limits = disc < ball if w > ZERO else disc + ball > ONE
    weight = abs(w)
    e = (ONE - weight) * both + weight * same_way
    g = (ONE - weight) * slope + (weight * g if rim_limits else ZERO)
    return e, g * _PER_SIGMA
