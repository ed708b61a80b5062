"""Twins of the detector's native functions in NumPy: the same equations, to read and to compare with."""

import cv2
import numpy as np

from spheremouse.ball.detect.appearance import appearance, seen_at
from spheremouse.ball.detect.projection import weights_of
from spheremouse.geometry.matching import suppress
from spheremouse.geometry.rotation import exp

SURROUND, UNEVEN, GLOSS, SLOPE, BESIDE, CLEAR = 3.0, 0.02, 0.3, 0.02, 0.2, 0.02
IN_FOCUS, SIZE, RIM_OFFSET, SLIVER_BIAS, SLIVER_SIZE, COVER_BIAS, NEAR_COVER = 0.94, 0.02, 0.35, 0.15, 0.18, 1.5, 0.02
MISFIT, SMEARED, LARGE = 16.0, 2.0, 3.0
LIMIT, WIDE_LIMIT, FAR, STILL, MOST_ROUNDS, SMEARED_ROUNDS = 0.25, 0.5, 0.5, 0.01, 10, 5
LIFTED, TWO_SHADES, STRAY, MARGIN = 0.15, 0.8, 0.3, 2.0


def phi(x):
    """Return the normal distribution of sqrt(2) x, less a half, and its derivative (Abramowitz, Stegun, 7.1.27)."""
    p = np.polynomial.Polynomial([1.0, 0.278393, 0.230389, 0.000972, 0.078108])
    return 0.5 - 0.5 * p(x) ** -4, 2.0 * p(x) ** -5 * p.deriv()(x)


def expected(x, y, inverse, at, path, blur):
    """Return e, (n,), and its derivatives by centre and size, (3, n): the mean of the images along the path."""
    parts = max(int(np.ceil(np.hypot(*path[:2]) / (1.8 * blur))), 1)
    e, d = np.zeros(len(x)), np.zeros((3, len(x)))
    for t in (np.arange(parts) + 0.5) / parts - 0.5:
        square = t * t + 1.0 / (12.0 * parts**2)
        Q = inverse + t * np.array([[path[4], path[5]], [path[5], path[6]]])
        offset = np.stack([x, y]) - (at[:2] + t * path[:2] + square * path[2:4])[:, None]
        g = Q @ offset
        rho = np.sqrt(np.sum(g * offset, axis=0) + 1e-6)
        along = path[:2] @ g / parts / np.sqrt(12.0)
        steep = rho / np.sqrt(2.0 * (np.sum(g * g, axis=0) * blur**2 + along**2 + 1e-12))
        z = (at[2] - rho) * steep
        (ahead, bell_ahead), (behind, bell_behind) = phi(np.abs(z)), phi((at[2] + rho) * steep)
        e += (np.copysign(ahead, z) + behind) / parts
        d[:2] += (bell_ahead - bell_behind) * steep / rho * g / parts
        d[2] += (bell_ahead + bell_behind) * steep / parts
    return e, d


def lighter(ball, contrast):
    return max(abs(ball), abs(ball - contrast))


def deep(u, contrast, noise):
    return u[3] > max(contrast * lighter(u[0] + u[1] * u[6] + u[2] * u[7], u[3]), 4.0 * noise)


def beside_cover(x, y, grey, e, shape):
    """Return a mask, (n,), of the pixels before the straight edge of a cover that cuts a disc: all without a cover.

    Otsu's threshold divides the pixels inside of the disc, and a line has to divide them alike.
    """
    everything = np.ones(len(x), dtype=bool)
    ball, inside = grey[e < CLEAR].mean(), e > 0.9 * e.max()
    value, at = ball + (grey[inside] - ball) * e.max() / e[inside], np.stack([x, y], axis=1)[inside]
    v, n = np.sort(value), len(value)
    if v[-1] - v[0] <= LIFTED * (ball - v[0]):
        return everything
    k, below = np.arange(1, n), np.cumsum(v)[:-1]
    low, high = below / k, (v.sum() - below) / (n - k)
    between = k * (n - k) / n * (high - low) ** 2
    dark = k[best] if between[best := np.argmax(between)] > TWO_SHADES * n * v.var() else 0
    if dark < 6 or n - dark < 3 or high[best] - low[best] <= LIFTED * (ball - low[best]):
        return everything
    light = value > 0.5 * (v[dark - 1] + v[dark])
    to_circle = np.linalg.inv(np.linalg.cholesky(shape))
    normal = to_circle.T @ to_circle @ (at[light].mean(axis=0) - at[~light].mean(axis=0))
    normal /= np.linalg.norm(normal)
    edge = np.sort(at @ normal)[dark] - 0.5
    if np.count_nonzero(light != (at @ normal > edge)) > STRAY * min(dark, n - dark) + 2:
        return everything
    return np.stack([x, y], axis=1) @ normal <= edge - MARGIN


