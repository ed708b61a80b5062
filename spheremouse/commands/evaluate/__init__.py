"""`spheremouse evaluate`: run the tracker on recordings and measure it against their truth."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.console import Console

from spheremouse.ball.build import build
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Rig, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.commands import terminal
from spheremouse.commands.evaluate.wand import WandEvaluation, evaluate_wands
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.evaluate.history import History
from spheremouse.evaluate.metrics import Reference, Run, report
from spheremouse.evaluate.plot import plot_run
from spheremouse.evaluate.table import ball_table, wand_table
from spheremouse.files import config
from spheremouse.files.atomic import write_json
from spheremouse.files.dataset.ball import Recording, open_dataset, read_frames
from spheremouse.files.dataset.wand import is_wand
from spheremouse.files.report.style import require_matplotlib
from spheremouse.files.rig import load_camera, load_rig, with_camera
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.session.ball.map_keeper import open_map
from spheremouse.session.offline import initialise, track
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.degrade import degraded


def evaluate(
    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET...", show_default=False, help="Folders.")],
    tracker: Annotated[
        str | None, typer.Option(metavar="so3|ekf1|ekf2|wand", help="Filter; recordings of a wand take wand.")
    ] = None,
    detector: Annotated[str | None, typer.Option(metavar="default|blobs", help="Disc detector.")] = None,
    pose: Annotated[
        str, typer.Option(metavar="own|known", help="Camera pose: found from the images, or the true one.")
    ] = "own",
    assignments: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter.")] = None,
    config_file: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Configuration file; its source, output and files do not count."),
    ] = None,
    rig_file: Annotated[Path | None, typer.Option("--rig", metavar="FILE", help="In place of the dataset's.")] = None,
    camera_file: Annotated[Path | None, typer.Option("--camera", metavar="FILE", help="Interior orientation.")] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Begin with a saved map of discs; it is not changed.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw one dataset's run.")
    ] = None,
    noise: Annotated[float, typer.Option(metavar="S", help="Add normal noise, grey values.")] = 0.0,
    brightness: Annotated[float, typer.Option(metavar="L", help="Add a constant, grey values.")] = 0.0,
    balls: Annotated[
        list[Path] | None,
        typer.Option("--ball", metavar="FILE", help="Wand: the ball, in place of the dataset's; may be repeated."),
    ] = None,
    runs: Annotated[int, typer.Option("--runs", metavar="N", help="Wand: runs with seeds 1 to N.")] = 1,
) -> None:
    """Track recordings and compare with their truth."""
    out, err = _console(stderr=json_file == Path("-")), _console(stderr=True)
    if tracker == "wand" or (tracker is None and all(is_wand(path) for path in datasets)):
        _check(pose, 0.0, datasets, json_file, None)
        others = {"--detector": detector, "--rig": rig_file, "--map": map_file, "--plot": plot_file}
        others |= {"--noise": noise or None, "--brightness": brightness or None}
        for name, value in others.items():
            if value is not None:
                raise ConfigurationError(f"{name}: does not go with --tracker wand; leave it out")
        results, failed = evaluate_wands(
            WandEvaluation(datasets, assignments or [], config_file, balls or [], camera_file, pose == "known", runs),
            err,
        )
        if results:
            out.print(wand_table(results))
    else:
        settings = _settings(config_file, assignments, tracker, detector)
        _check(pose, noise, datasets, json_file, plot_file)
        tracks = _tracks(datasets, settings, pose, rig_file, camera_file, map_file)
        if plot_file is not None and tracks[0].recording.truth is None:
            raise DatasetError(f"{tracks[0].recording.path}: no truth.csv, which --plot compares with")
        results, failed = _evaluated(tracks, settings, noise, brightness, plot_file, err)
        if results:
            out.print(ball_table(results, f"{settings.tracker} with detector {settings.detector}, {pose} camera pose"))
            _say_where_no_truth_is(tracks, err)
    if json_file is not None and results:
        write_json(json_file, results[0] if len(datasets) == 1 else results)
    if failed:
        raise typer.Exit(2)


# ---- what is asked for ----


def _settings(file: Path | None, assignments: list[str] | None, tracker: str | None, detector: str | None) -> Settings:
    """The defaults, then the file, then each KEY=VALUE, then the options with a name of their own."""
    settings: Settings = config.in_force(file, assignments or (), Configuration)
    for key, value in (("tracker", tracker), ("detector", detector)):
        if value is not None:
            settings = config.override(settings, f"{key}={value}", label="--")
    if settings.tracker == "wand":
        raise ConfigurationError("tracker: wand is for balls in a hand; --tracker so3 is for one in its frame")
    return settings


def _check(pose: str, noise: float, datasets: list[Path], json_file: Path | None, plot_file: Path | None) -> None:
    if pose not in ("own", "known"):
        raise ConfigurationError(f"--pose: must be own or known, is {pose!r}")
    if not 0.0 <= noise < np.inf:
        raise ConfigurationError(f"--noise: must be 0 or more grey values, is {noise:g}")
    for name, path in (("--json", json_file), ("--plot", plot_file)):
        if path is not None and not path.parent.is_dir():
            raise ConfigurationError(f"{name}: {path.parent}: no such folder")
    if plot_file is not None:
        if len(datasets) > 1:
            raise ConfigurationError("--plot: draws one dataset; name one at a time")
        require_matplotlib()


class _Track(NamedTuple):
    """A recording, and with what it is tracked."""

    recording: Recording
    rig: Rig
    known: DiscMap | None


def _tracks(
    datasets: list[Path],
    settings: Settings,
    pose: str,
    rig_file: Path | None,
    camera_file: Path | None,
    map_file: Path | None,
) -> list[_Track]:
    rig = None if rig_file is None else load_rig(rig_file)
    camera = None if camera_file is None else load_camera(camera_file)
    recordings = [open_dataset(path) for path in datasets]
    rigs = [_rig(recording, rig, camera, pose) for recording in recordings]
    known = [_known(map_file, used_rig, settings) for used_rig in rigs]
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
    """Reports of the recordings, and whether something failed, which is said."""
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


def _console(stderr: bool) -> Console:
    """As wide as the terminal; into a file or a pipe, as wide as it takes."""
    console = Console(stderr=stderr, soft_wrap=True)
    if not console.is_terminal:
        console.width = 1000
    return console
