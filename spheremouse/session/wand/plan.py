"""What a run of the wand is to do: balls, camera and source, checked and read, besides the plan that all runs have."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from spheremouse.capture import Source, Stream, open_source, paced
from spheremouse.errors import ConfigurationError, SourceError
from spheremouse.files.dataset.wand import open_wand, read_wand_frames
from spheremouse.files.wand import load_wand
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.output import Output, open_output
from spheremouse.output.axes import AxesOutput
from spheremouse.session.plan import Plan, Request, beside
from spheremouse.session.wand.settings import WandRunSettings
from spheremouse.wand.ball import WandBall, grzonka_ball
from spheremouse.wand.rims import ColourSettings
from spheremouse.wand.state import WandTracker
from spheremouse.wand.track import build


@dataclass(frozen=True, slots=True)
class Given:
    """A source, and what it knows itself."""

    source: Source
    camera: InteriorOrientation | None = None
    balls: tuple[WandBall, ...] = ()


def open_given(spec: str, realtime: bool) -> Given:
    """A source that is no camera: recordings of wands bring camera and balls along."""
    kind, _, argument = spec.partition(":")
    if kind == "synthetic":
        raise SourceError(f"{spec}: simulates no wand; film one with `spheremouse wand simulate DIR`, give dataset:DIR")
    if kind != "dataset":
        return Given(open_source(spec, realtime=realtime))
    if not argument:
        raise SourceError("dataset: needs a folder; write dataset:DIR")
    recording = open_wand(Path(argument))
    frames = read_wand_frames(recording)
    stream = Stream(paced(frames) if realtime else frames, fps=recording.fps, count=recording.frames)
    return Given(stream, recording.camera, recording.balls)


def wand_tracker(plan: Plan, request: Request, files: list[Path], given: Given | None) -> WandTracker:
    """The tracker of a run; `files` are the balls of the command line, above those of the configuration."""
    settings = plan.configuration.wand
    camera = _camera(plan, given)
    named = files or [path for name in settings.balls if (path := beside(request.file, name)) is not None]
    balls, colours = read_balls(named)
    balls = balls or (() if given is None else given.balls) or (grzonka_ball(),)
    if settings.points > len(balls):
        many = "is one ball" if len(balls) == 1 else f"are {len(balls)} balls"
        raise ConfigurationError(f"wand.points: is {settings.points}, but there {many}; balls are counted from 1")
    return build(camera, told_apart(balls), settings, colours)


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where pointer and axes go: what opens each, and the axes to be told of poses."""

    open_pointer: Callable[[], Output]
    open_axes: Callable[[], Output] | None  # besides the pointer
    axes: tuple[AxesOutput, ...]


def wand_outputs(output: str, settings: WandRunSettings) -> Outputs:
    """The outputs of a run: text outputs get the axes with the counts."""
    kind, _, argument = output.partition(":")
    found: list[AxesOutput] = []
    if kind == "text":
        found.append(AxesOutput(argument, settings.points - 1))
    if settings.axes is not None:
        if kind == "text" and _place(argument) == _place(settings.axes):
            raise ConfigurationError(f"--axes {settings.axes}: is the output already, which has the axes; leave it out")
        found.append(AxesOutput(settings.axes, settings.points - 1))
    open_pointer = found[0].open if kind == "text" else partial(open_output, output)
    return Outputs(open_pointer, None if settings.axes is None else found[-1].open, tuple(found))


def _place(argument: str) -> str:
    return "-" if argument in ("", "-") else str(Path(argument).absolute())


def _camera(plan: Plan, given: Given | None) -> InteriorOrientation:
    """The camera that was asked for, else the rig's, else the recording's own."""
    if plan.camera is not None:
        return plan.camera
    if plan.rig is not None:
        return plan.rig.camera
    if given is not None and given.camera is not None:
        return given.camera
    raise ConfigurationError(
        f"{plan.source}: says nothing of the camera; give its file with --camera FILE (`spheremouse calibrate camera` "
        "makes it)"
    )


def read_balls(files: Iterable[Path]) -> tuple[tuple[WandBall, ...], dict[str, ColourSettings]]:
    """Balls of wand files, and the bounds of their colours, which must be the same in all of them."""
    balls: list[WandBall] = []
    colours: dict[str, ColourSettings] = {}
    said_by: dict[str, Path] = {}
    for path in files:
        file = load_wand(path)
        balls.append(file.ball)
        for name, bounds in file.colours.items():
            if colours.setdefault(name, bounds) != bounds:
                raise ConfigurationError(
                    f"{path}: colours.{name}: other bounds than in {said_by[name]}; a colour has one set of bounds, "
                    "or another name"
                )
            said_by.setdefault(name, path)
    return tuple(balls), colours


def told_apart(balls: tuple[WandBall, ...]) -> tuple[WandBall, ...]:
    """Balls of the same name get numbers, for messages."""
    names = [ball.name for ball in balls]
    return tuple(
        replace(ball, name=f"{ball.name} {names[: k + 1].count(ball.name)}") if names.count(ball.name) > 1 else ball
        for k, ball in enumerate(balls)
    )
