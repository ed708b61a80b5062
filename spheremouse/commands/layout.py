"""`spheremouse layout`: choose places for the discs and print a guide, or assess the places on a ball."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    from spheremouse.calibrate.layout.choose import Assessment
    from spheremouse.geometry.rotation import Array

_DEFAULT_DISCS = 26
_MIN_DISCS, _MAX_DISCS = 4, 120
_ADVISED_DISCS = 16
_MIN_RECOGNISED = 0.9


def layout(
    discs: Annotated[
        int, typer.Option(metavar="N", min=_MIN_DISCS, max=_MAX_DISCS, help="Discs to place.")
    ] = _DEFAULT_DISCS,
    radius: Annotated[float | None, typer.Option(metavar="M", help="Radius of the ball in m.  [default: 0.6]")] = None,
    disc_radius: Annotated[
        float | None, typer.Option(metavar="M", help="Radius of a disc in m, along the surface.  [default: 0.02]")
    ] = None,
    view_angle: Annotated[
        float, typer.Option(metavar="DEG", help="The camera sees discs within this angle of the direction to it.")
    ] = 70.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives another layout.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder of the guide.  [default: calibration/placement-N]"),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the directions or the assessment; - prints.")
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Assess the layout in a scene.json, a saved map or a list of directions."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace another guide.")] = False,
) -> None:
    """Choose irregular, well spread places for the discs, and make a guide to print.

    The guide is one HTML page for a person with a tape measure. The same seed gives the same layout.
    """
    from spheremouse.calibrate.layout.choose import DISC_RADIUS, RADIUS, assess, choose_directions
    from spheremouse.calibrate.layout.guide import on_the_tape, write_guide
    from spheremouse.files.safe_files import write_atomically

    angle = math.radians(_within("--view-angle", view_angle, 20.0, 89.0))
    for name, value in (("--radius", radius), ("--disc-radius", disc_radius)):
        if value is not None:
            _within(name, value, 0.001, 10.0)
    if json_file is not None and json_file != Path("-") and not json_file.parent.is_dir():
        raise ConfigurationError(f"--json: {json_file.parent}: no such folder")
    if check is not None:
        _check(check, angle, radius, disc_radius, json_file)
        return
    ball, disc = radius or RADIUS, disc_radius or DISC_RADIUS
    try:
        directions = on_the_tape(choose_directions(discs, angle, 3.0 * disc / ball, seed), ball)
    except ValueError as e:
        raise ConfigurationError(f"--discs {discs}: {e}; take fewer or smaller discs") from None
    found = assess(directions, angle)
    text = json.dumps(_content(directions, found, ball, disc, view_angle, seed), indent=1) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    if json_file is not None:
        write_atomically(json_file, text)
    folder = out or Path("calibration") / f"placement-{discs}"
    _refuse_to_replace(folder, text, force)
    write_guide(folder / "guide.html", directions, found, ball, disc, angle, seed)
    write_atomically(folder / "layout.json", text)
    for line in summary(found, ball, disc):
        typer.echo(line)
    typer.echo(f"{folder / 'guide.html'}: print it on A4; {folder / 'layout.json'}: the directions")


def _content(
    directions: "Array", found: "Assessment", radius: float, disc_radius: float, view_angle: float, seed: int
) -> dict[str, Any]:
    """Return the content of layout.json, which `--check` reads."""
    from spheremouse.calibrate.layout.guide import places

    return {
        "made_by": "spheremouse layout",
        "ball": {"radius": radius},
        "disc_radius": disc_radius,
        "view_angle_deg": view_angle,
        "seed": seed,
        "directions": [[round(float(x), 6) for x in d] for d in directions],
        "places_mm": [
            {"disc": p.number, "band": p.band, "from_pole": p.from_pole, "checks": [list(c) for c in p.checks]}
            for p in places(directions, radius)
        ],
        **_figures(found, radius),
    }


def _figures(found: "Assessment", radius: float) -> dict[str, Any]:
    return {
        "in_view": found.in_view,
        "nearest_mm": round(1e3 * radius * found.distance, 1),
        "recognised": found.recognised,
        "mistaken": found.mistaken,
    }


def _refuse_to_replace(folder: Path, text: str, force: bool) -> None:
    """Refuse to replace another guide without `force`: a person may be working by it."""
    from spheremouse.files import plain_json
    from spheremouse.files.safe_files import read_text
    from spheremouse.files.yaml import MAX_BYTES

    old = folder / "layout.json"
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; name a folder with --out")
    if force or not old.exists():
        return
    try:
        same = plain_json.loads(read_text(old, MAX_BYTES, "layout"))["places_mm"] == json.loads(text)["places_mm"]
    except (OSError, ValueError, TypeError, KeyError):
        same = False
    if not same:
        raise ConfigurationError(f"{old}: is another layout; name another folder with --out or use --force")


def _within(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ConfigurationError(f"{name}: {value:g} must be from {low:g} to {high:g}")
    return value


# ---- a layout on a ball ----


def _check(path: Path, angle: float, radius: float | None, disc_radius: float | None, json_file: Path | None) -> None:
    from spheremouse.calibrate.layout.choose import DISC_RADIUS, RADIUS, assess
    from spheremouse.files.safe_files import write_json

    directions, file_radius, file_disc = read_layout(path)
    ball, disc = radius or file_radius or RADIUS, disc_radius or file_disc or DISC_RADIUS
    found = assess(directions, angle)
    if json_file is not None and write_json(
        json_file, {"file": str(path), "discs": len(directions), **_figures(found, ball)}
    ):
        return
    typer.echo(f"{path}: {len(directions)} discs")
    for line in [*summary(found, ball, disc), *advice(found, ball, disc)]:
        typer.echo(line)


def read_layout(path: Path) -> "tuple[Array, float | None, float | None]":
    """Read directions (n, 3), and the radii of ball and disc in m if the file has them."""
    import numpy as np

    from spheremouse.files.yaml import read_document

    data = read_document(path).data
    radius = disc_radius = None
    rows = data
    if isinstance(data, dict):
        ball = data.get("ball")
        radius = _length(ball.get("radius") if isinstance(ball, dict) else data.get("ball_radius"))
        disc_radius = _length(data.get("disc_radius"))
        rows = next((data[k] for k in ("truth_disc_directions", "directions", "discs") if k in data), None)
        if rows is None:
            raise ConfigurationError(
                f"{path}: no directions in it; name a scene.json, a saved map or a list of [x, y, z]"
            )
    rows = rows if isinstance(rows, tuple) else ()
    rows = [row.get("direction") if isinstance(row, dict) else row for row in rows]
    try:
        directions = np.array(rows, dtype=float)
        length = np.linalg.norm(directions.reshape(-1, 3), axis=1)
    except (TypeError, ValueError):
        raise ConfigurationError(f"{path}: directions must be a list of [x, y, z], three numbers each") from None
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise ConfigurationError(f"{path}: directions must be a list of [x, y, z], three numbers each")
    if not _MIN_DISCS <= len(directions) <= _MAX_DISCS:
        raise ConfigurationError(f"{path}: has {len(directions)} discs, must have {_MIN_DISCS} to {_MAX_DISCS}")
    invalid = np.flatnonzero(~(np.abs(length - 1.0) < 0.01))
    if len(invalid):
        k = int(invalid[0])
        raise ConfigurationError(f"{path}: direction {k + 1} has length {length[k]:.3g}; it must be 1")
    return directions / length[:, None], radius, disc_radius


def _length(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0 else None


def summary(found: "Assessment", radius: float, disc_radius: float) -> list[str]:
    """Return an assessment in words, one line each. Disc numbers count from 1."""
    first, second = (k + 1 for k in found.nearest)
    unknown = 1.0 - found.recognised - found.mistaken
    return [
        f"discs in view: at least {found.in_view}, from anywhere",
        f"nearest: discs {first} and {second}, {1e3 * radius * found.distance:.0f} mm apart "
        f"({2e3 * disc_radius:.0f} mm would touch)",
        f"recognised from one picture: {100 * found.recognised:.1f} % of the attitudes; not recognised "
        f"{100 * abs(unknown):.1f} %, mistaken for others {100 * found.mistaken:.1f} %",
    ]


def advice(found: "Assessment", radius: float, disc_radius: float) -> list[str]:
    """Return advice on a layout, one line each. Disc numbers count from 1."""
    from spheremouse.calibrate.layout.choose import ENOUGH_IN_VIEW

    lines = []
    gap = found.distance * radius
    if gap < 2.5 * disc_radius:
        first, second = (k + 1 for k in found.nearest)
        problem = "overlap" if gap < 2.0 * disc_radius else "nearly touch"
        lines.append(f"advice: discs {first} and {second} {problem}; move one of them {3e3 * disc_radius:.0f} mm away")
    if found.in_view < 2:
        lines.append(
            f"advice: from some sides {'one disc' if found.in_view else 'no disc'} is in view, and there the tracker "
            f"withholds motion; put up {_ADVISED_DISCS} discs or more"
        )
    elif found.in_view < ENOUGH_IN_VIEW:
        lines.append(
            f"advice: from some sides only {found.in_view} discs are in view, but one picture gives the attitude from "
            f"{ENOUGH_IN_VIEW}; add discs where the ball is bare"
        )
    if (found.recognised < _MIN_RECOGNISED and found.in_view >= ENOUGH_IN_VIEW) or found.mistaken > 0.0:
        lines.append("advice: the ball looks alike from several sides; move some discs out of the regular pattern")
    return lines or ["advice: none; this layout is good"]
