"""Edges of the picture across the ball's predicted outline, and their likelihood. They measure the distance.

The outlook of Grzonka 2005 (section 5.2) proposes ring outlines, because the distance from the discs was wrong by up to
40 cm. The ball's outline is the largest ring. At directions around the ball, the search goes across the outline for the
step from the ball's colour to the background.
"""

import numpy as np
from numba import njit

from spheremouse.geometry.rotation import Array
from spheremouse.wand.model import rotate, to_pixel
from spheremouse.wand.rims import Image

DIRECTIONS = 24  # around the outline; every four pixels of a ball 50 px across
SIGMA = 0.2  # px, of one edge: noise, pixels, shading within the blur
OFFSET_SIGMA = 0.15  # px, common to all edges: another gamma of the camera, a dark rim
HIDDEN = 0.3  # fraction of the outline that a hand or stick covers, or that has no contrast with the background
_REACH = 4.0  # px of the search to either side
UNIFORM_DENSITY = 1.0 / (2.0 * _REACH) * np.sqrt(2.0 * np.pi) * SIGMA  # of a false edge, over the true edge's peak
_COS = np.cos(2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS))
_SIN = np.sin(2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS))
_STEP = 0.5  # px
_COLOUR_SAMPLE = 3  # samples from the edge to the colours beside it: outside the blur, without much shading
_SAMPLES = 25  # from -6 to 6 px
_MIN_STEP = 8.0  # grey values: above the noise of a mean of nine pixels
_MAX_DEPTH = 6  # px inside the outline
_GAMMA = 2.2  # of grey values
_LOWER_POLE = np.cos(np.deg2rad(45.0))  # around it a stick, a robot, fingers or their shadow cover the ball


def measure_edges(
    image: Image, position: Array, rotation: Array, discs: Array, radius: float, lens: Array, f: int
) -> Array:
    """Return edges across the outline of a ball, (24, 5): u, v px, outward normal in the picture, 1 for a found one.

    The ball has its centre at (3,) m in cam, R_cam_ball (3, 3) and `radius` m. `discs` (m, 4) are directions in `ball`
    and angular radii; the search stays clear of their rims. `lens` is that of the model, and one step of the search is
    `f` px.
    """
    found = np.zeros((DIRECTIONS, 5))
    _measure(image, position, rotation, discs, radius, lens, float(f), found)
    return found


@njit(cache=True, fastmath=True, error_model="numpy")
def outline_point(c, radius, lens, k):
    """Return point k of the outline of a sphere at c, (3,) m: u, v px, and x, y, z m from the centre."""
    d2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    d = np.sqrt(d2)
    # basis across the line of sight; c x (0, 1, 0) is never short in front of a camera
    n = np.sqrt(c[0] * c[0] + c[2] * c[2])
    ax, az = c[2] / n, -c[0] / n
    bx, by, bz = c[1] * az / d, (c[2] * ax - c[0] * az) / d, -c[1] * ax / d
    s = radius * np.sqrt(max(1.0 - radius * radius / d2, 0.0))
    p, q, t = s * _COS[k], s * _SIN[k], -radius * radius / d2
    x, y, z = p * ax + q * bx + t * c[0], q * by + t * c[1], p * az + q * bz + t * c[2]
    depth = c[2] + z
    u, v = to_pixel(c[0] + x, c[1] + y, depth, lens)
    return u, v, x, y, z


@njit(cache=True, fastmath=True, error_model="numpy")
def _free_depth(c, R, x, y, z, discs, radius, lens, f):
    """Return the steps inward from the outline point c + (x, y, z) without a rim of a disc, at most 6."""
    distance = np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    scale = lens[0] * radius / distance / f  # steps per radius
    first = -1
    for depth in range(_MAX_DEPTH + 1):
        # the point that many steps inside, towards the camera
        cosine = max(1.0 - depth / scale, 0.0)
        sine = np.sqrt(1.0 - cosine * cosine) * radius / distance
        nx, ny, nz = cosine * x - sine * c[0], cosine * y - sine * c[1], cosine * z - sine * c[2]
        label = -1
        for q in range(len(discs)):
            d0, d1, d2 = rotate(R, discs, q, 0)
            angle = np.arccos(min(max((nx * d0 + ny * d1 + nz * d2) / radius, -1.0), 1.0)) - discs[q, 3]
            if abs(angle) < 1.0 / scale:  # and one step to the side
                return depth
            if angle < 0.0:
                label = q
        if depth == 0:
            first = label
        elif label != first:
            return depth
    return _MAX_DEPTH


