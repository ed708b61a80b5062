"""One step of the thesis' particle filter for one ball (Grzonka 2005, table 3): move at random, weigh, resample.

The setting `wand.method` chooses it with a likelihood: `product` of the thesis, or `rims`, the core's own.
"""

from dataclasses import replace

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation, project
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import log_likelihood
from spheremouse.wand.model import Model
from spheremouse.wand.motions import random_walk
from spheremouse.wand.particles import Particles, effective_number, mean_pose, move, normalise, resample_degenerate
from spheremouse.wand.peaks import SearchContext, fields_near
from spheremouse.wand.state import Track, WandPose
from spheremouse.wand.track import acquire

_EFFECTIVE_POINTS = 20.0  # of four visible discs
_MIN_FACTOR = 0.02  # a 5 x 5 kernel is zero 3 px from the colour: without this one hidden point makes the product zero


def follow(
    track: Track, stamp: float, context: SearchContext, search_due: bool, rng: np.random.Generator
) -> tuple[Track, WandPose]:
    """Track one ball through one frame. Without a pose, the core's search finds the ball.

    `search_due` has no effect: the thesis never searches the whole picture.
    """
    if track.phase != Status.TRACKING or track.particles is None:
        return acquire(track, stamp, context, rng)
    motions = random_walk(max(stamp - track.stamp, 1e-4), context.tracker)
    fields = fields_near(track, motions, context)
    moved_particles = move(track.particles, motions, rng)
    value, match = _LIKELIHOODS[context.tracker.settings.method](
        moved_particles.position, moved_particles.rotation, context.model, fields
    )
    weight, _ = normalise(np.log(np.maximum(moved_particles.weight, 1e-300)) + value)
    particles = Particles(moved_particles.position, moved_particles.rotation, weight)
    pose, count = mean_pose(particles), effective_number(weight)
    after = replace(track, particles=resample_degenerate(particles, rng), pose=pose, stamp=stamp, seen=stamp)
    return after, WandPose(
        context.ball.name, *pose, Status.TRACKING, event=None, match=float(weight @ match), effective=count, seen=True
    )


def log_product(position: Array, rotation: Array, model: Model, fields: Fields) -> tuple[Array, Array]:
    """Return the logarithm of the thesis' weight and the mean field of the visible points, (n,) each.

    The weight of Grzonka 2005, table 3, is the product of the fields at the five points of each disc that face the
    camera. A product over fewer points is larger, so this one is the geometric mean to the power of 20 points.
    `position` (n, 3) m and `rotation` (n, 3, 3) R_cam_ball are the poses.
    """
    inner = (model.points.colour >= 0) & (model.points.table[:, 6] > 0.0)
    normal = np.einsum("nij,pj->npi", rotation, model.points.table[inner, :3])
    place = position[:, None] + model.radius * normal
    visible = (place[..., 2] > 0.0) & (np.sum(normal * place, axis=2) < 0.0)
    fx, fy, cx, cy = model.lens[:4]
    camera = InteriorOrientation(0, 0, fx, fy, cx, cy, model.lens[4:])
    u, v = np.moveaxis(project(place.reshape(-1, 3), camera)[0].reshape(*visible.shape, 2), -1, 0)
    x, y = (u - fields.left + 0.5) / fields.factor - 0.5, (v - fields.top + 0.5) / fields.factor - 0.5
    _, h, w = fields.weight.shape
    inside = visible & (x >= 0.0) & (y >= 0.0) & (x < w - 1) & (y < h - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    j, i = x.astype(int), y.astype(int)
    a, b = x - j, y - i
    field = fields.weight[model.points.colour[inner]]
    k = np.arange(len(field))
    high, low = ((1.0 - a) * field[k, row, j] + a * field[k, row, j + 1] for row in (i, i + 1))
    m = np.where(inside, ((1.0 - b) * high + b * low) / 255.0, 0.0)
    number = np.sum(visible, axis=1)
    divisor = np.maximum(number, 1)
    total = np.sum(np.where(visible, np.log(np.maximum(m, _MIN_FACTOR)), 0.0), axis=1)
    return _EFFECTIVE_POINTS * np.where(number > 0, total / divisor, np.log(_MIN_FACTOR)), np.sum(m, axis=1) / divisor


_LIKELIHOODS = {"product": log_product, "rims": log_likelihood}