class Fit:
    """Fit of one disc, with the unknowns u: background, contrast (level and slopes each), centre and size."""

    def __init__(self, image, mask, place, shape, path, noise, settings):
        k = np.arange(-3, 4)
        kernel = np.exp(-0.5 * (k / settings.smoothing) ** 2)
        grey = image @ weights_of(settings.projection, image.shape[2]).astype(float)
        grey = cv2.sepFilter2D(grey, -1, *(2 * [kernel / kernel.sum()]), borderType=cv2.BORDER_REPLICATE)
        axes, V = np.linalg.eigh(shape)
        self.minor, self.major = np.sqrt(axes)
        margin = SURROUND * settings.blur / IN_FOCUS + 0.5 * np.hypot(*path[:2])
        grown = V @ np.diag((np.sqrt(axes) + margin) ** 2) @ V.T
        offset = np.stack(np.meshgrid(*map(np.arange, image.shape[1::-1])), axis=-1) - place
        near = np.einsum("hwi,ij,hwj->hw", offset, np.linalg.inv(grown), offset) < 1.0
        self.x, self.y = offset[near & (mask > 0)].T
        self.grey, self.shape, self.shown = grey[near & (mask > 0)], shape, 1.0
        self.all = self.x, self.y, self.grey
        self.inverse, self.path, self.noise, self.blur = np.linalg.inv(shape), path, noise, settings.blur
        self.u, self.smeared = np.append(np.zeros(8), 1.0), np.hypot(*path[:2]) > SMEARED
        self.expect()

    def expect(self):
        self.e, self.d = expected(self.x, self.y, self.inverse, self.u[6:], self.path, self.blur)

    def leave_out_covered(self):
        """Look for a cover among all pixels, and leave out what lies behind it."""
        if self.smeared:
            return
        self.x, self.y, self.grey = self.all
        self.expect()
        keep, slope = beside_cover(*self.all, self.e, self.shape), np.hypot(*self.d[:2])
        if not keep.all():
            self.shown = slope[keep].sum() / slope.sum()
            self.x, self.y, self.grey = (column[keep] for column in self.all)
            self.expect()
        else:
            self.shown = 1.0

    def residual(self):
        plane = np.stack([np.ones_like(self.x), self.x, self.y])
        return self.grey - self.u[:3] @ plane + self.u[3:6] @ plane * self.e

    def estimate_light(self):
        """Fit the background beside the disc, and the contrast."""
        plane, beside = np.stack([np.ones_like(self.x), self.x, self.y]), self.e < CLEAR
        w = beside.astype(float)
        for k in range(3):
            N = plane * w @ plane.T
            N += np.diag([0.0, 1e-3, 1e-3])
            self.u[:3] = np.linalg.solve(N, plane * w @ self.grey)
            off = np.abs(self.grey - self.u[:3] @ plane)
            if k < 2:
                w = beside & (off < max(1.5 * (w @ off) / w.sum(), 2.0 * self.noise))
        core = self.e > 0.3
        self.u[3:6] = 0.0
        self.u[3] = self.e[core] @ (self.u[:3] @ plane - self.grey)[core] / np.sum(self.e[core] ** 2)
        self.w = np.where(beside & (off > BESIDE * self.u[3] + 4.0 * self.noise), 0.0, 1.0)
        self.scale = max(self.noise, UNEVEN * self.u[3])
        self.gloss = np.clip((self.minor - 2.0 * self.blur) / 1.5, 0.01, 1.0) / self.major

    def step(self, gloss, size, size_sigma, damping):
        """Take a Gauss-Newton step with three expectations as observations; return the centre's move."""
        u, plane = self.u, np.stack([np.ones_like(self.x), self.x, self.y])
        A = np.concatenate([plane, -self.e * plane, -(u[3:6] @ plane) * self.d])
        as_shade = u[3] * u[0] / max(lighter(u[0], u[3]), 1.0) ** 2
        B, b, s = np.zeros((5, 9)), np.zeros(5), np.zeros(5)
        for k in (0, 1):
            B[k, 1 + k], b[k], s[k] = 1.0, -u[1 + k], SLOPE * max(abs(u[0]), 1.0)
            B[2 + k, [4 + k, 1 + k]] = 1.0, -as_shade
            b[2 + k], s[2 + k] = -(u[4 + k] - as_shade * u[1 + k]), gloss * max(u[3], 1.0)
        B[4, 8], b[4], s[4] = 1.0, size - u[8], size_sigma
        p = (self.scale / s) ** 2
        self.N = A * self.w @ A.T + B.T * p @ B + 1e-6 * np.eye(9)
        dx = np.linalg.solve(self.N, A * self.w @ self.residual() + B.T * p @ b)
        dx[6:] = np.clip(dx[6:], [-1.0, -1.0, -0.2], [1.0, 1.0, 0.2])
        u += damping * dx
        u[8] = np.clip(u[8], 0.3, 2.5)
        self.expect()
        return np.abs(dx[6:8]).max()

    def biweight(self, limit):
        bound = max(limit * self.u[3], 4.685 * self.scale)
        beside = min(max(BESIDE * self.u[3], 4.685 * self.scale), bound)
        ratio = self.residual() / np.where(self.e < CLEAR, beside, bound)
        self.w = np.maximum(1.0 - ratio**2, 0.0) ** 2


