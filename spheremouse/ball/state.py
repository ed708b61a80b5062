"""State of the tracker between frames: its phase, and the parts common to all phases."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.camera_watch import CameraMonitor
from spheremouse.ball.detect.detections import Detections, no_detections
from spheremouse.ball.detect.lookalikes import StaticDistractors
from spheremouse.ball.detect.projection import GREY, Projection
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detector import Detector
from spheremouse.ball.events import Doubt
from spheremouse.ball.filters import Filter, FilterState
from spheremouse.ball.filters.so3_mixture import Hypothesis
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.outline import SeenCentre
from spheremouse.ball.points import SpherePoints, intersect
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Estimate, Event, Frame, Status, sampled_rows

_MOVED_FRAMES = 2  # in a row: one may show a false edge
_NO_TRACK = np.zeros(0, dtype=np.intp)
RECENT_S = 0.15  # s, for which a camera's last frame counts beside those of another: five frames at 30 Hz
SURE = 10  # sightings from which a disc is worth keeping

Events = tuple[Event, ...]
F = TypeVar("F", bound=FilterState)
K = TypeVar("K", bound=Filter[Any])


@dataclass(frozen=True, slots=True)
class Tracker(Generic[K]):
    """The constant parts of tracking: device, camera pose, and stages with their settings."""

    settings: Settings
    rig: Rig
    pose: Pose
    detector: Detector
    detector_data: Any  # of `Detector.prepare`
    filter: K
    method: "Method"


class Method(NamedTuple):
    """The steps of tracking that depend on the filter, and on how a detector learns the ball."""

    keeps_map: bool  # also of discs out of view: to recognise a ball, and to notice a moved camera or a lifted ball
    to_map: Callable[["TrackState"], BallMap | None]  # to be saved; None while too little is known
    recall: Callable[["TrackState", BallMap], "TrackState"]  # the state that begins with a saved map
    next_phase: Callable[["TrackState", float, Tracker, Any], tuple["TrackState", Events]]  # after a frame's points
    at_new_pose: Callable[["TrackState", Tracker, Array | None], Any]  # the filter, after the camera moved
    update_all: Callable[..., "TrackState"]  # after a frame in which every point may be a disc: `phases.learn`
    is_covered: Callable[["TrackState", Any, Tracker], bool]  # something lies before most of the known discs


class BufferedFrame(NamedTuple):
    """Detections of one frame, and the state predicted for it."""

    stamp: float  # s
    detections: Detections
    points: SpherePoints
    filter: Any  # the filter's state as predicted for it
    track: NDArray[np.intp] = _NO_TRACK  # (n,) number of each point: equal for the same point in another view
    camera: int = 0
    ball_centre: SeenCentre | None = None  # by the ball's outline, if it was measured

    @property
    def attitude(self) -> Array:
        """R_obj_ball, (3, 3), as predicted."""
        return self.filter.attitude

    @property
    def centre(self) -> Array:
        """(n, 2) px of the points."""
        return self.detections.centre[self.points.index]


class Colours(NamedTuple):
    """Colour projection in which the discs are darker than the ball, and the lens's blur."""

    projection: Projection = GREY  # in which they are darker
    fixed: bool = False  # by the settings
    tried: float = -np.inf  # s, when all projections were tried last
    wait: float = 0.5  # s until they are tried again, unless the ball has turned
    tried_now: tuple[tuple[Projection, float], ...] = ()  # of an unfinished trial, and their information
    refined: bool = False  # from the pixels of known discs
    lens_blur: float | None = None  # px, standard deviation; None: not measured yet
    blur_tried: float = -np.inf  # s, when it was measured last
    blur_wait: float = 0.5  # s until it is measured again


class Recognising(NamedTuple):
    """The map of an earlier session is loaded, but the attitude in it is still unknown."""

    in_view_since: float | None = None  # s, of discs enough to speak against the map


class OtherView(NamedTuple):
    """A frame of a camera that does not decide whether the ball has turned, and the tracker of that camera."""

    view: BufferedFrame
    tracker: Tracker[Any]


class Learning(NamedTuple):
    """The ball has not turned yet, so any candidate may be a look-alike."""

    found: bool = False  # two discs were seen: the ball is tracked
    views: tuple[BufferedFrame, ...] = ()  # since the ball was seen, to be filtered again without the look-alikes
    others: tuple[OtherView, ...] = ()  # of other cameras since then
    next_track: int = 0  # number of the next point that no view has shown yet
    beside_map: bool = False  # an older map exists, which outweighs what two points show


class CentreCheck(NamedTuple):
    """Check of the ball's centre by its discs."""

    evidence: float = 0.0  # running mean of the squared deviations by which it is off the filter's estimate
    odds: float = 0.0  # nats, running sum: for a rig with a wrong length, against one that is right
    odds_static: float = 0.0  # the same against a centre that moves
    wrong_rig: bool = False  # it was off from the start, since a length in the rig is wrong
    moved: bool = False  # it has been off, and an event has said so
    turned: float = 0.0  # rad the ball has turned about it, since it last moved far
    home: Array = np.zeros(3)  # (3,) m, obj, where it is usually


