"""`spheremouse evaluate`: run the tracker on recordings and measure it against their truth."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from spheremouse.ball.build import build
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Rig, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.commands import terminal
from spheremouse.commands.evaluate.wand import WandEvaluation, evaluate_wands
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.evaluate.history import History
from spheremouse.evaluate.metrics import MIN_AREA, Reference, Run, report
from spheremouse.evaluate.plot import plot_run
from spheremouse.evaluate.table import wand_table
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
    printed_json = json_file == Path("-")
    out, err = _console(stderr=printed_json), _console(stderr=True)
    if tracker == "wand" or (tracker is None and all(is_wand(path) for path in datasets)):
        others = {"--detector": detector, "--rig": rig_file, "--map": map_file, "--plot": plot_file}
        others |= {"--noise": noise or None, "--brightness": brightness or None}
        asked = WandEvaluation(
            datasets, assignments or [], config_file, balls or [], camera_file, pose == "known", runs
        )
        _evaluate_wands(asked, pose, others, json_file, out, err)
        return
    try:
        settings = _settings(config_file, assignments, tracker, detector)
        _check(pose, noise, datasets, json_file, plot_file)
        rig = None if rig_file is None else load_rig(rig_file)
        camera = None if camera_file is None else load_camera(camera_file)
        recordings = [open_dataset(path) for path in datasets]
        rigs = [_rig(recording, rig, camera, pose) for recording in recordings]
        known = [_known(map_file, used_rig, settings) for used_rig in rigs]
        if plot_file is not None and recordings[0].truth is None:
            raise DatasetError(f"{recordings[0].path}: no truth.csv, which --plot compares with")
    except SpheremouseError as e:
        _fail(str(e))
    results: list[dict[str, Any]] = []
    failed = False
    for recording, used_rig, disc_map in zip(recordings, rigs, known, strict=True):
        try:
            run, found = _run(recording, used_rig, settings, noise, brightness, disc_map, err)
        except SpheremouseError as e:
            terminal.error(_about(recording, str(e)))
            failed = True
            continue
        reference = Reference(recording.truth, recording.discs, recording.pose, recording.truth_directions)
        results.append(
            report(
                run,
                reference,
                used_rig,
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
    if results:
        out.print(_table(results, settings, pose))
        for recording in recordings:
            if recording.truth is None:
                text = "no truth.csv: no errors are known; frames tracked, NIS and times say what can be said without"
                err.print(f"{recording.path}: {text}", markup=False, highlight=False)
    try:
        if json_file is not None and results:
            write_json(json_file, results[0] if len(datasets) == 1 else results)
    except SpheremouseError as e:
        _fail(str(e))
    if failed:
        raise typer.Exit(2)


def _evaluate_wands(
    asked: WandEvaluation, pose: str, others: dict[str, Any], json_file: Path | None, out: Console, err: Console
) -> None:
    """The same of hand-held balls; `others` are options that do not go with them, where given."""
    try:
        _check(pose, 0.0, asked.datasets, json_file, None)
        for name, value in others.items():
            if value is not None:
                raise ConfigurationError(f"{name}: does not go with --tracker wand; leave it out")
        results, failed = evaluate_wands(asked, err)
        if results:
            out.print(wand_table(results))
            if json_file is not None:
                write_json(json_file, results[0] if len(asked.datasets) == 1 else results)
    except SpheremouseError as e:
        _fail(str(e))
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


def _fail(message: str) -> NoReturn:
    terminal.error(message)
    raise typer.Exit(2)


# ---- one run ----


def _run(
    recording: Recording,
    rig: Rig,
    settings: Settings,
    noise: float,
    brightness: float,
    known: DiscMap | None,
    err: Console,
) -> tuple[Run, Pose | None]:
    """Track a recording from its first frame; also the camera's pose where it was found from the images."""
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


def _console(stderr: bool) -> Console:
    """As wide as the terminal; into a file or a pipe, as wide as it takes."""
    console = Console(stderr=stderr, soft_wrap=True)
    if not console.is_terminal:
        console.width = 1000
    return console


def _table(results: list[dict[str, Any]], settings: Settings, pose: str) -> Table:
    title = f"{settings.tracker} with detector {settings.detector}, {pose} camera pose"
    table = Table(title=title, caption="in brackets: about or along x, y, z of obj", title_justify="left")
    table.add_column("")
    for result in results:
        table.add_column(result["dataset"], justify="right")
    for label, value in _ROWS:
        table.add_row(label, *[value(result) for result in results])
    return table


def _shown(value: float | None, form: str = ".3g") -> str:
    return "–" if value is None else format(value, form)


def _axes(part: dict[str, float | None], form: str = ".3g") -> str:
    """Combined first, then each axis."""
    if part["combined"] is None:
        return "–"
    return f"{_shown(part['combined'], form)} ({' '.join(_shown(part[a], form) for a in 'xyz' if a in part)})"


def _each(result: dict[str, Any], part: str, *names: str, form: str = ".3g") -> str:
    values = result[part]
    return "–" if values is None else "  ".join(_shown(values[name], form) for name in names)


def _list(result: dict[str, Any], part: str, name: str) -> str:
    values = result[part]
    return "–" if values is None else f"({' '.join(_shown(v, '.2g') for v in values[name])})"


def _percent(result: dict[str, Any], name: str) -> str:
    detection = result["detection"]
    return "–" if detection is None or detection[name] is None else f"{100.0 * detection[name]:.1f}"


_ROWS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("frames tracked / all", lambda r: f"{r['tracked']} / {r['frames']}"),
    ("times lost", lambda r: str(r["lost_episodes"])),
    ("attitude RMSE, °", lambda r: _axes(r["attitude_rmse_deg"])),
    ("rate RMSE, °/s", lambda r: _axes(r["rate_rmse_deg_s"])),
    ("surface speed RMSE, mm/s", lambda r: _axes(r["surface_speed_rmse_mm_s"])),
    ("surface speed, Pearson's r", lambda r: _axes(r["surface_speed_r"], ".4f")),
    ("discs used per frame", lambda r: _shown(r["mean_discs"])),
    ("recognised in the map from frame", lambda r: _shown(r["identified_from_frame"], "d")),
    (f"recall of whole discs ≥ {MIN_AREA:g} px², %", lambda r: _percent(r, "recall")),
    ("points used that are no disc, %", lambda r: _percent(r, "false_share")),
    ("disc centre RMS per axis, px", lambda r: _each(r, "detection", "centre_rms_px")),
    ("camera position error, mm", lambda r: _list(r, "pose_error", "position_mm")),
    ("  its standard deviation, mm", lambda r: _list(r, "pose_error", "sigma_position_mm")),
    ("camera rotation error, °", lambda r: _list(r, "pose_error", "angle_deg")),
    ("  its standard deviation, °", lambda r: _list(r, "pose_error", "sigma_angle_deg")),
    ("NEES of attitude, rate (3 is right)", lambda r: _each(r, "nees", "attitude", "rate")),
    ("NIS per degree of freedom (1 is right)", lambda r: _shown(r["nis"])),
    ("RMSE / bound: attitude, rate", lambda r: _each(r, "bound_ratio", "attitude", "rate")),
    ("time per frame: median, p99, max, µs", lambda r: _each(r, "frame_us", "median", "p99", "max", form=".0f")),
    (
        "median per stage, µs",
        lambda r: "  ".join(f"{stage} {_shown(us, '.0f')}" for stage, us in r["stages_us"].items()) or "–",
    ),
)
