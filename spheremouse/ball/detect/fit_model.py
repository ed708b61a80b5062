"""The image of a disc that the fit expects: a sloped background less a blurred ellipse, and its normal equations."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

CLEAR = 0.02  # part of a disc's darkness below which a pixel lies beside it
BESIDE = 0.2  # of the contrast: what is beside a disc and differs more from the ball's shade is not the ball
_SLOPE = 0.02  # 1/px: slope of the ball's shade, cos falls so fast 60 degrees off the light at 100 px radius
UNKNOWNS = 9
PATH = 7  # numbers that describe how a disc moves during the exposure: `moving_ellipse_of`
_STEP = 1.8  # of the blur, px between the images that make up a smear: the ripple of such a sum is below 1 %
EDGE = 3  # px around a patch that the smoothing needs


def smoothing_kernel(sigma: float) -> NDArray[np.float32]:
    """Gaussian, (7,) float32, of up to one pixel of standard deviation."""
    x = np.arange(-EDGE, EDGE + 1)
    g = np.exp(-0.5 * (x / max(sigma, 1e-3)) ** 2)
    return (g / g.sum()).astype(np.float32)


@njit(cache=True, fastmath=True, error_model="numpy")
def noise_of(image, weights, top, bottom, left, right):
    """Standard deviation of a pixel's projection by `weights`, (c,), from second differences along sixteen rows.

    Their median: half of the pixels may be edges.
    """
    count = np.zeros(1024, dtype=np.int64)
    total = 0
    step = max((bottom - top) // 16, 1)
    for i in range(top + step // 2, bottom, step):
        for j in range(left + 1, right - 1):
            d = np.float32(0.0)
            for channel in range(len(weights)):
                if weights[channel] != 0.0:
                    beside = int(image[i, j - 1, channel]) + int(image[i, j + 1, channel])
                    d += weights[channel] * (2 * int(image[i, j, channel]) - beside)
            count[int(abs(d) + np.float32(0.5))] += 1
            total += 1
    below = 0
    for d in range(1024):
        if 2 * (below + count[d]) >= total:
            # of whole numbers the median lies within the step: interpolated
            return max((d - 0.5 + (0.5 * total - below) / max(count[d], 1)) * 1.4826 / np.sqrt(6.0), 0.29)
        below += count[d]
    return 0.29


@njit(cache=True, fastmath=True, error_model="numpy")
def cut_patch(image, weights, top, left, h, w, kernel, raw, across, out):
    """Smoothed projection by `weights`, (c,), of a window of h x w px from row `top` and column `left`: into `out`.

    Beyond the picture's edge its last row and column are repeated.
    """
    height, width, channels = image.shape
    rows, columns = h + 2 * EDGE, w + 2 * EDGE
    y0, x0 = top - EDGE, left - EDGE
    w0 = weights[0]
    w1, w2 = (weights[1], weights[2]) if channels == 3 else (np.float32(0.0), np.float32(0.0))
    if channels == 3 and y0 >= 0 and x0 >= 0 and y0 + rows <= height and x0 + columns <= width:
        for i in range(rows):
            line, to = image[np.uint64(y0 + i)], raw[i]
            for j in range(columns):
                at = np.uint64(x0 + j)
                to[np.uint64(j)] = (
                    w0 * np.float32(line[at, 0]) + w1 * np.float32(line[at, 1]) + w2 * np.float32(line[at, 2])
                )
    else:
        for i in range(rows):
            y = min(max(y0 + i, 0), height - 1)
            for j in range(columns):
                x = min(max(x0 + j, 0), width - 1)
                value = w0 * np.float32(image[y, x, 0])
                if channels == 3:
                    value += w1 * np.float32(image[y, x, 1]) + w2 * np.float32(image[y, x, 2])
                raw[i, j] = value
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
def ellipse_of(n, px, py, xx, xy, yy, cx, cy, size, blur, smear, e, d):
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


@njit(cache=True, error_model="numpy")
def moving_ellipse_of(n, px, py, inverse, at, path, blur, e, d, e_part, d_part):
    """`ellipse_of` for a disc that moves during the exposure: the mean of its images along the path.

    At time t, from -1/2 to 1/2 of the exposure, the centre is c + t s + t² q, with s = path[:2], q = path[2:4] px.
    The curvature q matters: seen in perspective, a turning ball's discs travel along arcs at a changing speed.
    Foreshortening changes the shape: S^-1 is `inverse` + t path[4:]. `at` (3,): c and the size. The images are `_STEP`
    apart and each is blurred by its own part of the way. `e_part` (n,) and `d_part` (3, n) are work space.
    """
    parts = max(int(np.ceil(np.hypot(path[0], path[1]) / (_STEP * blur))), 1)
    step, size, share = path[:2] / parts, np.float32(at[2]), np.float32(1.0 / parts)
    e_one, d_one = (e, d) if parts == 1 else (e_part, d_part)
    for k in range(parts):
        t = (k + 0.5) / parts - 0.5
        square = t * t + 1.0 / (12.0 * parts * parts)  # mean of t² over this part
        x, y = at[0] + t * path[0] + square * path[2], at[1] + t * path[1] + square * path[3]
        xx, xy, yy = inverse[0] + t * path[4], inverse[1] + t * path[5], inverse[2] + t * path[6]
        ellipse_of(
            n, px, py, np.float32(xx), np.float32(xy), np.float32(yy), np.float32(x), np.float32(y), size, blur, step,
            e_one, d_one,
        )  # fmt: skip
        if parts > 1:
            _add_share(n, share, e_part, d_part, k == 0, e, d)


@njit(cache=True, fastmath=True, error_model="numpy")
def _add_share(n, share, e_part, d_part, first, e, d):
    """Add `share` of `e_part` and `d_part` to e and d; the first one replaces them."""
    for i in range(n):
        if first:
            e[i], d[0, i], d[1, i], d[2, i] = 0.0, 0.0, 0.0, 0.0
        e[i] += share * e_part[i]
        d[0, i] += share * d_part[0, i]
        d[1, i] += share * d_part[1, i]
        d[2, i] += share * d_part[2, i]


@njit(cache=True, fastmath=True, error_model="numpy")
def normal_equations(n, px, py, grey, e, d, x, weight, A, Aw, N, g):
    """Write the Jacobian of n pixels into A, (9, n), weighted into Aw; also normal matrix N, (9, 9), and gradient g."""
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
    for j in range(UNKNOWNS):
        for i in range(n):
            Aw[i] = A[j, i] * weight[i]
        for k in range(j, UNKNOWNS + 1):
            total = np.float32(0.0)
            for i in range(n):
                total += Aw[i] * A[k, i]
            if k < UNKNOWNS:
                N[j, k] = total
                N[k, j] = total
            else:
                g[j] = total


@njit(cache=True, fastmath=True, error_model="numpy")
def biweight(n, px, py, grey, e, x, limit, scale, weight):
    """Compute Tukey's weights of n residuals: 0 beyond `limit` of the contrast; the bound beside the disc is lower."""
    b0, b1, b2 = np.float32(x[0]), np.float32(x[1]), np.float32(x[2])
    a0, a1, a2 = np.float32(x[3]), np.float32(x[4]), np.float32(x[5])
    floor = np.float32(4.685) * scale
    bound = max(limit * a0, floor)
    beside = min(max(np.float32(BESIDE) * a0, floor), bound)
    # no rim lies beside the disc, so a deviation there is a foreign object
    near, far = np.float32(1.0) / (bound * bound), np.float32(1.0) / (beside * beside)
    for i in range(n):
        r = grey[i] - (b0 + b1 * px[i] + b2 * py[i] - (a0 + a1 * px[i] + a2 * py[i]) * e[i])
        u = max(np.float32(1.0) - r * r * (far if e[i] < np.float32(CLEAR) else near), np.float32(0.0))
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
def solve(L, b, n):
    """Solve L L' x = b; b becomes x."""
    for i in range(n):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]


