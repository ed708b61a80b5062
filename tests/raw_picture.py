"""A raw frame for tests of what takes frames: in place of a camera's buffer."""

from typing import Any

import numpy as np

from spheremouse.capture import Payload
from spheremouse.tracker import Frame


def payload_of(image: Any) -> Payload:
    """The bytes of a picture, as a camera would send them: (h, w) grey or (h, w, 3) BGR."""
    height, width = image.shape[:2]
    return Payload("grey" if image.ndim == 2 else "bgr", width, height, np.ascontiguousarray(image).reshape(-1).data)


class RawPicture:
    """A picture in colour and in grey, or an error. It counts how it was used."""

    def __init__(self, colour: Any, grey: Any, stamp: float, sequence: int, error: Exception | None = None) -> None:
        self.images, self._error = (grey, colour), error
        self.stamp, self.sequence = stamp, sequence
        self.asked, self.copied, self.released = list[bool](), 0, 0  # colour or not; payloads; releases

    def frame(self, colour: bool) -> Frame:
        self.asked.append(colour)
        if self._error is not None:
            raise self._error
        return Frame(self.images[colour], self.stamp, self.sequence)

    def payload(self) -> Payload:
        if self._error is not None:
            raise self._error
        self.copied += 1
        return payload_of(self.images[0])

    def release(self) -> None:
        self.released += 1
