"""One picture with its time: what every source gives and every detector takes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Frame:
    """A picture and when it was taken."""

    image: NDArray[np.uint8]  # (h, w, 3) BGR or (h, w) grey
    stamp: float  # s, mid-exposure of the middle row, on the source's own clock
    sequence: int  # counts every frame the source produced, so that a gap shows
