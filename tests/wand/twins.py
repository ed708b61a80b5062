"""Twins of the wand's native functions in NumPy: the same equations, to read and to compare with."""

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from scipy.stats import multivariate_normal

from spheremouse.geometry.rotation import exp, log
from spheremouse.wand.likelihood import FULL_FACING, MIN_FACING

OUTLIER, SIGMA, FIELD_SIGMA, SHARP_RIM = 0.08, 0.065, 1.2, 0.55
EDGE_SIGMA, EDGE_OFFSET, EDGE_HIDDEN = 0.2, 0.15, 0.3
EDGE_UNIFORM = np.sqrt(2.0 * np.pi) * EDGE_SIGMA / 8.0
ONE, HALF = np.float32(1.0), np.float32(0.5)


def pixel(x, y, lens):
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
    return u, fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy


def ray_basis(c):
    x, z = np.array([c[2], 0.0, -c[0]]) / np.hypot(c[0], c[2]), c / np.linalg.norm(c)
    return np.stack([x, np.cross(z, x), z], axis=1)


def outline(c, radius):
    """Return 24 points of the outline of a ball at c, m from the centre."""
    phi, share = 2.0 * np.pi / 24 * np.arange(24), radius**2 / (c @ c)
    B = ray_basis(c)
    circle = np.cos(phi)[:, None] * B[:, 0] + np.sin(phi)[:, None] * B[:, 1]
    return radius * np.sqrt(1.0 - share) * circle - share * c


# ---- likelihood ----


def normal(x):
    x = np.clip(x, np.float32(-3.6), np.float32(3.6))
    xx = x * x
    y = x * (np.float32(0.7988) + np.float32(0.03528) * xx)
    yy = y * y
    a, b, c, d, e, f = np.array([135135.0, 17325.0, 378.0, 62370.0, 3150.0, 28.0], dtype=np.float32)
    t = y * (a + yy * (b + yy * (c + yy))) / (a + yy * (d + yy * (e + f * yy)))
    return HALF + HALF * t, HALF * (ONE - t * t) * (np.float32(0.7988) + np.float32(0.10584) * xx)


def scaled_asin(s):
    x = np.minimum(np.abs(s), ONE)
    a, b, c = np.array([0.1350363, 0.0472763, 0.0119235], dtype=np.float32)
    rest = np.sqrt(ONE - x) * (ONE - x * (a - x * (b - x * c)))
    return np.where(s > 0, ONE - rest, rest - ONE)


def expected_field(points):
    """Twin of `kernels.expected_field` in single precision."""
    along, outward, facing, scale, inside, width, bend, offset, blur = np.asarray(points, dtype=np.float32).T
    per_sigma, half_sigma = np.float32(1.0 / FIELD_SIGMA), np.float32(0.5 * FIELD_SIGMA)
    per_root = ONE / np.sqrt(np.maximum(ONE - along * along, np.float32(0.02)))
    across = scale * facing * per_root * per_sigma
    wider = ONE + blur * blur * per_sigma * per_sigma
    bent = half_sigma * wider * facing * bend * per_root * per_root * per_root / scale
    apart, alone = (inside + width) * across * np.float32(FIELD_SIGMA), -offset
    (_, slope), (opposite, steep) = normal(alone * (ONE / blur)), normal((apart - alone) * (ONE / blur))
    both = alone + blur * (ONE - opposite) / np.maximum(slope - steep, np.float32(0.05))
    shift = np.minimum(bent, np.float32(0.8)) + np.minimum(both, np.maximum(HALF * apart, alone)) * per_sigma
    (near, g), (far, slope) = normal(inside * across - shift), normal(width * across - shift)
    disc, g = np.maximum(near + far - ONE, np.float32(0.0)), g + slope
    aside = np.sqrt(np.maximum(ONE - facing * facing, np.float32(1e-6)))
    ball, _ = normal(scale * (ONE - aside) * per_sigma)
    v = scaled_asin(outward / aside * per_root)
    same_way = np.where(v > 0, np.minimum(disc, ball), np.maximum(disc + ball - ONE, np.float32(0.0)))
    rim_limits = np.where(v > 0, ball - disc, disc + ball - ONE) > 0
    weight = np.abs(v)
    e = (ONE - weight) * disc * ball + weight * same_way
    return e, ((ONE - weight) * g * ball + np.where(rim_limits, weight * g, np.float32(0.0))) * per_sigma


