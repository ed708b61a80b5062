"""Edges of the picture across the ball's predicted outline, and their likelihood. They measure the distance.

The outlook of Grzonka 2005 (section 5.2) proposes ring outlines, because the distance from the discs was wrong by up to
40 cm. The ball's outline is the largest ring. At directions around the ball, the search goes across the outline for the
step from the ball's colour to the background.
"""

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.wand.model import Model
from spheremouse.wand.rims import Image

DIRECTIONS = 24  # around the outline; every four pixels of a ball 50 px across


def measure_edges(image: Image, position: Array, rotation: Array, discs: Array, model: Model, factor: int) -> Array:
    """Return edges across the outline of a ball, (24, 5): u, v px, outward normal in the picture, 1 for a found one.

    The pose is (3,) m in cam and R_cam_ball (3, 3). `discs` (m, 4) are directions in `ball` and angular radii; the
    search stays clear of their rims. One step of the search is `factor` px.
    """
    return kernels.measure_edges(image, position, rotation, discs, model.kernel, factor)


def log_likelihood(position: Array, which: NDArray[np.int64], edges: Array, model: Model, factor: int) -> Array:
    """Return the log-likelihood ratios, (n,), of the edges `edges[which]`, (24, 5), for balls at (n, 3) m."""
    return kernels.outline_log_likelihood(position, which, edges, model.kernel, factor)
