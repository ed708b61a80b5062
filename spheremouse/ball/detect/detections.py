"""Result of a disc detector."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.matching import distances
from spheremouse.geometry.rotation import Array

Image = NDArray[Any]  # (h, w, 3) BGR or (h, w), uint8; Any because OpenCV's stubs name no type


@dataclass(frozen=True, slots=True)
class Detections:
    """Disc candidates in one image."""

    centre: Array  # (n, 2) px, the disc's centre in the (distorted) image
    covariance: Array  # (n, 2, 2) px²
    area: Array  # (n,) px²

    def __len__(self) -> int:
        return len(self.centre)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> "Detections":
        """Return the entries of a mask (n,) or of indices (k,), in that order."""
        index = np.flatnonzero(keep) if keep.dtype == bool else keep
        return Detections(self.centre[index], self.covariance[index], self.area[index])

    def joined(self, other: "Detections") -> "Detections":
        """Return the entries of both."""
        if len(other) == 0:
            return self
        return Detections(
            np.concatenate([self.centre, other.centre]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.area, other.area]),
        )

    def joined_apart(self, other: "Detections", distance: float) -> "Detections":
        """Return the entries, and those of `other` that are `distance` px or more from each of them."""
        gap = distances(other.centre, self.centre).min(axis=1, initial=np.inf)
        return self.joined(other.take(gap >= distance))


def no_detections() -> Detections:
    """An empty set."""
    return Detections(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))