@njit(cache=True, fastmath=True, error_model="numpy")
def _measure(image, c, R, discs, radius, lens, f, found):
    h, w, channels = image.shape
    line = np.empty((_SAMPLES, channels))
    middle = (_SAMPLES - 1) // 2
    for k in range(DIRECTIONS):
        u, v, x, y, z = outline_point(c, radius, lens, k)
        if R[0, 2] * x + R[1, 2] * y + R[2, 2] * z < -_LOWER_POLE * radius:
            continue
        first = max(middle - int(_free_depth(c, R, x, y, z, discs, radius, lens, f) / _STEP), 0) + _COLOUR_SAMPLE
        if first > middle - _COLOUR_SAMPLE:
            continue
        # outward normal: from the opposite point
        u2, v2, _, _, _ = outline_point(c, radius, lens, (k + DIRECTIONS // 2) % DIRECTIONS)
        length = np.sqrt((u - u2) ** 2 + (v - v2) ** 2)
        du, dv = (u - u2) / length, (v - v2) / length
        reach = middle * _STEP * f + 1.0
        if not (reach < u < w - 1 - reach and reach < v < h - 1 - reach):
            continue
        for i in range(_SAMPLES):
            s = (i - middle) * _STEP * f
            pu, pv = u + s * du, v + s * dv
            j, a = int(pu), pu - int(pu)
            l, b = int(pv), pv - int(pv)
            for m in range(channels):
                line[i, m] = (1.0 - b) * ((1.0 - a) * image[l, j, m] + a * image[l, j + 1, m]) + b * (
                    (1.0 - a) * image[l + 1, j, m] + a * image[l + 1, j + 1, m]
                )
        # strongest step over four samples, all channels
        best, at = 0.0, -1
        for i in range(max(first, 4), _SAMPLES - 4):
            step = 0.0
            for m in range(channels):
                step += (line[i + 2, m] - line[i - 2, m]) ** 2
            if step > best:
                best, at = step, i
        if at < 0:
            continue
        size = 0.0
        for m in range(channels):
            size += (line[at + _COLOUR_SAMPLE, m] - line[at - _COLOUR_SAMPLE, m]) ** 2
        if size < _MIN_STEP * _MIN_STEP:
            continue
        # half way between the light inside and outside: light mixes linearly, grey values do not
        for i in range(at - _COLOUR_SAMPLE, at + _COLOUR_SAMPLE + 1):
            for m in range(channels):
                line[i, m] = (max(line[i, m], 0.0) * (1.0 / 255.0)) ** _GAMMA
        size = 0.0
        for m in range(channels):
            size += (line[at + _COLOUR_SAMPLE, m] - line[at - _COLOUR_SAMPLE, m]) ** 2
        before, place = 0.0, -1.0
        for i in range(at - _COLOUR_SAMPLE, at + _COLOUR_SAMPLE + 1):
            part = 0.0
            for m in range(channels):
                part += (
                    (line[i, m] - line[at - _COLOUR_SAMPLE, m])
                    * (line[at + _COLOUR_SAMPLE, m] - line[at - _COLOUR_SAMPLE, m])
                    / size
                )
            if i > at - _COLOUR_SAMPLE and before < 0.5 <= part:
                place = i - 1 + (0.5 - before) / (part - before)
                break
            before = part
        if place < 0.0:
            continue
        s = (place - middle) * _STEP * f
        found[k, 0], found[k, 1] = u + s * du, v + s * dv
        found[k, 2], found[k, 3], found[k, 4] = du, dv, 1.0


@njit(cache=True, fastmath=True, error_model="numpy")
def add_log_likelihood(position, which, edges, radius, lens, f, out):
    """Add the log-likelihood ratio of the edges `edges[which]`, (24, 5), for balls at (n, 3) m to out, (n,)."""
    variance = (SIGMA * f) ** 2
    for n in range(len(position)):
        rg, gg, product = 0.0, 0.0, 1.0  # at least HIDDEN to the power of the directions
        found = edges[which[n]]
        for k in range(DIRECTIONS):
            if found[k, 4] == 0.0:
                continue
            u, v, _, _, _ = outline_point(position[n], radius, lens, k)
            r = (found[k, 0] - u) * found[k, 2] + (found[k, 1] - v) * found[k, 3]
            seen = (1.0 - HIDDEN) * np.exp(-0.5 * r * r / variance) / UNIFORM_DENSITY
            product *= seen + HIDDEN
            inlier = seen / (seen + HIDDEN)
            rg += inlier * r
            gg += inlier
        information = 1.0 / (OFFSET_SIGMA * f) ** 2 + gg / variance
        offset = 0.5 * (rg / variance) ** 2 / information - 0.5 * np.log(information * (OFFSET_SIGMA * f) ** 2)
        out[n] += np.log(product) + offset
