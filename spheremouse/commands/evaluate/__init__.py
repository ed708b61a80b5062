"""`spheremouse evaluate`: run the tracker on recordings and measure it against their truth."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from spheremouse.commands.options import Assignments, Balls, CameraFile, JsonFile, RigFile, with_fields
from spheremouse.commands.terminal import table_console
from spheremouse.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the command."""

    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET...", show_default=False, help="Folders.")]
    tracker: Annotated[
        str | None, typer.Option(metavar="so3|ekf1|ekf2|wand", help="Filter; recordings of a wand take wand.")
    ] = None
    detector: Annotated[str | None, typer.Option(metavar="default|blobs|texture|both", help="Detector.")] = None
    pose: Annotated[
        Literal["own", "known"], typer.Option(help="Camera pose: found from the images, or the true one.")
    ] = "own"
    assignments: Assignments = None
    config_file: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Configuration file; its source, output and files do not count."),
    ] = None
    beside: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Film by a second camera, merged by stamp; it has its own rig, and true axes."
        ),
    ] = None
    rig_file: RigFile = None
    camera_file: CameraFile = None
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Begin with a saved map; it is not changed.")
    ] = None
    json_file: JsonFile = None
    plot_file: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw one dataset's run.")] = None
    noise: Annotated[float, typer.Option(metavar="S", min=0.0, help="Add normal noise, grey values.")] = 0.0
    brightness: Annotated[float, typer.Option(metavar="L", help="Add a constant, grey values.")] = 0.0
    balls: Balls = None
    runs: Annotated[int, typer.Option("--runs", metavar="N", min=1, help="Wand: runs with seeds 1 to N.")] = 1
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Add the estimates given all frames, also the later ones (so3).")
    ] = False
    begin: Annotated[float, typer.Option(metavar="S", min=0.0, help="Begin of the section to track, in s.")] = 0.0
    end: Annotated[float, typer.Option(metavar="S", min=0.0, help="End of the section, in s.")] = math.inf


@with_fields()
def evaluate(*, options: Options) -> None:
    """Track recordings and compare with their truth."""
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.commands.evaluate.ball import evaluate_balls
    from spheremouse.commands.evaluate.wand import evaluate_wands
    from spheremouse.files.dataset.wand import is_wand
    from spheremouse.files.safe_files import write_json

    o = options
    if o.plot_file is not None and len(o.datasets) > 1:
        raise ConfigurationError("--plot: draws one dataset; name one at a time")
    if o.beside is not None and len(o.datasets) > 1:
        raise ConfigurationError("--beside: belongs to one dataset; name one at a time")
    if not math.isfinite(o.noise + o.brightness):
        raise ConfigurationError("--noise, --brightness: must be finite numbers")
    inputs = [o.config_file, o.rig_file, o.camera_file, o.map_file, *(o.balls or ())]
    check_outputs([o.json_file, o.plot_file], inputs, force=True)
    of_wand = o.tracker == "wand" or (o.tracker is None and all(is_wand(path) for path in o.datasets))
    if of_wand:
        others = {"--detector": o.detector, "--rig": o.rig_file, "--map": o.map_file, "--plot": o.plot_file}
        others |= {"--beside": o.beside}
        others |= {"--begin": o.begin or None, "--end": None if o.end == math.inf else o.end}
        others |= {"--noise": o.noise or None, "--brightness": o.brightness or None, "--smooth": o.smooth or None}
        for name, value in others.items():
            if value is not None:
                raise ConfigurationError(f"{name}: does not go with --tracker wand; leave it out")
    out, err = table_console(stderr=o.json_file == Path("-")), table_console(stderr=True)
    results, failed = (evaluate_wands if of_wand else evaluate_balls)(o, out, err)
    if o.json_file is not None and results:
        write_json(o.json_file, results[0] if len(o.datasets) == 1 and not o.smooth else results)
    if failed:
        raise typer.Exit(2)


def about(path: Path, message: str) -> str:
    """Return a message that names its dataset; those of the recording itself contain its path."""
    return message if str(path) in message else f"{path}: {message}"
