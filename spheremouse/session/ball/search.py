"""Searches that may take longer than a frame, in another thread: for targets, and for the reason of missing discs.

A search starts with one frame, and a later frame takes its result without waiting. If `elsewhere` runs the work in the
caller's thread, the result is there at once, so the same frames give the same result.
"""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Generic, TypeVar

from spheremouse.ball.camera_moved import MovedTracker, seek_by_colour
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.diagnosis import Absence
from spheremouse.ball.detect.rings import TargetDetections, detect_targets
from spheremouse.ball.events import OF_CAMERA, MotionReleased, MotionWithheld
from spheremouse.ball.pose import Resection, find_pose, gather
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.session import messages
from spheremouse.session.process.threads import Work, as_future
from spheremouse.tracker import Frame, Status, Step

Elsewhere = Callable[[Work], object]  # has another thread do work, in order
T = TypeVar("T")

_FEW_DISCS = 3  # with this many in view, the picture is not the cause
_FIRST_DIAGNOSIS_S = 1.0  # without tracking: hands pass in less
_DIAGNOSIS_INTERVAL_S = 2.0


class _Search(Generic[T]):
    """Runs at most one search at a time, and holds its result until it is taken."""

    def __init__(self, elsewhere: Elsewhere) -> None:
        self._elsewhere = elsewhere
        self._future: Future[T] | None = None

    @property
    def idle(self) -> bool:
        """True if no search runs and no result waits."""
        return self._future is None

    def begin(self, work: Callable[[], T]) -> None:
        """Start a search; `work` returns its result."""
        self._future = as_future(work, self._elsewhere)

    def take(self) -> T | None:
        """Return the result once and clear it, or raise the search's error; None while there is none."""
        if self._future is None or not self._future.done():
            return None
        done, self._future = self._future, None
        return done.result()


class PoseSearch:
    """Estimates the camera's pose from targets in several frames. It skips frames that come while a search runs."""

    def __init__(self, rig: Rig, settings: Settings, elsewhere: Elsewhere) -> None:
        self._rig, self._settings = rig, settings
        self._search = _Search[Resection | None](elsewhere)
        self._views: list[TargetDetections] = []
        self._first: Image | None = None
        self.seen: tuple[str, ...] = ()  # codes in the last complete set of views
        self.view: TargetDetections | None = None  # the last one

    @property
    def wants_colour(self) -> bool:
        """True if the next frame is searched, so that it must be in colour."""
        return self._search.idle

    def look(self, frame: Frame) -> Resection | None:
        """Search a frame if no search runs. Return the pose once there are enough views, else None.

        Raises PoseError if the views give no pose, or if the frame is grey.
        """
        if self._search.idle:  # else this frame may be grey
            self._begin(frame)
        return self._search.take()

    def _begin(self, frame: Frame) -> None:
        """Search a frame's targets in another thread. Raise PoseError for a grey frame."""
        if frame.image.ndim != 3:
            self._views, self._first = [], None
            raise PoseError("the frames are grey: the ring targets need colour; give a rig with a camera pose")
        image = frame.image.copy()
        first = self._first = image if self._first is None else self._first
        self._search.begin(lambda: self._find(image, first))

    def _find(self, image: Image, first: Image) -> Resection | None:
        """Detect targets, and return the pose when enough frames have been seen, else None."""
        self.view = detect_targets(image, self._rig.targets.radii, self._settings.rings)
        self._views.append(self.view)
        if len(self._views) < self._settings.pose.frames:
            return None
        views, self._views, self._first = self._views, [], None
        self.seen = tuple(sorted({s.code for s in gather(views)}))
        return find_pose(views, self._rig, first)


class PoseRecovery:
    """Searches the targets by their colours after the camera was moved, while the ball is tracked."""

    def __init__(self, elsewhere: Elsewhere) -> None:
        """`elsewhere` runs a search, in the caller's thread or another one."""
        self._search = _Search[MovedTracker | None](elsewhere)
        self._tracker: Tracker | None = None  # in use when the search began

    def __call__(self, frame: Frame, tracker: Tracker) -> MovedTracker | None:
        """Begin a search for the moved camera, unless one runs or its result waits.

        Return its result if `elsewhere` (see `__init__`) ran it at once: the tracker at the new pose, and what that
        adds to the covariance. Otherwise return None; `found` gives the pose in a later frame. A tracker is immutable,
        so only the image is copied.
        """
        if not self._search.idle:
            return None
        kept = replace(frame, image=frame.image.copy())
        self._tracker = tracker
        self._search.begin(lambda: seek_by_colour(kept, tracker))
        return self._search.take()

    def found(self, tracker: Tracker | None) -> Pose | None:
        """Return the pose of a complete search; None if there is none, or if it began with another tracker."""
        moved = self._search.take()
        return None if moved is None or tracker is not self._tracker else moved.tracker.pose


