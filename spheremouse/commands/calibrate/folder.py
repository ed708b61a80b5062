"""`spheremouse calibrate init` and `next`: the folder of a device, and the checklist of its calibration."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.options import Cabinet, JsonFile
from spheremouse.commands.terminal import table_console
from spheremouse.errors import CalibrationError, ConfigurationError, os_errors_as

if TYPE_CHECKING:
    from rich.console import Console

    from spheremouse.calibrate.guide.checklist import Step

_STYLES = {"done": "green", "too few": "yellow", "not needed": "dim", "next": "bold yellow", "later": "dim"}


def init(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="One folder for each device.  [default: cabinet]")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace device.yaml, even if filled in. Photos stay.")
    ] = False,
) -> None:
    """Make a folder with room for photos, and device.yaml to fill in."""
    from spheremouse.calibrate.guide.folder import default_folder, next_command
    from spheremouse.files.device import device_template
    from spheremouse.files.safe_files import write_atomically

    folder = default_folder() if folder is None else folder
    for place in (folder / "board", folder / "device"):
        with os_errors_as(CalibrationError, f"{place}: cannot be made", "choose another place"):
            place.mkdir(parents=True, exist_ok=True)
    path = folder / "device.yaml"
    if path.exists() and not force:
        typer.echo(f"{path}: there already, kept as it is (--force replaces it)")
    else:
        write_atomically(path, device_template())
        typer.echo(f"{path}: written; open it in an editor and enter your measurements")
    typer.echo(f"{folder / 'board'}, {folder / 'device'}: photos of the board and of the device go here")
    typer.echo("To print board, targets and discs: spheremouse calibrate print")
    typer.echo(f"The next step, now and at any time: {next_command(folder)}")


def next_(
    folder: Cabinet = None,
    json_file: JsonFile = None,
) -> None:
    """Show how far a calibration is, and the next step with its command.

    It reads only files: those of the folder, printed pages, and the service's rig. So you can leave a calibration
    at any time and continue it later.
    """
    from spheremouse.calibrate.guide.checklist import checklist
    from spheremouse.calibrate.guide.folder import default_folder
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.files.safe_files import write_json

    folder = default_folder() if folder is None else folder
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; name the folder that `spheremouse calibrate init` made")
    check_outputs([json_file], [folder], force=True)
    steps = checklist(folder)
    described = {"folder": str(folder), "steps": [dataclasses.asdict(s) for s in steps]}
    if json_file is None or not write_json(json_file, described):
        _show(steps)


def _show(steps: "Sequence[Step]") -> None:
    from rich.table import Table
    from rich.text import Text

    console = table_console(markup=False)
    table = Table(box=None, show_header=False, pad_edge=False)
    for step in steps:
        style = _STYLES[step.state]
        table.add_row(Text(step.state, style), Text(step.name, style), step.found)
    console.print(table)
    step = next((s for s in steps if s.state == "next"), None)
    if step is None:
        console.print("\nThe calibration is complete, and the service has it. Its state: `spheremouse ctl status`.")
        return
    console.print(f"\nNext: {step.name}", style="bold")
    for line in step.todo:
        console.print(line)
    _commands(console, step.command)
    for what, command in step.otherwise:
        console.print(what)
        _commands(console, command)


def _commands(console: "Console", command: str) -> None:
    if command:
        console.print(f"    {command}", style="cyan")
