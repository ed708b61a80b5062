"""Grey pictures of a ball with discs, cast ray by ray, and what a detector found of them: nothing of it is tested here.

`CLEAN` shows `DISCS` at `TRUTH` to the rig `RIG` from `POSE`.
"""

import cv2
import numpy as np
from ball_world import POSE, RIG

FINE = 8  # samples per pixel and axis
BALL, INK, ROOM = 190.0, 30.0, 90.0


def spread(n, seed, least=0.25, axis=(0.0, 0.0, 1.0), widest=1.0):
    """Directions within `widest` rad of the axis, no two nearer than `least`."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        if d @ np.array(axis) > np.cos(widest) and all(d @ other < np.cos(least) for other in found):
            found.append(d)
    return np.array(found)


def directions_of(u, v, rig, pose):
    """Where the rays of pixels meet the ball, nan where they miss: distortion undone by iteration, and a quadratic."""
    c = rig.camera
    k1, k2, p1, p2, k3 = c.distortion
    target = np.stack([(np.ravel(u) - c.cx) / c.fx, (np.ravel(v) - c.cy) / c.fy], axis=1)
    xy = target
    for _ in range(25 if np.any(c.distortion) else 0):
        x, y = xy.T
        r2 = x * x + y * y
        shift = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=1)
        xy = (target - shift) / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))[:, None]
    ray = np.column_stack([xy, np.ones(len(xy))]) @ pose.rotation.T
    o = pose.position - rig.ball.centre
    a, b = np.einsum("ij,ij->i", ray, ray), ray @ o
    with np.errstate(invalid="ignore"):
        s = -(b + np.sqrt(b * b - a * (o @ o - rig.ball.radius**2))) / a
    return (o + s[:, None] * ray) / rig.ball.radius


def looking_at(target, position):
    """R_obj_cam of a camera at `position` that looks at `target`, a little rolled."""
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0.3, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def to_image(points, rig, pose):
    R = pose.rotation.T
    points = np.asarray(points, dtype=float).reshape(-1, 1, 3)
    if len(points) == 0:
        return np.zeros((0, 2))
    camera = rig.camera
    return cv2.projectPoints(points, cv2.Rodrigues(R)[0], -R @ pose.position, camera.matrix, camera.distortion)[0][:, 0]


def polygon_moments(p):
    """Area and centroid of a closed polygon, (n, 2) px."""
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return abs(cross.sum()) / 2.0, ((p + q) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())


def centre_of(directions, rig, pose):
    return to_image(rig.ball.centre + rig.ball.radius * directions, rig, pose)


def ray_cast(directions, rig=RIG, pose=POSE, *, ball=BALL, ink=INK, blur=0.4):
    """Grey picture, (h, w) float: flat ball, discs by the share of each pixel's rays that meet them, a lens' blur."""
    h, w = rig.camera.height, rig.camera.width
    v, u = np.mgrid[:h, :w]
    on_ball = np.isfinite(directions_of(u, v, rig, pose)[:, 0]).reshape(h, w)
    image = np.where(on_ball, ball, ROOM)
    sub = (np.arange(FINE) + 0.5) / FINE - 0.5
    least = np.cos(rig.disc_radius / rig.ball.radius)
    for d, c in zip(directions, centre_of(directions, rig, pose), strict=True):
        reach = int(1.5 * rig.disc_radius * rig.camera.fx / (pose.position[2] - rig.ball.radius)) + 3
        x0, y0 = (int(max(round(float(x)) - reach, 0)) for x in c)
        x1, y1 = min(int(c[0]) + reach + 2, w), min(int(c[1]) + reach + 2, h)
        if x1 <= x0 or y1 <= y0:
            continue
        x, y = (np.arange(x0, x1)[:, None] + sub).ravel(), (np.arange(y0, y1)[:, None] + sub).ravel()
        p = directions_of(*np.meshgrid(x, y), rig, pose)
        with np.errstate(invalid="ignore"):
            cover = (p @ d > least).reshape(y1 - y0, FINE, x1 - x0, FINE).mean(axis=(1, 3))
        image[y0:y1, x0:x1] += cover * (ink - ball)
    return cv2.GaussianBlur(image, (0, 0), blur) if blur else image


def photo(image, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(image + noise * rng.normal(size=image.shape)), 0, 255).astype(np.uint8)


def match(seen, truth, within=3.0):
    """Pairs (index into detections, index into truth)."""
    if len(seen) == 0:
        return np.zeros((0, 2), dtype=int)
    d = np.linalg.norm(seen.centre[:, None] - truth[None], axis=2)
    return np.array([(i, d[i].argmin()) for i in range(len(seen)) if d[i].min() < within], dtype=int).reshape(-1, 2)


def errors(seen, truth):
    i, j = match(seen, truth).T
    return seen.centre[i] - truth[j]


def nees(seen, truth, within=3.0):
    """Squared Mahalanobis distances, (n,), of the detections that match."""
    i, j = match(seen, truth, within).T
    e = seen.centre[i] - truth[j]
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(seen.covariance[i]), e)


DISCS = spread(14, 1)
TRUTH = centre_of(DISCS, RIG, POSE)
CLEAN = ray_cast(DISCS)
