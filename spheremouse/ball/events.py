"""Events of the ball's tracker, as data."""

from dataclasses import dataclass
from enum import StrEnum

from spheremouse.tracker import Event


class Why(StrEnum):
    """Reason of a loss."""

    UNSEEN = "unseen"  # no disc confirms where it should be
    GAP = "gap"  # no frame came
    OFF_CENTRE = "off-centre"  # it does not turn about its centre
    CAMERA = "camera"  # the camera was moved, and its pose is not found


class Doubt(StrEnum):
    """Reason for a frame that does not confirm the attitude of a tracked ball."""

    NO_DISC = "no disc"  # none is seen
    UNKNOWN = "unknown"  # none of those seen is where a disc of the map should be
    ONE_DISC = "one disc"  # the rotation about it is free
    UNCERTAIN = "uncertain"  # chance explains the matches, or the rate is one that no hand gives
    SEVERAL = "several"  # more than one attitude explains the discs in view
    CAMERA = "camera"  # the camera is moving


@dataclass(frozen=True, slots=True)
class Found(Event):
    """Tracking begins, with so many discs in view."""

    discs: int


@dataclass(frozen=True, slots=True)
class Turned(Event):
    """The ball's first rotation separates discs from look-alikes; `masked` is the number of masked look-alikes."""

    masked: int


@dataclass(frozen=True, slots=True)
class Recognised(Event):
    """The attitude is found by so many discs of the map: one that was saved, or that of a ball that was lost."""

    discs: int
    saved: bool = False
    older: bool = False  # the map before the last new one


@dataclass(frozen=True, slots=True)
class BallLost(Event):
    """Nothing is sent until the ball is found again."""

    why: Why
    figure: float = 0.0  # s without a confirmation or a frame; m, or radii, off the centre
    discs: int = 0  # in view
    radii: bool = False  # the figure counts in radii


@dataclass(frozen=True, slots=True)
class MotionWithheld(Event):
    """The ball is tracked, but no frame confirms its attitude: motion is sent once one does."""

    doubt: Doubt


@dataclass(frozen=True, slots=True)
class MotionReleased(Event):
    """A frame confirms the attitude again: the motion that was withheld is sent from now on."""

    seconds: float  # since the last confirmation
    angle: float  # rad that the ball has turned since then


@dataclass(frozen=True, slots=True)
class NewMap(Event):
    """A new map begins at the last attitude of a lost ball, or in place of a saved map."""

    saved: bool = False


@dataclass(frozen=True, slots=True)
class OutOfRound(Event):
    """The discs do not fit a ball that turns about its centre, though it is followed."""


@dataclass(frozen=True, slots=True)
class WrongSize(Event):
    """The ball's outline does not have the size that the rig gives it."""

    error: float  # relative, of the radius: above zero for a larger ball


@dataclass(frozen=True, slots=True)
class ReadoutKnown(Event):
    """Play has shown how long the rolling shutter takes for all rows."""

    readout: float  # s


@dataclass(frozen=True, slots=True)
class DiscColours(Event):
    """Another colour projection separates the discs from the ball."""

    weights: tuple[float, float, float]  # of blue, green and red: in that sum the discs are darker


@dataclass(frozen=True, slots=True)
class AxisUnseen(Event):
    """The pattern shows no rotation about one axis, or shows it again."""

    ended: bool = False


@dataclass(frozen=True, slots=True)
class PatternRepeats(Event):
    """The ball looks the same at several attitudes, so a lost one is not recognised."""


@dataclass(frozen=True, slots=True)
class CameraMoved(Event):
    """The camera has a new pose."""

    path: float  # m
    turn: float  # rad
    asked: bool = False  # on demand: it need not have moved


@dataclass(frozen=True, slots=True)
class TargetsHidden(Event):
    """The ball is lost while the targets are out of sight, so the camera may have moved."""


OF_CAMERA = (ReadoutKnown, DiscColours, CameraMoved, TargetsHidden, WrongSize)  # which concern one camera, of several
