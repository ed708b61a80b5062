"""Frames to read several times: a recording that is opened again, or a live camera's frames in memory."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from spheremouse.capture import open_source, section
from spheremouse.errors import SourceError
from spheremouse.tracker import Frame

Footage = Callable[[float | None], Iterator[Frame]]  # frames of the first seconds, or all, any number of times

_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # quick, and half the size
_COLOUR_EVERY = 0.25  # s
_MAX_BYTES = 1_500_000_000  # in memory


def footage_of(source: str, at_most: float | None) -> Footage:
    """Return the first seconds of a source, or all, which is opened for each reading."""

    def frames(seconds: float | None) -> Iterator[Frame]:
        with open_source(source) as given:
            yield from section(given, 0.0, min((s for s in (seconds, at_most) if s is not None), default=math.inf))

    return frames


@dataclass(slots=True)
class FrameBuffer:
    """Frames of a live camera in memory, without loss; grey but for some in colour, which targets need."""

    stored: list[tuple[bytes, float, int]] = field(default_factory=list)  # PNG, stamp (s), sequence
    size: int = 0  # bytes
    coloured: float = -np.inf  # s, stamp of the last in colour

    def append(self, frame: Frame) -> None:
        """Store a frame; SourceError if memory is full."""
        image = frame.image
        if image.ndim == 3 and frame.stamp - self.coloured >= _COLOUR_EVERY:
            self.coloured = frame.stamp
        elif image.ndim == 3:
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        data = cv2.imencode(".png", image, _PNG)[1].tobytes()
        self.size += len(data)
        if self.size > _MAX_BYTES:
            raise SourceError("the pictures fill the memory: take a smaller mode of the camera, or fewer --seconds")
        self.stored.append((data, frame.stamp, frame.sequence))

    def frames(self, seconds: float | None) -> Iterator[Frame]:
        """Yield the frames of the first seconds, or all."""
        decoded = (
            Frame(np.asarray(cv2.imdecode(np.frombuffer(d, np.uint8), cv2.IMREAD_UNCHANGED), np.uint8), stamp, number)
            for d, stamp, number in self.stored
        )
        yield from section(decoded, 0.0, math.inf if seconds is None else seconds)
