"""`spheremouse evaluate` of a ball in its frame: run a tracker on recordings, compare with their truth.

The command line is that of `evaluate`, which hands over here.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from spheremouse.ball.build import build
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Rig, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.commands import terminal
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.evaluate.history import History
from spheremouse.evaluate.metrics import Reference, Run, report
from spheremouse.evaluate.plot import plot_run
from spheremouse.evaluate.table import ball_table
from spheremouse.files import config
from spheremouse.files.dataset.ball import Recording, open_dataset, read_frames
from spheremouse.files.rig import load_camera, load_rig, with_camera
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.session.ball.map_keeper import open_map
from spheremouse.session.offline import initialise, track
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.degrade import degraded


@dataclass(frozen=True, slots=True)
class BallEvaluation:
    """Options of an evaluation."""

    datasets: list[Path]
    assignments: list[str]
    tracker: str | None
    detector: str | None
    pose: str  # own or known
    config_file: Path | None
    rig_file: Path | None
    camera_file: Path | None
    map_file: Path | None
    noise: float  # grey values
    brightness: float  # the same
    plot_file: Path | None


def evaluate_balls(asked: BallEvaluation, out: Console, say: Console) -> tuple[list[dict[str, Any]], bool]:
    """Reports of the datasets, which go `out` as a table, and whether one of them failed, which `say` tells."""
    settings = _settings(asked)
    tracks = _tracks(asked, settings)
    if asked.plot_file is not None and tracks[0].recording.truth is None:
        raise DatasetError(f"{tracks[0].recording.path}: no truth.csv, which --plot compares with")
    results, failed = _evaluated(tracks, settings, asked.noise, asked.brightness, asked.plot_file, say)
    if results:
        how = f"{settings.tracker} with detector {settings.detector}, {asked.pose} camera pose"
        out.print(ball_table(results, how))
        _say_where_no_truth_is(tracks, say)
    return results, failed


def _settings(asked: BallEvaluation) -> Settings:
    """The defaults, then the file, then each KEY=VALUE, then the options with a name of their own."""
    settings: Settings = config.in_force(asked.config_file, asked.assignments, Configuration)
    for key, value in (("tracker", asked.tracker), ("detector", asked.detector)):
        if value is not None:
            settings = config.override(settings, f"{key}={value}", label="--")
    if settings.tracker == "wand":
        raise ConfigurationError("tracker: wand is for balls in a hand; --tracker so3 is for one in its frame")
    return settings


class _Track(NamedTuple):
    """A recording, and with what it is tracked."""

    recording: Recording
    rig: Rig
    known: DiscMap | None


def _tracks(asked: BallEvaluation, settings: Settings) -> list[_Track]:
    rig = None if asked.rig_file is None else load_rig(asked.rig_file)
    camera = None if asked.camera_file is None else load_camera(asked.camera_file)
    recordings = [open_dataset(path) for path in asked.datasets]
    rigs = [_rig(recording, rig, camera, asked.pose) for recording in recordings]
    known = [_known(asked.map_file, used_rig, settings) for used_rig in rigs]
    return [_Track(*each) for each in zip(recordings, rigs, known, strict=True)]


def _rig(recording: Recording, rig: Rig | None, camera: InteriorOrientation | None, pose: str) -> Rig:
    rig = recording.rig if rig is None else rig
    if rig.scale_free and not recording.rig.scale_free:  # the truth is in metres
        rig = in_metres(rig, recording.rig.ball.radius / rig.ball.radius)
    rig = rig if camera is None else with_camera(rig, camera)
    if pose == "own":
        return rig
    if recording.pose is None:
        raise DatasetError(f"{recording.path}: scene.json has no truth_T_obj_cam, which --pose known takes")
    return replace(rig, pose=recording.pose)


def _known(file: Path | None, rig: Rig, settings: Settings) -> DiscMap | None:
    if file is None:
        return None
    if settings.tracker != "so3":
        raise ConfigurationError(f"--map: tracker {settings.tracker} keeps no map; use so3, or leave --map out")
    return open_map(file, rig).map


def _about(recording: Recording, message: str) -> str:
    """A message that says which dataset it is about; those of the recording itself begin with its path."""
    return message if str(recording.path) in message else f"{recording.path}: {message}"


# ---- runs ----


def _evaluated(
    tracks: list[_Track],
    settings: Settings,
    noise: float,
    brightness: float,
    plot_file: Path | None,
    err: Console,
) -> tuple[list[dict[str, Any]], bool]:
    """Return the reports of the recordings, and True if one failed. Failures are printed."""
    results: list[dict[str, Any]] = []
    failed = False
    for each in tracks:
        recording = each.recording
        try:
            run, found = _run(each, settings, noise, brightness, err)
        except SpheremouseError as e:
            terminal.error(_about(recording, str(e)))
            failed = True
            continue
        results.append(
            report(
                run,
                Reference(recording.truth, recording.discs, recording.pose, recording.truth_directions),
                each.rig,
                dataset=recording.name,
                tracker=settings.tracker,
                frames=recording.frames,
                found=found,
            )
        )
        try:
            if plot_file is not None:
                _plot(run, recording, plot_file)
        except SpheremouseError as e:
            terminal.error(str(e))
            failed = True
    return results, failed


def _run(each: _Track, settings: Settings, noise: float, brightness: float, err: Console) -> tuple[Run, Pose | None]:
    """Track a recording from its first frame; also the camera's pose where it was found from the images."""
    recording, rig, known = each
    # by their index, which is what the truth's rows go by: a live camera counts those too that were dropped
    numbered = (replace(frame, sequence=i) for i, frame in enumerate(read_frames(recording)))
    frames = degraded(numbered, noise, brightness)
    with terminal.progress_bar() as progress:
        task = progress.add_task(recording.name, total=recording.frames)
        passed_over: list[str] = []  # why the first views gave no pose: said only where later ones did
        start = initialise(frames, rig, settings, report=passed_over.append)
        for text in passed_over:
            err.print(f"{_about(recording, text)} (first frames passed over)", markup=False, highlight=False)
        history = History()
        for epoch in track(start.frames, build(rig, start.pose, settings), known):
            history.add(epoch)
            progress.update(task, completed=epoch.frame.sequence + 1)
    return history.run(), None if start.resection is None else start.pose


def _plot(run: Run, recording: Recording, path: Path) -> None:
    """The tracked frames; those between are gaps."""
    kept, truth = run.tracked, recording.truth
    assert truth is not None
    if len(kept) == 0:
        raise DatasetError(f"{recording.path}: nothing was tracked, so there is nothing to draw for --plot")
    true = truth.attitude[run.frame[kept]], truth.rate[run.frame[kept]]
    plot_run(run.stamp[kept], run.attitude[kept], run.rate[kept], *true, run.covariance[kept], path)


def _say_where_no_truth_is(tracks: list[_Track], err: Console) -> None:
    for recording, _, _ in tracks:
        if recording.truth is None:
            text = "no truth.csv: no errors are known; frames tracked, NIS and times say what can be said without"
            err.print(f"{recording.path}: {text}", markup=False, highlight=False)