@njit(cache=True, error_model="numpy")
def lighter(ball, contrast):
    """Return the light of the lighter of ball and disc, from their projections `ball` and `ball - contrast`."""
    return max(abs(ball), abs(ball - contrast))


@njit(cache=True, error_model="numpy")
def gauss_newton_step(N, g, x, scale, gloss, size, size_sigma, damping):
    """Take one Gauss-Newton step of x, (9,), times `damping`.

    Without damping, changing weights make the steps oscillate. N becomes its factor. Returns the length of the
    centre's full step, px.

    Three expectations enter as observations:
    - A ball's shade slopes little. A steeper slope belongs to a strut.
    - Print leaves a part of the light, so the contrast slopes as the shade of a light ball does. A dark ball's shade
      gives no information about it. Gloss changes that slope by up to `gloss` (of the contrast, 1/px).
    - The size is `size`. In the image of a sliver, size and contrast are inseparable, so this value decides.
    """
    shade = (scale / (_SLOPE * max(abs(x[0]), 1.0))) ** 2
    gleam = (scale / (gloss * max(x[3], 1.0))) ** 2
    hold = (scale / size_sigma) ** 2
    as_shade = x[3] * x[0] / max(lighter(x[0], x[3]), 1.0) ** 2
    for k in range(1, 3):
        unlike = x[k + 3] - as_shade * x[k]
        N[k, k] += shade + gleam * as_shade**2
        N[k, k + 3] -= gleam * as_shade
        N[k + 3, k] -= gleam * as_shade
        N[k + 3, k + 3] += gleam
        g[k] -= shade * x[k] - gleam * as_shade * unlike
        g[k + 3] -= gleam * unlike
    N[8, 8] += hold
    g[8] -= hold * (x[8] - size)
    for k in range(UNKNOWNS):
        N[k, k] += 1e-6
    _cholesky(N, UNKNOWNS)
    solve(N, g, UNKNOWNS)
    g[6] = min(max(g[6], -1.0), 1.0)
    g[7] = min(max(g[7], -1.0), 1.0)
    g[8] = min(max(g[8], -0.2), 0.2)
    for k in range(UNKNOWNS):
        x[k] += damping * g[k]
    x[8] = min(max(x[8], 0.3), 2.5)
    return max(abs(g[6]), abs(g[7]))


