"""Setup of a run of hand-held balls: camera, balls, and the source, which may bring both."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from spheremouse.capture import Source, Stream, open_source, paced
from spheremouse.errors import ConfigurationError, SourceError
from spheremouse.files.dataset.wand import open_wand, read_wand_frames
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.balls import told_apart
from spheremouse.session.follower import Do
from spheremouse.session.plan import Plan, Request
from spheremouse.session.wand.follower import WandFollower
from spheremouse.session.wand.offline import make_wand_ready
from spheremouse.tracker import Frame
from spheremouse.wand.ball import WandBall, grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.state import WandTracker


@dataclass(frozen=True, slots=True)
class WandSetup:
    """A source that is no camera, where there is one, and what it knows itself."""

    source: Source | None = None
    camera: InteriorOrientation | None = None
    balls: tuple[WandBall, ...] = ()

    def planned(self, request: Request, plan: Plan) -> Plan:
        """As it is."""
        return plan

    def open(self, plan: Plan) -> Source:
        """A recording of balls in a hand, held to its stamps."""
        source = wand_setup(plan.source, realtime=True).source
        assert source is not None
        return source

    def make_ready(self, plan: Plan, tell: Callable[[str], None] | None = None) -> None:
        """Compile the particle filter."""
        make_wand_ready(tell)

    def follower(self, plan: Plan, say: Callable[[str], None], do: Do) -> WandFollower:
        """Raises ConfigurationError without a camera, or where no ball points."""
        made = WandFollower(self.tracker, plan, say)
        made.introduce()
        return made

    def begin(self, frames: Iterator[Frame], follower: WandFollower) -> Iterator[Frame]:
        """All of them."""
        return frames

    def tracker(self, plan: Plan) -> WandTracker:
        """The tracker of a plan: of its balls, else the recording's own, else Grzonka's."""
        settings = plan.configuration.wand
        camera = _camera(plan, self.camera)
        balls = plan.balls.balls or self.balls or (grzonka_ball(),)
        if settings.points > len(balls):
            many = "is one ball" if len(balls) == 1 else f"are {len(balls)} balls"
            raise ConfigurationError(f"wand.points: is {settings.points}, but there {many}; balls are counted from 1")
        return build(camera, told_apart(balls), settings, plan.balls.colours)


def wand_setup(spec: str, realtime: bool) -> WandSetup:
    """Open a source that is no camera. A wand's recording brings camera and balls."""
    kind, _, argument = spec.partition(":")
    if kind == "synthetic":
        raise SourceError(f"{spec}: simulates no wand; film one with `spheremouse wand simulate DIR`, give dataset:DIR")
    if kind != "dataset":
        return WandSetup(open_source(spec, realtime=realtime))
    if not argument:
        raise SourceError("dataset: needs a folder; write dataset:DIR")
    recording = open_wand(Path(argument))
    frames = read_wand_frames(recording)
    stream = Stream(paced(frames) if realtime else frames, fps=recording.fps, count=recording.frames)
    return WandSetup(stream, recording.camera, recording.balls)


def _camera(plan: Plan, given: InteriorOrientation | None) -> InteriorOrientation:
    """Return the camera of the plan, else that of the rig, else that of the recording."""
    if plan.camera is not None:
        return plan.camera
    if plan.rig is not None:
        return plan.rig.camera
    if given is not None:
        return given
    raise ConfigurationError(
        f"{plan.source}: says nothing of the camera; give its file with --camera FILE (`spheremouse calibrate camera` "
        "makes it)"
    )
