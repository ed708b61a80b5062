"""One run from the first frame to the last: the camera's pose from the targets, then every frame tracked.

The shell's part of the use phase: it takes frames as they come and measures times. Printing is its callers' matter.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.build import begin
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.pose import Resection, find_pose
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Epoch, Tracker, TrackState
from spheremouse.ball.track import step
from spheremouse.ball.warm import warm_up
from spheremouse.compiling import told
from spheremouse.errors import PoseError, SourceError
from spheremouse.geometry.camera import Pose
from spheremouse.output import Output
from spheremouse.session.follower import FrameResult, TrackerAdapter
from spheremouse.tracker import Frame, check_size


@dataclass(frozen=True, slots=True)
class Start:
    """The end of initialisation: the pose, what it rests on, and the frames from the first that was used on."""

    pose: Pose
    resection: Resection | None  # None where the pose was known beforehand
    frames: Iterator[Frame]
    passed: int = 0  # frames before those


def initialise(
    frames: Iterator[Frame],
    rig: Rig,
    settings: Settings,
    *,
    live: bool = False,
    report: Callable[[str], None] = lambda _: None,
) -> Start:
    """Find the camera's pose in the first views that show enough targets.

    A recording is tracked from the first of those views on; a live camera from where it is by then. Views that show too
    few targets are passed over and `report`ed once; PoseError where the frames end before a pose was found.
    """
    if rig.pose is not None:
        return Start(rig.pose, None, frames)
    if len(rig.targets.codes) < 3:
        raise PoseError("the rig has fewer than three targets and no camera pose: calibrate the device first")
    said: str | None = None
    passed = 0
    while True:
        views = list(islice(frames, settings.pose.frames))
        if not views:
            raise PoseError(said or "the source gave no frame")
        for view in views:
            check_size(view, rig.camera)
        try:
            seen = [detect_targets(_colour(view), rig.targets.radii, settings.rings) for view in views]
            resection = find_pose(seen, rig, views[0].image)
        except PoseError as e:
            if str(e) != said:
                said = str(e)
                report(said)
            passed += len(views)
            continue
        return Start(resection.pose, resection, frames if live else chain(views, frames), passed)


def _colour(frame: Frame) -> NDArray[np.uint8]:
    if frame.image.ndim != 3:
        raise SourceError("the frames are grey: the ring targets need colour; give a rig with a camera pose")
    return frame.image


def make_ready(settings: Settings, tell: Callable[[str], None] | None = None) -> None:
    """Compile the functions of tracking, or read them from disk, with progress (`compiling.told`)."""
    with told(tell):
        warm_up(settings)


class View(Protocol):
    """Displays a run."""

    def say(self, text: str) -> None:
        """One or more lines, which stay."""
        ...

    def show(self, made: FrameResult, follower: TrackerAdapter) -> None:
        """A tracked frame, and what tracks it."""
        ...


def follow(frames: Iterable[Frame], follower: TrackerAdapter, sinks: Sequence[Output], view: View) -> None:
    """Track every frame of a recording, and log changes with the frame's stamp."""
    for frame in frames:
        follower.check(frame)
        made = follower.follow(frame)
        if made is None:
            continue
        for sink in sinks:
            sink.send(made.report)
        change, more = follower.take_news()
        for text in filter(None, (change, *more)):
            view.say(f"{frame.stamp:9.3f} s  {text}")
        view.show(made, follower)


def track(frames: Iterator[Frame], tracker: Tracker, known: DiscMap | None = None) -> Iterator[Epoch]:
    """Track every frame; with a `known` map of the ball's discs the attitude is in its frame once it is recognised."""
    make_ready(tracker.settings)
    state: TrackState | None = None
    times = [0.0, 0.0, 0.0]

    def detected() -> None:
        times[1] = time.perf_counter()

    for frame in frames:
        check_size(frame, tracker.rig.camera)
        state = state or begin(tracker, frame.stamp, known=known)
        times[0] = time.perf_counter()
        state, estimate, events = step(state, frame, tracker, detected)
        times[2] = time.perf_counter()
        yield Epoch(frame, state, estimate, events, {"detect": times[1] - times[0], "filter": times[2] - times[1]})