class OutlineCheck(NamedTuple):
    """Check of the ball's centre by its outline, at one pose of the camera."""

    begun: bool = False  # the first frame has been measured
    seen: SeenCentre | None = None  # in the last frame, if it was measured
    measured: float = -np.inf  # s, stamp of the frame in which it was measured last
    first: SeenCentre | None = None  # in the first frame; None after the centre moved before it proved its place
    attitude: Array = np.eye(3)  # (3, 3) R_obj_ball in the first frame
    trust: Array | None = None  # (240,) in the edges of its normals, by the first frame (`outline.SeenBall`)
    size_sigma: float = np.inf  # relative standard deviation of the rig's radius, as the first frame confirmed it
    away: int = 0  # frames in a row in which the outline was far from its first place
    drift: float = 0.0  # m, farthest from that place before
    watched: float = 0.0  # rad the ball has turned while the outline was measured

    @property
    def has_moved(self) -> bool:
        """Return whether the outline has left its first place, for longer than one false edge lasts."""
        return self.away >= _MOVED_FRAMES

    @property
    def shift(self) -> Array | None:
        """The centre in the last frame, from its place in the first, (3,) m in obj; None if one is unknown."""
        if self.seen is None or self.first is None:
            return None
        return self.seen.axes @ (self.seen.place - self.first.place)

    @property
    def is_in_place(self) -> bool:
        """Return whether the outline of the last frame is where it was in the first."""
        return self.seen is not None and self.first is not None and self.away == 0

    def again(self, first: SeenCentre | None) -> "OutlineCheck":
        """Return a new check from the place `first`, at the same pose."""
        attitude, trust, size_sigma = self.attitude, self.trust, self.size_sigma
        return OutlineCheck(begun=True, first=first, attitude=attitude, trust=trust, size_sigma=size_sigma)


class LastPicture(NamedTuple):
    """Rows of the last picture of a camera, to detect that it comes again."""

    rows: bytes = b""  # noise makes them differ in two exposures
    rate: Array = np.zeros(3)  # (3,) rad/s, w_obj, of the ball before it was processed
    repeats: int = 0  # frames in a row that showed it again

    @classmethod
    def of(cls, image: NDArray[np.uint8], rate: Array) -> "LastPicture":
        """Return that of a frame's image; `rate` is of the ball before it is processed."""
        return cls(sampled_rows(image), rate)


class Tracking(NamedTuple):
    """The ball has turned, so its discs differ from look-alikes."""


class Trial(NamedTuple):
    """A new map without proof yet that its points are on a ball."""

    filter: So3State
    phase: Learning


class Lost(NamedTuple):
    """The ball is lost; the tracker reports no motion until it finds the ball again."""

    last: Learning | Tracking  # the phase before
    in_view_since: float | None = None  # s, of discs
    lifted_at: float | None = None  # s, when it was seen to be off its centre
    trial: Trial | None = None  # of an object that has been in view for long and is not recognised


Phase = Recognising | Learning | Tracking | Lost


class CameraState(NamedTuple):
    """Parts of the state of a camera that does not show this frame. `TrackState` has the same fields."""

    camera: int
    shown_at: float
    picture: LastPicture
    confirmed: bool
    detections: Detections
    points: SpherePoints
    lookalikes: StaticDistractors
    search: Any
    colours: Colours
    centre: CentreCheck
    outline: OutlineCheck
    watch: CameraMonitor | None
    rebuilt: Tracker[Any] | None
    readout_known: bool

    @classmethod
    def of(cls, state: "TrackState[Any]") -> "CameraState":
        """Return the part of a state that belongs to the camera of its last frame."""
        return cls(*(getattr(state, name) for name in cls._fields))


class Withheld(NamedTuple):
    """Motion of a tracked ball that is not reported, since no frame confirms the attitude."""

    since: float  # s, stamp of the last frame that confirmed it
    doubt: Doubt  # of the last frame
    announced: bool = False  # it has lasted long enough to matter, and an event has said so


