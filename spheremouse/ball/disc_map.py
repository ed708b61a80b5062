"""The map of a ball: directions of its discs in `ball` with their joint covariance, as a tracker has built it.

What lasts longer than a run: kept beside the rig, it makes the next run's attitude absolute from its first frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.projection import GREY, Projection
from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class DiscMap:
    """Discs known on a ball."""

    directions: Array  # (m, 3) unit vectors, ball
    covariance: Array  # (2m, 2m) rad², of errors along rotation.tangent_basis(directions)
    sightings: NDArray[np.intp]  # (m,) frames in which each was seen
    projection: Projection = GREY  # of colours, in which the discs are darker than the ball

    def __len__(self) -> int:
        return len(self.directions)
