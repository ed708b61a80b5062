"""Truth of a recording. Only the simulation writes it, and only the evaluation reads it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

HIDDEN, PARTLY_HIDDEN, VISIBLE = 1, 2, 3  # state of a disc on the near side of the ball


@dataclass(frozen=True, slots=True)
class Truth:
    """The ball's motion, one row per frame."""

    stamp: Array  # (n,) s
    attitude: Array  # (n, 3, 3) R_obj_ball
    rate: Array  # (n, 3) rad/s, w_obj

    def __len__(self) -> int:
        return len(self.stamp)


@dataclass(frozen=True, slots=True)
class DiscTruth:
    """Image positions of the discs: one row for each frame and disc with its centre on the near side of the ball."""

    frame: NDArray[np.intp]  # (k,) index of the frame
    disc: NDArray[np.intp]  # (k,) index of the disc
    centre: Array  # (k, 2) px, projection of the disc's centre
    blob_centre: Array  # (k, 2) px, centroid of the projected disc; nan where the limb cuts it
    area: Array  # (k,) px², of the projected disc, hidden parts included; nan where the limb cuts it
    state: NDArray[np.intp]  # (k,) VISIBLE, PARTLY_HIDDEN or HIDDEN

    def __len__(self) -> int:
        return len(self.frame)

    def of_frame(self, frame: int) -> "DiscTruth":
        """The rows of one frame."""
        keep = self.frame == frame
        return DiscTruth(*(getattr(self, name)[keep] for name in self.__slots__))
