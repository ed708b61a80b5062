"""One step of the thesis' particle filter for one ball (Grzonka 2005, table 3): move at random, weigh, resample.

The setting `wand.method` chooses it with a likelihood: `product` of the thesis, `edges` that its outlook names (section
5.2), or `rims`, the core's own. Edges are those of Canny (1986). The rims of the discs that face the camera and the
ball's outline should lie on edges, so the distance of their points from the nearest edge gives the likelihood of a
pose.
"""

from dataclasses import replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status
from spheremouse.wand.colour import Fields, Region
from spheremouse.wand.likelihood import FULL_FACING, interpolate, log_likelihood
from spheremouse.wand.limb import DIRECTIONS, outline_point
from spheremouse.wand.model import Model, rotate, to_pixel
from spheremouse.wand.motions import random_walk
from spheremouse.wand.particles import Particles, effective_number, mean_pose, move, normalise, resample_degenerate
from spheremouse.wand.peaks import SearchContext, covered_region, fields_near
from spheremouse.wand.rims import Image
from spheremouse.wand.state import Track, WandPose
from spheremouse.wand.track import acquire

_EFFECTIVE_POINTS = (
    20.0  # points of four visible discs; less than all edges, because pixels along one repeat each other
)
_SIGMA = 0.7  # px, of an edge: half a pixel of Canny's grid, half of lens, gloss and motion
_OUTLIER = 0.1  # fraction of the points without an edge: hidden, or without contrast
_CANNY = (32.0, 64.0)  # thresholds, Sobel: steps of 8 and 16 grey values, above the noise of a webcam
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
    _weigh_product(
        position, rotation, p.table, p.colour, model.radius, model.lens, fields.weight, fields.place(), value, mean
    )
    return value, mean


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh_product(position, rotation, table, colour, radius, lens, weight, place, value, mean):
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


def edge_distances(image: Image, region: Region | None, factor: int) -> tuple[NDArray[np.float32], Array]:
    """Return distances from the nearest edge, (h, w) px of the picture reduced `factor` times, and left, top, factor.

    None for `region` is the whole picture.
    """
    h, w = image.shape[:2]
    left, top, right, bottom = region or (0, 0, w, h)
    part = image[top:bottom, left:right]
    if factor > 1:
        part = cv2.resize(part, (part.shape[1] // factor, part.shape[0] // factor), interpolation=cv2.INTER_AREA)
    found = cv2.Canny(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), *_CANNY)
    distance = cv2.distanceTransform(255 - found, cv2.DIST_L2, 5) if found.any() else np.full(found.shape, 1e3)
    return np.asarray(distance, dtype=np.float32), np.array([left, top, factor], dtype=float)


def log_edges(
    position: Array, rotation: Array, model: Model, distance: NDArray[np.float32], place: Array
) -> tuple[Array, Array]:
    """Return the log-likelihood of n poses, (n, 3) m and (n, 3, 3), and the fraction of their points on edges, (n,).

    It is the mean over the points times 20, so that a pose gains nothing by hiding points. `distance` and `place` are
    those of `edge_distances`.
    """
    value, fraction = np.empty(len(position)), np.empty(len(position))
    p = model.points
    _weigh_edges(position, rotation, p.table, p.colour, model.radius, model.lens, distance, place, value, fraction)
    return value, fraction


@njit(cache=True, error_model="numpy")
def _weigh_edges(position, rotation, table, colour, radius, lens, distance, place, value, fraction):
    for n in range(len(position)):
        c, R = position[n], rotation[n]
        total, near, number = 0.0, 0.0, 0
        for q in range(len(table) + DIRECTIONS):
            if q < len(table):
                if colour[q] < 0 or table[q, 6] != 0.0:  # no rim
                    continue
                nx, ny, nz = rotate(R, table, q, 0)
                x, y, z = c[0] + radius * nx, c[1] + radius * ny, c[2] + radius * nz
                if z <= 0.0 or nx * x + ny * y + nz * z > -FULL_FACING * np.sqrt(x * x + y * y + z * z):
                    continue
                u, v = to_pixel(x, y, z, lens)
            else:
                if c[2] <= radius:
                    continue
                u, v, _, _, _ = outline_point(c, radius, lens, q - len(table))
            j = np.int64(np.floor((u - place[0] + 0.5) / place[2]))
            i = np.int64(np.floor((v - place[1] + 0.5) / place[2]))
            number += 1
            fit = 0.0
            if 0 <= i < distance.shape[0] and 0 <= j < distance.shape[1]:
                d = distance[i, j] / _SIGMA
                fit = np.exp(-0.5 * d * d)
            total += np.log((1.0 - _OUTLIER) * fit + _OUTLIER)
            near += fit
        value[n] = _EFFECTIVE_POINTS * total / number if number else _EFFECTIVE_POINTS * np.log(_OUTLIER)
        fraction[n] = near / number if number else 0.0
