"""Likelihood of poses from the edges of a picture alone, which the outlook of Grzonka 2005 (section 5.2) proposes.

Edges are those of Canny (1986). The rims of the discs that face the camera and the ball's outline should lie on edges,
so the distance of their points from the nearest edge gives the likelihood of a pose, in one compiled pass.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import Region
from spheremouse.wand.likelihood import FULL_FACING
from spheremouse.wand.limb import DIRECTIONS, outline_point
from spheremouse.wand.model import Model, rotate, to_pixel
from spheremouse.wand.rims import Image

_SIGMA = 0.7  # px, of an edge: half a pixel of Canny's grid, half of lens, gloss and motion
_OUTLIER = 0.1  # fraction of the points without an edge: hidden, or without contrast
_CANNY = (32.0, 64.0)  # thresholds, Sobel: steps of 8 and 16 grey values, above the noise of a webcam
_EFFECTIVE_POINTS = 20.0  # less than all, because pixels along an edge repeat each other


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
    _weigh(position, rotation, p.table, p.colour, model.radius, model.lens, distance, place, value, fraction)
    return value, fraction


@njit(cache=True, error_model="numpy")
def _weigh(position, rotation, table, colour, radius, lens, distance, place, value, fraction):
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
