"""The contract of a tracker: pictures with their times in, motion with its covariance and events out."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import SourceError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array

S = TypeVar("S")


@dataclass(frozen=True, slots=True)
class Frame:
    """A picture and when it was taken."""

    image: NDArray[np.uint8]  # (h, w, 3) BGR or (h, w) grey
    stamp: float  # s, mid-exposure of the middle row, on the source's own clock
    sequence: int  # counts every frame the source produced, so that a gap shows


def check_size(frame: Frame, camera: InteriorOrientation) -> None:
    """Raise SourceError where a frame has another size than the camera was calibrated for."""
    height, width = frame.image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise SourceError(
            f"frame {frame.sequence} is {width}x{height}, the camera was calibrated at {camera.width}x{camera.height}: "
            "set the camera to that mode, or give the calibration of this one (--camera)"
        )


class Motion(NamedTuple):
    """What a frame adds, in the tracker's still axes: `obj` of the ball in its frame, `cam` of one in a hand.

    It counts from the last motion that was confirmed. Where a ball that was lost is found again it counts from there,
    rotation and shift are zero without an error: what the ball did unseen is in no motion.
    """

    stamp: float  # s
    rotation: Array  # (3,) rad, rotation vector since then
    shift: Array  # (3,) m; zero for the ball in its frame
    rate: Array  # (6,) rad/s and m/s
    covariance: Array  # (12, 12) of rotation, shift, rate
    confirmed: bool  # this picture bears it out: the rate may be carried on


def no_motion(stamp: float) -> Motion:
    """Nothing that a picture bears out."""
    return Motion(stamp, np.zeros(3), np.zeros(3), np.zeros(6), np.zeros((12, 12)), confirmed=False)


class Status(StrEnum):
    """What a tracker knows of its ball."""

    SEARCHING = "searching"  # not seen yet
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Event:
    """What has changed with a frame, as data; `session.messages` has the words."""


class Step(NamedTuple, Generic[S]):
    """What a tracker makes of a frame."""

    state: S
    motion: Motion
    events: tuple[Event, ...] = ()
