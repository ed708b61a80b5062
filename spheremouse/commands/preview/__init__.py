"""`spheremouse preview`: what a camera or a recording shows, before there is a rig: a picture, a film, and words."""

from pathlib import Path
from typing import Annotated

import typer

from spheremouse.errors import ConfigurationError

_PICTURES = (".png", ".jpg", ".jpeg")


def preview(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND:ARG]",
            help="As `run --source` has it: v4l2:DEVICE, opencv:INDEX, video:PATH, dataset:DIR.  [default: the first "
            "camera]",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="A picture (.png, .jpg) or a film (.mkv, .mp4, .avi). An earlier one is replaced."
        ),
    ] = Path("preview.png"),
    at: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            min=0.0,
            help="So long after the first frame.  [default: 1 with a camera, which sets its exposure]",
        ),
    ] = None,
    every: Annotated[
        float | None, typer.Option(metavar="S", min=0.2, help="The picture anew every S seconds, until Ctrl-C.")
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=0.2, max=600.0, help="Length of a film.")] = 5.0,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Say which targets this rig has.  [default: the recording's own]"),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Configuration: the camera's settings, colours of targets (rings)."),
    ] = None,
    assignments: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter, as rings.* or camera.*.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was seen as JSON.")] = False,
) -> None:
    """Show what is seen: ring targets with their codes, what is nearly one and why it is none, round dark spots.

    No rig and no calibration are needed: use it to place the camera, to focus it and to light the ball. Says how sharp
    and how bright the picture is. The whole picture is kept, with whoever is in it.
    """
    from spheremouse.capture import full_spec
    from spheremouse.capture.default_camera import default_camera
    from spheremouse.commands.preview.show import Wanted, film, pictures

    if every is not None and out.suffix.lower() not in _PICTURES:
        raise ConfigurationError(
            f"--every: goes with a picture, {out} is none; end its name in .png, or leave --every out"
        )
    wanted = Wanted(full_spec(source or default_camera()), out, at, rig, config, tuple(assignments or ()), as_json)
    if out.suffix.lower() in _PICTURES:
        pictures(wanted, every)
    else:
        film(wanted, seconds)
