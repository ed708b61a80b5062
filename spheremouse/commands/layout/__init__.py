"""`spheremouse layout`: where to put the discs so that no two sides of the ball look alike, as a guide to print."""

import json
import math
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.calibrate.layout.limits import DISC_RADIUS, FEWEST, MOST, RADIUS
from spheremouse.errors import ConfigurationError
from spheremouse.files import plain_json
from spheremouse.files.atomic import write_atomically
from spheremouse.files.safe_open import read_text


def layout(
    discs: Annotated[int, typer.Option(metavar="N", min=FEWEST, max=MOST, help="Discs to place.")] = 26,
    radius: Annotated[float | None, typer.Option(metavar="M", help="Radius of the ball in m.  [default: 0.6]")] = None,
    disc_radius: Annotated[
        float | None, typer.Option(metavar="M", help="Radius of a disc in m, along the surface.  [default: 0.02]")
    ] = None,
    view_angle: Annotated[
        float, typer.Option(metavar="DEG", help="Discs within this angle of the direction to the camera are seen.")
    ] = 70.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the search; another seed, another layout.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where the guide goes.  [default: calibration/placement-N]"),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write directions or the judgement; - prints.")
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Judge the layout in a scene.json, a saved map or a list of directions."),
    ] = None,
    compare: Annotated[
        int, typer.Option(metavar="K", min=0, max=200, help="Compare with K random well-spread layouts; no guide.")
    ] = 0,
    force: Annotated[bool, typer.Option("--force", help="Replace another guide that is there.")] = False,
) -> None:
    """Find places for the discs at which every view of the ball differs from all others, and make a guide to print.

    The guide is one HTML page for whoever has a tape measure. The same seed gives the same layout.
    """
    from spheremouse.calibrate.layout.guide import write_guide
    from spheremouse.commands.layout.check import check_layout
    from spheremouse.commands.layout.compare import compare_layout
    from spheremouse.commands.layout.make import careless, described, designed
    from spheremouse.commands.layout.words import verdict

    angle = math.radians(_within("--view-angle", view_angle, 20.0, 89.0))
    for name, value in (("--radius", radius), ("--disc-radius", disc_radius)):
        if value is not None:
            _within(name, value, 0.001, 10.0)
    if json_file is not None and json_file != Path("-") and not json_file.parent.is_dir():
        raise ConfigurationError(f"--json: {json_file.parent}: no such folder")
    if check is not None:
        check_layout(check, angle, radius, disc_radius, json_file)
        return
    ball, disc = radius or RADIUS, disc_radius or DISC_RADIUS
    if compare:
        compare_layout(discs, angle, 3.0 * disc / ball, seed, compare)
        return
    folder = out or Path("calibration") / f"placement-{discs}"
    design = designed(discs, ball, disc, angle, seed)
    text = json.dumps(described(design), indent=1, allow_nan=False) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    if json_file is not None:
        write_atomically(json_file, text)
    _refuse_to_replace(folder, text, force)
    write_guide(folder / "guide.html", design)
    write_atomically(folder / "layout.json", text)
    for line in verdict(design.judgement, design.trials, ball, disc):
        typer.echo(line)
    typer.echo(careless(design))
    typer.echo(f"{folder / 'guide.html'}: print it on A4; {folder / 'layout.json'}: the directions")


def _refuse_to_replace(folder: Path, text: str, force: bool) -> None:
    """A guide by which somebody may be at work is not replaced by another unasked."""
    from spheremouse.files.yaml import MAX_BYTES

    there = folder / "layout.json"
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; name a folder with --out")
    if force or not there.exists():
        return
    try:
        before = plain_json.loads(read_text(there, MAX_BYTES, "layout"))
        same = before["places_mm"] == json.loads(text)["places_mm"]
    except (OSError, ValueError, TypeError, KeyError):
        same = False
    if not same:
        raise ConfigurationError(f"{there}: another layout is there; name another folder with --out or use --force")


def _within(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ConfigurationError(f"{name}: {value:g} must be from {low:g} to {high:g}")
    return value