class BallMessages:
    """Creates the texts about the ball for status and log.

    One thread calls the methods. Other threads may read `reason`.
    """

    def __init__(self, elsewhere: Elsewhere) -> None:
        """Create the texts; `elsewhere` runs the diagnosis of a picture in another thread."""
        self.reason = ""  # for the status: the state of the ball; empty if there is nothing to report
        self._known, self._log = "", ""
        self._last = ""  # reason for missing discs, in the last frame of the first camera
        self._missing = MissingDiscs(elsewhere)

    def add(self, step: Step[TrackState], frame: Frame, tracker: Tracker, name: str = "") -> None:
        """Update the texts from one frame and the tracker's step for it. A `name` precedes events of the camera."""
        state, events = step.state, step.events
        words = tracker.detector.words
        lines = [messages.line(events, words)] if events else []
        if name and any(isinstance(event, OF_CAMERA) for event in events):
            lines = [name + line for line in lines]
        if lasting := [e for e in events if not isinstance(e, MotionWithheld | MotionReleased)]:
            self._known = messages.reason(lasting, words)
        new = False
        if frame.camera == 0:
            self._last, new = self._missing.look(state, frame, tracker)
        if new:
            lines.append(self._last)
        if lines:
            self._log = "; ".join(lines)
        withheld = state.withheld
        if withheld is not None and withheld.announced:
            self.reason = messages.withheld(frame.stamp - withheld.since, withheld.doubt, words)
        else:
            self.reason = self._last or self._known

    def restart(self, reason: str) -> None:
        """Set `reason` to this text, since the search for the ball starts again."""
        self.reason = self._known = reason

    def take(self) -> str:
        """Return the last log line since the previous call, and clear it; empty if there is none."""
        log, self._log = self._log, ""
        return log


class MissingDiscs:
    """Finds the reason for missing points in the picture every 2 s while the ball is not tracked."""

    def __init__(self, elsewhere: Elsewhere) -> None:
        self._elsewhere = elsewhere
        self._reset()

    def look(self, state: TrackState, frame: Frame, tracker: Tracker) -> tuple[str, bool]:
        """Return the reason for the missing discs as text, and True if it differs from the last one.

        It is empty while the ball is tracked or three discs are in view, and until the first diagnosis is complete. A
        ball with a pattern may show many points before it turns.
        """
        detector, stamp = tracker.detector, frame.stamp
        points = detector.clear_points(len(state.points))
        if state.status is Status.TRACKING:
            self._reset()
            return "", False
        since = self._since = stamp if self._since is None else min(self._since, stamp)
        due = stamp - since >= _FIRST_DIAGNOSIS_S and not 0.0 <= stamp - self._diagnosed < _DIAGNOSIS_INTERVAL_S
        if due and points < _FEW_DISCS and self._diagnosis.idle:
            self._diagnosed, self._seen, image = stamp, points, frame.image.copy()
            known = state.status is Status.LOST
            given = image, tracker.rig, tracker.pose, tracker.settings, known
            self._diagnosis.begin(lambda: detector.why_absent(*given))
        self._absence = self._diagnosis.take() or self._absence
        if self._absence is None or points >= _FEW_DISCS:
            return "", False
        before, self._problem = self._problem, messages.why_absent(self._absence)[0]
        text = messages.absent(self._seen, stamp - since, self._absence, detector.words)
        return text, strip_digits(before) != strip_digits(self._problem)

    def _reset(self) -> None:
        self._since: float | None = None  # s, stamp of the first frame in which the ball was not tracked
        self._diagnosed = -float("inf")  # s, stamp of the last frame with a diagnosis
        self._diagnosis = _Search[Absence](self._elsewhere)
        self._seen = 0  # discs in that frame
        self._absence: Absence | None = None
        self._problem = ""
