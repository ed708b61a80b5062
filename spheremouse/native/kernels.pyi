"""A wrong type, shape or order of an array raises TypeError with the argument's name."""

import numpy as np
from numpy.typing import NDArray

_Float = NDArray[np.float64]
_Index = NDArray[np.int64]
_Byte = NDArray[np.uint8]

# spheremouse/wand/colour.cpp

def select_colours(image: _Byte, bounds: NDArray[np.float32]) -> tuple[_Byte, _Index, _Byte, int]:
    """Select the pixels of a BGR picture, (h, w, 3), within the bounds of each colour, (c, 6).

    Return binary pictures, (c, h, w) of 255 or 0, and their numbers of pixels, (c,). Then return a binary picture,
    (h, w), of overexposed pixels without a colour, and their number. Bounds are least and greatest hue in degrees,
    saturation from 0 to 1, and brightness from 0 to 255. A hue lies between them through 0 if the least is greater.
    """

def grow_glare(
    image: _Byte, bounds: NDArray[np.float32], distance: NDArray[np.float32], top: int, left: int, reach: float,
    pale: _Byte,
) -> None:  # fmt: skip
    """Set pixels of `pale`, (h, w), to 255 within `reach` px of an overexposed spot, and connected pale print.

    `distance`, (k, l) px, is that from the spot, for the pixels from `top`, `left` on. Pale print is within 8 px of the
    spot. It has the hue of a colour, and a quarter to all of its least saturation.
    """
