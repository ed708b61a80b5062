"""Search for targets in whole images, in another thread, since it can take longer than a frame.

A search starts with one frame, and a later frame takes its result without waiting. If `elsewhere` runs it at once, the
result is there at once, so the same frames give the same result.
"""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import TypeVar

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.rings import TargetDetections, detect_targets
from spheremouse.ball.pose import Resection, find_pose, gather
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker
from spheremouse.ball.track import Moved, seek_by_colour
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.tracker import Frame

Elsewhere = Callable[[Callable[[], None]], object]  # has something done, one after the other

T = TypeVar("T")


def at_once(work: Callable[[], None]) -> None:
    """Do it here and now."""
    work()


class FirstPose:
    """Views for the first pose: the newest frame is looked through as soon as the one before has been."""

    def __init__(self, rig: Rig, settings: Settings, elsewhere: Elsewhere) -> None:
        self._rig, self._settings, self._elsewhere = rig, settings, elsewhere
        self._views: list[TargetDetections] = []
        self._first: Image | None = None
        self._looking: Future[Resection | None] | None = None
        self.seen: tuple[str, ...] = ()  # codes in the last views that were enough

    def look(self, frame: Frame) -> Resection | None:
        """The pose, once there are views enough. PoseError where they tell none, and where the frame is grey."""
        found = self._come_of()
        if self._looking is None and found is None:
            self._begin(frame)
            found = self._come_of()
        return found

    def _begin(self, frame: Frame) -> None:
        if frame.image.ndim != 3:
            self._views, self._first = [], None
            raise PoseError("the frames are grey: the ring targets need colour; give a rig with a camera pose")
        image = frame.image.copy()
        first = self._first = image if self._first is None else self._first
        self._looking = begun(lambda: self._look(image, first), self._elsewhere)

    def _look(self, image: Image, first: Image) -> Resection | None:
        self._views.append(detect_targets(image, self._rig.targets.radii, self._settings.rings))
        if len(self._views) < self._settings.pose.frames:
            return None
        views, self._views, self._first = self._views, [], None
        self.seen = tuple(sorted({s.code for s in gather(views)}))
        return find_pose(views, self._rig, first)

    def _come_of(self) -> Resection | None:
        if self._looking is None or not self._looking.done():
            return None
        done, self._looking = self._looking, None
        return done.result()


class PoseRecovery:
    """The camera sought by the targets' colours while it is tracked, after it was moved or the targets were hidden."""

    def __init__(self, elsewhere: Elsewhere) -> None:
        self._elsewhere = elsewhere
        self._seeking: Future[Moved | None] | None = None
        self._tracker: Tracker | None = None  # in use when it began

    def __call__(self, frame: Frame, tracker: Tracker) -> Moved | None:
        """Start `seek_by_colour`, and return its pose if it is known at once; else `found` returns it later."""
        if self._seeking is not None:
            return None
        kept = replace(frame, image=frame.image.copy())
        self._tracker = tracker
        self._seeking = begun(lambda: seek_by_colour(kept, tracker), self._elsewhere)
        if not self._seeking.done():
            return None
        done, self._seeking = self._seeking, None
        return done.result()

    def found(self, tracker: Tracker | None) -> Pose | None:
        """The pose that was found since, if the tracker in use is still the same."""
        if self._seeking is None or not self._seeking.done():
            return None
        done, self._seeking = self._seeking, None
        moved = done.result()
        return None if moved is None or tracker is not self._tracker else moved[0].pose


def begun(work: Callable[[], T], elsewhere: Elsewhere) -> Future[T]:
    """Return a function that gives the result of the work, or its error."""
    future: Future[T] = Future()

    def do() -> None:
        try:
            future.set_result(work())
        except Exception as e:
            future.set_exception(e)

    elsewhere(do)
    return future
