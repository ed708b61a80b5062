"""The contract of a tracker: `Frame` in, `Step` out: the next state, an estimate with its covariance, and events."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import SourceError
from spheremouse.geometry import Array

if TYPE_CHECKING:
    from spheremouse.geometry.camera import InteriorOrientation

S = TypeVar("S")
_SAMPLED_ROWS = 32  # a disc of 15 px crosses one at 480 rows
# of a picture in a row, as of 10 Hz in a stream of 30; more show, without noise, a body that stopped
MAX_REPEATS = 2
NO_STATISTICS: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Frame:
    """An image and the time of its exposure."""

    image: NDArray[np.uint8]  # (h, w, 3) BGR or (h, w) grey
    stamp: float  # s, mid-exposure of the middle row, on the source's own clock
    sequence: int  # counts every frame the source produced, so that a gap shows
    camera: int = 0  # number of the camera, of several that see the body


def check_size(frame: Frame, camera: "InteriorOrientation") -> None:
    """Raise SourceError if a frame has another size than the calibration of the camera."""
    height, width = frame.image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise SourceError(
            f"frame {frame.sequence} is {width}x{height}, the camera was calibrated at {camera.width}x{camera.height}: "
            "set the camera to that mode, or give the calibration of this one (--camera)"
        )


def sampled_rows(image: NDArray[np.uint8]) -> bytes:
    """Return rows of an image that differ, by their noise alone, from those of any other exposure."""
    step = max(1, len(image) // _SAMPLED_ROWS)
    return image[step // 2 :: step].tobytes()


class Status(StrEnum):
    """Phase of tracking."""

    SEARCHING = "searching"  # not seen yet
    TRACKING = "tracking"
    LOST = "lost"


class Estimate(NamedTuple):
    """State of the tracked body at one frame, in the tracker's still axes: `obj` of the ball in its frame, else `cam`.

    The increment counts from the last confirmed estimate. It is zero, without an error, if this frame is not confirmed,
    and when a lost ball is found: motion that no frame shows is in no increment.
    """

    stamp: float  # s, mid-exposure
    sequence: int  # frames since the tracker began
    status: Status
    rotation: Array  # (3, 3) R_obj_ball or R_cam_ball
    position: Array  # (3,) m; zero for the ball in its frame
    rate: Array  # (6,) rad/s and m/s
    covariance: Array  # (12, 12) of the rotation error e, exp(e) @ rotation, of position and of rate
    increment: Array  # (6,) rotation vector, rad, and shift, m, since the last confirmed estimate
    increment_covariance: Array  # (6, 6)
    confirmed: bool  # this frame supports it; otherwise it is a prediction
    statistics: Mapping[str, float] = NO_STATISTICS  # of the frame; `ball.state.statistics` lists those of the ball


def unknown(stamp: float, sequence: int = 0, status: Status = Status.SEARCHING) -> Estimate:
    """Return an estimate of a body of which no frame has shown anything."""
    zero, covariance = np.zeros(6), np.zeros((12, 12))
    return Estimate(
        stamp, sequence, status, np.eye(3), zero[:3], zero, covariance, zero, covariance[:6, :6], confirmed=False
    )


@dataclass(frozen=True, slots=True)
class Event:
    """A change with a frame, as data; `session.messages` has the words."""

    @property
    def name(self) -> str:
        """Name for programs: that of the class in small letters with hyphens, for example ball-lost."""
        return "".join(f"-{c.lower()}" if c.isupper() else c for c in type(self).__name__).lstrip("-")


class Step(NamedTuple, Generic[S]):
    """Result of one frame."""

    state: S
    estimate: Estimate
    events: tuple[Event, ...] = ()
