"""`spheremouse map`: print a saved map of discs."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True)


@app.callback()
def map_() -> None:
    """Print a saved map of discs."""


@app.command(epilog="Example: spheremouse map show rig.map.yaml")
def show(file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)]) -> None:
    """Print the discs of a saved map: place on the ball, standard deviation and number of sightings.

    Latitude and longitude are in degrees in `ball`. The pole is Y, longitude 0 is Z, 90 is X. Sigma is the standard
    deviation of the direction for each axis.
    """
    import numpy as np
    from rich.table import Table

    from spheremouse.ball.disc_map import variances
    from spheremouse.commands.terminal import table_console
    from spheremouse.files.disc_map import age, load_map

    saved = load_map(file)
    sigma = np.rad2deg(np.sqrt(variances(saved.map)))
    table = Table(box=None, title_justify="left", title_style="")
    table.title = (
        f"{file}: {len(saved.map)} discs of radius {1e3 * saved.disc_radius:g} mm on a ball of {saved.ball_radius:g} m;"
        f" saved {saved.saved:%Y-%m-%d %H:%M %Z} ({age(saved)}) by spheremouse {saved.version}"
    )
    for name in ("disc", "latitude, °", "longitude, °", "sigma, °", "sightings"):
        table.add_column(name, justify="right")
    x, y, z = saved.map.directions.T
    places = zip(np.rad2deg(np.arcsin(np.clip(y, -1.0, 1.0))), np.rad2deg(np.arctan2(x, z)), strict=True)
    for i, ((latitude, longitude), s, n) in enumerate(zip(places, sigma, saved.map.sightings, strict=True)):
        table.add_row(str(i), f"{latitude:+.1f}", f"{longitude:+.1f}", f"{s:.3f}", str(n))
    table.add_section()
    table.add_row("all", "", "", f"{np.sqrt(np.mean(sigma**2)):.3f}", str(saved.map.sightings.sum()))
    table_console().print(table)
