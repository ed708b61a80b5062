"""`spheremouse map`: print a saved map of discs, or compare two maps."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.terminal import table_console

if TYPE_CHECKING:
    from spheremouse.geometry.rotation import Array

app = typer.Typer(no_args_is_help=True, help="Print a saved map of discs, or compare two.")
_ANOTHER_BALL = 1  # exit code


@app.command(epilog="Example: spheremouse map show rig.map.yaml")
def show(file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)]) -> None:
    """Print the discs of a saved map: place on the ball, standard deviation and number of sightings.

    Latitude and longitude are in degrees in `ball`. The pole is Y, longitude 0 is Z, 90 is X. Sigma is the standard
    deviation of the direction for each axis.
    """
    import numpy as np
    from rich.table import Table

    from spheremouse.ball.disc_map import variances
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
    for i, (place, s, sightings) in enumerate(
        zip(_places(saved.map.directions), sigma, saved.map.sightings, strict=True)
    ):
        table.add_row(str(i), *place, f"{s:.3f}", str(sightings))
    table.add_section()
    table.add_row("all", "", "", f"{np.sqrt(np.mean(sigma**2)):.3f}", str(saved.map.sightings.sum()))
    table_console().print(table)


@app.command("compare", epilog="Example: spheremouse map compare rig.map.old.yaml rig.map.yaml")
def compare_(
    a: Annotated[Path, typer.Argument(metavar="A", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", show_default=False)],
) -> None:
    """Compare two maps of a ball: which discs have moved in B, are gone, or are new.

    The exit code is 0 for the same ball, and 1 if the maps have too few discs in common.
    """
    import numpy as np
    from rich.table import Table

    from spheremouse.ball.disc_map import compare, in_words
    from spheremouse.files.disc_map import BALL_DIFFERS, load_map
    from spheremouse.geometry.rotation import log

    one, other = load_map(a), load_map(b)
    before, after = one.map, other.map
    console = table_console()
    if abs(one.ball_radius - other.ball_radius) > BALL_DIFFERS * one.ball_radius:
        console.print(f"another ball: its radius is {one.ball_radius:g} m in {a}, {other.ball_radius:g} m in {b}")
        raise typer.Exit(_ANOTHER_BALL)
    found = compare(before, after)
    if found is None:
        console.print(f"another ball, or too few discs in common: {len(before)} in {a}, {len(after)} in {b}")
        raise typer.Exit(_ANOTHER_BALL)
    turn = np.rad2deg(log(found.rotation))
    console.print(f"the same ball: {in_words(found)}; B is turned by {np.linalg.norm(turn):.2f}° against A")
    rows = [(i, j, "moved") for i, j in found.moved] + [(i, None, "gone") for i in found.gone]
    rows += [(None, j, "new") for j in found.new]
    if not rows:
        return
    in_b = before.directions @ found.rotation.T
    table = Table(box=None)
    for name in ("", "disc of A", "disc of B", "latitude, °", "longitude, °", "by, °"):
        table.add_column(name, justify="right")
    for i, j, change in rows:
        place = _places(in_b[i] if j is None else after.directions[j])[0]
        by = (
            ""
            if i is None or j is None
            else f"{np.rad2deg(np.arccos(np.clip(in_b[i] @ after.directions[j], -1, 1))):.2f}"
        )
        table.add_row(change, "" if i is None else str(i), "" if j is None else str(j), *place, by)
    console.print(table)
    console.print("latitude and longitude in the frame of B")


def _places(directions: "Array") -> list[tuple[str, str]]:
    """Return latitude about Y and longitude from Z towards X, in degrees, of directions (m, 3) or one (3,)."""
    import numpy as np

    x, y, z = np.atleast_2d(directions).T
    latitude = np.rad2deg(np.arcsin(np.clip(y, -1.0, 1.0)))
    longitude = np.rad2deg(np.arctan2(x, z))
    return [(f"{a:+.1f}", f"{o:+.1f}") for a, o in zip(latitude, longitude, strict=True)]
