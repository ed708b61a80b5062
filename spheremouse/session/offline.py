"""Track a recording of a ball, or of balls in a hand, from its first frame to its last, and measure times."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from heapq import merge
from itertools import chain, islice
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.cameras import begin_all
from spheremouse.ball.detect.rings import TargetDetections, detect_targets
from spheremouse.ball.filters.so3_settings import So3Settings
from spheremouse.ball.pose import Resection, find_pose
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.smooth import smooth
from spheremouse.ball.state import Epoch, Tracker, TrackState
from spheremouse.ball.track import step as step_ball
from spheremouse.errors import ConfigurationError, OutputError, PoseError, SourceError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.output import Output, OutputClosed, Report, open_output, report_of, response_of
from spheremouse.output.counts import OutputCounter
from spheremouse.output.reporter import log_line
from spheremouse.output.sample import Sample
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter
from spheremouse.tracker import Frame, check_size

if TYPE_CHECKING:
    from spheremouse.wand.state import WandEpoch, WandState, WandTracker

_NO_HUE = ("dark", "light")  # colours of a wand's discs that grey frames show as well

Known = dict[int, tuple[Array, Array]]  # position and rotation of balls in a hand, by their index


@dataclass(frozen=True, slots=True)
class Start:
    """Result of the initialisation: the pose, its resection, and the frames from the first that was used."""

    pose: Pose
    resection: Resection | None  # None if the rig has the pose
    frames: Iterator[Frame]
    passed: int = 0  # frames before those


def initialise(
    frames: Iterator[Frame], rig: Rig, settings: Settings, *, report: Callable[[str], None] = lambda _: None
) -> Start:
    """Find the camera's pose in the first views that show enough targets.

    The returned frames start with the first of those views. `report` gets the problem of views with too few targets
    once. Raises PoseError if the frames end before a pose was found.
    """
    if rig.pose is not None:
        return Start(rig.pose, resection=None, frames=frames)
    if len(rig.targets.codes) < 3:
        raise PoseError("the rig has fewer than three targets and no camera pose: calibrate the device first")
    last_text, passed = "", 0
    while True:
        views, found = list[Frame](), list[TargetDetections]()
        for view in islice(frames, settings.pose.frames):
            check_size(view, rig.camera)
            views.append(view)
            found.append(detect_targets(_colour(view), rig.targets.radii, settings.rings))
        if not views:
            raise PoseError(last_text or "the source gave no frame")
        try:
            resection = find_pose(found, rig, views[0].image)
        except PoseError as e:
            if str(e) != last_text:
                last_text = str(e)
                report(last_text)
            passed += len(views)
            continue
        return Start(resection.pose, resection, chain(views, frames), passed)


def _colour(frame: Frame) -> NDArray[np.uint8]:
    if frame.image.ndim != 3:
        raise SourceError("the frames are grey: the ring targets need colour; give a rig with a camera pose")
    return frame.image


class View(Protocol):
    """Displays a run."""

    def log(self, text: str) -> None:
        """Print one or more lines, which stay."""
        ...

    def show(self, result: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        """Show a tracked frame of an adapter, and its report."""
        ...


def results(frames: Iterable[Frame], adapter: TrackerAdapter) -> Iterator[FrameResult]:
    """Track every frame, and yield the results of those that the adapter could track."""
    return (made for frame in frames if (made := adapter.follow(frame)) is not None)


def smoothed(result: Iterable[FrameResult], adapter: TrackerAdapter, settings: So3Settings) -> list[FrameResult]:
    """Return the results with estimates given all frames, and without images.

    The adapter must be of tracker so3. Raise ConfigurationError if it gives no observations.
    """
    kept, samples = list[FrameResult](), list[Sample]()
    for made in result:
        samples.append(replace(made.samples[0], observation=adapter.observation(made)))
        frame = replace(made.frame, image=np.zeros((0, 0), np.uint8))
        kept.append(replace(made, frame=frame, epoch=replace(made.epoch, frame=frame)))
    smoothed_samples = smooth_samples(samples, settings)
    return [replace(made, samples=(sample,)) for made, sample in zip(kept, smoothed_samples, strict=True)]


def smooth_samples(samples: Iterable[Sample], settings: So3Settings) -> list[Sample]:
    """Return the samples with smoothed estimates, each of which uses all samples, also the later ones.

    Status, motion and covariances of a sample are those of its estimate. The results have no observations, so they
    cannot be smoothed again. `settings` are those of the tracking. Raises ConfigurationError for a sample without an
    observation.
    """
    samples, observations = list(samples), []
    for sample in samples:
        if sample.observation is None:
            hint = "give samples as `track` yields them, by tracker so3, and not of a ball in a hand"
            raise ConfigurationError(f"smooth: the sample of frame {sample.sequence} has no observation", hint)
        observations.append(sample.observation)
    estimates = smooth(observations, settings)
    return [replace(s, estimate=e, observation=None) for s, e in zip(samples, estimates, strict=True)]


def open_outputs(specs: Sequence[str], stack: ExitStack, view: View) -> dict[str, Output]:
    """Open outputs. One that cannot be opened is logged and left out. The error of the last one ends the run."""
    outputs = dict[str, Output]()
    for spec in specs:
        try:
            outputs[spec] = stack.enter_context(open_output(spec))
        except OutputError as e:
            if spec == specs[-1] and not outputs:
                raise
            view.log(log_line(f"output {spec}", e))
    return outputs


def follow(result: Iterable[FrameResult], adapter: TrackerAdapter, outputs: dict[str, Output], view: View) -> None:
    """Send a report of each tracked frame of a recording to all `outputs`, and display the frame in `view`.

    `view` also logs changes, with the frame's stamp. An output that fails or whose reader is gone is logged and left
    out. The error of the last one ends the run.
    """
    working = {spec: (output, OutputCounter(response_of(spec))) for spec, output in outputs.items()}
    for made in result:
        report = report_of(made.samples, adapter.mapping, made.pointing)
        _send(report, working, view)
        change, more = adapter.take_messages()
        for text in filter(None, (change, *more)):
            view.log(f"{made.frame.stamp:9.3f} s  {text}")
        view.show(made, report, adapter)


def _send(report: Report, working: dict[str, tuple[Output, OutputCounter]], view: View) -> None:
    """Send a report to each output, and remove those that fail. Raise the error of the last one."""
    for spec, (output, counter) in tuple(working.items()):
        try:
            output.send(counter.apply(report))
        except (OutputError, OutputClosed) as e:
            if len(working) == 1:
                raise
            del working[spec]
            reason = e if isinstance(e, OutputError) else "the reader of the output is gone"
            view.log(log_line(f"output {spec}", reason))


def merged(cameras: Sequence[Iterable[Frame]]) -> Iterator[Frame]:
    """Return the frames of several cameras in the order of their stamps, with the number of their camera."""

    def of_camera(k: int) -> Iterator[Frame]:
        return (replace(frame, camera=k) for frame in cameras[k])

    return merge(*map(of_camera, range(len(cameras))), key=lambda frame: frame.stamp)


def track(
    frames: Iterator[Frame], tracker: Tracker, known: BallMap | None = None, others: Sequence[Tracker] = ()
) -> Iterator[Epoch]:
    """Track every frame. With a `known` map of the ball, attitudes are in its frame once the ball is recognised.

    `others` are the trackers of further cameras, in the order of their numbers.
    """
    trackers = (tracker, *others)
    state: TrackState | None = None
    times = [0.0, 0.0, 0.0]

    def detected() -> None:
        times[1] = time.perf_counter()

    for frame in frames:
        state = state or begin_all(trackers, frame.stamp, known=known)
        times[0] = time.perf_counter()
        state, estimate, events = step_ball(state, frame, trackers[frame.camera], detected)
        times[2] = time.perf_counter()
        yield Epoch(frame, state, estimate, events, {"detect": times[1] - times[0], "filter": times[2] - times[1]})


# ---- balls in a hand ----


def track_wand(
    frames: Iterable[Frame], tracker: "WandTracker", seed: int = 0, known: Known | None = None
) -> "Iterator[WandEpoch]":
    """Track every frame; `known` has the poses of balls at the first one."""
    from spheremouse.wand.state import WandEpoch
    from spheremouse.wand.track import begin, step

    state: WandState | None = None
    for frame in frames:
        check_wand_frame(frame, tracker)
        state = state or begin(tracker, seed, frame.stamp, known)
        start = time.perf_counter()
        state, estimate, _ = step(state, frame, tracker)
        yield WandEpoch(frame, state, estimate, time.perf_counter() - start)


def check_wand_frame(frame: Frame, tracker: "WandTracker") -> None:
    """Raise SourceError if a frame has another size than the camera's, or lacks the colour that the balls need."""
    check_size(frame, tracker.camera)
    if frame.image.ndim == 2 and (paints := [c for c in tracker.names if c not in _NO_HUE]):
        problem = f"the frames are grey, and the ball has {' and '.join(paints)} discs"
        raise SourceError(f"{problem}: use a camera in colour, or a ball in dark and light")
