"""The plan of a run: the configuration file, the command line's overrides, and the files that they name.

It is read as a whole or not at all, so a reload never leaves the daemon between two configurations.
"""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from spheremouse import capture as sources
from spheremouse import output as outputs
from spheremouse.ball.build import map_kind
from spheremouse.ball.rig import Rig
from spheremouse.errors import ConfigurationError, OutputError, SourceError
from spheremouse.files import config
from spheremouse.files.access import service_state_folder
from spheremouse.files.ball_map import map_path
from spheremouse.files.exchange import read_saved
from spheremouse.files.registry import check
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.cameras import is_camera
from spheremouse.session.settings import Configuration

if TYPE_CHECKING:
    from spheremouse.wand.ball import WandBall
    from spheremouse.wand.settings import ColourSettings


@dataclass(frozen=True, slots=True)
class Balls:
    """Balls in the order of their numbers, and the bounds of their colours."""

    balls: "tuple[WandBall, ...]" = ()
    colours: "dict[str, ColourSettings]" = field(default_factory=dict)


def read_balls(files: Iterable[Path]) -> Balls:
    """Read balls from wand files.

    If a file is given twice, there are two equal balls. Raises ConfigurationError if a file is invalid, if balls of two
    files share a name, or if two files differ in a colour's bounds.
    """
    named: dict[str, Path] = {}
    balls: list[WandBall] = []
    colours: dict[str, ColourSettings] = {}
    said_by: dict[str, Path] = {}
    for path in files:
        from spheremouse.files.wand import load_wand  # no other tracker needs it

        file = load_wand(path)
        name = file.ball.name
        if name in named and not path.samefile(named[name]):  # a file that is named twice is of two equal balls
            raise ConfigurationError(f"{path}: name: {name} is also the ball of {named[name]}; give each its own name")
        named[name] = path
        balls.append(file.ball)
        for name, bounds in file.colours.items():
            if colours.setdefault(name, bounds) != bounds:
                problem = f"{path}: colours.{name}: other bounds than in {said_by[name]}"
                raise ConfigurationError(problem, "a colour has one set of bounds, or another name")
            said_by.setdefault(name, path)
    return Balls(tuple(balls), colours)


def with_distinct_names(balls: "tuple[WandBall, ...]") -> "tuple[WandBall, ...]":
    """Return the balls with numbers after names that several share, for messages."""
    names = [ball.name for ball in balls]
    return tuple(
        replace(ball, name=f"{ball.name} {names[: k + 1].count(ball.name)}") if names.count(ball.name) > 1 else ball
        for k, ball in enumerate(balls)
    )


@dataclass(frozen=True, slots=True)
class CommandLineOverrides:
    """A configuration file, and the settings that come before it."""

    file: Path | None = None  # the configuration
    assignments: tuple[str, ...] = ()  # KEY=VALUE: those of --set, and options that stand for a setting
    no_map: bool = False
    changes: tuple[str, ...] = ()  # KEY=VALUE by `ctl set`: until the next start or reload
    saved: Path | None = None  # file of the settings that the service saved; they override the configuration


class SecondCamera(NamedTuple):
    """A second camera of the same ball; its rig is in the axes of the first."""

    source: str
    rig: Rig | None  # None: the source brings its own
    rig_path: Path | None


@dataclass(frozen=True, slots=True)
class RunConfig:
    """The checked configuration and its files."""

    configuration: Configuration
    source: str
    outputs: tuple[str, ...]  # the main one first
    rig: Rig | None  # None: the source brings its own
    rig_path: Path | None
    camera: InteriorOrientation | None
    camera_path: Path | None
    map_path: Path | None  # None: no map is kept
    balls: Balls = field(default_factory=Balls)  # in a hand; none: the source's own, or Grzonka's
    ball_paths: tuple[Path, ...] = ()
    without_changes: Configuration = field(default_factory=Configuration)  # without the changes by `ctl set`
    saved: tuple[str, ...] = ()  # KEY=VALUE, by the service
    notice: str = ""  # what was saved, or why it is ignored
    second: SecondCamera | None = None

    @property
    def cameras(self) -> tuple["RunConfig", ...]:
        """The plan of each camera alone."""
        if self.second is None:
            return (self,)
        source, rig, rig_path = self.second
        return replace(self, second=None), replace(self, source=source, rig=rig, rig_path=rig_path, second=None)

    def devices(self, given: Sequence[Rig | None]) -> tuple[Rig, ...]:
        """Return the calibrated device of each camera, as `device`."""
        return tuple(plan.device(rig) for plan, rig in zip(self.cameras, given, strict=True))

    def device(self, given: Rig | None) -> Rig:
        """Return the calibrated device; `given` is that of the source. Raises ConfigurationError if there is none."""
        rig = self.rig or given
        if rig is None:
            problem = f"{self.source}: has no description of the device"
            raise ConfigurationError(problem, "give its rig file with --rig FILE")
        return rig if self.camera is None else replace(rig, camera=self.camera)


def saved_file(configuration: Path | None) -> Path | None:
    """Return the file for settings of a service that may not write its configuration; None for other runs."""
    state = service_state_folder()
    if state is None or configuration is None or os.access(configuration.parent, os.W_OK):
        return None
    return state / "saved.yaml"


def read_run_config(overrides: CommandLineOverrides) -> RunConfig:
    """Read all files and settings of a request. Saved settings with which there is no plan are ignored with a notice.

    Raises ConfigurationError, with file and line for an error in a file.
    """
    if overrides.saved is None:
        return _read(overrides, ())
    try:
        plan = _read(overrides, saved := read_saved(overrides.saved))
        notice = f"{overrides.saved}: in place of the configuration file: {', '.join(saved)}"
        return replace(plan, notice=notice if saved else "")
    except ConfigurationError as e:
        plan = _read(overrides, ())  # raises if the fault is elsewhere
        return replace(plan, notice=f"saved settings ignored: {e}; `spheremouse ctl save --forget` removes them")


