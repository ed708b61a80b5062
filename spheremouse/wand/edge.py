"""How well poses of a ball agree with the edges of a picture, whatever their colours: for comparison with colours.

The outlook of Grzonka 2005 (section 5.2) names edges as another likelihood. Edges are those of Canny (1986); of a pose,
the rims of the discs that face the camera and the ball's outline should lie on them. A pose is weighed by the distance
of its points from the nearest edge, in one compiled pass.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.camera import distorted
from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import Region
from spheremouse.wand.likelihood import FULLY
from spheremouse.wand.limb import DIRECTIONS, outline
from spheremouse.wand.model import Model
from spheremouse.wand.rims import Image

_SIGMA = 0.7  # px, of an edge: half a pixel of Canny's grid, half of lens, gloss and motion
_OUTLIER = 0.1  # part of the points without an edge: hidden, or of no contrast
_WEAK, _STRONG = 32.0, 64.0  # Canny's thresholds, Sobel: steps of 8 and 16 grey values, above the noise of a webcam
_SHOWN = 20.0  # points that count: pixels along an edge repeat each other


def distances(image: Image, region: Region | None, factor: int) -> tuple[NDArray[np.float32], Array]:
    """Distance from the nearest edge, (h, w) px of the picture reduced `factor` times, and (3,): left, top, factor."""
    h, w = image.shape[:2]
    left, top, right, bottom = region or (0, 0, w, h)
    part = image[top:bottom, left:right]
    if factor > 1:
        part = cv2.resize(part, (part.shape[1] // factor, part.shape[0] // factor), interpolation=cv2.INTER_AREA)
    found = cv2.Canny(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), _WEAK, _STRONG)
    away = cv2.distanceTransform(255 - found, cv2.DIST_L2, 5) if found.any() else np.full(found.shape, 1e3)
    return np.asarray(away, dtype=np.float32), np.array([left, top, factor], dtype=float)


def on_edges(
    position: Array, rotation: Array, model: Model, away: NDArray[np.float32], place: Array
) -> tuple[Array, Array]:
    """Log-likelihood of n poses, (n, 3) m and (n, 3, 3), and the part of their points that lie on edges, (n,).

    The mean over the points, times as many as count, so that hiding points does not pay.
    """
    out, part = np.empty(len(position)), np.empty(len(position))
    p = model.points
    _weigh(position, rotation, p.table, p.colour, model.radius, model.lens, away, place, out, part)
    return out, part


@njit(cache=True, error_model="numpy")
def _weigh(position, rotation, table, colour, radius, lens, away, place, out, part):
    for n in range(len(position)):
        c, R = position[n], rotation[n]
        total, near, number = 0.0, 0.0, 0
        for q in range(len(table) + DIRECTIONS):
            if q < len(table):
                if colour[q] < 0 or table[q, 6] != 0.0:  # no rim
                    continue
                nx = R[0, 0] * table[q, 0] + R[0, 1] * table[q, 1] + R[0, 2] * table[q, 2]
                ny = R[1, 0] * table[q, 0] + R[1, 1] * table[q, 1] + R[1, 2] * table[q, 2]
                nz = R[2, 0] * table[q, 0] + R[2, 1] * table[q, 1] + R[2, 2] * table[q, 2]
                x, y, z = c[0] + radius * nx, c[1] + radius * ny, c[2] + radius * nz
                if z <= 0.0 or nx * x + ny * y + nz * z > -FULLY * np.sqrt(x * x + y * y + z * z):
                    continue
                xd, yd, _, _, _ = distorted(x / z, y / z, lens[4:])
                u, v = lens[0] * xd + lens[2], lens[1] * yd + lens[3]
            else:
                if c[2] <= radius:
                    continue
                u, v, _, _, _ = outline(c, radius, lens, q - len(table))
            j = np.int64(np.floor((u - place[0] + 0.5) / place[2]))
            i = np.int64(np.floor((v - place[1] + 0.5) / place[2]))
            number += 1
            fit = 0.0
            if 0 <= i < away.shape[0] and 0 <= j < away.shape[1]:
                d = away[i, j] / _SIGMA
                fit = np.exp(-0.5 * d * d)
            total += np.log((1.0 - _OUTLIER) * fit + _OUTLIER)
            near += fit
        out[n] = _SHOWN * total / number if number else _SHOWN * np.log(_OUTLIER)
        part[n] = near / number if number else 0.0