@njit(cache=True, error_model="numpy")
def semi_axes(sxx, sxy, syy):
    """Minor and major semi-axis of an ellipse."""
    mean, half = 0.5 * (sxx + syy), np.hypot(0.5 * (sxx - syy), sxy)
    return np.sqrt(max(mean - half, 1e-6)), np.sqrt(max(mean + half, 1e-6))


@njit(cache=True, fastmath=True, error_model="numpy")
def plane(n, px, py, grey, weight, x):
    """Write the level and slopes of weighted grey values into x[:3]."""
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
def keep_near(n, px, py, grey, e, x, noise, weight):
    """Set weight 1 for pixels beside the disc within 1.5 mean deviations of the plane x[:3], else 0."""
    b0, b1, b2 = np.float32(x[0]), np.float32(x[1]), np.float32(x[2])
    total, count = np.float32(0.0), np.float32(1e-3)
    for i in range(n):
        total += weight[i] * abs(grey[i] - b0 - b1 * px[i] - b2 * py[i])
        count += weight[i]
    off = max(np.float32(1.5) * total / count, np.float32(2.0) * noise)
    for i in range(n):
        near = abs(grey[i] - b0 - b1 * px[i] - b2 * py[i]) < off and e[i] < np.float32(CLEAR)
        weight[i] = np.float32(1.0) if near else np.float32(0.0)
