"""`spheremouse layout`: where to put the discs so that no two sides of the ball look alike, as a guide to print."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from spheremouse.calibrate.layout.guide import Accuracy, Design, on_the_tape, places, write_guide
from spheremouse.calibrate.layout.search import (
    CLEAR,
    ENOUGH,
    FEWEST,
    MOST,
    Judgement,
    Step,
    Trials,
    default_steps,
    in_order,
    inaccurate,
    judge,
    recognised,
    search,
)
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError
from spheremouse.files import plain_json
from spheremouse.files.atomic import write_atomically, write_json
from spheremouse.files.bounded import read_text
from spheremouse.files.yaml import MAX_BYTES, read_document
from spheremouse.geometry.rotation import Array, log
from spheremouse.simulate.ball.scene import spread_directions

_RADIUS, _DISC_RADIUS = 0.6, 0.02  # m
_CARELESS = (0.2, 0.5, 1.0, 2.0, 4.0)  # of the distance at which places pass for alike
_TRIALS, _MISSING = 300, 0.2  # attitudes, and the probability that a disc is hidden
_SIGMA = np.radians(0.1)
_COARSER = (0.1, 0.5, 1.0)  # deg, in comparisons


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
    angle = np.radians(_within("--view-angle", view_angle, 20.0, 89.0))
    for name, value in (("--radius", radius), ("--disc-radius", disc_radius)):
        if value is not None:
            _within(name, value, 0.001, 10.0)
    if json_file is not None and json_file != Path("-") and not json_file.parent.is_dir():
        raise ConfigurationError(f"--json: {json_file.parent}: no such folder")
    if check is not None:
        _check(check, angle, radius, disc_radius, json_file)
        return
    ball, disc = radius or _RADIUS, disc_radius or _DISC_RADIUS
    apart = 3.0 * disc / ball
    if compare:
        _compare(discs, angle, apart, seed, compare)
        return
    folder = out or Path("calibration") / f"placement-{discs}"
    design = _designed(discs, ball, disc, angle, seed)
    text = json.dumps(_description(design), indent=1, allow_nan=False) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    if json_file is not None:
        write_atomically(json_file, text)
    _refuse_to_replace(folder, text, force)
    write_guide(folder / "guide.html", design)
    write_atomically(folder / "layout.json", text)
    for line in _verdict(design.judgement, design.trials, ball, disc):
        typer.echo(line)
    typer.echo(_carelessness(design))
    typer.echo(f"{folder / 'guide.html'}: print it on A4; {folder / 'layout.json'}: the directions")


# ---- a new layout ----


def _designed(n: int, radius: float, disc_radius: float, angle: float, seed: int) -> Design:
    tries = int(np.clip(500 // n, 5, 20))
    steps = default_steps(n)
    with progress_bar() as bar:
        task = bar.add_task(f"placing {n} discs", total=steps + len(_CARELESS) * max(1, steps // 20))
        directions = np.zeros((0, 3))
        for step in _searched(n, angle, 3.0 * disc_radius / radius, seed, steps):
            directions = step.directions
            bar.update(task, completed=step.done)
        directions = on_the_tape(in_order(directions), radius)
        judgement = judge(directions, angle)
        rng = np.random.default_rng(seed)
        trials = recognised(directions, angle, _SIGMA, _MISSING, _TRIALS, rng)
        accuracy = []
        sds = judgement.alike * np.array(_CARELESS)
        for sd, (separability, in_view) in zip(sds, inaccurate(directions, angle, sds, tries, rng), strict=True):
            accuracy.append(Accuracy(1e3 * radius * sd, float(separability.min()), int(in_view.min())))
            bar.advance(task, max(1, steps // 20))
    return Design(
        directions, radius, disc_radius, angle, seed, judgement, trials, _SIGMA, _MISSING, tuple(accuracy), tries
    )


def _searched(n: int, angle: float, apart: float, seed: int, steps: int | None = None) -> Iterator[Step]:
    try:
        yield from search(n, angle, apart, seed, steps)
    except ValueError as e:
        raise ConfigurationError(f"--discs {n}: {e}; take fewer or smaller discs") from None


def _description(design: Design) -> dict[str, Any]:
    """Content of layout.json; `--check` reads it."""
    return {
        "made_by": "spheremouse layout",
        "ball": {"radius": design.radius},
        "disc_radius": design.disc_radius,
        "view_angle_deg": round(float(np.degrees(design.view_angle)), 6),
        "seed": design.seed,
        "directions": [[round(float(x), 6) for x in d] for d in design.directions],
        "places_mm": [
            {"disc": p.number, "band": p.band, "from_pole": p.from_pole, "checks": [list(c) for c in p.checks]}
            for p in places(design.directions, design.radius)
        ],
        **_figures(design.judgement, design.trials, design.radius),
        "misplaced_tries": design.tries,
        "misplaced": [
            {"sd_mm": round(a.sd_mm, 2), "separability": round(a.separability, 2), "in_view": a.in_view}
            for a in design.accuracy
        ],
    }


def _refuse_to_replace(folder: Path, text: str, force: bool) -> None:
    """A guide by which somebody may be at work is not replaced by another unasked."""
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


def _carelessness(design: Design) -> str:
    if design.bears_mm > 0.0:
        return f"put up by eye: stays clear with discs off by {design.bears_mm:.0f} mm (sd to either side)"
    return "put up by eye: some views look alike however exactly the discs are placed; more discs help"


# ---- a layout that is there ----


def _check(path: Path, angle: float, radius: float | None, disc_radius: float | None, json_file: Path | None) -> None:
    directions, file_radius, file_disc = read_layout(path)
    ball, disc = radius or file_radius or _RADIUS, disc_radius or file_disc or _DISC_RADIUS
    judgement = judge(directions, angle)
    trials = recognised(directions, angle, _SIGMA, _MISSING, _TRIALS, np.random.default_rng(0))
    figures = {"file": str(path), "discs": len(directions), **_figures(judgement, trials, ball)}
    if json_file is not None and write_json(json_file, figures):
        return
    typer.echo(f"{path}: {len(directions)} discs")
    for line in [*_verdict(judgement, trials, ball, disc), *advice(judgement, trials, ball, disc)]:
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


# ---- words and figures ----


def _figures(j: Judgement, t: Trials, radius: float) -> dict[str, Any]:
    return {
        "in_view": j.in_view,
        "nearest_mm": round(1e3 * radius * j.apart, 1),
        "alike_mm": round(1e3 * radius * j.alike, 1),
        "separability": round(j.separability, 2),
        "separability_median": round(float(np.median(j.contradictions)), 2),
        "unclear_share": round(j.unclear, 4),
        "symmetries": len(j.symmetries),
        "recognised": {
            "sigma_deg": round(float(np.degrees(_SIGMA)), 3),
            "missing": _MISSING,
            "found": t.found,
            "refused": t.refused,
            "wrong": t.wrong,
        },
    }


def _verdict(j: Judgement, t: Trials, radius: float, disc_radius: float) -> list[str]:
    mm = 1e3 * radius
    return [
        f"in view: {j.in_view} discs or more from anywhere ({ENOUGH} are enough)",
        f"nearest: discs {j.closest[0] + 1} and {j.closest[1] + 1}, {j.apart * mm:.0f} mm apart "
        f"({2e3 * disc_radius:.0f} mm would touch)",
        f"separability: {j.separability:.1f} discs tell the worst view from the one most like it, "
        f"{np.median(j.contradictions):.1f} the median (within {j.alike * mm:.0f} mm is alike; {CLEAR:g} are clear)",
        f"unclear views: {100 * j.unclear:.1f} %; symmetries: {len(j.symmetries)}",
        f"recognised from one picture (0.1 degrees, {100 * _MISSING:.0f} % hidden): {100 * t.found:.1f} %, "
        f"left open {100 * t.refused:.1f} %, mistaken {100 * t.wrong:.1f} %",
    ]


def _compare(n: int, angle: float, apart: float, seed: int, others: int) -> None:
    """A table: our layout beside random ones that are merely well spread."""
    steps = default_steps(n)
    with progress_bar() as bar:
        task = bar.add_task(f"comparing {n} discs", total=steps + others * max(1, steps // 50))
        ours = np.zeros((0, 3))
        for step in _searched(n, angle, apart, seed, steps):
            ours = step.directions
            bar.update(task, completed=step.done)
        found = [_compared(ours, angle)]
        for k in range(others):
            found.append(_compared(spread_directions(n, apart, np.random.default_rng([seed, 1, k])), angle))
            bar.advance(task, max(1, steps // 50))
    random = np.array(found[1:])
    table = Table(title=f"{n} discs, in view within {np.degrees(angle):g} degrees", title_justify="left")
    table.add_column("")
    for name in ("this layout", f"median of {others}", "best", "worst"):
        table.add_column(name, justify="right")
    for row, (name, form) in enumerate(_COMPARED):
        column = np.sort(random[:, row])
        values = (found[0][row], float(np.median(column)), column[-1], column[0])
        table.add_row(name, *(form.format(v) for v in values))
    Console(soft_wrap=True).print(table)


_COMPARED = (
    ("discs in view, least", "{:.0f}"),
    ("nearest discs, degrees", "{:.1f}"),
    ("contradictions, worst view", "{:.1f}"),
    ("contradictions, 1 % of views", "{:.1f}"),
    ("contradictions, median view", "{:.1f}"),
    *((f"recognised at {sigma} degrees, %", "{:.1f}") for sigma in _COARSER),
    ("never mistaken, %", "{:.1f}"),
)


def _compared(directions: Array, angle: float) -> list[float]:
    j = judge(directions, angle)
    trials = [
        recognised(directions, angle, np.radians(s), _MISSING, _TRIALS, np.random.default_rng(0)) for s in _COARSER
    ]
    return [
        float(j.in_view),
        float(np.degrees(j.apart)),
        j.separability,
        float(np.quantile(j.contradictions, 0.01)),
        float(np.median(j.contradictions)),
        *(100.0 * t.found for t in trials),
        100.0 * (1.0 - max(t.wrong for t in trials)),
    ]


def _within(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ConfigurationError(f"{name}: {value:g} must be from {low:g} to {high:g}")
    return value
