"""`spheremouse map`: print a saved map."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.table import Table

    from spheremouse.ball.disc_map import DiscMap
    from spheremouse.ball.texture.picture_map import PictureMap

_TURN_WIDTH_PX = 1440  # px, of a whole turn

app = typer.Typer(no_args_is_help=True)


@app.callback()
def map_() -> None:
    """Print a saved map."""


@app.command(epilog="Example: spheremouse map show rig.map.yaml")
def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)],
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw a pattern by longitude and latitude.")
    ] = None,
) -> None:
    """Print a saved map: the discs, or the known part of a pattern.

    Latitude and longitude of a disc are in degrees in `ball`. The pole is Y, longitude 0 is Z, 90 is X. Sigma is the
    standard deviation of the direction for each axis.
    """
    from spheremouse.ball.disc_map import DiscMap
    from spheremouse.ball.texture.picture_map import unfold
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.commands.terminal import table_console
    from spheremouse.files.ball_map import age, load_map
    from spheremouse.session.overlay.file import write_picture

    saved = load_map(file)
    found: Any = saved.map
    if output is not None and found.kind == DiscMap.kind:
        raise ConfigurationError(f"--output: {file} is a map of discs, and draws none", "leave --output out")
    if output is not None:
        check_outputs([output], [file], force=True)
        write_picture(output, unfold(found.fine, _TURN_WIDTH_PX))
    table = (_disc_table if found.kind == DiscMap.kind else _pattern_table)(found)
    description = f"{found.text} on a ball of {saved.ball_radius:g} m"
    if saved.disc_radius is not None:
        description = f"{found.text} of radius {1e3 * saved.disc_radius:g} mm on a ball of {saved.ball_radius:g} m"
    when = f"{saved.saved:%Y-%m-%d %H:%M %Z} ({age(saved.saved)})"
    table.title = f"{file}: {description}; saved {when} by spheremouse {saved.version}"
    table_console().print(table)


def _disc_table(found: "DiscMap") -> "Table":
    import numpy as np
    from rich.table import Table

    from spheremouse.ball.disc_map import variances

    sigma = np.rad2deg(np.sqrt(variances(found)))
    table = Table(box=None, title_justify="left", title_style="")
    for name in ("disc", "latitude, °", "longitude, °", "sigma, °", "sightings"):
        table.add_column(name, justify="right")
    x, y, z = found.directions.T
    places = zip(np.rad2deg(np.arcsin(np.clip(y, -1.0, 1.0))), np.rad2deg(np.arctan2(x, z)), strict=True)
    for i, ((latitude, longitude), s, n) in enumerate(zip(places, sigma, found.sightings, strict=True)):
        table.add_row(str(i), f"{latitude:+.1f}", f"{longitude:+.1f}", f"{s:.3f}", str(n))
    table.add_section()
    table.add_row("all", "", "", f"{np.sqrt(np.mean(sigma**2)):.3f}", str(found.sightings.sum()))
    return table


def _pattern_table(found: "PictureMap") -> "Table":
    import numpy as np
    from rich.table import Table

    from spheremouse.ball.disc_map import variances

    table = Table(box=None, title_justify="left", title_style="", show_header=False)
    value, weight = found.fine.value, found.fine.weight
    known = weight[weight > 0.0]
    rows = {
        "cells along a face of the cube": str(value.shape[1]),
        "views of a known cell, median": f"{np.median(known):.1f}",
        "contrast, standard deviation": f"{value[weight > 0.0].std():.3f}",
        "of a cell in one view, standard deviation": f"{found.noise:.3f}",
        "usual correlation of a frame": f"{found.correlation:.2f}",
        "parts, standard deviation": f"{np.rad2deg(np.sqrt(np.mean(variances(found.parts)))):.3f}°",
    }
    for name, text in rows.items():
        table.add_row(name, text)
    return table
