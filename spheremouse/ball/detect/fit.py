"""Discs measured: the picture and the expected ellipses in, centres with their covariance and what tells a disc out.

Around each place the picture is modelled by a sloped background minus a blurred ellipse whose shape the geometry gives:

    I = b0 + b1 x + b2 y - (a0 + a1 x + a2 y) e(x - c; s)

with the background b, the contrast a (gloss lightens print on one side), the centre c and the size s, by Gauss-Newton.
Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight). The covariance is that of the
adjustment (Wittich 2017, chapter 5, names it as the next step). Compiled: all per-pixel work is in the functions below.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.geometry.rotation import Array

_SURROUND = 3.0  # px of background around a disc that take part in the fit: enough for its slope, too few for more
_UNEVEN = 0.02  # of the contrast: unevenness of print and ball that a good fit leaves
_CLEAR = 0.02  # part of a disc's darkness below which a pixel lies beside it
_BESIDE = 0.2  # of the contrast: what is beside a disc and differs more from the ball's shade is not the ball
_SLOPE = 0.02  # 1/px: slope of the ball's shade, cos falls so fast 60 degrees off the light at 100 px radius
_GLOSS = 0.3  # of the contrast, from a disc's centre to its rim: gloss lightens print on the side of the light
_SIZE = 0.02  # discs cut from one sheet differ by this part of their size
_RIM_OFF = 0.35  # px by which lens blur and gloss may shift a rim: to a sliver's size that is a lot
_SLIVER = 2.0  # px, semi-minor axis below which both rims are one blur
_SLIVER_BIAS = 0.15  # px at a semi-minor axis of one pixel
_CUT = 1.5  # px², variance per part of the rim that something lies over: its edge passes for a rim here and there
_LARGE = 3.0  # px, semi-minor axis from which a disc tells the size of all
_LIMITS = np.array([0.35, 0.25, 0.25, 0.25, 0.25], dtype=np.float32)  # of the contrast: residuals beyond weigh nothing
_STILL = 0.01  # px: a step this short is the last
_UNKNOWNS = 9
_EDGE = 3  # px around a patch that the smoothing needs


@dataclass(frozen=True, slots=True)
class Fits:
    """What became of n places; numbers of a fit that came to nothing are meaningless."""

    ok: NDArray[np.bool_]  # (n,) a disc
    centroid: Array  # (n, 2) px, of the disc's image
    covariance: Array  # (n, 2, 2) px²
    rim: Array  # (n,) part of the rim on the ball that fits
    cut: Array  # (n,) part of it that does not fit at all: something lies over it


@dataclass(frozen=True, slots=True)
class FitSettings:
    """What the fit needs to know of discs and camera, in pixels of the picture reduced `reduction` times."""

    reduction: int  # so many pixels squared are averaged to one before all else
    light: bool  # discs lighter than the ball
    kernel: NDArray[np.float32]  # (2 _EDGE + 1,), the smoothing
    blur: float  # px, standard deviation of a rim's blur: pixels, lens and smoothing
    contrast: float  # least contrast over the background
    size_tolerance: float
    rim: float  # least part of the rim that fits
    sigma: float  # px of the whole picture, floor of a centre's standard deviation


def measure(
    image: Image,
    mask: Image,
    place: Array,
    shape: Array,
    noise: float,
    settings: FitSettings,
    share: float = 1.0,
    size: float = 0.0,
    smear: Array | None = None,
) -> Fits:
    """Fit n discs expected at `place`, (n, 2) px, with `shape`, (n, 2, 2) px², in an image (h, w, c) of uint8.

    `mask` (h, w) is not 0 on the ball, `noise` is that of one pixel. First the size is free, which tells discs from
    other things and the size all discs share; then it is held at that, so that a disc cut by a strut is seen as cut,
    not as smaller. Where fewer than three tell it, 1 is taken. With `size` (fitted over expected) it is held at that
    from the beginning. Of the contrast that is asked for, `share` is enough. `smear` (n, 2) px is the way of each while
    the shutter is open.
    """
    n = len(place)
    f = settings.reduction
    ok, centroid, covariance, rim = np.zeros(n, dtype=np.bool_), np.empty((n, 2)), np.empty((n, 2, 2)), np.zeros(n)
    cut = np.zeros(n)
    if n:
        measure_into(
            image,
            mask,
            place,
            np.ascontiguousarray(shape),
            np.zeros((n, 2)) if smear is None else smear / f,
            np.float32(noise / f),
            f,
            settings.light,
            settings.kernel,
            settings.blur,
            share * settings.contrast,
            settings.size_tolerance,
            settings.rim,
            settings.sigma,
            size,
            ok,
            centroid,
            covariance,
            rim,
            cut,
        )
    return Fits(ok, centroid, covariance, rim, cut)


def smoothing_kernel(sigma: float) -> NDArray[np.float32]:
    """Gaussian, (7,) float32, of up to one pixel of standard deviation."""
    x = np.arange(-_EDGE, _EDGE + 1)
    g = np.exp(-0.5 * (x / max(sigma, 1e-3)) ** 2)
    return (g / g.sum()).astype(np.float32)


@njit(cache=True, fastmath=True, error_model="numpy")
def noise_of(image, top, bottom, left, right):
    """Standard deviation of one pixel's grey value, from second differences along sixteen rows of a window.

    Their median: half of the pixels may be edges. Colour takes its green, which weighs most in grey.
    """
    channel = 1 if image.shape[2] == 3 else 0
    count = np.zeros(1024, dtype=np.int64)
    total = 0
    step = max((bottom - top) // 16, 1)
    for i in range(top + step // 2, bottom, step):
        for j in range(left + 1, right - 1):
            d = 2 * int(image[i, j, channel]) - int(image[i, j - 1, channel]) - int(image[i, j + 1, channel])
            count[abs(d)] += 1
            total += 1
    below = 0
    for d in range(1024):
        if 2 * (below + count[d]) >= total:
            # of whole numbers the median lies within the step: interpolated
            return max((d - 0.5 + (0.5 * total - below) / max(count[d], 1)) * 1.4826 / np.sqrt(6.0), 0.29)
        below += count[d]
    return 0.29


@njit(cache=True, fastmath=True, error_model="numpy")
def _patch(image, light, f, top, left, h, w, kernel, raw, across, out):
    """Smoothed grey of a window of h x w px from row `top` and column `left` of the reduced picture: into `out`.

    Beyond the picture's edge its last row and column are repeated.
    """
    height, width, channels = image.shape
    rows, columns = h + 2 * _EDGE, w + 2 * _EDGE
    y0, x0 = (top - _EDGE) * f, (left - _EDGE) * f
    scale, base = np.float32(1.0 / (f * f)), np.float32(0.0)
    if light:
        scale, base = -scale, np.float32(255.0)
    if f == 1 and channels == 3 and y0 >= 0 and x0 >= 0 and y0 + rows <= height and x0 + columns <= width:
        for i in range(rows):
            line, to = image[np.uint64(y0 + i)], raw[i]
            for j in range(columns):
                at = np.uint64(x0 + j)
                value = (
                    np.float32(0.114) * np.float32(line[at, 0])
                    + np.float32(0.587) * np.float32(line[at, 1])
                    + np.float32(0.299) * np.float32(line[at, 2])
                )
                to[np.uint64(j)] = base + scale * value
    else:
        for i in range(rows):
            for j in range(columns):
                value = np.float32(0.0)
                for di in range(f):
                    y = min(max(y0 + i * f + di, 0), height - 1)
                    for dj in range(f):
                        x = min(max(x0 + j * f + dj, 0), width - 1)
                        if channels == 3:
                            value += (
                                np.float32(0.114) * np.float32(image[y, x, 0])
                                + np.float32(0.587) * np.float32(image[y, x, 1])
                                + np.float32(0.299) * np.float32(image[y, x, 2])
                            )
                        else:
                            value += np.float32(image[y, x, 0])
                raw[i, j] = base + scale * value
    k0, k1, k2, k3 = kernel[3], kernel[4], kernel[5], kernel[6]
    for i in range(rows):
        r, a = raw[i], across[i]
        for j in range(w):
            a[j] = k0 * r[j + 3] + k1 * (r[j + 2] + r[j + 4]) + k2 * (r[j + 1] + r[j + 5]) + k3 * (r[j] + r[j + 6])
    for i in range(h):
        a0, a1, a2, a3 = across[i], across[i + 1], across[i + 2], across[i + 3]
        a4, a5, a6, o = across[i + 4], across[i + 5], across[i + 6], out[i]
        for j in range(w):
            o[j] = k0 * a3[j] + k1 * (a2[j] + a4[j]) + k2 * (a1[j] + a5[j]) + k3 * (a0[j] + a6[j])


@njit(cache=True, fastmath=True, error_model="numpy")
def _phi(x):
    """Gaussian distribution function of sqrt(2) x, x >= 0, less a half; and its derivative by x.

    Abramowitz and Stegun 1964, 7.1.27: within 3e-4, the derivative that of the approximation.
    """
    one = np.float32(1.0)
    p = one + x * (
        np.float32(0.278393) + x * (np.float32(0.230389) + x * (np.float32(0.000972) + x * np.float32(0.078108)))
    )
    dp = np.float32(0.278393) + x * (np.float32(0.460778) + x * (np.float32(0.002916) + x * np.float32(0.312432)))
    inverse = one / p
    square = inverse * inverse
    tail = np.float32(0.5) * square * square
    return np.float32(0.5) - tail, np.float32(4.0) * tail * inverse * dp


@njit(cache=True, fastmath=True, error_model="numpy")
def _ellipse(n, px, py, xx, xy, yy, cx, cy, size, blur, smear, e, d):
    """e of n pixels, and its derivatives by centre and size: rows of d, (3, n).

    With rho² = (x - c)' S^-1 (x - c) the rim lies (s - rho) / |grad rho| ahead and (s + rho) / |grad rho| behind;
    a strip of that width, blurred, is e = Phi(ahead) + Phi(behind) - 1. A disc that travels by `smear`, (2,) px, while
    the shutter is open is blurred by that too, across its rim: the variance of a box is a twelfth of its square.
    """
    square = blur * blur
    lx, ly = np.float32(0.28867513) * np.float32(smear[0]), np.float32(0.28867513) * np.float32(smear[1])
    by_x, by_y, by_size = d[0], d[1], d[2]
    for i in range(n):
        dx, dy = px[i] - cx, py[i] - cy
        gx, gy = xx * dx + xy * dy, xy * dx + yy * dy
        rho = np.sqrt(gx * dx + gy * dy + np.float32(1e-6))
        along = gx * lx + gy * ly
        steep = np.float32(0.70710678) * rho / np.sqrt((gx * gx + gy * gy) * square + along * along + np.float32(1e-12))
        z = (size - rho) * steep
        ahead, bell_ahead = _phi(abs(z))
        behind, bell_behind = _phi((size + rho) * steep)
        by_rho = (bell_ahead - bell_behind) * steep / rho  # minus de/drho; rho falls by g / rho along dc
        e[i] = math.copysign(ahead, z) + behind
        by_x[i] = by_rho * gx
        by_y[i] = by_rho * gy
        by_size[i] = (bell_ahead + bell_behind) * steep


@njit(cache=True, fastmath=True, error_model="numpy")
def _normal_equations(n, px, py, grey, e, d, x, weight, A, Aw, N, g):
    """Of n pixels: columns of the Jacobian into A, (9, n), weighted into Aw; N, (9, 9), and gradient g, (9,)."""
    b0, b1, b2 = np.float32(x[0]), np.float32(x[1]), np.float32(x[2])
    a0, a1, a2 = np.float32(x[3]), np.float32(x[4]), np.float32(x[5])
    for i in range(n):
        contrast = a0 + a1 * px[i] + a2 * py[i]
        A[0, i] = 1.0
        A[1, i] = px[i]
        A[2, i] = py[i]
        A[3, i] = -e[i]
        A[4, i] = -e[i] * px[i]
        A[5, i] = -e[i] * py[i]
        A[6, i] = -contrast * d[0, i]
        A[7, i] = -contrast * d[1, i]
        A[8, i] = -contrast * d[2, i]
        A[9, i] = grey[i] - (b0 + b1 * px[i] + b2 * py[i] - contrast * e[i])
    for j in range(_UNKNOWNS):
        for i in range(n):
            Aw[i] = A[j, i] * weight[i]
        for k in range(j, _UNKNOWNS + 1):
            total = np.float32(0.0)
            for i in range(n):
                total += Aw[i] * A[k, i]
            if k < _UNKNOWNS:
                N[j, k] = total
                N[k, j] = total
            else:
                g[j] = total


@njit(cache=True, fastmath=True, error_model="numpy")
def _biweight(n, px, py, grey, e, x, limit, scale, weight):
    """Tukey's weights of n residuals: beyond `limit` of the contrast none, beside the disc sooner."""
    b0, b1, b2 = np.float32(x[0]), np.float32(x[1]), np.float32(x[2])
    a0, a1, a2 = np.float32(x[3]), np.float32(x[4]), np.float32(x[5])
    floor = np.float32(4.685) * scale
    bound = max(limit * a0, floor)
    beside = min(max(np.float32(_BESIDE) * a0, floor), bound)
    # beside the disc no rim has to settle: what differs there is foreign
    near, far = np.float32(1.0) / (bound * bound), np.float32(1.0) / (beside * beside)
    for i in range(n):
        r = grey[i] - (b0 + b1 * px[i] + b2 * py[i] - (a0 + a1 * px[i] + a2 * py[i]) * e[i])
        u = max(np.float32(1.0) - r * r * (far if e[i] < np.float32(_CLEAR) else near), np.float32(0.0))
        weight[i] = u * u


