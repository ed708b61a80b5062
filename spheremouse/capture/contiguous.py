"""Frames as compiled code takes them: rows without gaps, in memory that may be written."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.tracker import Frame


class ContiguousBuffer:
    """A picture to copy what a camera only lends into, used again for the next frame."""

    def __init__(self) -> None:
        self._image: NDArray[np.uint8] = np.zeros(0, np.uint8)

    def __call__(self, frame: Frame) -> Frame:
        """The frame with its picture contiguous and writeable: itself where it is so already."""
        image = frame.image
        if image.flags.c_contiguous and image.flags.writeable:
            return frame
        if self._image.shape != image.shape:
            self._image = np.empty(image.shape, np.uint8)
        np.copyto(self._image, image)
        return replace(frame, image=self._image)
