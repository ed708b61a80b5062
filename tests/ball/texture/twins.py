"""The native functions of `spheremouse.ball.texture` in NumPy, to read and to compare."""

import numpy as np

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.geometry.rotation import exp, tangent_basis

HALF, TILE = 1.1, 8
STATIC_ODDS, FACING = -3.0, 0.3


def direction_of(face, row, column, n):
    """Direction, (3,), of a cell; it has no unit length."""
    x = np.zeros(3)
    x[face // 2] = -1.0 if face % 2 else 1.0
    x[(face // 2 + 1) % 3] = (row + 0.5) * 2.0 * HALF / n - HALF
    x[(face // 2 + 2) % 3] = (column + 0.5) * 2.0 * HALF / n - HALF
    return x


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
    loose, prior, shared = errors
    b = view.anchors @ alignment.attitude.T
    E = tangent_basis(b)
    H = E.transpose(0, 2, 1) @ alignment.information @ E
    which = np.flatnonzero((b @ facing[0] > facing[1]) & (np.linalg.eigvalsh(H)[:, 1] > loose**-2))
    b, E = b[which], E[which]
    C = np.linalg.inv(H[which] + prior**-2 * np.eye(2))
    own = E @ C @ E.transpose(0, 2, 1) @ alignment.gradient[which][:, :, None]
    b = np.einsum("kij,kj->ki", exp(own[:, :, 0]), b)
    steps = 1e-5 * np.cross(E.transpose(0, 2, 1), b[:, None])
    uv = seen_at(np.stack([b[:, None] - steps, b[:, None] + steps]).reshape(-1, 3), view.rig, view.pose)
    J = np.diff(uv.reshape(2, len(b), 2, 2), axis=0)[0].transpose(0, 2, 1) / 2e-5
    covariance = J @ (C + shared**2 * np.eye(2)) @ J.transpose(0, 2, 1)
    return seen_at(b, view.rig, view.pose), covariance, which


def leave_out_doubtful(contrast, first, own, odds, change, detail):
    """Log odds of samples, once -inf for a detail that may stand still, and once for any sample that may."""
    same = (np.abs(contrast - first) < change) & (own < -STATIC_ODDS)
    return np.where(same & (np.abs(contrast) > detail), -np.inf, odds), np.where(same, -np.inf, odds)