@njit(cache=True, error_model="numpy")
def _cholesky(N, n):
    """Lower factor of N, in place."""
    for j in range(n):
        for k in range(j):
            N[j, j] -= N[j, k] * N[j, k]
        N[j, j] = np.sqrt(max(N[j, j], 1e-12))
        for i in range(j + 1, n):
            for k in range(j):
                N[i, j] -= N[i, k] * N[j, k]
            N[i, j] /= N[j, j]


@njit(cache=True, error_model="numpy")
def _solve(L, b, n):
    """b of L L' x = b becomes x."""
    for i in range(n):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]


@njit(cache=True, error_model="numpy")
def _step(N, g, x, scale, gloss, size, size_sigma, damping):
    """One Gauss-Newton step of x, (9,), times `damping` (weights that come and go let a full step swing).

    N becomes its factor. Returns the length of the centre's full step, px.

    What is expected of the slopes and the size comes in as observations: a ball's shade slopes little, and what does
    more is a strut; gloss slopes the contrast; a sliver cannot tell size from contrast, there the known size decides.
    """
    shade = (scale / (_SLOPE * max(x[0], 1.0))) ** 2
    gleam = (scale / (gloss * max(x[3], 1.0))) ** 2
    hold = (scale / size_sigma) ** 2
    for k in range(1, 3):
        N[k, k] += shade
        g[k] -= shade * x[k]
        N[k + 3, k + 3] += gleam
        g[k + 3] -= gleam * x[k + 3]
    N[8, 8] += hold
    g[8] -= hold * (x[8] - size)
    for k in range(_UNKNOWNS):
        N[k, k] += 1e-6
    _cholesky(N, _UNKNOWNS)
    _solve(N, g, _UNKNOWNS)
    g[6] = min(max(g[6], -1.0), 1.0)
    g[7] = min(max(g[7], -1.0), 1.0)
    g[8] = min(max(g[8], -0.2), 0.2)
    for k in range(_UNKNOWNS):
        x[k] += damping * g[k]
    x[8] = min(max(x[8], 0.3), 2.5)
    return max(abs(g[6]), abs(g[7]))


