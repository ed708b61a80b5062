"""`spheremouse evaluate` of a ball in its frame: run a tracker on recordings, compare with their truth."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from spheremouse.ball.build import build
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Rig, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.commands import terminal
from spheremouse.commands.evaluate import Options, about
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.evaluate.metrics import History, Reference, Run, report
from spheremouse.evaluate.plot import plot_run
from spheremouse.evaluate.table import ball_table, consistency, path_notes
from spheremouse.files import config
from spheremouse.files.dataset.ball import Recording, open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.rig import load_camera, load_rig, with_camera
from spheremouse.geometry.camera import Pose
from spheremouse.session.ball.map_keeper import open_map
from spheremouse.session.offline import initialise, track
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.events import degraded

_FILTERED, _SMOOTHED = "", ", smoothed"  # suffixes of a recording's name in the report
_NO_TRUTH = "no truth.csv: no errors are known; the table has the frames tracked, NIS and times"


class _Track(NamedTuple):
    """A recording with the rig and the map of its run."""

    recording: Recording
    rig: Rig
    known: DiscMap | None


def evaluate_balls(options: Options, out: Console, err: Console) -> tuple[list[dict[str, Any]], bool]:
    """Print a table of the datasets. Return their reports, and True if one of them failed."""
    settings = _settings(options)
    tracks = list(_tracks(options, settings))
    if options.plot_file is not None and tracks[0].recording.truth is None:
        raise DatasetError(f"{tracks[0].recording.path}: no truth.csv, which --plot compares with")
    results: list[dict[str, Any]] = []
    tracker, failed = settings.tracker, False
    for each in tracks:
        recording = each.recording
        reference = Reference(recording.truth, recording.discs, recording.pose, recording.truth_directions)
        name, frames = recording.name, recording.frames
        try:
            runs, found = _run(each, settings, options, err)
            for kind, run in runs.items():
                label = f"{name}{kind}"
                results.append(
                    report(run, reference, each.rig, dataset=label, tracker=tracker, frames=frames, found=found)
                )
            if options.plot_file is not None:
                _plot(runs[_FILTERED], recording, options.plot_file)
        except SpheremouseError as e:
            terminal.error(about(recording.path, str(e)))
            failed = True
    if results:
        out.print(ball_table(results, f"{tracker} with detector {settings.detector}, {options.pose} camera pose"))
        for line in [line for result in results for line in (*path_notes(result), *consistency(result))]:
            out.print(line, markup=False)
        for each in tracks:
            if each.recording.truth is None:
                err.print(about(each.recording.path, _NO_TRUTH), markup=False)
    return results, failed


def _settings(options: Options) -> Settings:
    """Return the defaults, changed by the file, each KEY=VALUE, and the options with a name of their own."""
    settings: Settings = config.in_force(options.config_file, options.assignments, Configuration)
    for key, value in (("tracker", options.tracker), ("detector", options.detector)):
        if value is not None:
            settings = config.override(settings, f"{key}={value}", label="--")
    if options.smooth and settings.tracker != "so3":
        raise ConfigurationError(f"--smooth: there is no smoother for {settings.tracker}; use so3, or leave it out")
    if settings.tracker == "wand":
        raise ConfigurationError("tracker: wand is for balls in a hand; --tracker so3 is for one in its frame")
    return settings


def _tracks(options: Options, settings: Settings) -> Iterator[_Track]:
    given = None if options.rig_file is None else load_rig(options.rig_file)
    camera = None if options.camera_file is None else load_camera(options.camera_file)
    if options.map_file is not None and settings.tracker != "so3":
        raise ConfigurationError(f"--map: tracker {settings.tracker} keeps no map; use so3, or leave --map out")
    for path in options.datasets:
        recording = open_dataset(path)
        rig = recording.rig if given is None else given
        if rig.scale_free and not recording.rig.scale_free:  # the truth is in metres
            rig = in_metres(rig, recording.rig.ball.radius / rig.ball.radius)
        rig = rig if camera is None else with_camera(rig, camera)
        if options.pose == "known":
            if recording.pose is None:
                raise DatasetError(f"{path}: scene.json has no truth_T_obj_cam, which --pose known takes")
            rig = replace(rig, pose=recording.pose)
        known = None if options.map_file is None else open_map(options.map_file, rig).map
        yield _Track(recording, rig, known)


def _run(each: _Track, settings: Settings, options: Options, err: Console) -> tuple[dict[str, Run], Pose | None]:
    """Track a recording from its first frame. Also return the camera's pose if it was found from the images.

    The runs have the suffix of the recording's name in the report as key. With `--smooth` there are two.
    """
    recording, rig, known = each
    # numbered as the rows of the truth: a live camera also counts the frames that it dropped
    numbered = (replace(frame, sequence=i) for i, frame in enumerate(read_frames(recording)))
    frames = degraded(numbered, options.noise, options.brightness)
    with terminal.progress_bar() as progress:
        task = progress.add_task(recording.name, total=recording.frames)
        passed_over: list[str] = []  # reasons why the first views gave no pose, if later ones did
        start = initialise(frames, rig, settings, report=passed_over.append)
        for text in passed_over:
            err.print(f"{about(recording.path, text)} (first frames passed over)", markup=False)
        history = History()
        tracker = build(rig, start.pose, settings)
        for epoch in track(start.frames, tracker, known):
            history.add(epoch)
            progress.update(task, completed=epoch.frame.sequence + 1)
    runs = {_FILTERED: history.run()}
    if options.smooth:
        runs[_SMOOTHED] = history.smoothed(tracker).run()
    return runs, None if start.resection is None else start.pose


def _plot(run: Run, recording: Recording, path: Path) -> None:
    """Draw the tracked frames; those between are gaps."""
    kept, truth = run.tracked, recording.truth
    assert truth is not None
    if len(kept) == 0:
        raise DatasetError(f"{recording.path}: nothing was tracked, so there is nothing to draw for --plot")
    true = truth.attitude[run.frame[kept]], truth.rate[run.frame[kept]]
    plot_run(run.stamp[kept], run.attitude[kept], run.rate[kept], *true, run.covariance[kept], path)