def fit_known_size(fit, size, size_sigma):
    """Fit the centre, and return its last step."""
    moved = 1.0
    for k in range(SMEARED_ROUNDS if fit.smeared else MOST_ROUNDS):
        fit.biweight(WIDE_LIMIT if moved > FAR and not fit.smeared else LIMIT)
        gloss = fit.gloss * min(max(1.0 - fit.u[3] / lighter(fit.u[0], fit.u[3]), UNEVEN), GLOSS)
        moved = fit.step(gloss, size, size_sigma, 1.0 if k < 2 else 0.5)
        if k and moved < STILL:
            break


def fit_disc(image, mask, place, shape, path, noise, settings, size):
    """Twin of `kernels.fit_discs` for a single disc without refusals: is it deep, its centroid, covariance and rim."""
    fit = Fit(image, mask, place, shape, path, noise, settings)
    fit.leave_out_covered()
    fit.estimate_light()
    for k in range(0 if size else 2):
        if k:
            fit.biweight(0.5)
        fit.step(GLOSS * fit.gloss, 1.0, 0.4 * settings.size_tolerance, 1.0)
    size, fit.u[8] = size or 1.0, size or fit.u[8]
    defocus = settings.blur / IN_FOCUS
    rim_sigma, thin = RIM_OFFSET / 3.0 * defocus / fit.minor, (defocus / fit.minor) ** 2
    fit_known_size(fit, size, SIZE + rim_sigma)
    was_covered, corrected = fit.shown < 1.0, np.zeros(2)
    fit.leave_out_covered()
    if was_covered or fit.shown < 1.0:
        corrected = fit.u[6:8].copy()
        fit.estimate_light()
        fit_known_size(fit, size, SIZE + rim_sigma)
        corrected -= fit.u[6:8]
    slope, r = np.hypot(*fit.d[:2]), fit.residual()
    rim, lost = fit.w @ slope / slope.sum(), slope[fit.w < 0.3].sum() / slope.sum()
    variance = max(fit.w @ r**2 / max(fit.w.sum() - 9, 1.0), 0.5 * noise**2)
    C, sliver = np.linalg.inv(fit.N)[6:, 6:], SLIVER_BIAS * defocus * thin
    by_rim = C[:2, 2] / C[2, 2] * rim_sigma
    near = min(np.mean(fit.w[fit.e < CLEAR] < 0.3) / NEAR_COVER, 1.0)
    unfit = max(lost, near * (0.95 - 0.1 / fit.minor - rim))
    misfit = (MISFIT * unfit / max(fit.minor, LARGE)) ** 2 * np.eye(2)
    if fit.shown < 1.0:
        other = (COVER_BIAS / fit.minor**3) ** 2 * shape
    elif fit.minor < LARGE:
        other_size = abs(fit.u[8] - size + SLIVER_SIZE * thin) - SIZE * (1.0 + thin)
        other = misfit + max(other_size, 0.0) ** 2 * shape
    else:
        shifted = max(abs(fit.u[8] - size) - SIZE - rim_sigma, 0.0) * fit.minor
        other = misfit + near * shifted**2 * np.eye(2)
    systematic = settings.sigma**2 + sliver**2 + corrected @ corrected
    covariance = variance * C[:2, :2] + systematic * np.eye(2) + np.outer(by_rim, by_rim) + other
    rim *= fit.shown
    return deep(fit.u, settings.contrast, noise), place + fit.u[6:8], covariance, rim


