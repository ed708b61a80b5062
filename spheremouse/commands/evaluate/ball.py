"""`spheremouse evaluate` of a ball in its frame: run a tracker on recordings, compare with their truth."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.build import detector_name, map_kind
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.capture import section
from spheremouse.commands import terminal
from spheremouse.commands.evaluate import Options, about
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.evaluation.plot import plot_run
from spheremouse.evaluation.table import ball_table, consistency, path_notes
from spheremouse.files import config
from spheremouse.files.dataset.ball import Recording, open_dataset
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.session.ball.map_keeper import open_map
from spheremouse.session.evaluate import BallRun, FurtherCamera, ball_reports, join, numbered_frames, rig_of, run_ball
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.events import degrade

_NO_TRUTH = "no truth.csv: no errors are known; the table has the frames tracked, NIS and times"


class _Track(NamedTuple):
    recording: Recording
    rig: Rig
    known: BallMap | None
    beside: Recording | None = None  # by a second camera

    @property
    def truth(self) -> Recording:
        """The recording that has the truth of all frames."""
        return self.recording if self.beside is None else join(self.recording, self.beside)


def evaluate_balls(options: Options, out: Console, err: Console) -> tuple[list[dict[str, Any]], bool]:
    """Print a table of the datasets. Return their reports, and True if one of them failed.

    Raises DatasetError if a dataset does not open or lacks the truth that an option needs, ConfigurationError for
    `--map` with a tracker that keeps none.
    """
    settings = _settings(options)
    tracks = list(_tracks(options, settings))
    if options.plot_file is not None:
        for recording in filter(None, (tracks[0].recording, tracks[0].beside)):
            if recording.truth is None:
                raise DatasetError(f"{recording.path}: no truth.csv, which --plot compares with")
    results: list[dict[str, Any]] = []
    failed = False
    for each in tracks:
        recording = each.recording
        try:
            run = _run(each, settings, options, err)
            results += ball_reports(run, each.truth, options.smooth)
            if options.plot_file is not None:
                made = run.history.run()
                if len(made.tracked) == 0:
                    raise DatasetError(f"{recording.path}: nothing was tracked, so there is nothing to draw for --plot")
                assert each.truth.truth is not None
                plot_run(made, each.truth.truth, options.plot_file)
        except SpheremouseError as e:
            terminal.error(about(recording.path, str(e)))
            failed = True
    if results:
        detectors = " and ".join(dict.fromkeys(detector_name(each.rig, settings) for each in tracks))
        method = f"{settings.tracker} with detector {detectors}, {options.pose} camera pose"
        out.print(ball_table(results, method))
        for line in [line for result in results for line in (*path_notes(result), *consistency(result))]:
            out.print(line, markup=False)
        for each in tracks:
            if each.recording.truth is None:
                err.print(about(each.recording.path, _NO_TRUTH), markup=False)
    return results, failed


def _settings(options: Options) -> Settings:
    """Return the defaults, changed by the file, each KEY=VALUE, and the options with a name of their own."""
    settings: Settings = config.in_force(options.config_file, options.assignments or (), Configuration)
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
        rig = rig_of(recording, given)
        rig = rig if camera is None else replace(rig, camera=camera)
        rig = _with_pose(rig, recording, options)
        known = None if options.map_file is None else open_map(options.map_file, rig, map_kind(rig, settings)).map
        yield _Track(recording, rig, known, None if options.beside is None else open_dataset(options.beside))


def _with_pose(rig: Rig, recording: Recording, options: Options) -> Rig:
    if options.pose != "known":
        return rig
    if recording.pose is None:
        raise DatasetError(f"{recording.path}: scene.json has no truth_T_obj_cam, which --pose known takes")
    return replace(rig, pose=recording.pose)


def _run(each: _Track, settings: Settings, options: Options, err: Console) -> BallRun:
    """Track one dataset with a progress bar, and print why the first frames gave no pose."""
    recording, rig, known, beside = each
    others = []
    if beside is not None:
        seen = section(numbered_frames(beside, recording.frames), options.begin, options.end)
        seen = degrade(iter(seen), options.noise, options.brightness)
        others.append(FurtherCamera(seen, _with_pose(beside.rig, beside, options), beside.turn))
    since = recording.seconds - recording.seconds[0]
    total = int(np.count_nonzero((since >= options.begin) & (since < options.end)))
    with terminal.progress_bar() as progress:
        numbered = section(numbered_frames(recording), options.begin, options.end)
        frames = progress.track(numbered, total, description=recording.name)
        passed_over: list[str] = []  # reasons why the first views gave no pose, if later ones did
        run = run_ball(
            degrade(iter(frames), options.noise, options.brightness), rig, settings, known, passed_over.append, others
        )
    for text in passed_over:
        err.print(f"{about(recording.path, text)} (first frames passed over)", markup=False)
    return run
