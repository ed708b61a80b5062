"""`spheremouse calibrate init`: the folder of a device, with the device.yaml to fill in."""

from pathlib import Path
from typing import Annotated

import typer

from spheremouse.errors import CalibrationError

EXAMPLE = "Example: spheremouse calibrate init cabinet"


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
        try:
            place.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise CalibrationError(f"{place}: is a file where a folder should be; choose another name") from None
        except OSError as e:
            raise CalibrationError(f"{place}: cannot be made: {e.strerror or e}; choose another place") from None
    path = folder / "device.yaml"
    if path.exists() and not force:
        typer.echo(f"{path}: there already, kept as it is (--force replaces it)")
    else:
        write_atomically(path, device_template())
        typer.echo(f"{path}: written; open it in an editor and enter your measurements")
    typer.echo(f"{folder / 'board'}, {folder / 'device'}: photos of the board and of the device go here")
    typer.echo("To print board, targets and discs: spheremouse calibrate print")
    typer.echo(f"The next step, now and at any time: {next_command(folder)}")
