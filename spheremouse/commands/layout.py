"""`spheremouse layout`: choose places for the discs and print a guide."""

import math
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.errors import ConfigurationError, os_errors_as


def layout(
    discs: Annotated[int, typer.Option(metavar="N", min=4, max=120, help="Discs to place.")] = 26,
    radius: Annotated[float, typer.Option(metavar="M", min=0.001, max=10.0, help="Radius of the ball in m.")] = 0.6,
    disc_radius: Annotated[
        float, typer.Option(metavar="M", min=0.001, max=10.0, help="Radius of a disc in m, along the surface.")
    ] = 0.02,
    view_angle: Annotated[
        float,
        typer.Option(
            metavar="DEG", min=20.0, max=89.0, help="The camera sees discs within this angle of the direction to it."
        ),
    ] = 70.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives another layout.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of the guide.  [default: calibration/placement-N]")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace another guide.")] = False,
) -> None:
    """Choose irregular, well spread places for the discs, and make a guide to print.

    The guide is one HTML page for a person with a tape measure. The same seed gives the same layout.
    """
    from spheremouse.calibrate.layout.choose import choose_directions, min_in_view, nearest, on_the_tape, places
    from spheremouse.calibrate.layout.guide import Layout, write_guide
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.files.safe_files import write_json

    angle = math.radians(view_angle)
    try:
        directions = on_the_tape(choose_directions(discs, angle, 3.0 * disc_radius / radius, seed), radius)
    except ValueError as e:
        raise ConfigurationError(f"--discs {discs}: {e}; take fewer or smaller discs") from None
    in_view, (distance, (first, second)) = min_in_view(directions, angle), nearest(directions)
    content = {
        "made_by": "spheremouse layout",
        "ball": {"radius": radius},
        "disc_radius": disc_radius,
        "view_angle_deg": view_angle,
        "seed": seed,
        "directions": directions.round(6).tolist(),
        "places_mm": [
            {"disc": p.number, "band": p.band, "from_pole": p.from_pole, "checks": [list(c) for c in p.checks]}
            for p in places(directions, radius)
        ],
        "in_view": in_view,
        "nearest_mm": round(1e3 * radius * distance, 1),
    }
    folder = out or Path("calibration") / f"placement-{discs}"
    with os_errors_as(ConfigurationError, f"{folder}: cannot be made", "name another with --out"):
        folder.mkdir(parents=True, exist_ok=True)
    guide, file = folder / "guide.html", folder / "layout.json"
    check_outputs([guide, file], [], force=force)
    write_guide(guide, Layout(directions, radius, disc_radius, angle, seed))
    write_json(file, content)
    typer.echo(f"discs in view: at least {in_view}, from anywhere")
    typer.echo(
        f"nearest: discs {first + 1} and {second + 1}, {1e3 * radius * distance:.0f} mm apart "
        f"({2e3 * disc_radius:.0f} mm would touch)"
    )
    typer.echo(f"{guide}: print it on A4; {file}: the directions")