class TrackState(NamedTuple, Generic[F]):
    """State of the tracker after a frame. The fields that `CameraState` has too are of the camera of that frame."""

    phase: Phase
    filter: F
    reported_attitude: Array  # (3, 3) at the last motion
    confirmed_at: float  # s, stamp of the last frame whose discs confirmed the attitude
    detections: Detections  # all of the last frame
    points: SpherePoints  # of the last frame, look-alikes left out; filter.used indexes these
    alternatives: tuple[Hypothesis, ...] = ()  # to `filter`, while the discs in view leave more than one possible
    older: F | None = None  # with the map before the last new one, in case that was of an object before the ball
    older_searches: int = 0  # of an older map that an earlier session saved, and one more; 0: it is of this session
    confirmed: bool = False  # the last frame's discs confirm the attitude
    supported_at: float = -np.inf  # s, of the last frame that showed a disc of the map, or should have shown none
    paired_at: float = -np.inf  # s, stamp of the last frame that showed two discs of the map
    withheld: Withheld | None = None  # None: the last frame confirms the attitude, or the ball is not tracked
    lookalikes: StaticDistractors = StaticDistractors()
    search: Any = SearchState()  # of the detector: for discs that are not on the map yet, or what it knows of a texture
    colours: Colours = Colours()
    centre: CentreCheck = CentreCheck()
    outline: OutlineCheck = OutlineCheck()
    absolute: bool = False  # the attitude is that of a map made earlier
    watch: CameraMonitor | None = None  # on the targets: does the camera stand?
    rebuilt: Tracker[Any] | None = None  # for a new pose of the camera, or the outline's size; None: neither
    readout_known: bool = False  # play has shown what the rolling shutter takes
    frames: int = 0  # since the tracker began
    camera: int = 0  # number of the camera that showed the last frame
    shown_at: float = -np.inf  # s, stamp of the last frame of that camera
    picture: LastPicture = LastPicture()
    others: tuple[CameraState, ...] = ()  # in the order of `filter.others`

    @property
    def status(self) -> Status:
        """Phase of tracking."""
        match self.phase:
            case Tracking() | Learning(found=True):
                return Status.TRACKING
            case Lost():
                return Status.LOST
            case _:
                return Status.SEARCHING

    @property
    def known_to_turn(self) -> bool:
        """Return True if the ball has turned, so that look-alikes differ from discs."""
        phase = self.phase.last if isinstance(self.phase, Lost) else self.phase
        return isinstance(phase, Tracking)

    @property
    def follows(self) -> bool:
        """Return True if the last frame of this camera, or a later one of another, confirmed the attitude."""
        return self.shown_at <= self.confirmed_at <= self.filter.stamp

    def most_in_view(self, stamp: float) -> int:
        """Return the number of points in this frame, or in the last one of another camera if that has more."""
        others = (len(other.points) for other in self.others if abs(stamp - other.shown_at) < RECENT_S)
        return max((len(self.points), *others))

    def is_confirmed_by_another(self, stamp: float) -> bool:
        """Return whether the last frame of another camera confirmed the attitude."""
        return any(other.confirmed and abs(stamp - other.shown_at) < RECENT_S for other in self.others)


def statistics(state: TrackState) -> dict[str, float]:
    """Return the statistics of the last frame.

    `discs_used`, `discs_seen` and `discs_known` are numbers of discs. `nis` is the normalised innovation squared of
    the update, which a published filter does not give.
    """
    f = state.filter
    return {"discs_used": len(f.used), "discs_seen": len(state.points), "discs_known": len(f.discs), **f.statistics}


def current(state: TrackState | CameraState, tracker: Tracker[K]) -> Tracker[K]:
    """Return the tracker in use: `tracker`, or the one that was rebuilt for a new pose or size."""
    return tracker if state.rebuilt is None else state.rebuilt


def lost(state: TrackState[F], lifted_at: float | None = None) -> TrackState[F]:
    """Return the state of a ball that is lost with this frame."""
    last = state.phase
    assert isinstance(last, Learning | Tracking)
    return state._replace(phase=Lost(last, lifted_at=lifted_at), filter=clear_matches(state.filter), confirmed=False)


def clear_matches(filter_state: Any) -> Any:
    return filter_state._replace(used=np.zeros(0, dtype=np.intp))


def start_tracking(
    state: TrackState[F], phase: Learning | Tracking, filtered: F, reported: Array, stamp: float
) -> TrackState[F]:
    """Return the state of a ball that a new filter tracks from `stamp` (s) on.

    Motion counts from the attitude `reported`, R_obj_ball (3, 3).
    """
    return state._replace(
        phase=phase,
        filter=filtered,
        alternatives=(),
        reported_attitude=reported,
        confirmed_at=stamp,
        confirmed=True,
    )


def forget(lookalikes: StaticDistractors) -> StaticDistractors:
    """Keep the masks; remove the candidates, since they belong to another attitude."""
    return StaticDistractors(lookalikes.masks, lookalikes.mask_seen, next_number=lookalikes.next_number)


def no_points(tracker: Tracker) -> SpherePoints:
    return intersect(no_detections(), tracker.rig, tracker.pose)


@dataclass(frozen=True, slots=True)
class Epoch:
    """One tracked frame."""

    frame: Frame
    state: TrackState
    estimate: Estimate
    events: Events
    seconds: dict[str, float]  # wall time per stage: detect, filter

    @property
    def used(self) -> Array:
        """(k, 2) px, centres of the discs that took part in the filter's update; none for a picture that came again."""
        if self.state.picture.repeats > 0:
            return np.zeros((0, 2))
        return self.state.detections.centre[self.state.points.index[self.state.filter.used]]