@njit(cache=True, error_model="numpy")
def _semi_axes(sxx, sxy, syy):
    """Minor and major semi-axis of an ellipse."""
    mean, half = 0.5 * (sxx + syy), np.hypot(0.5 * (sxx - syy), sxy)
    return np.sqrt(max(mean - half, 1e-6)), np.sqrt(max(mean + half, 1e-6))


@njit(cache=True, fastmath=True, error_model="numpy")
def _plane(n, px, py, grey, weight, x):
    """Level and slopes of weighted grey values: into x[:3]."""
    sw, sx, sy, sg, sxx, sxy, syy, sxg, syg = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        w = weight[i]
        sw += w
        sx += w * px[i]
        sy += w * py[i]
        sg += w * grey[i]
        sxx += w * px[i] * px[i]
        sxy += w * px[i] * py[i]
        syy += w * py[i] * py[i]
        sxg += w * px[i] * grey[i]
        syg += w * py[i] * grey[i]
    if sw < 3.0:
        return
    mx, my, mg = sx / sw, sy / sw, sg / sw
    cxx, cxy, cyy = sxx - sw * mx * mx + 1e-3, sxy - sw * mx * my, syy - sw * my * my + 1e-3
    cxg, cyg = sxg - sw * mx * mg, syg - sw * my * mg
    det = cxx * cyy - cxy * cxy
    x[1] = (cyy * cxg - cxy * cyg) / det
    x[2] = (cxx * cyg - cxy * cxg) / det
    x[0] = mg - x[1] * mx - x[2] * my


