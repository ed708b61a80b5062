"""Description of a device before its calibration: codes of the targets, sizes, axes and a few distances."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Distance:
    """A length measured with a tape between the centres of two targets."""

    start: int  # id of a target
    end: int
    metres: float
    sigma: float  # m


@dataclass(frozen=True, slots=True)
class Axes:
    """Targets that define the axes of `obj`: Y runs from `origin` to `up`, X lies in the plane with `plane`."""

    origin: int  # ids of targets
    up: int
    plane: int


@dataclass(frozen=True, slots=True)
class Device:
    """The content of device.yaml."""

    ids: tuple[int, ...]
    codes: tuple[str, ...]  # colours inside to outside, one of rig.CODES each
    target_radii: Array  # (3,) m: inner disc, middle ring, outer ring
    disc_radius: float  # m, along the ball's surface
    axes: Axes
    distances: tuple[Distance, ...] = ()  # empty: the scale is free

    @property
    def row(self) -> dict[int, int]:
        """Place of each id among the targets."""
        return {id_: i for i, id_ in enumerate(self.ids)}

    @property
    def ends(self) -> NDArray[np.intp]:
        """Rows of the targets that each distance joins, (k, 2)."""
        row = self.row
        return np.array([[row[d.start], row[d.end]] for d in self.distances], dtype=np.intp).reshape(-1, 2)


class DistanceError(CalibrationError):
    """A distance that contradicts photos and other distances; `index` is its index in Device.distances."""

    def __init__(self, device: Device, index: int, metres: float, sigmas: float | None = None) -> None:
        d = device.distances[index]
        excess = "" if sigmas is None else f", {sigmas:.0f} sigma"
        super().__init__(
            f"the distance from target {d.start} to {d.end} is {d.metres:.4g} m on the tape (sigma {1e3 * d.sigma:g} "
            f"mm), but {metres:.4f} m by the photos and the other distances ({1e3 * (metres - d.metres):+.1f} "
            f"mm{excess}): measure it again, and see that its ids, and the codes of these targets, are right"
        )
        self.index = index