def _read(overrides: CommandLineOverrides, saved: tuple[str, ...]) -> RunConfig:
    c = config.in_force(overrides.file, (*saved, *overrides.assignments), Configuration)
    c = without_changes = _with_folder(c, overrides.file)
    for change in overrides.changes:
        c = config.override(c, change, label="")
    c = _with_folder(c, overrides.file)
    if not c.sources:
        hint = "give --source, for example v4l2:/dev/video0, or `source:` in --config FILE"
        raise ConfigurationError(f"no source: {hint}")
    outputs = c.outputs
    if not outputs:
        hint = "give --output, for example uinput or text:-, or `output:` in --config FILE"
        raise ConfigurationError(f'no output: {hint} (in quotes, "null", where motion is to go nowhere)')
    for key, text in contradictions(replace(c, map=None) if overrides.no_map else c):
        raise ConfigurationError(f"{key}: {text}")
    camera_path, map_file = (beside(overrides.file, name) for name in (c.camera_file, c.map))
    rig_paths = [beside(overrides.file, name) for name in c.rigs] or [None] * len(c.sources)
    (rig, rig_path), *others = [(None if path is None else load_rig(path), path) for path in rig_paths]
    camera = None if camera_path is None else load_camera(camera_path)
    if overrides.no_map or c.tracker != "so3":
        map_file = None
    elif map_file is None and rig_path is not None and rig is not None:
        map_file = _usual_map(rig_path, map_kind(rig, c))
    ball_paths = wand_files(overrides.file, c) if c.tracker == "wand" else ()
    balls, (source, *more) = read_balls(ball_paths), map(sources.full_spec, c.sources)
    second = SecondCamera(more[0], *others[0]) if more else None
    files = (rig, rig_path, camera, camera_path, map_file, balls, ball_paths)
    return RunConfig(c, source, outputs, *files, without_changes, saved, second=second)


def contradictions(c: Configuration) -> Iterator[tuple[str, str]]:
    """Yield the key and the problem of each setting that another one excludes."""
    outputs, names = c.outputs, tuple(map(sources.full_spec, c.sources))
    yield from (
        ("output", f"{spec} is given twice; leave one out") for k, spec in enumerate(outputs) if spec in outputs[:k]
    )
    if c.map is not None and c.tracker != "so3":
        yield "map", f"tracker {c.tracker} keeps no map; use so3, or leave the map out"
    if c.rigs and names and len(c.rigs) != len(names):
        numbers = f"{len(c.rigs)} and not {len(names)}, the number of sources"
        yield "rig", f"{numbers}; give one rig file for each source, in the same order"
    if len(names) > 1:
        if c.camera_file is not None:
            yield "camera_file", "belongs to one camera; of two, write each camera into its rig file"
        if c.tracker != "so3":
            yield "source", f"tracker {c.tracker} takes one camera; use so3, or give one source"
        if names[0] == names[1]:
            yield "source", f"{names[0]} is given twice; name another camera, or leave one out"


def check_kinds(plan: RunConfig, before: RunConfig | None = None) -> None:
    """Reject a source or output of an unknown kind or with an invalid argument, unless it is the same as `before`.

    At the start, without `before`, one valid output is enough: opening logs the error of each other one. A missing
    device is accepted, since a user may plug it in later. A change between a ball in its frame and a ball in a hand is
    rejected too.
    """
    if before is not None and "wand" in {plan.configuration.tracker} ^ {before.configuration.tracker}:
        problem = "tracker: a ball in its frame and one in a hand are runs of their own"
        raise ConfigurationError(f"{problem}: stop this run and start again")
    if before is not None and len(plan.cameras) != len(before.cameras):
        raise ConfigurationError("source: one camera more or less is another run: stop this run and start again")
    known = () if before is None else [each.source for each in before.cameras]
    for each in plan.cameras:
        if each.source not in known:
            check(sources, "source", each.source, SourceError)
    if len({is_camera(each.source) for each in plan.cameras}) > 1:
        raise ConfigurationError("source: a camera and a recording have no common clock; give two of one kind")
    errors = list[OutputError]()
    for spec in plan.outputs:
        if before is None or spec not in before.outputs:
            try:
                check(outputs, "output", spec, OutputError)
            except OutputError as e:
                errors.append(e)
    if errors and (before is not None or len(errors) == len(plan.outputs)):
        raise errors[0]


def beside(file: Path | None, name: str | None) -> Path | None:
    """Return a path of the configuration, relative to its folder; None for None."""
    if name is None:
        return None
    path = Path(name).expanduser()
    return path if file is None else file.parent / path


def wand_files(file: Path | None, c: Configuration) -> tuple[Path, ...]:
    return tuple(path for name in c.wand.balls if (path := beside(file, name)) is not None)


def _with_folder(c: Configuration, file: Path | None) -> Configuration:
    """Return the configuration with the path of the recordings' folder, which is relative to its file."""
    if c.record.folder is None:
        return c
    return replace(c, record=replace(c.record, folder=str(beside(file, c.record.folder))))


def _usual_map(rig_path: Path, kind: str) -> Path:
    """Return the map's path beside the rig, or in the state folder of a service."""
    usual = map_path(rig_path, kind)
    state = service_state_folder()
    return usual if state is None or os.access(rig_path.parent, os.W_OK) else state / usual.name