def windows(directions, rig, pose, model, motion):
    """Return appearances and paths of the discs that `kernels.follow_discs` fits, in its order."""
    row = (seen_at(directions, rig, pose)[:, 1] + 0.5) / len(model.mask) - 0.5
    late = np.nan_to_num(motion.readout * row)
    directions = np.einsum("nij,nj->ni", exp(late[:, None] * motion.rate), directions)
    now, path = appearance(directions, rig, pose), np.zeros((len(directions), 7))
    turn = exp(0.5 * model.exposure * motion.rate)
    if model.exposure:
        first, last = directions @ turn, directions @ turn.T
        a, b = (seen_at(d, rig, pose) for d in (first, last))
        A, B = (np.linalg.inv(appearance(d, rig, pose).shape) for d in (first, last))
        path = np.concatenate([b - a, 2.0 * (a + b - 2.0 * now.centre), (B - A).reshape(-1, 4)[:, [0, 1, 3]]], axis=1)
        path[:, 4:] = np.nan_to_num(path[:, 4:])
    reach = np.sqrt(np.diagonal(now.shape, axis1=1, axis2=2))
    size = np.array(model.mask.shape[::-1]) - 0.5
    whole = np.all((now.centroid - reach > -0.5) & (now.centroid + reach < size), axis=1)
    return now, path, np.flatnonzero((now.area >= model.min_area) & whole)


def best_fits(found, rim, ok, apart):
    """Return the indices of discs by their fit, without those nearer to a better one than `apart` px."""
    order = np.flatnonzero(ok)[np.argsort(-rim[ok], kind="stable")]
    return order[suppress(found[order], np.full(len(order), apart))]


def candidate_pixels(grey, mask, samples, offsets, limits, turn, known, rejected):
    """Return the dark spots that `kernels.follow_discs` measures, from the values of a projection, (h, w)."""
    contrast, least, radius, reduction = limits
    keep, found = int(256.0 * (1.0 - contrast)), np.zeros((0, 2))
    darker = lambda a, b: (256 * a < keep * b) & (keep * a < 256 * b)  # noqa: E731
    clearly = lambda a, b: darker(a, b) & (a < b - int(least))  # noqa: E731
    near = lambda at, places, r: np.any(np.sum((at - places) ** 2, axis=1) < r**2)  # noqa: E731
    for i in np.roll(np.arange(len(samples.place)), -(turn * 997) % max(len(samples.place), 1)):
        x, y = samples.place[i]
        on = [(samples.sides[i] >> k) & 1 == 1 for k in range(8)]
        ring = np.array([int(grey[y + v, x + u]) if k else 0 for k, (u, v) in zip(on, offsets, strict=True)])
        brighter = np.array(on) & clearly(int(grey[y, x]), ring)
        if on[0] and on[1] and not darker(int(grey[y, x]), ring[:2].max()):
            continue
        if np.count_nonzero(on) - brighter.sum() > 1 or brighter.sum() < 4:
            continue
        if not all(clearly(int(grey[y, x]), int(grey[y + v, x + u])) for u, v in samples.along[i] if u or v):
            continue
        at, wide = np.array([x, y], dtype=float), radius + 2.0 * reduction
        if near(at, known, wide) or near(at, found, wide) or near(at, rejected, 0.7 * radius):
            continue
        level = 0.5 * (int(grey[y, x]) + ring[brighter].mean())
        for _ in range(2):
            low = np.maximum((at - radius - reduction).astype(int), 0)
            high = np.minimum((at + radius + reduction).astype(int) + 1, np.array(mask.shape[::-1]) - 1)
            u, v = (
                a.ravel()
                for a in np.meshgrid(*(np.arange(a, b + 1, reduction) for a, b in zip(low, high, strict=True)))
            )
            dark = (grey[v, u] < level) & (mask[v, u] > 0) & (np.hypot(u - at[0], v - at[1]) < radius + reduction)
            if dark.any():
                at = np.average(np.stack([u, v], axis=1)[dark], axis=0, weights=level - grey[v, u][dark])
        if not near(at, known, wide) and not near(at, rejected, 2.5 * reduction):
            found = np.vstack([found, at])
        if len(found) == 4:
            break
    return found


def next_turn(search, rejected, reduction):
    """Return the search's state after a frame that rejected the places `rejected`, (k, 2) px, as discs."""
    turn, before = search.turn + 1, search.rejected.copy()
    again = np.linalg.norm(before[:, None, :2] - rejected[None], axis=2) < 2.5 * reduction
    old = again.any(axis=1)
    before[old, 3] = np.minimum(2.0 * before[old, 3], 512.0)
    before[old, 2] = turn + before[old, 3]
    new = np.concatenate([rejected, np.broadcast_to([turn + 32.0, 32.0], rejected.shape)], axis=1)[~again.any(axis=0)]
    expired = turn - before[:, 2] >= before[:, 3] if len(rejected) else np.zeros(len(before), dtype=bool)
    return search._replace(turn=turn, rejected=np.concatenate([new, before[~expired]])[:256])