@njit(cache=True, fastmath=True, error_model="numpy")
def _keep_near(n, px, py, grey, e, x, noise, weight):
    """Weight 1 for what is beside the disc and within 1.5 mean deviations of the plane x[:3], else 0."""
    b0, b1, b2 = np.float32(x[0]), np.float32(x[1]), np.float32(x[2])
    total, count = np.float32(0.0), np.float32(1e-3)
    for i in range(n):
        total += weight[i] * abs(grey[i] - b0 - b1 * px[i] - b2 * py[i])
        count += weight[i]
    off = max(np.float32(1.5) * total / count, np.float32(2.0) * noise)
    for i in range(n):
        near = abs(grey[i] - b0 - b1 * px[i] - b2 * py[i]) < off and e[i] < np.float32(_CLEAR)
        weight[i] = np.float32(1.0) if near else np.float32(0.0)


@njit(cache=True, error_model="numpy")
def measure_into(
    image, mask, place, shape, smear, noise, f, light, kernel, blur, contrast, size_tolerance, rim_least, sigma,
    size_known, ok, centroid, covariance, rim, cut,
):  # fmt: skip
    """`measure` into ok, centroid, covariance, rim and cut; returns the size all discs share, 0 where too few tell."""
    n = len(place)
    widest = 0.0
    for k in range(n):
        half_way = 0.5 * np.hypot(smear[k, 0], smear[k, 1])
        widest = max(widest, np.sqrt(max(shape[k, 0, 0], shape[k, 1, 1])) / f + half_way)
    reach = int(np.ceil(widest + _SURROUND)) + 1
    side = 2 * reach + 1
    most = side * side
    raw = np.empty((side + 2 * _EDGE, side + 2 * _EDGE), dtype=np.float32)
    across = np.empty((side + 2 * _EDGE, side), dtype=np.float32)
    patch = np.empty((side, side), dtype=np.float32)
    px, py = np.empty((n, most), dtype=np.float32), np.empty((n, most), dtype=np.float32)
    grey, weight = np.empty((n, most), dtype=np.float32), np.empty((n, most), dtype=np.float32)
    e = np.empty((n, most), dtype=np.float32)
    d = np.empty((n, 3, most), dtype=np.float32)
    A, Aw = np.empty((10, most), dtype=np.float32), np.empty(most, dtype=np.float32)
    count = np.zeros(n, dtype=np.int64)
    x = np.zeros((n, _UNKNOWNS))
    N, g = np.zeros((_UNKNOWNS, _UNKNOWNS)), np.zeros(_UNKNOWNS)
    inverse = np.zeros((n, 3), dtype=np.float32)
    scale, gloss, minor = np.zeros(n), np.zeros(n), np.zeros(n)
    sizes, tell = np.zeros(n), 0
    b = np.float32(blur)
    for k in range(n):
        sxx, sxy, syy = shape[k, 0, 0] / f**2, shape[k, 0, 1] / f**2, shape[k, 1, 1] / f**2
        det = sxx * syy - sxy * sxy
        if not (det > 1e-3 and np.isfinite(place[k, 0] + place[k, 1])):
            continue
        minor[k], major = _semi_axes(sxx, sxy, syy)
        inverse[k, 0], inverse[k, 1], inverse[k, 2] = syy / det, -sxy / det, sxx / det
        # the ellipse whose axes are longer by the surround: same axes, so a combination of S and I
        lo, hi = minor[k] ** 2, major**2
        margin = _SURROUND + 0.5 * np.hypot(smear[k, 0], smear[k, 1])
        glo, ghi = (minor[k] + margin) ** 2, (major + margin) ** 2
        slope = (ghi - glo) / (hi - lo) if hi - lo > 1e-9 * hi else 1.0
        gxx, gxy, gyy = glo + slope * (sxx - lo), slope * sxy, glo + slope * (syy - lo)
        gdet = gxx * gyy - gxy * gxy
        half_w, half_h = int(np.ceil(np.sqrt(gxx))), int(np.ceil(np.sqrt(gyy)))
        u0, v0 = (place[k, 0] - 0.5 * (f - 1)) / f, (place[k, 1] - 0.5 * (f - 1)) / f  # px of the reduced picture
        left, top = int(np.rint(u0)) - half_w, int(np.rint(v0)) - half_h
        h, w = 2 * half_h + 1, 2 * half_w + 1
        if h > side or w > side:
            continue
        _patch(image, light, f, top, left, h, w, kernel, raw, across, patch)
        m = 0
        for i in range(h):
            y = top + i
            v = y * f + f // 2
            if v < 0 or v >= mask.shape[0] or y * f + f > image.shape[0] or y < 0:
                continue
            dy = np.float32(y - v0)
            for j in range(w):
                z = left + j
                u = z * f + f // 2
                if u < 0 or u >= mask.shape[1] or z * f + f > image.shape[1] or z < 0 or mask[v, u] == 0:
                    continue
                dx = np.float32(z - u0)
                if gyy * dx * dx - 2.0 * gxy * dx * dy + gxx * dy * dy < gdet:
                    px[k, m], py[k, m], grey[k, m] = dx, dy, patch[i, j]
                    m += 1
        if m < 2 * _UNKNOWNS:
            continue
        q = inverse[k]
        _ellipse(
            m,
            px[k],
            py[k],
            q[0],
            q[1],
            q[2],
            np.float32(0.0),
            np.float32(0.0),
            np.float32(1.0),
            b,
            smear[k],
            e[k],
            d[k],
        )
        # the ball's shade beside the disc to begin with: a plane, twice, the second time without what lies off it
        beside = 0
        for i in range(m):
            weight[k, i] = 1.0 if e[k, i] < _CLEAR else 0.0
            beside += e[k, i] < _CLEAR
        if beside < _UNKNOWNS:
            continue
        for _ in range(2):
            _plane(m, px[k], py[k], grey[k], weight[k], x[k])
            _keep_near(m, px[k], py[k], grey[k], e[k], x[k], np.float32(noise), weight[k])
        _plane(m, px[k], py[k], grey[k], weight[k], x[k])
        above, sum_e = 0.0, 0.0
        for i in range(m):
            if e[k, i] > 0.3:
                above += e[k, i] * (x[k, 0] + x[k, 1] * px[k, i] + x[k, 2] * py[k, i] - grey[k, i])
                sum_e += e[k, i] * e[k, i]
        a = above / max(sum_e, 1e-3)
        if a < max(0.3 * contrast * x[k, 0], 2.0 * noise):
            continue
        x[k, 3], x[k, 8] = a, 1.0
        scale[k] = max(noise, _UNEVEN * a)
        # across a sliver a slope of the contrast and a shift of the centre look alike: there it is taken for even
        gloss[k] = _GLOSS / major * min(max((minor[k] - 2.0 * blur) / 1.5, 0.01), 1.0)
        foreign = _BESIDE * a + 4.0 * noise
        for i in range(m):
            r = grey[k, i] - x[k, 0] - x[k, 1] * px[k, i] - x[k, 2] * py[k, i]
            weight[k, i] = 0.0 if e[k, i] < _CLEAR and abs(r) > foreign else 1.0
        if size_known > 0.0:  # what discs look like is known: no need to learn it from each
            x[k, 8] = size_known
            count[k] = m
            continue
        for turn in range(2):
            if turn > 0:
                _biweight(m, px[k], py[k], grey[k], e[k], x[k], np.float32(0.5), np.float32(scale[k]), weight[k])
            _normal_equations(m, px[k], py[k], grey[k], e[k], d[k], x[k], weight[k], A, Aw, N, g)
            _step(N, g, x[k], scale[k], gloss[k], 1.0, 0.4 * size_tolerance, 1.0)
            _ellipse(
                m, px[k], py[k], q[0], q[1], q[2], np.float32(x[k, 6]), np.float32(x[k, 7]), np.float32(x[k, 8]), b,
                smear[k], e[k], d[k],
            )  # fmt: skip
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
    for k in range(n):
        m = count[k]
        if m == 0:
            continue
        q = inverse[k]
        size_sigma = _SIZE + _RIM_OFF / 3.0 / minor[k]
        moved = 1.0
        for turn in range(len(_LIMITS)):
            _biweight(m, px[k], py[k], grey[k], e[k], x[k], _LIMITS[turn], np.float32(scale[k]), weight[k])
            _normal_equations(m, px[k], py[k], grey[k], e[k], d[k], x[k], weight[k], A, Aw, N, g)
            moved = _step(N, g, x[k], scale[k], gloss[k], size, size_sigma, 1.0 if turn < 2 else 0.5)
            _ellipse(
                m, px[k], py[k], q[0], q[1], q[2], np.float32(x[k, 6]), np.float32(x[k, 7]), np.float32(x[k, 8]), b,
                smear[k], e[k], d[k],
            )  # fmt: skip
            if turn > 0 and moved < _STILL:
                break
        fits, whole, inside, lost = 0.0, 1e-9, 0.0, 0.0
        squares, freedom = 0.0, -float(_UNKNOWNS)
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
        area = np.pi * f**-2.0 * np.sqrt(shape[k, 0, 0] * shape[k, 1, 1] - shape[k, 0, 1] ** 2) * size**2
        ok[k] = _deep(x[k], contrast, noise) and rim[k] > least and inside > 0.4 * area and moved < 0.1
        centroid[k, 0], centroid[k, 1] = place[k, 0] + f * x[k, 6], place[k, 1] + f * x[k, 7]
        # of the pixels' noise the smoothing leaves about a half in a centre
        variance = max(squares / max(freedom, 1.0), 0.5 * noise**2) * f**2
        for j in range(2):
            g[:] = 0.0
            g[6 + j] = 1.0
            _solve(N, g, _UNKNOWNS)
            covariance[k, j, 0] = variance * g[6]
            covariance[k, j, 1] = variance * g[7]
            # where both rims are one blur the limb's own shade draws the centre: from experience with rendered limbs
            covariance[k, j, j] += sigma**2 + ((_SLIVER_BIAS / minor[k] ** 2) ** 2 + _CUT * cut[k]) * f**2
    return told


@njit(cache=True, error_model="numpy")
def _deep(x, contrast, noise):
    """Is the contrast more than this part of the background, and than noise?"""
    return x[3] > max(contrast * (x[0] + x[1] * x[6] + x[2] * x[7]), 4.0 * noise)
