"""One step of the thesis' particle filter for one ball (Grzonka 2005, table 3): move at random, weigh, resample.

The setting `wand.method` chooses it with a likelihood: `product` of the thesis, `edges` that its outlook names (section
5.2), or `rims`, the core's own.
"""

from dataclasses import replace

import numpy as np
from numba import njit

from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import interpolate, log_likelihood
from spheremouse.wand.model import Model, rotate, to_pixel
from spheremouse.wand.motions import random_walk
from spheremouse.wand.particles import Particles, effective_number, mean_pose, move, normalise, resample_degenerate
from spheremouse.wand.peaks import SearchContext, covered_region, fields_near
from spheremouse.wand.published.edges import edge_distances, log_edges
from spheremouse.wand.state import Track, WandPose
from spheremouse.wand.track import acquire

_EFFECTIVE_POINTS = 20.0  # points of four visible discs
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
    moved = move(track.particles, motions, rng)
    value, match = _LIKELIHOODS[context.tracker.settings.method](moved.position, moved.rotation, context, fields)
    weight, _ = normalise(np.log(np.maximum(moved.weight, 1e-300)) + value)
    particles = Particles(moved.position, moved.rotation, weight)
    pose, count = mean_pose(particles), effective_number(weight)
    after = replace(track, particles=resample_degenerate(particles, rng), pose=pose, stamp=stamp, seen=stamp)
    return after, WandPose(context.ball.name, *pose, Status.TRACKING, None, float(weight @ match), count, True)


def _edges(position: Array, rotation: Array, context: SearchContext, fields: Fields) -> tuple[Array, Array]:
    distance, place = edge_distances(context.scene.image, covered_region(fields), fields.factor)
    return log_edges(position, rotation, context.model, distance, place)


def _product(position: Array, rotation: Array, context: SearchContext, fields: Fields) -> tuple[Array, Array]:
    return log_product(position, rotation, context.model, fields)


def _rims(position: Array, rotation: Array, context: SearchContext, fields: Fields) -> tuple[Array, Array]:
    return log_likelihood(position, rotation, context.model, fields)


_LIKELIHOODS = {"product": _product, "edges": _edges, "rims": _rims}


def log_product(position: Array, rotation: Array, model: Model, fields: Fields) -> tuple[Array, Array]:
    """Return the logarithm of the thesis' weight and the mean field of the visible points, (n,) each.

    The weight of Grzonka 2005, table 3, is the product of the fields at the five points of each disc that face the
    camera. A product over fewer points is larger, so this one is the geometric mean to the power of 20 points.
    `position` (n, 3) m and `rotation` (n, 3, 3) R_cam_ball are the poses.
    """
    value, mean = np.empty(len(position)), np.empty(len(position))
    p = model.points
    _weigh(position, rotation, p.table, p.colour, model.radius, model.lens, fields.weight, fields.place(), value, mean)
    return value, mean


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh(position, rotation, table, colour, radius, lens, weight, place, value, mean):
    """Write `log_product` to value and mean, (n,)."""
    _, field_h, field_w = weight.shape
    for n in range(len(position)):
        c, R = position[n], rotation[n]
        total, shown, number = 0.0, 0.0, 0
        for q in range(len(table)):
            if colour[q] < 0 or table[q, 6] <= 0.0:
                continue
            nx, ny, nz = rotate(R, table, q, 0)
            x, y, z = c[0] + radius * nx, c[1] + radius * ny, c[2] + radius * nz
            if z <= 0.0 or nx * x + ny * y + nz * z >= 0.0:
                continue
            u, v = to_pixel(x, y, z, lens)
            px, py = (u - place[0] + 0.5) / place[2] - 0.5, (v - place[1] + 0.5) / place[2] - 0.5
            m = 0.0
            if px >= 0.0 and py >= 0.0 and px < field_w - 1 and py < field_h - 1:
                j, i = np.int64(px), np.int64(py)
                m = interpolate(weight, colour[q], i, j, px - j, py - i)
            total += np.log(max(m, _MIN_FACTOR))
            shown += m
            number += 1
        value[n] = _EFFECTIVE_POINTS * total / number if number else _EFFECTIVE_POINTS * np.log(_MIN_FACTOR)
        mean[n] = shown / number if number else 0.0
