"""A layout that is there, judged: a scene.json, a saved map, a layout.json or a list of directions."""

from pathlib import Path
from typing import Any

import numpy as np
import typer

from spheremouse.calibrate.layout.limits import CLEAR, DISC_RADIUS, ENOUGH, FEWEST, MOST, RADIUS
from spheremouse.calibrate.layout.search import Judgement, Trials, judge, recognised
from spheremouse.commands.layout.words import MISSING, SIGMA, TRIALS, figures, verdict
from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import write_json
from spheremouse.files.yaml import read_document
from spheremouse.geometry.rotation import Array, log


def check_layout(
    path: Path, angle: float, radius: float | None, disc_radius: float | None, json_file: Path | None
) -> None:
    """Print what a layout is worth, and what would mend it; or write its figures as JSON."""
    directions, file_radius, file_disc = read_layout(path)
    ball, disc = radius or file_radius or RADIUS, disc_radius or file_disc or DISC_RADIUS
    judgement = judge(directions, angle)
    trials = recognised(directions, angle, SIGMA, MISSING, TRIALS, np.random.default_rng(0))
    said = {"file": str(path), "discs": len(directions), **figures(judgement, trials, ball)}
    if json_file is not None and write_json(json_file, said):
        return
    typer.echo(f"{path}: {len(directions)} discs")
    for line in [*verdict(judgement, trials, ball, disc), *advice(judgement, trials, ball, disc)]:
        typer.echo(line)


def read_layout(path: Path) -> tuple[Array, float | None, float | None]:
    """Directions, (n, 3), of a scene.json, a saved map, a layout.json or a plain list; radius of ball and disc in m."""
    data = read_document(path).data
    radius = disc_radius = None
    found = data
    if isinstance(data, dict):
        ball = data.get("ball")
        radius = _length(ball.get("radius") if isinstance(ball, dict) else data.get("ball_radius"))
        disc_radius = _length(data.get("disc_radius"))
        found = next((data[k] for k in ("truth_disc_directions", "directions", "discs") if k in data), None)
        if found is None:
            raise ConfigurationError(
                f"{path}: no directions in it; name a scene.json, a saved map or a list of [x, y, z]"
            )
    rows = found if isinstance(found, tuple) else ()
    rows = [row.get("direction") if isinstance(row, dict) else row for row in rows]
    try:
        directions = np.array(rows, dtype=float)
        length = np.linalg.norm(directions.reshape(-1, 3), axis=1)
    except (TypeError, ValueError):
        raise ConfigurationError(f"{path}: directions must be a list of [x, y, z], three numbers each") from None
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise ConfigurationError(f"{path}: directions must be a list of [x, y, z], three numbers each")
    if not FEWEST <= len(directions) <= MOST:
        raise ConfigurationError(f"{path}: {len(directions)} discs; from {FEWEST} to {MOST} can be judged")
    bad = np.flatnonzero(~(np.abs(length - 1.0) < 0.01))
    if len(bad):
        raise ConfigurationError(f"{path}: direction {bad[0] + 1} has length {length[bad[0]]:.3g}; it must be 1")
    return directions / length[:, None], radius, disc_radius


def _length(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0 else None


def advice(judgement: Judgement, trials: Trials, radius: float, disc_radius: float) -> list[str]:
    """Advice on a layout, a line each; disc numbers count from 1."""
    j, mm, lines = judgement, 1e3 * radius, []
    if j.apart * radius < 2.5 * disc_radius:
        first, second = (k + 1 for k in j.closest)
        what = "overlap" if j.apart * radius < 2.0 * disc_radius else "nearly touch"
        lines.append(f"advice: discs {first} and {second} {what}; move one of them {3e3 * disc_radius:.0f} mm away")
    if j.in_view < 2:
        lines.append(
            f"advice: from some sides {'one disc' if j.in_view else 'no disc'} is in view, and there the tracker "
            "withholds motion; put up 16 discs or more"
        )
    if j.in_view < ENOUGH:
        lines.append(
            f"advice: somewhere only {j.in_view} discs are in view, and recognising takes {ENOUGH}; add discs where "
            "it is bare, or spread them more evenly"
        )
    for turn in j.symmetries[:3]:
        vector = log(turn)
        about = ", ".join(f"{x:.2f}" for x in vector / np.linalg.norm(vector))
        lines.append(
            f"advice: turned by {np.degrees(np.linalg.norm(vector)):.0f} degrees about ({about}) the ball looks the "
            "same; break the pattern"
        )
    if (j.separability < CLEAR and j.in_view >= ENOUGH) or len(j.symmetries):
        here, there = (", ".join(str(k + 1) for k in ks) for ks in j.worst)
        lines.append(
            f"advice: discs {here} look like {there}; move one or two of them by {2.0 * j.alike * mm:.0f} mm or more, "
            "in any direction"
        )
    if trials.wrong > 0.0:
        lines.append(f"advice: {100 * trials.wrong:.1f} % of attitudes were mistaken for others: change the layout")
    return lines or ["advice: none; this layout is good"]
