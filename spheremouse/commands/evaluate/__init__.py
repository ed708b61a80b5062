"""`spheremouse evaluate`: run the tracker on recordings and measure it against their truth."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import Assignments, Balls, CameraFile, JsonFile, RigFile
from spheremouse.commands.terminal import table_console
from spheremouse.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the command."""

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
    brightness: float  # grey values
    plot_file: Path | None
    balls: list[Path]
    runs: int
    smooth: bool
    begin: float  # s after the first frame
    end: float  # s after the first frame


def evaluate(
    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET...", show_default=False, help="Folders.")],
    tracker: Annotated[
        str | None, typer.Option(metavar="so3|ekf1|ekf2|wand", help="Filter; recordings of a wand take wand.")
    ] = None,
    detector: Annotated[str | None, typer.Option(metavar="default|blobs", help="Disc detector.")] = None,
    pose: Annotated[
        str, typer.Option(metavar="own|known", help="Camera pose: found from the images, or the true one.")
    ] = "own",
    assignments: Assignments = None,
    config_file: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Configuration file; its source, output and files do not count."),
    ] = None,
    rig_file: RigFile = None,
    camera_file: CameraFile = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Begin with a saved map of discs; it is not changed.")
    ] = None,
    json_file: JsonFile = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw one dataset's run.")
    ] = None,
    noise: Annotated[float, typer.Option(metavar="S", help="Add normal noise, grey values.")] = 0.0,
    brightness: Annotated[float, typer.Option(metavar="L", help="Add a constant, grey values.")] = 0.0,
    balls: Balls = None,
    runs: Annotated[int, typer.Option("--runs", metavar="N", help="Wand: runs with seeds 1 to N.")] = 1,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Add the estimates given all frames, also the later ones (so3).")
    ] = False,
    begin: Annotated[float, typer.Option(metavar="S", min=0.0, help="Begin of the section to track, in s.")] = 0.0,
    end: Annotated[float, typer.Option(metavar="S", min=0.0, help="End of the section, in s.")] = math.inf,
) -> None:
    """Track recordings and compare with their truth."""
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.commands.evaluate.ball import evaluate_balls
    from spheremouse.commands.evaluate.wand import evaluate_wands
    from spheremouse.files.dataset.wand import is_wand
    from spheremouse.files.safe_files import write_json

    if pose not in ("own", "known"):
        raise ConfigurationError(f"--pose: must be own or known, is {pose!r}")
    if not 0.0 <= noise < math.inf:
        raise ConfigurationError(f"--noise: must be 0 or more grey values, is {noise:g}")
    if plot_file is not None and len(datasets) > 1:
        raise ConfigurationError("--plot: draws one dataset; name one at a time")
    check_outputs([json_file, plot_file], [config_file, rig_file, camera_file, map_file, *(balls or ())], True)
    of_wand = tracker == "wand" or (tracker is None and all(is_wand(path) for path in datasets))
    if of_wand:
        others = {"--detector": detector, "--rig": rig_file, "--map": map_file, "--plot": plot_file}
        others |= {"--begin": begin or None, "--end": None if end == math.inf else end}
        others |= {"--noise": noise or None, "--brightness": brightness or None, "--smooth": smooth or None}
        for name, value in others.items():
            if value is not None:
                raise ConfigurationError(f"{name}: does not go with --tracker wand; leave it out")
    options = Options(
        *(datasets, assignments or [], tracker, detector, pose, config_file, rig_file, camera_file, map_file),
        *(noise, brightness, plot_file, balls or [], runs, smooth, begin, end),
    )
    out, err = table_console(stderr=json_file == Path("-")), table_console(stderr=True)
    results, failed = (evaluate_wands if of_wand else evaluate_balls)(options, out, err)
    if json_file is not None and results:
        write_json(json_file, results[0] if len(datasets) == 1 and not smooth else results)
    if failed:
        raise typer.Exit(2)


def about(path: Path, message: str) -> str:
    """Return a message that names its dataset; those of the recording itself contain its path."""
    return message if str(path) in message else f"{path}: {message}"
