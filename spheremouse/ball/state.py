"""What tracking carries from frame to frame."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol

import numpy as np

from spheremouse.ball.camera_watch import Watch
from spheremouse.ball.detect.detections import Detections, Image, no_detections
from spheremouse.ball.detect.lookalikes import Lookalikes
from spheremouse.ball.detect.search import Hunt
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters import Filter, FilterState
from spheremouse.ball.filters.so3_state import So3State, to_map
from spheremouse.ball.points import SpherePoints, intersect
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.output.counts import Remainder
from spheremouse.tracker import Frame, Motion

_SURE = 10  # sightings from which a disc is worth keeping


class Detector(Protocol):
    """What finds discs."""

    def detect(self, image: Image) -> Detections:
        """Disc candidates in an image (h, w, 3) BGR or (h, w)."""
        ...


class Phase(StrEnum):
    """What the tracker knows."""

    SEARCHING = "searching"  # no disc seen yet
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Tracker:
    """What stays the same from frame to frame: device, camera pose, stages with their settings."""

    settings: Settings
    rig: Rig
    pose: Pose
    detector: Detector
    filter: Filter[Any]
    counts: Array  # (3, 3) counts per radian


@dataclass(frozen=True, slots=True)
class Sight:
    """What one frame showed, and the attitude it was taken for."""

    stamp: float  # s
    detections: Detections
    points: SpherePoints
    attitude: Array  # (3, 3) R_obj_ball

    @property
    def centre(self) -> Array:
        """(n, 2) px of the points."""
        return self.detections.centre[self.points.index]


@dataclass(frozen=True, slots=True)
class TrackState:
    """What one frame hands to the next."""

    phase: Phase
    event: str  # what changed with this frame, in words; empty where nothing did
    filter: FilterState
    lookalikes: Lookalikes
    remainder: Remainder
    sent: Array  # (3, 3) attitude at the last motion
    held: float  # s, stamp of the last frame whose discs held the attitude
    found: float | None  # s, since when discs are in view again while lost
    moved: bool  # the ball has been seen to turn: look-alikes are told from discs
    recent: tuple[Sight, ...]  # frames since the ball was seen, while not `moved`
    hunt: Hunt  # for discs that are not on the map yet
    holds: bool  # the last frame's discs hold the attitude
    saved: bool  # a map made earlier is to be recognised first
    absolute: bool  # the attitude is that of a map made earlier
    detections: Detections  # all of the last frame
    points: SpherePoints  # of the last frame, look-alikes left out; filter.used indexes these
    watch: Watch | None = None  # on the targets: does the camera stand?
    rebuilt: Tracker | None = None  # for the pose found after the camera was moved; None: it never was
    off: int = 0  # frames in a row that show the ball's centre off its place
    lifted: float | None = None  # s, since when the ball is lost for that
    misfit: float = 0.0  # mean chi-square per degree of freedom of the discs' places about the centre
    out_of_round: bool = False  # that was too much, and is said
    fitted: float = 0.0  # rad the ball has turned about its centre, since it last did not
    readout_told: bool = False  # play has shown what the rolling shutter takes, and it is said


def current(state: TrackState, tracker: Tracker) -> Tracker:
    """The tracker in use: the one given, or the one rebuilt since, when the camera was moved."""
    return tracker if state.rebuilt is None else state.rebuilt


def disc_map(state: TrackState) -> DiscMap | None:
    """What is worth keeping of the discs on the ball; None while fewer than four are sure, or for another tracker."""
    return to_map(state.filter, _SURE) if isinstance(state.filter, So3State) and not state.saved else None


def unused(filter_state: Any) -> Any:
    return replace(filter_state, used=np.zeros(0, dtype=np.intp))


def tracking(state: TrackState, filtered: FilterState, sent: Array, stamp: float) -> TrackState:
    """Tracking from this frame on, by a filter just found or begun; motion counts from the attitude `sent`."""
    return replace(state, filter=filtered, phase=Phase.TRACKING, sent=sent, held=stamp, holds=True, found=None)


def forget(lookalikes: Lookalikes) -> Lookalikes:
    """Masks stay; candidates followed under another attitude go."""
    return Lookalikes(masks=lookalikes.masks, mask_seen=lookalikes.mask_seen)


def no_motion(stamp: float) -> Motion:
    return Motion(stamp, (0, 0, 0), np.zeros(3), np.zeros(3))


def no_points(tracker: Tracker) -> SpherePoints:
    return intersect(no_detections(), tracker.rig, tracker.pose)


@dataclass(frozen=True, slots=True)
class Epoch:
    """One tracked frame."""

    frame: Frame
    state: TrackState
    motion: Motion
    seconds: dict[str, float]  # wall time per stage: detect, filter

    @property
    def used(self) -> Array:
        """(k, 2) px, centres of the discs that took part in the filter's update."""
        return self.state.detections.centre[self.state.points.index[self.state.filter.used]]
