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
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.camera import InteriorOrientation, distorted
from spheremouse.rotation import Array, tangent_basis
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import FIELD_SIGMA, Fields

SIGMA = 0.15  # of the field's range: half a pixel of a rim, for print, gloss and pixels of its own
OUTLIER = 0.08  # part of the points that a finger, a highlight or a stick hides
RIM_OFFSET = 0.4  # px, standard deviation of the rims' common offset: bounds and lens blur
_RIM = 12  # points on a rim
_BESIDE = 6  # points beside it
_BESIDE_BY = 0.11  # rad: half the gap between the discs of one azimuth, and three pixels of a ball 50 px across
_BARE = 80  # directions tried for bare points
BEGINS, FULLY = 0.08, 0.25  # cosine of the angle of view where a point begins to count, and counts fully
_ASKED = 0.3  # of the field's range: points expected above it tell how well a pose matches
_TABLE = 1023
_SHOWN, _FLOOR = 20.0, 0.02  # published: points of four discs in view; least weight of one, a product's zero undone
_KERNEL_AREA = 2.0 * np.pi * FIELD_SIGMA**2  # px²
_LEAST, _MOST = 0.003, 0.5  # part of a picture of one colour, as far as the ratio believes it
_STEP = np.array([1e-3, 1e-3, 1e-3, 4e-3, 4e-3, 4e-3])  # for numeric derivatives: radii of the ball, and rad


@dataclass(frozen=True, slots=True)
class Points:
    """Points on a ball, in its frame."""

    # (p, 10): direction, unit; tangent along the rim, unit; rad from the rim towards the disc's centre, negative beside
    # the disc; rad to the far rim; 1 / tan of the disc's angular radius; sr that each
    # point of the disc stands for, at its centre, which comes first, else 0
    table: Array
    colour: NDArray[np.int64]  # (p,) index of the colour; -1: bare of all


@dataclass(frozen=True, slots=True)
class Model:
    """What the compiled functions need of ball, points and camera."""

    points: Points
    radius: float  # m
    lens: Array  # (9,) fx, fy, cx, cy, k1, k2, p1, p2, k3


def ball_points(ball: WandBall, names: tuple[str, ...]) -> Points:
    """The points of a ball; `names` are the colours of the fields."""
    rows = []
    for disc in ball.discs:
        c = names.index(disc.colour)
        basis = tangent_basis(disc.direction)
        rows.append((disc.direction, basis[:, 0], disc.angle, disc.angle, c))  # the centre comes first
        rings = (
            (4, disc.points_angle, disc.angle - disc.points_angle),
            (_RIM, disc.angle, 0.0),
            (_BESIDE, disc.angle + _BESIDE_BY, -_BESIDE_BY),
        )
        for n, away, inside in rings:
            for phi in np.arange(n) * (2.0 * np.pi / n):
                out = basis @ np.array([np.cos(phi), np.sin(phi)])
                along = basis @ np.array([-np.sin(phi), np.cos(phi)])
                u = np.cos(away) * disc.direction + np.sin(away) * out
                if inside < 0.0 and _within(u, ball, _BESIDE_BY / 2, disc.colour):
                    continue
                rows.append((u, along, inside, disc.angle, c))
    for u in _spiral(_BARE):
        if not _within(u, ball, 1.5 * _BESIDE_BY, None):
            rows.append((u, tangent_basis(u)[:, 0], -1.0, 1.0, -1))
    table, last = [], None
    for u, t, inside, angle, c in rows:
        # what a point stands for is written down at the first of each disc, and of the bare ones
        first = inside == angle or (c < 0 and last != c)
        last = c
        share = _solid_angle(angle, c) if first else 0.0
        table.append([*u, *t, inside, 2.0 * angle - inside, 1.0 / np.tan(angle), share])
    return Points(np.array(table), np.array([row[4] for row in rows], dtype=np.int64))


def model(ball: WandBall, camera: InteriorOrientation, names: tuple[str, ...] | None = None) -> Model:
    """A ball before a camera; `names` are the colours of the fields, those of the ball where not given."""
    return Model(
        ball_points(ball, names or ball.colours), ball.radius, np.concatenate([camera.intrinsic, camera.distortion])
    )


