"""The native functions of `spheremouse.ball.texture` in NumPy, to read and to compare."""

import numpy as np

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.geometry.rotation import exp, tangent_basis

HALF, TILE = 1.1, 8
SMOOTH = 0.1
LEAST_WEIGHT, STATIC_ODDS, YOUNG, FAR, FACING = 0.08, -3.0, 3.0, 3.8, 0.3


def place_on(x, n):
    """Face, row and column on the cube of (n, n) cells, (k,) each, of directions (k, 3)."""
    axis = np.argmax(np.abs(x), axis=1)
    k = np.arange(len(x))
    depth = np.abs(x[k, axis])
    at = np.stack([x[k, (axis + 1) % 3], x[k, (axis + 2) % 3]], axis=1) / depth[:, None]
    row, column = ((at + HALF) * n / (2.0 * HALF) - 0.5).T
    return 2 * axis + (x[k, axis] < 0.0), row, column


def direction_of(face, row, column, n):
    """Direction, (3,), of a cell; it has no unit length."""
    x = np.zeros(3)
    x[face // 2] = -1.0 if face % 2 else 1.0
    x[(face // 2 + 1) % 3] = (row + 0.5) * 2.0 * HALF / n - HALF
    x[(face // 2 + 2) % 3] = (column + 0.5) * 2.0 * HALF / n - HALF
    return x


def look(value, weight, x):
    """Value between four cells, (k,), and the least weight of the four, at directions (k, 3)."""
    face, row, column = place_on(x, value.shape[1])
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    a, b = row - i, column - j
    corners = [(i, j, (1 - a) * (1 - b)), (i + 1, j, a * (1 - b)), (i, j + 1, (1 - a) * b), (i + 1, j + 1, a * b)]
    shown = np.sum([w * value[face, r, c] for r, c, w in corners], axis=0)
    return shown, np.min([weight[face, r, c] for r, c, _ in corners], axis=0)


def change_by_turn(value, weight, d, R, step=1e-6):
    """Change of the value by a rotation of the ball about each axis of obj, (k, 3), by central differences."""
    shown = [[look(value, weight, d @ (exp(sign * step * axis) @ R))[0] for axis in np.eye(3)] for sign in (1.0, -1.0)]
    return (np.array(shown[0]) - np.array(shown[1])).T / (2.0 * step)


def mean_by_tile(share, x, n):
    """Mean share, (k,), of the samples at directions (k, 3) that lie in the same tile of (n, n) cells."""
    face, row, column = place_on(x, n)
    tile = (face * n + row.astype(int) // TILE) * n + column.astype(int) // TILE
    return (np.bincount(tile, share) / np.maximum(np.bincount(tile), 1))[tile]


def align(contrast, d, picture, R, noise, place, pixel):
    """Attitude by the contrast of samples, (k,) at (k, 3) in obj: with scale, correlation, information, known axes."""
    value, weight = picture

    def model(R):
        shown, known = look(value, weight, d @ R)
        J = change_by_turn(value, weight, d, R)
        square = np.sum(J * J, axis=1)
        variance = noise**2 + place**2 * (1.0 + YOUNG / np.maximum(known, 1e-9)) * square
        return contrast - shown, shown, J, np.where(known < LEAST_WEIGHT, np.inf, variance)

    _, _, J, variance = model(R)
    chosen = np.isfinite(variance) & (pixel**2 * np.sum(J * J, axis=1) > noise**2)
    scale, correlation, w = 0.0, 0.0, variance
    for _ in range(30):
        z, shown, J, variance = (part[chosen] for part in model(R))
        size = np.sort(np.abs(z) / np.sqrt(variance))
        scale = max(1.4826 * size[len(size) // 2], 0.5)
        root = 1.0 / (1.0 + z**2 / variance / (FAR * scale) ** 2)
        w = (root * mean_by_tile(root**2, d[chosen] @ R, value.shape[1])) ** 2 / variance / scale**2
        dx = np.linalg.solve((J * w[:, None]).T @ J + 1e-3 * np.eye(3), (J * w[:, None]).T @ z)
        mild, c = root / variance, contrast[chosen]
        correlation = np.sum(mild * c * shown) / np.sqrt(np.sum(mild * c**2) * np.sum(mild * shown**2))
        if np.abs(dx).max() < 1e-7:
            break
        R = exp(dx) @ R
    H = (J * w[:, None]).T @ J
    across, slope = np.eye(3) - d[chosen, :, None] * d[chosen, None, :], np.sum(J * J, axis=1)
    feigned = (SMOOTH * noise**2 / look(value, weight, d[chosen] @ R)[1] + 2.0 * place**2 * slope) / pixel**2
    values, axes = np.linalg.eigh(H - 2.0 * np.einsum("k,kij->ij", w * feigned, across))
    axes = axes[:, values > 0.0]
    return R, scale, correlation, H, axes @ axes.T


def shift(contrast, d, picture, R, noise, place, pixel, camera, axes):
    """Shift of the ball's centre along axes (2, 3), in radii, and its covariance; the camera is at (3,) radii."""
    value, weight = picture

    def seen_at(offset):
        """Direction from the moved centre to the first point of the ball on each ray, by a quadratic equation."""
        ray, to = d - camera, camera - offset @ axes
        a, b, c = np.sum(ray * ray, axis=1), ray @ to, to @ to - 1.0
        return to + ((-b - np.sqrt(np.maximum(b * b - a * c, 0.0))) / a)[:, None] * ray

    offset = np.zeros(2)
    for _ in range(3):
        u = seen_at(offset)
        shown, known = look(value, weight, u @ R)
        J = change_by_turn(value, weight, u, R)
        by_shift = [
            look(value, weight, seen_at(offset + sign * 1e-6 * e) @ R)[0] for e in np.eye(2) for sign in (1, -1)
        ]
        A = np.column_stack([J, (by_shift[0] - by_shift[1]) / 2e-6, (by_shift[2] - by_shift[3]) / 2e-6])
        square = np.sum(J * J, axis=1)
        variance = noise**2 + place**2 * (1.0 + YOUNG / np.maximum(known, 1e-9)) * square
        chosen = (known >= LEAST_WEIGHT) & (pixel**2 * square > noise**2)
        z, A, variance = (contrast - shown)[chosen], A[chosen], variance[chosen]
        scale = max(1.4826 * np.median(np.abs(z) / np.sqrt(variance)), 0.5)
        root = 1.0 / (1.0 + z**2 / variance / (FAR * scale) ** 2)
        w = (root * mean_by_tile(root**2, u[chosen] @ R, value.shape[1])) ** 2 / variance / scale**2
        C = np.linalg.inv((A * w[:, None]).T @ A)
        dx = C @ (A * w[:, None]).T @ z
        R, offset = exp(dx[:3]) @ R, offset + dx[3:]
    return offset, C[3:, 3:] * max(1.0, len(z) / 6000)


def correlate(contrast, d, picture, R):
    """Correlation of samples and the nearest cells of the picture at an attitude."""
    value, weight = picture
    face, row, column = place_on(d @ R, value.shape[1])
    at = face, np.floor(row + 0.5).astype(int), np.floor(column + 0.5).astype(int)
    known = weight[at] >= LEAST_WEIGHT
    q, m = contrast[known], value[at][known]
    return q @ m / np.sqrt((q @ q) * (m @ m)) if 2 * known.sum() > len(d) else 0.0


def learn(view, seen, contrast, picture, R, most):
    """Picture after a frame at an attitude, with the contrast of its chart, every cell on its own."""
    value, weight = picture.value.astype(float).copy(), picture.weight.astype(float).copy()
    n, centre, radius = value.shape[1], view.rig.ball.centre, view.rig.ball.radius
    for face, row, column in np.ndindex(6, n, n):
        d = direction_of(face, row, column, n)
        d = R @ (d / np.linalg.norm(d))
        ray = centre + radius * d - view.pose.position
        facing = -d @ ray / np.linalg.norm(ray)
        if facing <= FACING:
            continue
        right, down, height = view.chart.axes @ d
        from_middle = np.arccos(height) / view.chart.spacing * np.array([right, down]) / np.hypot(right, down)
        x, y = from_middle + 0.5 * (view.chart.size - 1)
        i, j, q = int(y), int(x), contrast.astype(float)
        if x < 0 or y < 0 or x >= q.shape[1] - 1 or y >= q.shape[0] - 1:
            continue
        at = int(y / view.step + 0.5), int(x / view.step + 0.5)
        sample = view.number[at] if np.all(np.array(at) < view.number.shape) else -1
        if sample < 0 or seen.counts[sample] <= STATIC_ODDS:
            continue
        a, b = y - i, x - j
        now = (1 - a) * ((1 - b) * q[i, j] + b * q[i, j + 1]) + a * ((1 - b) * q[i + 1, j] + b * q[i + 1, j + 1])
        now -= seen.offset[sample]
        w, before = facing**2, weight[face, row, column]
        value[face, row, column] += (now - value[face, row, column]) * w / (before + w)
        weight[face, row, column] = min(before + w, most)
    return value, weight


def weigh(contrast, d, picture, R, before, noise, settle):
    """Mean contrast, log odds and offset of samples, (k,), after a frame at an attitude; `before` has those before."""
    (mean, odds, offset), (value, weight) = before, picture
    shown, known = look(value, weight, d @ R)
    contrast = contrast - offset
    apart, stays, turns = mean - shown, contrast - mean, contrast - shown
    nats = np.clip(0.5 * (stays**2 - turns**2) / noise**2, -3.0, 3.0)
    differ = (known > LEAST_WEIGHT) & (apart**2 > 9.0 * noise**2)
    light = offset + settle * np.clip(turns, -3.0 * noise, 3.0 * noise)
    return (
        mean + 0.2 * (contrast - mean),
        np.where(differ, np.clip(odds + nats, -12.0, 12.0), odds),
        np.where(known > LEAST_WEIGHT, light, offset),
    )


def resample(image, uv):
    """Grey values of an image, (h, w), between four pixels each, at (n, 2) inside it."""
    padded = np.pad(image.astype(float), ((0, 1), (0, 1)), mode="edge")
    (u, v), (right, down) = np.floor(uv).astype(int).T, (uv % 1.0).T
    upper = padded[v, u] + right * (padded[v, u + 1] - padded[v, u])
    lower = padded[v + 1, u] + right * (padded[v + 1, u + 1] - padded[v + 1, u])
    return upper + down * (lower - upper)


def enlarged(far, ratio):
    """Values of a coarse chart, (h, w), between its pixels on one with `ratio` times as many along each edge."""
    for _ in range(2):
        n = len(far)
        at = (np.arange(n * ratio) + 0.5) / ratio - 0.5
        far = np.array([np.interp(at, np.arange(n), column) for column in far.T])
    return far


def contrast(light, inside, far, reach):
    """Contrast of a chart: light less the mean of means over squares, over the light far around."""
    width, rows, columns = 2 * reach + 1, *light.shape
    padded, mean = np.pad(light.astype(float), 2 * reach), 0.0
    for i, j in np.ndindex(2 * width - 1, 2 * width - 1):
        share = (width - abs(i - 2 * reach)) * (width - abs(j - 2 * reach)) / width**4
        mean = mean + share * padded[i : i + rows, j : j + columns]
    return np.where(inside == 255, (light - mean) / enlarged(far, len(light) // len(far)), 0.0)


def anchor_points(view, alignment, facing, errors):
    """Places, covariances and numbers of the anchors that a frame shows, by differences."""
    loose, prior, shared, tilted = errors
    b = view.anchors @ alignment.attitude.T
    E = tangent_basis(b)
    H = E.transpose(0, 2, 1) @ alignment.information @ E
    which = np.flatnonzero((b @ facing[0] > facing[1]) & (np.linalg.eigvalsh(H)[:, 1] > loose**-2))
    in_view = np.count_nonzero(b @ facing[0] > facing[1])
    b, E, C = b[which], E[which], np.zeros((len(which), 2, 2))
    for k, own in enumerate(alignment.information[which]):
        values, axes = np.linalg.eigh(own + prior_information(E[k], prior, alignment.known))
        C3 = axes / np.maximum(values, 10.0**-2) @ axes.T
        C[k] = E[k].T @ C3 @ E[k]
        b[k] = exp(E[k] @ E[k].T @ C3 @ alignment.gradient[which[k]]) @ b[k]
    steps = 1e-5 * np.cross(E.transpose(0, 2, 1), b[:, None])
    uv = seen_at(np.stack([b[:, None] - steps, b[:, None] + steps]).reshape(-1, 3), view.rig, view.pose)
    J = np.diff(uv.reshape(2, len(b), 2, 2), axis=0)[0].transpose(0, 2, 1) / 2e-5
    common = in_view * tilted**2 * E.transpose(0, 2, 1) @ alignment.known @ E
    covariance = J @ (C + shared**2 * np.eye(2) + common) @ J.transpose(0, 2, 1)
    return seen_at(b, view.rig, view.pose), covariance, which


def prior_information(E, sigma, known):
    """Limit of the information of a rotation, `sigma` about columns of E, for a huge variance about unknown axes."""
    least = np.linalg.inv(sigma**2 * E @ E.T + 1e-10 * np.eye(3))
    values, axes = np.linalg.eigh(known)
    O = axes[:, values < 0.5]
    return least - least @ O @ np.linalg.inv(O.T @ least @ O) @ O.T @ least if O.shape[1] else least


def leave_out_doubtful(contrast, first, own, odds, change, detail):
    """Log odds of samples, once -inf for a detail that may stand still, and once for any sample that may."""
    same = (np.abs(contrast - first) < change) & (own < -STATIC_ODDS)
    return np.where(same & (np.abs(contrast) > detail), -np.inf, odds), np.where(same, -np.inf, odds)
