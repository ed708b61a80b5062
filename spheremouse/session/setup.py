"""Setup of a run with either tracker: the source, and the device or the balls that it may bring."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from spheremouse.ball.rig import Rig
from spheremouse.capture import Camera, OpenCamera, Source, Stream, open_source, pace
from spheremouse.capture.fetch import Streamed
from spheremouse.capture.lock import locked_camera
from spheremouse.capture.replay import Replay
from spheremouse.errors import ConfigurationError, SourceError
from spheremouse.files.dataset.frames import read_frames
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.ball.map_keeper import open_keeper
from spheremouse.session.cameras import is_camera, node_of
from spheremouse.session.run_config import RunConfig, with_distinct_names
from spheremouse.session.tracker_adapter import Submit, TrackerAdapter

if TYPE_CHECKING:
    from spheremouse.wand.ball import WandBall
    from spheremouse.wand.state import WandTracker


@dataclass(frozen=True, slots=True)
class Setup:
    """The open source of a run, and the device or the balls that it brings."""

    source: Source | None = None  # None: a camera, which is opened again and again
    camera: InteriorOrientation | None = None  # of a wand's recording
    balls: "tuple[WandBall, ...]" = ()
    replay: Replay | None = None  # that plays the source, if people control it
    second: Source | None = None  # of the second camera, if there is one, and it is no camera

    @property
    def rigs(self) -> tuple[Rig | None, ...]:
        """The devices that the sources of the first and the second camera bring; None for a camera."""
        return tuple(None if source is None else source.rig for source in (self.source, self.second))

    def planned(self, plan: RunConfig) -> RunConfig:
        """Return the plan without a map if the source brings its own device, unless a map was requested."""
        brought = self.rigs[0] is not None and not is_camera(plan.source)
        return replace(plan, map_path=None) if brought and plan.configuration.map is None else plan

    def adapter(self, plan: RunConfig, log: Callable[[str], None], submit: Submit) -> TrackerAdapter:
        """Return the tracker's adapter. Raise ConfigurationError or PoseError if the plan is incomplete."""
        if _is_wand(plan):
            from spheremouse.session.wand.adapter import WandAdapter

            made = WandAdapter(self.wand_tracker, plan, log)
            made.introduce()
            return made
        given = self.rigs[: len(plan.cameras)]
        rigs = plan.devices(given)
        return BallAdapter(rigs, plan.configuration, open_keeper(plan, rigs[0], log, submit), log, submit, given)

    def wand_tracker(self, plan: RunConfig) -> "WandTracker":
        """Return the tracker of the plan's balls, else of the recording's own, else of `grzonka_ball()`.

        Equal names of balls get numbers.

        Raises ConfigurationError if no file describes the camera, or if `wand.points` exceeds the number of balls.
        """
        from spheremouse.wand.ball import grzonka_ball
        from spheremouse.wand.build import build

        settings = plan.configuration.wand
        camera = plan.camera or (None if plan.rig is None else plan.rig.camera) or self.camera
        if camera is None:
            hint = "give its file with --camera FILE (`spheremouse calibrate camera` makes it)"
            raise ConfigurationError(f"{plan.source}: has no description of the camera", hint)
        balls = plan.balls.balls or self.balls or (grzonka_ball(),)
        if settings.points > len(balls):
            number = "is one ball" if len(balls) == 1 else f"are {len(balls)} balls"
            raise ConfigurationError(f"wand.points: is {settings.points}, but there {number}; balls are counted from 1")
        return build(camera, with_distinct_names(balls), settings, plan.balls.colours)


def open_replay(plan: RunConfig) -> Setup:
    """Return the setup of a plan whose recording people control.

    Raises SourceError for a camera, and the errors of `open_setup`.
    """
    if plan.second is not None:
        raise ConfigurationError("--replay: plays one recording; give one source")
    setup = open_setup(plan)
    if setup.source is None:
        raise SourceError(f"{plan.source}: is no recording, which --replay needs")
    return replace(setup, replay=Replay(setup.source, lambda: open_recording(plan), plan.source))


def open_recording(plan: RunConfig, realtime: bool = False) -> Source:
    """Open the recording of a plan; `realtime` plays it at the pace of its stamps."""
    source = open_setup(plan, realtime).source
    assert source is not None
    return source


def open_setup(plan: RunConfig, realtime: bool = False) -> Setup:
    """Return the setup of a plan. It opens a recording; `realtime` plays it at its own pace.

    Raises SourceError or DatasetError if the source does not open, or if a wand's source is `synthetic`.
    """
    if is_camera(plan.source):
        return Setup()
    kind, _, argument = plan.source.partition(":")
    if not _is_wand(plan) or kind not in ("synthetic", "dataset"):
        first, *more = (open_source(each.source, realtime=realtime) for each in plan.cameras)
        return Setup(first, second=more[0] if more else None)
    if kind == "synthetic":
        hint = "film one with `spheremouse wand simulate DIR`, give dataset:DIR"
        raise SourceError(f"{plan.source}: simulates no wand", hint)
    if not argument:
        raise SourceError("dataset: needs a folder; write dataset:DIR")
    from spheremouse.files.dataset.wand import open_wand

    recording = open_wand(Path(argument))
    frames = read_frames(recording)
    stream = Stream(pace(frames) if realtime else frames, fps=recording.fps, count=recording.frames)
    return Setup(stream, recording.camera, recording.balls)


def opener(plan: RunConfig, opened: list[Source] | None = None, replay: Replay | None = None) -> OpenCamera:
    """Return a function that opens a plan's camera and locks its node. It takes a source that is `opened` already.

    A `replay` is the camera of any plan.
    """
    if replay is not None:
        return lambda: replay

    def open_it() -> Camera:
        kind, _, argument = plan.source.partition(":")
        if kind == "v4l2":
            from spheremouse.capture import v4l2

            return v4l2.open_camera(argument, plan.configuration.camera)
        if opened:
            source = opened.pop(0)
        elif is_camera(plan.source):
            source = open_source(plan.source, realtime=True)
        else:
            source = open_recording(plan, realtime=True)
        return Streamed(source, plan.source)

    def open_held() -> AbstractContextManager[Camera]:
        node = node_of(plan.source)  # each time: a camera that comes back may have another node
        return open_it() if node is None else locked_camera(node, open_it)

    return open_held


def _is_wand(plan: RunConfig) -> bool:
    return plan.configuration.tracker == "wand"