def log_likelihood(position: Array, rotation: Array, model: Model, fields: Fields) -> tuple[Array, Array]:
    """Of n poses, (n, 3) m and (n, 3, 3) R_cam_ball: log-likelihood ratio, (n,), and match, (n,).

    The match is the part of the coloured points in view that show their colour; points that show it and should not
    count against it.
    """
    out, match = np.empty(len(position)), np.empty(len(position))
    p = model.points
    _weigh(
        position, rotation, p.table, p.colour, model.radius, model.lens, fields.weight, fields.place(),
        shares(fields), out, match,
    )  # fmt: skip
    return out, match


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


def _solid_angle(angle: float, colour: int) -> float:
    """Of one point of a disc or of a bare one, sr."""
    return 4.0 * np.pi / _BARE if colour < 0 else np.pi * angle**2 / (5 + _RIM)


def _spiral(n: int) -> Array:
    z = 1.0 - (np.arange(n) + 0.5) * 2.0 / n
    azimuth = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)


def _within(u: Array, ball: WandBall, margin: float, colour: str | None) -> bool:
    """Does a direction lie in or near a disc, of one colour or of any?"""
    return any(
        np.arccos(np.clip(u @ d.direction, -1.0, 1.0)) < d.angle + margin
        for d in ball.discs
        if colour is None or d.colour == colour
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh(position, rotation, table, colour, radius, lens, weight, place, share, out, match):
    """`log_likelihood` into out and match, (n,)."""
    count, field_h, field_w = weight.shape
    rg, gg = np.zeros(count), np.zeros(count)
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    straight = True
    for k in range(4, 9):
        straight = straight and lens[k] == 0.0
    left, top, f = place[0], place[1], place[2]
    agree = np.empty(_TABLE + 1)  # (1 - o) N(m - e) by |m - e|
    for i in range(_TABLE + 1):
        agree[i] = (1.0 - OUTLIER) * np.exp(-0.5 * (i / _TABLE / SIGMA) ** 2)
    other = np.empty((count, _TABLE + 1))  # 1 / B(e)
    for k in range(count):
        for i in range(_TABLE + 1):
            other[k, i] = 1.0 / ((1.0 - share[k]) * np.exp(-0.5 * (i / _TABLE / SIGMA) ** 2) + share[k])
    variance = SIGMA * SIGMA
    per_f, per_ramp = 1.0 / f, 1.0 / (FULLY - BEGINS)
    for n in range(len(position)):
        x0, y0, z0 = position[n, 0], position[n, 1], position[n, 2]
        r00, r01, r02 = rotation[n, 0, 0], rotation[n, 0, 1], rotation[n, 0, 2]
        r10, r11, r12 = rotation[n, 1, 0], rotation[n, 1, 1], rotation[n, 1, 2]
        r20, r21, r22 = rotation[n, 2, 0], rotation[n, 2, 1], rotation[n, 2, 2]
        # the centre in the ball's own axes: what a point faces is then one product with its direction
        cx0 = r00 * x0 + r10 * y0 + r20 * z0
        cx1 = r01 * x0 + r11 * y0 + r21 * z0
        cx2 = r02 * x0 + r12 * y0 + r22 * z0
        squared = x0 * x0 + y0 * y0 + z0 * z0 + radius * radius
        total, product, hit, asked = 0.0, 1.0, 0.0, 0.0
        disc_counts = 1.0
        for k in range(count):
            rg[k] = 0.0
            gg[k] = 0.0
        for q in range(len(table)):
            u0, u1, u2 = table[q, 0], table[q, 1], table[q, 2]
            towards = u0 * cx0 + u1 * cx1 + u2 * cx2 + radius
            if table[q, 9] > 0.0:  # the first point of a disc: its centre
                total += disc_counts * np.log(product)  # one logarithm for all points of the last disc
                product = 1.0
                per_length = 1.0 / np.sqrt(squared + 2.0 * radius * (towards - radius))
                disc_counts = counted(-towards * per_length, fx * radius * per_length * per_f, table[q, 9])
            if towards >= 0.0:
                continue
            per_length = 1.0 / np.sqrt(squared + 2.0 * radius * (towards - radius))
            facing = -towards * per_length
            if facing <= BEGINS:
                continue
            z = z0 + radius * (r20 * u0 + r21 * u1 + r22 * u2)
            if z <= 0.0:
                continue
            per_z = 1.0 / z
            xr = (x0 + radius * (r00 * u0 + r01 * u1 + r02 * u2)) * per_z
            yr = (y0 + radius * (r10 * u0 + r11 * u1 + r12 * u2)) * per_z
            if not straight:
                xr, yr, _, _, _ = distorted(xr, yr, lens[4:])
            px, py = (fx * xr + cx - left + 0.5) * per_f - 0.5, (fy * yr + cy - top + 0.5) * per_f - 0.5
            if not (px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1):
                continue
            j, i = np.int64(px), np.int64(py)
            a, b = px - j, py - i
            ramp = min((facing - BEGINS) * per_ramp, 1.0)
            k = colour[q]
            if k < 0:
                for one in range(count):
                    m = between(weight[one], i, j, a, b)
                    if m > 0.0:
                        total += ramp * disc_counts * np.log(agree[np.int64(m * _TABLE + 0.5)] + OUTLIER)
                        if m > 0.5:
                            asked += ramp * disc_counts
                continue
            m = between(weight[k], i, j, a, b)
            along = per_length * (table[q, 3] * cx0 + table[q, 4] * cx1 + table[q, 5] * cx2)
            scale = fx * radius * per_length * per_f
            e, g = expected_field(along, facing, scale, table[q, 6], table[q, 7], table[q, 8])
            r = m - e
            near = agree[np.int64(abs(r) * _TABLE + 0.5)]
            ratio = near * other[k, np.int64(e * _TABLE + 0.5)] + OUTLIER
            if ramp == 1.0:
                product *= ratio
            else:
                total += ramp * disc_counts * np.log(ratio)
            counts = ramp * disc_counts
            sure = counts * near / (near + OUTLIER)  # the offset explains rims that are nearly right, not missing ones
            rg[k] += sure * r * g
            gg[k] += sure * g * g
            if e > _ASKED:
                asked += counts
                hit += counts * (1.0 if abs(r) < 3.0 * SIGMA else min(m / e, 1.0))
            elif m > 0.5:
                asked += counts
        total += disc_counts * np.log(product)
        for k in range(count):
            information = 1.0 / RIM_OFFSET**2 + gg[k] / variance
            total += 0.5 * (rg[k] / variance) ** 2 / information - 0.5 * np.log(information * RIM_OFFSET**2)
        out[n] = total
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
                m = between(weight[colour[q]], i, j, px - j, py - i)
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
def between(field, i, j, a, b):
    """Bilinear between pixels, 0 to 1."""
    high = (1.0 - a) * field[i, j] + a * field[i, j + 1]
    low = (1.0 - a) * field[i + 1, j] + a * field[i + 1, j + 1]
    return ((1.0 - b) * high + b * low) * (1.0 / 255.0)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def expected_field(along, facing, scale, inside, width, bend):
    """Field e that a point of a disc should have, and de / d(offset of the rim in px of the field).

    `along` is the rim's tangent times the line of sight, `scale` px per rad seen from the front, `inside` the way to
    the rim and `width` that to the far side, rad; `bend` is the curvature's 1 / tan(angle).
    """
    per_root = 1.0 / np.sqrt(max(1.0 - along * along, 0.02))
    across = scale * facing * per_root * (1.0 / FIELD_SIGMA)  # field sigmas per rad, across the projected rim
    # a blurred rim of curvature k moves inward by k s² / 2
    moved = min(0.5 * FIELD_SIGMA * facing * bend * per_root * per_root * per_root / scale, 0.8)
    e, g = _normal(inside * across - moved)
    far = width * across - moved
    if far < 3.0:
        beyond, slope = _normal(far)
        e, g = max(e + beyond - 1.0, 0.0), g + slope
    return e, g * (1.0 / FIELD_SIGMA)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _normal(x):
    """Gaussian distribution function and density, to 0.02 %, without a call.

    The logistic of a cubic (Bowling et al. 2009), its hyperbolic tangent as a continued fraction.
    """
    x = min(max(x, -3.6), 3.6)
    xx = x * x
    y = x * (0.7988 + 0.03528 * xx)
    yy = y * y
    t = y * (135135.0 + yy * (17325.0 + yy * (378.0 + yy))) / (135135.0 + yy * (62370.0 + yy * (3150.0 + 28.0 * yy)))
    return 0.5 + 0.5 * t, 0.5 * (1.0 - t * t) * (0.7988 + 0.10584 * xx)