@dataclass
class Sight:
    """Points that a pose shows, by their index: weight, field m, expected field e, residual r, slope g, glare."""

    index: np.ndarray
    w: np.ndarray
    m: np.ndarray  # (p, c): a bare point has the fields of all colours
    e: np.ndarray
    r: np.ndarray
    g: np.ndarray
    hidden: np.ndarray
    disc_weight: np.ndarray


def interpolated(fields, x, y):
    """Interpolate fields, (c, h, w), at places in px, (p,): (p, c)."""
    j, i = x.astype(int), y.astype(int)
    a, b = x - j, y - i
    high, low = ((1 - a) * fields[:, k, j] + a * fields[:, k, j + 1] for k in (i, i + 1))
    return (((1 - b) * high + b * low) / 255.0).T


def sight(p, R, model, fields, fixed=None):
    table, colour, radius = model.points.table, model.points.colour, model.radius
    normal_, tangent = table[:, :3] @ R.T, table[:, 3:6] @ R.T
    out = np.cross(tangent, normal_)
    x = p + radius * normal_
    length = np.linalg.norm(x, axis=1)
    facing, scale = -np.sum(normal_ * x, axis=1) / length, model.lens[0] * radius / fields.factor / length
    first = table[:, 9] > 0
    area = np.maximum(facing[first], MIN_FACING) * scale[first] ** 2 * table[first, 9]
    disc_weight = np.minimum(area / (2.0 * np.pi * FIELD_SIGMA**2), 1.0) if fixed is None else fixed
    u, v = pixel(x[:, 0] / x[:, 2], x[:, 1] / x[:, 2], model.lens)
    u, v = (u - fields.left + 0.5) / fields.factor - 0.5, (v - fields.top + 0.5) / fields.factor - 0.5
    _, h, w = fields.weight.shape
    q = np.flatnonzero((facing > MIN_FACING) & (x[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < w - 1) & (v < h - 1))
    hidden = interpolated(fields.glare, u[q], v[q])[:, 0] if len(fields.glare) else np.zeros(len(q))
    ramp = np.minimum((facing[q] - MIN_FACING) / (FULL_FACING - MIN_FACING), 1.0)
    weight = ramp * disc_weight[np.cumsum(first)[q] - 1] * (1.0 - hidden)
    m, k, bare = interpolated(fields.weight, u[q], v[q]), np.maximum(colour[q], 0), colour[q] < 0
    along, outward = np.sum(tangent * x, axis=1) / length, np.sum(out * x, axis=1) / length
    offset = fields.rim[np.maximum(colour, 0)]
    if fields.exposure_motion.any():
        motion = fields.exposure_motion[:3] + np.cross(fields.exposure_motion[3:], radius * normal_)
        across = np.cross(x / length[:, None], tangent) / np.sqrt(np.maximum(1.0 - along**2, 0.02))[:, None]
        moved = (0.5 - fields.cover[np.maximum(colour, 0)]) * scale / radius * np.abs(np.sum(motion * across, axis=1))
        offset = np.copysign(np.hypot(offset, moved), moved)
    blur = fields.edge[np.maximum(colour, 0)]
    points = np.column_stack([along, outward, facing, scale, table[:, 6:9], offset, blur])
    e, g = (np.where(bare, 0.0, one) for one in expected_field(points[q]))
    r = np.where(bare, m.max(axis=1), m[np.arange(len(q)), k] - e)
    veiled = (hidden > 0) & (r < 0) & ~bare
    r = np.where(veiled, np.minimum(r + hidden, 0.0), r)
    g = np.where(veiled & (r == 0.0), 0.0, g)
    return Sight(q, weight, m, e, r, g, hidden, disc_weight)


def noise(fields):
    """Return the standard deviation of a field."""
    return SIGMA * np.mean(np.maximum(np.sqrt((1.0 + fields.edge**2) / (1.0 + SHARP_RIM**2)), 1.0))


def log_likelihood(p, R, model, fields, sigma=SIGMA, fixed=None):
    """Twin of `kernels.log_likelihood` for one pose, without the table of |m - e|: return value and match."""
    s, fraction = sight(p, R, model, fields, fixed), np.clip(fields.fraction, 0.003, 0.5)
    sigma = max(sigma, noise(fields))
    colour = model.points.colour[s.index]
    bare, value = colour < 0, 0.0
    m = s.m[bare]
    value += np.sum(
        s.w[bare, None] * np.where(m > 0, np.log((1 - OUTLIER) * np.exp(-0.5 * (m / sigma) ** 2) + OUTLIER), 0)
    )
    expected = np.sum(s.w[bare, None] * (m > 0.5))
    k = colour[~bare]
    w, e, r, g, hidden = (one[~bare] for one in (s.w, s.e, s.r, s.g, s.hidden))
    m = s.m[~bare][np.arange(len(k)), k]
    near = (1 - OUTLIER) * np.exp(-0.5 * (np.minimum(np.abs(r), 1.0) / sigma) ** 2)
    chance = (1 - fraction[k]) * np.exp(-0.5 * (np.clip(m - r, 0.0, 1.0) / sigma) ** 2) + fraction[k]
    value += np.sum(w * np.log(near / chance + OUTLIER))
    inlier = w * near / (near + OUTLIER)
    for one in range(len(fraction)):
        b, A = np.sum((inlier * r * g)[k == one]) / sigma**2, np.sum((inlier * g * g)[k == one]) / sigma**2
        information = 1.0 / fields.rim_sigma[one] ** 2 + A
        value += 0.5 * b * b / information - 0.5 * np.log(information * fields.rim_sigma[one] ** 2)
    counts = ~((hidden > 0) & (m < 0.3))
    shows = np.where(np.abs(r) < 0.25, 1.0, np.minimum(m / np.maximum(e, 1e-9), 1.0))
    expected += np.sum(w[counts & ((e > 0.3) | (m > 0.5))])
    return value, np.sum((w * shows)[counts & (e > 0.3)]) / expected if expected > 0 else 0.0


def evidence_bounds(p, R, model, fields):
    """Twin of `kernels.evidence_bounds` for one pose."""
    s, fraction = sight(p, R, model, fields), np.clip(fields.fraction, 0.003, 0.5)
    k = model.points.colour[s.index]
    w, e, k = (one[k >= 0] for one in (s.w, s.e, k))
    none = np.exp(-0.5 * (e / noise(fields)) ** 2)
    chance = (1 - OUTLIER) / ((1 - fraction[k]) * none + fraction[k])
    terms = w * np.log(none * chance + OUTLIER), w * np.log(chance + OUTLIER)
    return [[np.sum(term[k == one]) for one in range(len(fraction))] for term in terms]


def outline_log_likelihood(c, edges, model, factor):
    """Twin of `kernels.outline_log_likelihood` for one position."""
    x = c + outline(c, model.radius)
    u, v = pixel(x[:, 0] / x[:, 2], x[:, 1] / x[:, 2], model.lens)
    r = ((edges[:, 0] - u) * edges[:, 2] + (edges[:, 1] - v) * edges[:, 3])[edges[:, 4] > 0]
    variance, prior = (EDGE_SIGMA * factor) ** 2, (EDGE_OFFSET * factor) ** 2
    seen = (1 - EDGE_HIDDEN) * np.exp(-0.5 * r * r / variance) / EDGE_UNIFORM
    inlier = seen / (seen + EDGE_HIDDEN)
    b, information = np.sum(inlier * r) / variance, 1.0 / prior + np.sum(inlier) / variance
    return np.sum(np.log(seen + EDGE_HIDDEN)) + 0.5 * b * b / information - 0.5 * np.log(information * prior)


# ---- refinement ----


def refine_once(p, R, model, fields, edges):
    """Twin of `kernels.refine` with one round: one Gauss-Newton step. Return position and rotation."""
    count, factor = len(fields.rim), fields.factor
    fraction, sigma = np.clip(fields.fraction, 0.003, 0.5), noise(fields)
    distance = np.linalg.norm(p)
    half = 0.5 * factor * distance / model.lens[0]
    step = [half, half, half * min(distance / model.radius, 40.0), *[0.5 * half / model.radius] * 3]
    B, found = ray_basis(p), edges[:, 4] > 0

    def outline_residual(c):
        x = c + outline(c, model.radius)
        u, v = pixel(x[:, 0] / x[:, 2], x[:, 1] / x[:, 2], model.lens)
        return (edges[:, 0] - u) * edges[:, 2] + (edges[:, 1] - v) * edges[:, 3]

    def full(s):
        r, w = np.zeros(len(model.points.colour)), np.zeros(len(model.points.colour))
        r[s.index], w[s.index] = s.r, s.w
        return r, w

    here, J, J_outline = sight(p, R, model, fields), [], []
    for k in range(6):
        d = np.eye(6)[k] * step[k]
        sides = [(p + s * B @ d[:3], exp(s * d[3:]) @ R) for s in (1.0, -1.0)]
        (r0, w0), (r1, w1) = (full(sight(*side, model, fields)) for side in sides)
        J.append(np.where((w0 > 0) & (w1 > 0), r0 - r1, 0.0)[here.index] / (2.0 * step[k]))
        J_outline.append((outline_residual(sides[0][0]) - outline_residual(sides[1][0])) / (2.0 * step[k]) * (k < 3))
    colour = model.points.colour[here.index]
    rows = np.column_stack([*J, *[np.where(colour == k, -here.g, 0.0) for k in range(count)], np.zeros(len(colour))])
    inlier = (1 - OUTLIER) * np.exp(-0.5 * (here.r / sigma) ** 2)
    p_of = fraction[np.maximum(colour, 0)]
    m = np.where(colour < 0, 0.0, here.m[np.arange(len(colour)), np.maximum(colour, 0)] - here.r)
    inlier /= (1 - p_of) * np.exp(-0.5 * (m / sigma) ** 2) + p_of
    weight = here.w * inlier / (inlier + OUTLIER) / sigma**2
    edge_rows = np.column_stack([*J_outline, np.zeros((24, count)), -np.ones(24)])[found]
    edge_r, variance = outline_residual(p)[found], (EDGE_SIGMA * factor) ** 2
    seen = (1 - EDGE_HIDDEN) * np.exp(-0.5 * edge_r**2 / variance) / EDGE_UNIFORM
    edge_weight = seen / (seen + EDGE_HIDDEN) / variance
    prior = [0.5 * model.radius] * 2 + [2.0 * model.radius] + [0.3] * 3 + [*fields.rim_sigma, EDGE_OFFSET * factor]
    A = rows.T * weight @ rows + edge_rows.T * edge_weight @ edge_rows + np.diag(np.array(prior) ** -2.0)
    dx = np.linalg.solve(A, -rows.T @ (weight * here.r) - edge_rows.T @ (edge_weight * edge_r))
    across, along = np.abs(dx[:2]).max() / (0.5 * model.radius), abs(dx[2]) / (0.15 * distance)
    dx /= max(across, along, np.abs(dx[3:6]).max() / 0.4, 1.0)
    return p + B @ dx[:3], exp(dx[3:6]) @ R


# ---- outline ----


def measure_edge(image, at, normal, first, factor):
    """Return the place of the edge on a line across the outline, in samples of half a pixel from -6 px, or None."""
    uv = at + (np.arange(25)[:, None] - 12) * 0.5 * factor * normal
    j, i = uv.astype(int).T
    a, b = (uv - np.stack([j, i], axis=1)).T[:, :, None]
    high, low = ((1 - a) * image[k, j] + a * image[k, j + 1] for k in (i, i + 1))
    line = (1 - b) * high + b * low
    step = np.sum((line[4:] - line[:-4]) ** 2, axis=1)  # of the samples 2 to 22
    step[: max(first, 4) - 2], step[19:] = 0.0, 0.0
    n = int(np.argmax(step)) + 2
    if step[n - 2] <= 0.0 or np.sum((line[n + 3] - line[n - 3]) ** 2) < 64.0:
        return None
    light = (line[n - 3 : n + 4] / 255.0) ** 2.2
    span = light[-1] - light[0]
    part = (light - light[0]) @ span / (span @ span)
    rising = [k for k in range(1, 7) if part[k - 1] < 0.5 <= part[k]]
    return (
        n - 3 + rising[0] - 1 + (0.5 - part[rising[0] - 1]) / (part[rising[0]] - part[rising[0] - 1])
        if rising
        else None
    )


def free_depth(p, R, d, discs, radius, scale):
    """Return the steps inward from the outline point p + d without a rim of a disc, at most 6."""
    first = None
    for depth in range(7):
        cosine = max(1.0 - depth / scale, 0.0)
        n = cosine * d / radius - np.sqrt(1.0 - cosine**2) * p / np.linalg.norm(p)
        angle = np.arccos(np.clip(discs[:, :3] @ R.T @ n, -1.0, 1.0)) - discs[:, 3]
        label = tuple(np.flatnonzero(angle < 0.0))
        if np.any(np.abs(angle) < 1.0 / scale) or (depth and label != first):
            return depth
        first = label
    return 6


def measure_edges(image, p, R, discs, model, factor):
    """Twin of `kernels.measure_edges`."""
    found, radius = np.zeros((24, 5)), model.radius
    d = outline(p, radius)
    x = p + d
    uv = np.stack(pixel(x[:, 0] / x[:, 2], x[:, 1] / x[:, 2], model.lens), axis=1)
    scale, reach = model.lens[0] * radius / np.linalg.norm(p) / factor, 6.0 * factor + 1.0
    for k in range(24):
        first = max(12 - 2 * free_depth(p, R, d[k], discs, radius, scale), 0) + 3
        inside = np.all((uv[k] > reach) & (uv[k] < np.array(image.shape[1::-1]) - 1 - reach))
        if R[:, 2] @ d[k] < -np.cos(np.pi / 4) * radius or first > 9 or not inside:
            continue
        normal_ = (uv[k] - uv[(k + 12) % 24]) / np.linalg.norm(uv[k] - uv[(k + 12) % 24])
        place = measure_edge(image.astype(float), uv[k], normal_, first, factor)
        if place is not None:
            found[k] = *(uv[k] + (place - 12) * 0.5 * factor * normal_), *normal_, 1.0
    return found


# ---- particles ----


def pose_difference(p, R, q, S):
    return np.concatenate([p - q, log(R @ S.T)])


def log_haar(d):
    square = d[3:] @ d[3:]
    return -square / 12 if square < 1e-4 else np.log(max(2 * (1 - np.cos(np.sqrt(square))) / square, 1e-6))


class Proposal:
    """Twin of `kernels.Proposal`, for one particle at a time."""

    def __init__(self, motions, peaks):
        self.motions, self.peaks = motions, peaks
        self.pairs = [(a, b) for a in range(len(motions.shift)) for b in range(len(peaks.log_mass))]
        self.gain = [P @ np.linalg.inv(Q + P) for Q, P in self._covariances()]
        self.product = [P - K @ P for K, (_, P) in zip(self.gain, self._covariances(), strict=True)]

    def _covariances(self):
        return [(self.motions.covariance[a], self.peaks.covariance[b]) for a, b in self.pairs]

    def _moved(self, a, p, R):
        shift = self.motions.shift[a]
        return p + shift[:3], exp(shift[3:]) @ R

    def score(self, p, R):
        value, difference = [], []
        for (a, b), (Q, P) in zip(self.pairs, self._covariances(), strict=True):
            d = pose_difference(*self._moved(a, p, R), self.peaks.position[b], self.peaks.rotation[b])
            log_p = np.log(self.motions.probability[a]) + self.peaks.log_mass[b]
            value.append(log_p + multivariate_normal.logpdf(d, cov=Q + P))
            difference.append(d)
        return np.array(value), np.array(difference)

    def draw(self, chosen, difference, normal_):
        b = chosen % len(self.peaks.log_mass)
        if chosen < len(self.pairs):
            x = self.gain[chosen] @ difference[chosen] + np.linalg.cholesky(self.product[chosen]) @ normal_
        else:
            x = np.linalg.cholesky(self.peaks.covariance[b]) @ normal_
        return self.peaks.position[b] + x[:3], exp(x[3:]) @ self.peaks.rotation[b]

    def log_ratio(self, base, pose, difference, responsibility, blind):
        p = 0.0
        for a, probability in enumerate(self.motions.probability):
            d = pose_difference(*self._moved(a, *base), *pose)
            p += probability * np.exp(multivariate_normal.logpdf(d, cov=self.motions.covariance[a]) - log_haar(d))
        x = [pose_difference(*pose, *peak) for peak in zip(self.peaks.position, self.peaks.rotation, strict=True)]
        k = len(x)
        fit = [multivariate_normal.logpdf(x[b] - K @ d, cov=C)
               for (_, b), K, C, d in zip(self.pairs, self.gain, self.product, difference, strict=True)]  # fmt: skip
        fit += [multivariate_normal.logpdf(x[b], cov=self.peaks.covariance[b]) for b in range(k)]
        q = sum(r * np.exp(f - log_haar(x[i % k])) for i, (r, f) in enumerate(zip(responsibility, fit, strict=True)))
        return np.log(p + self.motions.birth) - np.log((1 - blind) * q + blind * p), int(np.argmax(fit)) % k


# ---- assignment of spots ----


def frame(a, b):
    s = (a + b) / np.linalg.norm(a + b)
    d = a - b - ((a - b) @ s) * s
    return np.stack([s, d / np.linalg.norm(d), np.cross(s, d / np.linalg.norm(d))], axis=1)


def overlap(a, b, gap):
    if gap >= a + b or gap <= abs(a - b):
        return 0.0 if gap >= a + b else np.pi * min(a, b) ** 2
    u = (gap * gap + a * a - b * b) / (2 * gap)
    v = gap - u
    return a * a * np.arccos(u / a) - u * np.sqrt(a * a - u * u) + b * b * np.arccos(v / b) - v * np.sqrt(b * b - v * v)


def poses_of_two(q, area, n, angle):
    """Yield scale, centre and rotation from two spots of two discs."""
    d = q[1] - q[0]
    gap, chord = d @ d, 2.0 - 2.0 * n[0] @ n[1]
    whole = area / (np.pi * angle**2)
    square = (gap + np.sqrt(gap**2 + 4 * chord * (whole[0] - whole[1]) ** 2)) / (2 * chord)
    if np.any(whole / square > 1.25):
        return
    za, zb = np.minimum(whole / square, 0.999)
    scale, length = np.sqrt(square), np.sqrt(gap / square)
    u = d / np.sqrt(gap)
    along = (za**2 - zb**2 - length**2) / (2 * length)
    aside = np.sqrt(max(1 - za**2 - along**2, 0.0))
    for sign in (1, -1):
        at = along * u + sign * aside * np.array([-u[1], u[0]])
        a, b = np.array([*at, -za]), np.array([*(at + length * u), -zb])
        yield scale, q[0] - scale * at, frame(a, b) @ frame(*n).T


def poses_of_three(q, area, n, angle, tolerance):
    """Yield scale, centre and rotation from three spots of three discs: two singular values of one size."""
    D, B = (q[1:] - q[0]).T, (n[1:] - n[0]).T
    if np.linalg.det(B.T @ B) < 1e-3:
        return
    M = D @ np.linalg.pinv(B)
    U, (scale, small), _ = np.linalg.svd(M, full_matrices=False)
    if np.any(area > 1.6 * np.pi * (scale * angle) ** 2 + 9 * tolerance**2):
        return
    normal_ = np.cross(*B.T) / np.linalg.norm(np.cross(*B.T))
    for sign in (1, -1):
        rows = (M + sign * np.sqrt(scale**2 - small**2) * np.outer(U[:, 1], normal_)) / scale
        R = np.stack([*rows, np.cross(*rows)])
        if np.all(n @ R[2] < -0.05):
            yield scale, q[0] - scale * rows @ n[0], R


def score(scale, centre, R, q, spots, near, discs, glare, tolerance):
    found, expected_area, count, used = 0.0, 0.0, 0, set()
    for *n, angle, colour in discs:
        x, y, z = R @ np.array(n) * [1, 1, -1]
        if z < 0:
            continue
        at, inside = centre + scale * np.array([x, y]), (scale * angle) ** 2
        expected = np.pi * inside * z
        hidden = [overlap(np.sqrt(expected / np.pi), g[2], np.linalg.norm(g[:2] - at)) for g in glare]
        shown = max(expected - sum(hidden), 0.0)
        expected_area += shown * (z > 0.25)
        u = (at - centre) / max(np.linalg.norm(at - centre), 1e-9)
        for s in near:
            d, area = q[s] - at, spots[s, 2]
            across, aside = d @ u / max(z, 0.25), d[1] * u[0] - d[0] * u[1]
            part = area < expected and across**2 + aside**2 < inside
            if spots[s, 3] == colour and (part or d @ d < (0.15 * scale + tolerance) ** 2):
                used.add(s)
                if z > 0.25:
                    found += shown * min(area / max(shown, 1e-12), expected / area, 1.0)
                    count += 1
                break
    other = [s for s in near if s not in used and np.sum((q[s] - centre) ** 2) < (0.9 * scale) ** 2]
    expected_area += np.sum(spots[other, 2])
    return (found / expected_area if expected_area > 0 else 0.0), count


def assign_spots(spots, discs, glare, limits, min_score):
    """Twin of `kernels.assign_spots` without bounds on the work: rows of score, centre and rotation, the best first."""
    low, high, tolerance = limits
    rows, opposite = [], discs[:, :3] @ discs[:, :3].T < -0.9
    rays, shown = (np.column_stack([s[:, :2], np.ones(len(s))]) for s in (spots, glare))
    for first in range(len(spots)):
        B = ray_basis(rays[first])
        B[:, 0] = np.array([1.0, 0.0, -spots[first, 0]]) / np.hypot(1.0, spots[first, 0])
        B[:, 1] = np.cross(B[:, 2], B[:, 0])
        q = (rays @ B)[:, :2] / (rays @ B)[:, 2:]
        glare_q = np.column_stack([(shown @ B)[:, :2] / (shown @ B)[:, 2:], glare[:, 2]])
        gap = np.sum(q**2, axis=1)
        near = np.argsort(gap, kind="stable")[:9]
        groups = [(first, s) for s in near[1:] if s > first and gap[s] < 4 * high**2]
        groups += [(first, a, b) for a, b in combinations(near[1:], 2)
                   if gap[b] <= 4 * high**2 and not (a < first and b < first)]  # fmt: skip
        for s in groups:
            for d in permutations(range(len(discs)), len(s)):
                if np.any(discs[list(d), 4] != spots[list(s), 3]) or np.any(opposite[np.ix_(d, d)]):
                    continue
                arguments = q[list(s)], spots[list(s), 2], discs[list(d), :3], discs[list(d), 3]
                made = poses_of_two(*arguments) if len(s) == 2 else poses_of_three(*arguments, tolerance)
                for scale, centre, R in made:
                    if low < scale < high:
                        part, count = score(scale, centre, R, q, spots, near, discs, glare_q, tolerance)
                        if part >= min_score:
                            rows.append([part * count, *(B @ [*centre, 1.0] / scale), *(B @ R).ravel()])
    return np.array(sorted(rows, key=lambda row: -row[0])).reshape(-1, 13)
