"""What a tracker takes and gives: a picture with its time, and the motion that it adds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Frame:
    """A picture and when it was taken."""

    image: NDArray[np.uint8]  # (h, w, 3) BGR or (h, w) grey
    stamp: float  # s, mid-exposure of the middle row, on the source's own clock
    sequence: int  # counts every frame the source produced, so that a gap shows


@dataclass(frozen=True, slots=True)
class Motion:
    """What one frame adds."""

    stamp: float  # s
    counts: tuple[int, int, int]  # x, y and third axis
    rotation: Array  # (3,) rad, rotation vector in obj since the last motion
    rate: Array  # (3,) rad/s, w_obj
