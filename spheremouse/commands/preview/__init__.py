"""`spheremouse preview`: show the picture of a camera or a recording, with targets and advice. No rig is needed."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import Assignments, ConfigFile, with_fields
from spheremouse.errors import ConfigurationError

_PICTURES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True)
class PreviewOptions:
    """Options of the command."""

    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND:ARG]",
            help="A source as of `run --source`: v4l2:DEVICE, opencv:INDEX, video:PATH, dataset:DIR.  [default: the "
            "first camera]",
        ),
    ] = None
    out: Annotated[Path, typer.Option(metavar="FILE", help="The picture (.png, .jpg). An earlier one is replaced.")] = (
        Path("preview.png")
    )
    at: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            min=0.0,
            help="Time of the picture after the first frame.  [default: 1 for a camera, which sets its exposure]",
        ),
    ] = None
    every: Annotated[
        float | None, typer.Option(metavar="S", min=0.2, help="Replace the picture every S seconds, until Ctrl-C.")
    ] = None
    rig: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Report the targets that this rig has.  [default: the recording's rig]"),
    ] = None
    config: ConfigFile = None
    assignments: Assignments = None
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False


@with_fields()
def preview(*, options: PreviewOptions) -> None:
    """Show the camera's picture with ring targets, rejected targets and dark spots. Print sharpness and brightness.

    Use it to place and focus the camera and to light the ball. You need no rig and no calibration. For each rejected
    target it prints the reason and the remedy. The file contains the whole picture, with all people in it.
    """
    from spheremouse.capture import full_spec
    from spheremouse.capture.nodes import default_camera
    from spheremouse.commands.preview.show import pictures

    if options.out.suffix.lower() not in _PICTURES:
        raise ConfigurationError(f"--out: {options.out} is not a picture; end its name in .png or .jpg")
    pictures(options, full_spec(options.source or default_camera()))
