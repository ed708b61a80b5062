"""Measurement of discs: fit the expected ellipses to the image; return centres, covariances and tests of a disc.

The model of the image around each place is a sloped background minus a blurred ellipse. The geometry gives its shape:

    I = b0 + b1 x + b2 y - (a0 + a1 x + a2 y) e(x - c; s)

with the background b, the contrast a, the centre c and the size s, fitted by Gauss-Newton. The contrast has a slope
because gloss lightens print on one side. A disc that moves during the exposure is the mean of its ellipses along its
path.
Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight). The covariance is that of the
adjustment (Wittich 2017, chapter 5, names it as the next step). The functions are compiled and do all per-pixel work.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.detect.fit_model import (
    BESIDE,
    CLEAR,
    EDGE,
    UNKNOWNS,
    biweight,
    cut_patch,
    gauss_newton_step,
    keep_near,
    lighter,
    moving_ellipse_of,
    normal_equations,
    plane,
    semi_axes,
    solve,
)
from spheremouse.ball.detect.projection import Projection
from spheremouse.geometry.rotation import Array

_SURROUND = 3.0  # px of background around a disc that take part in the fit: enough for its slope, too few for more
_UNEVEN = 0.02  # of the contrast: unevenness of print and ball that a good fit leaves
_GLOSS = 0.3  # of the contrast, the most that gloss takes of it, and changes it by from a disc's centre to its rim
_SIZE = 0.02  # discs cut from one sheet differ by this part of their size
_RIM_OFF = 0.35  # px by which lens blur and gloss may shift a rim: to a sliver's size that is a lot
_SLIVER = 2.0  # px, semi-minor axis below which both rims are one blur
_SLIVER_BIAS = 0.15  # px at a semi-minor axis of one pixel
_CUT = 1.5  # px², variance per covered part of the rim: the cover's edge partly passes for a rim
_LARGE = 3.0  # px, semi-minor axis from which a disc contributes to the common size
_LIMITS = np.array([0.35, 0.25, 0.25, 0.25, 0.25], dtype=np.float32)  # of the contrast: residuals beyond weigh nothing
_STILL = 0.01  # px: a step this short is the last


class Fits(NamedTuple):
    """Results at n places; the numbers of a failed fit are meaningless."""

    ok: NDArray[np.bool_]  # (n,) a disc
    centroid: Array  # (n, 2) px, of the disc's image
    covariance: Array  # (n, 2, 2) px²
    rim: Array  # (n,) part of the rim on the ball that fits
    cut: Array  # (n,) part of the rim that does not fit at all, because something covers it


class FitSettings(NamedTuple):
    """Parameters of the discs and the camera for the fit."""

    projection: Projection  # of colours, in which discs are darker than the ball
    kernel: NDArray[np.float32]  # (2 EDGE + 1,), the smoothing
    blur: float  # px, standard deviation of a rim's blur: pixels, lens and smoothing
    contrast: float  # least contrast over the light of the lighter of disc and ball
    size_tolerance: float  # largest deviation of fitted over expected size from 1
    rim: float  # least part of the rim that fits
    sigma: float  # px, floor of a centre's standard deviation


@njit(cache=True, error_model="numpy")
def measure(image, mask, place, shape, path, noise, weights, fit, contrast, size_known):
    """Fit n discs expected at `place`, (n, 2) px, with `shape`, (n, 2, 2) px², in an image (h, w, c) of uint8.

    `mask` (h, w) is not 0 on the ball. `path` (n, 7) is each disc's motion during the exposure (`moving_ellipse_of`).
    `noise` is that of a pixel, `weights` (c,) are those of the projection, and `fit` is a FitSettings. `contrast` is
    the least contrast over the light of the lighter of disc and ball.

    Returns Fits and the common size of all discs, fitted over expected. The first fit leaves the size free. It
    separates discs from other objects and gives the common size. The second fit fixes the size at that value.
    Otherwise a disc cut by a strut would look smaller instead of cut. If fewer than three discs determine the size, it
    is fixed at 1 and the returned size is 0. If `size_known` is not 0, both fits use that size.
    """
    kernel, blur, size_tolerance = fit.kernel, fit.blur, fit.size_tolerance
    rim_least, sigma = fit.rim, fit.sigma
    noise = np.float32(noise)
    n = len(place)
    ok, centroid, covariance = np.zeros(n, dtype=np.bool_), np.empty((n, 2)), np.empty((n, 2, 2))
    rim, cut = np.zeros(n), np.zeros(n)
    widest = 0.0
    for k in range(n):
        half_way = 0.5 * np.hypot(path[k, 0], path[k, 1])
        widest = max(widest, np.sqrt(max(shape[k, 0, 0], shape[k, 1, 1])) + half_way)
    reach = int(np.ceil(widest + _SURROUND)) + 1
    side = 2 * reach + 1
    most = side * side
    raw = np.empty((side + 2 * EDGE, side + 2 * EDGE), dtype=np.float32)
    across = np.empty((side + 2 * EDGE, side), dtype=np.float32)
    patch = np.empty((side, side), dtype=np.float32)
    px, py = np.empty((n, most), dtype=np.float32), np.empty((n, most), dtype=np.float32)
    grey, weight = np.empty((n, most), dtype=np.float32), np.empty((n, most), dtype=np.float32)
    e = np.empty((n, most), dtype=np.float32)
    d = np.empty((n, 3, most), dtype=np.float32)
    e_part, d_part = np.empty(most, dtype=np.float32), np.empty((3, most), dtype=np.float32)
    A, Aw = np.empty((10, most), dtype=np.float32), np.empty(most, dtype=np.float32)
    count = np.zeros(n, dtype=np.int64)
    x = np.zeros((n, UNKNOWNS))
    N, g = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    inverse = np.zeros((n, 3), dtype=np.float32)
    scale, gloss, minor = np.zeros(n), np.zeros(n), np.zeros(n)
    sizes, tell = np.zeros(n), 0
    b = np.float32(blur)
    for k in range(n):
        sxx, sxy, syy = shape[k, 0, 0], shape[k, 0, 1], shape[k, 1, 1]
        det = sxx * syy - sxy * sxy
        if not (det > 1e-3 and np.isfinite(place[k, 0] + place[k, 1])):
            continue
        minor[k], major = semi_axes(sxx, sxy, syy)
        inverse[k, 0], inverse[k, 1], inverse[k, 2] = syy / det, -sxy / det, sxx / det
        # the ellipse whose axes are longer by the surround: same axes, so a combination of S and I
        lo, hi = minor[k] ** 2, major**2
        margin = _SURROUND + 0.5 * np.hypot(path[k, 0], path[k, 1])
        glo, ghi = (minor[k] + margin) ** 2, (major + margin) ** 2
        slope = (ghi - glo) / (hi - lo) if hi - lo > 1e-9 * hi else 1.0
        gxx, gxy, gyy = glo + slope * (sxx - lo), slope * sxy, glo + slope * (syy - lo)
        gdet = gxx * gyy - gxy * gxy
        half_w, half_h = int(np.ceil(np.sqrt(gxx))), int(np.ceil(np.sqrt(gyy)))
        u0, v0 = place[k, 0], place[k, 1]
        left, top = int(np.rint(u0)) - half_w, int(np.rint(v0)) - half_h
        h, w = 2 * half_h + 1, 2 * half_w + 1
        if h > side or w > side:
            continue
        cut_patch(image, weights, top, left, h, w, kernel, raw, across, patch)
        m = 0
        for i in range(h):
            y = top + i
            if y < 0 or y >= mask.shape[0]:
                continue
            dy = np.float32(y - v0)
            for j in range(w):
                z = left + j
                if z < 0 or z >= mask.shape[1] or mask[y, z] == 0:
                    continue
                dx = np.float32(z - u0)
                if gyy * dx * dx - 2.0 * gxy * dx * dy + gxx * dy * dy < gdet:
                    px[k, m], py[k, m], grey[k, m] = dx, dy, patch[i, j]
                    m += 1
        if m < 2 * UNKNOWNS:
            continue
        q = inverse[k]
        x[k, 8] = 1.0
        moving_ellipse_of(m, px[k], py[k], q, x[k, 6:9], path[k], b, e[k], d[k], e_part, d_part)
        # start with the ball's shade beside the disc: fit a plane twice, the second time without outliers
        beside = 0
        for i in range(m):
            weight[k, i] = 1.0 if e[k, i] < CLEAR else 0.0
            beside += e[k, i] < CLEAR
        if beside < UNKNOWNS:
            continue
        for _ in range(2):
            plane(m, px[k], py[k], grey[k], weight[k], x[k])
            keep_near(m, px[k], py[k], grey[k], e[k], x[k], np.float32(noise), weight[k])
        plane(m, px[k], py[k], grey[k], weight[k], x[k])
        above, sum_e = 0.0, 0.0
        for i in range(m):
            if e[k, i] > 0.3:
                above += e[k, i] * (x[k, 0] + x[k, 1] * px[k, i] + x[k, 2] * py[k, i] - grey[k, i])
                sum_e += e[k, i] * e[k, i]
        a = above / max(sum_e, 1e-3)
        if a < max(0.3 * contrast * lighter(x[k, 0], a), 2.0 * noise):
            continue
        x[k, 3] = a
        scale[k] = max(noise, _UNEVEN * a)
        # across a sliver a slope of the contrast and a shift of the centre look alike: there gloss is left out
        gloss[k] = min(max((minor[k] - 2.0 * blur) / 1.5, 0.01), 1.0) / major
        foreign = BESIDE * a + 4.0 * noise
        for i in range(m):
            r = grey[k, i] - x[k, 0] - x[k, 1] * px[k, i] - x[k, 2] * py[k, i]
            weight[k, i] = 0.0 if e[k, i] < CLEAR and abs(r) > foreign else 1.0
        if size_known > 0.0:  # the appearance of discs is known from earlier ones
            x[k, 8] = size_known
            count[k] = m
            continue
        for turn in range(2):
            if turn > 0:
                biweight(m, px[k], py[k], grey[k], e[k], x[k], np.float32(0.5), np.float32(scale[k]), weight[k])
            normal_equations(m, px[k], py[k], grey[k], e[k], d[k], x[k], weight[k], A, Aw, N, g)
            gauss_newton_step(N, g, x[k], scale[k], _GLOSS * gloss[k], 1.0, 0.4 * size_tolerance, 1.0)
            moving_ellipse_of(m, px[k], py[k], q, x[k, 6:9], path[k], b, e[k], d[k], e_part, d_part)
            if turn == 0 and (not _deep(x[k], 0.5 * contrast, noise) or abs(x[k, 8] - 1.0) > 2.0 * size_tolerance):
                break
            alike = abs(x[k, 8] - 1.0) < max(size_tolerance, _RIM_OFF / minor[k])
            if turn == 1 and alike and _deep(x[k], contrast, noise):
                count[k] = m
                if minor[k] > _LARGE:
                    sizes[tell] = x[k, 8]
                    tell += 1
    size = size_known if size_known > 0.0 else 1.0
    told = size_known
    if tell >= 3:
        part = np.sort(sizes[:tell])
        size = 0.5 * (part[(tell - 1) // 2] + part[tell // 2])
        told = size
    full = _full_contrast(x, count, minor)
    for k in range(n):
        m = count[k]
        if m == 0:
            continue
        q = inverse[k]
        size_sigma = _SIZE + _RIM_OFF / 3.0 / minor[k]
        moved = 1.0
        for turn in range(len(_LIMITS)):
            biweight(m, px[k], py[k], grey[k], e[k], x[k], _LIMITS[turn], np.float32(scale[k]), weight[k])
            normal_equations(m, px[k], py[k], grey[k], e[k], d[k], x[k], weight[k], A, Aw, N, g)
            gleam = gloss[k] * min(max(1.0 - x[k, 3] / lighter(x[k, 0], x[k, 3]) / full, _UNEVEN), _GLOSS)
            moved = gauss_newton_step(N, g, x[k], scale[k], gleam, size, size_sigma, 1.0 if turn < 2 else 0.5)
            moving_ellipse_of(m, px[k], py[k], q, x[k, 6:9], path[k], b, e[k], d[k], e_part, d_part)
            if turn > 0 and moved < _STILL:
                break
        fits, whole, inside, lost = 0.0, 1e-9, 0.0, 0.0
        squares, freedom = 0.0, -float(UNKNOWNS)
        for i in range(m):
            slope = np.sqrt(d[k, 0, i] ** 2 + d[k, 1, i] ** 2)
            fits += weight[k, i] * slope
            whole += slope
            if weight[k, i] < 0.3:
                lost += slope
            inside += e[k, i]
            contrast_i = x[k, 3] + x[k, 4] * px[k, i] + x[k, 5] * py[k, i]
            r = grey[k, i] - (x[k, 0] + x[k, 1] * px[k, i] + x[k, 2] * py[k, i] - contrast_i * e[k, i])
            squares += weight[k, i] * r * r
            freedom += weight[k, i]
        rim[k] = fits / whole
        cut[k] = lost / whole
        # the far rim of a sliver drowns in the limb; half of it, with the known size, still fixes the centre
        least = min(0.45, rim_least) if minor[k] < _SLIVER else rim_least
        area = np.pi * np.sqrt(shape[k, 0, 0] * shape[k, 1, 1] - shape[k, 0, 1] ** 2) * size**2
        ok[k] = _deep(x[k], contrast, noise) and rim[k] > least and inside > 0.4 * area and moved < 0.1
        centroid[k, 0], centroid[k, 1] = place[k, 0] + x[k, 6], place[k, 1] + x[k, 7]
        # of the pixels' noise the smoothing leaves about a half in a centre
        variance = max(squares / max(freedom, 1.0), 0.5 * noise**2)
        for j in range(2):
            g[:] = 0.0
            g[6 + j] = 1.0
            solve(N, g, UNKNOWNS)
            covariance[k, j, 0] = variance * g[6]
            covariance[k, j, 1] = variance * g[7]
            # where both rims are one blur the limb's own shade draws the centre: from experience with rendered limbs
            covariance[k, j, j] += sigma**2 + (_SLIVER_BIAS / minor[k] ** 2) ** 2 + _CUT * cut[k]
    return Fits(ok, centroid, covariance, rim, cut), told


@njit(cache=True, error_model="numpy")
def _full_contrast(x, count, minor):
    """Return the contrast over light of discs without gloss: the largest measured; 1 with fewer than three discs.

    Gloss reduces the contrast. A slope due to gloss is at most as steep as that reduction.
    """
    full, tell = 0.0, 0
    for k in range(len(x)):
        if count[k] > 0 and minor[k] > _LARGE:
            full = max(full, x[k, 3] / lighter(x[k, 0], x[k, 3]))
            tell += 1
    return full if tell >= 3 else 1.0


@njit(cache=True, error_model="numpy")
def _deep(x, contrast, noise):
    """Return whether the contrast exceeds this part of the lighter of disc and ball, and the noise."""
    return x[3] > max(contrast * lighter(x[0] + x[1] * x[6] + x[2] * x[7], x[3]), 4.0 * noise)
