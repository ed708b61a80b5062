"""Numbers and figures of the page on the ball in a hand."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments import wand_films as wand
from experiments.kit.job import Result, Results
from experiments.report.frames import markdown
from experiments.report.labels import label_points
from experiments.report.page import Page, fixed
from experiments.report.plot import Drawing, plain_numbers
from experiments.report.wand_rows import ENOUGH, SOME, Row, rows, verdicts
from experiments.wand import SPEEDS
from spheremouse.evaluate.table import axes, shown
from spheremouse.evaluate.wand import OFF_ANGLE, RECOVERED
from spheremouse.geometry.rotation import log

_SHOWN = "drive-01"  # the film whose errors are drawn frame by frame
_OURS, _THESIS = "350, known start", "350, all as in the thesis"
_METHODS = {"ours": "known start", "as in the thesis": "all as in the thesis"}
_THESIS_MAX = {"x": 3.0, "y": 15.0, "z": 40.0, "rotation": 7.0}  # cm, °: largest errors with 350 particles
_THESIS_RUNS = {  # by the number of particles: s per picture, runs that lost the ball, largest error in z
    50: ("0.6", "2 of 3", "–"),
    350: ("0.71", "none", f"{_THESIS_MAX['z']:g} cm"),
    5000: ("2.73", "–", "–"),
    50000: ("–", "–", "–"),
}
_DIFFERENCES = {  # variants with 350 particles, each with what is not ours, and that of those above
    _OURS: "ours",
    "350, without the outline": "without the outline of the ball",
    "350, the thesis' motion": "with the thesis' motion in place of ours",
    "350, drawn by the thesis' motion alone": "with particles drawn by that motion alone and not towards the peaks",
    _THESIS: "with its product of colour fields for a likelihood as well: all as in the thesis",
    "350, edges alone": "with Canny's edges alone for it",
    "5000, all as in the thesis": "all as in the thesis, 5000 particles",
}
_TURNED = 50.0 / 0.8  # °, of the thesis' robot from one picture to the next
_WORDS = {None: "not judged", True: "yes", False: "no"}
_CLAIMED = {"ours": _OURS, "thesis": _THESIS, "alone": "350, drawn by the thesis' motion alone"}
_ABSURD = 1000.0  # an ANEES of which the digits say nothing


def page(results: Results) -> Page:
    """Targets, results and speed of each film."""
    timed = results.get(SPEEDS, {})
    table = rows({key: result for key, result in results.items() if key != SPEEDS})
    reached = [(*said, _WORDS[good]) for *said, good in verdicts(table, timed)]
    drive = {row.variant: row for row in table if row.film.name in ("drive", "drive-many")}
    values = {
        "recovered": RECOVERED,
        "off_angle": np.degrees(OFF_ANGLE),
        "within": wand.FOUND_WITHIN,
        "enough": ENOUGH,
        "some": SOME,
        "reached": markdown(pd.DataFrame(reached, columns=["asked", "thesis", "ours", "reached"])),
        "lost": {who: drive[variant].lost if variant in drive else np.nan for who, variant in _CLAIMED.items()},
        "turned": _TURNED,
        "thesis_z": _THESIS_MAX["z"],
        "differences": _differences(drive),
        "particles": _particles(table, timed),
        "films": markdown(pd.DataFrame([_cells(row) for row in table]), sparse=["film"]),
        "speeds": _speeds(timed),
    }
    return Page(values, tuple(_drawings(table, results.get(_SHOWN, {}))))


def numbers(results: Results) -> dict[str, Any]:
    """Content of experiments.json: sums over the runs of each film and tracker, without the poses of all frames."""
    timed = results.get(SPEEDS, {})
    table = rows({key: result for key, result in results.items() if key != SPEEDS and "error" not in result})
    names = ("variant", "runs", "lost", "found", "tracked")
    reached = [{"asked": a, "thesis": t, "ours": o, "reached": good} for a, t, o, good in verdicts(table, timed)]
    found = [{"film": row.film.name, **{n: getattr(row, n) for n in names}, **row.figures} for row in table]
    return {"rows": found, "speeds": timed, "reached": reached}


def _differences(drive: Mapping[str, Row]) -> str:
    """Effect of each part of the thesis' filter, on the same images."""
    there = {how: drive[name] for name, how in _DIFFERENCES.items() if name in drive}
    columns = {
        "filter": list(there),
        "lost": [f"{row.lost} of {row.runs}" for row in there.values()],
        "z (95th percentile), cm": [_z(row, "position_p95_mm") for row in there.values()],
    }
    return markdown(pd.DataFrame(columns), 1)


def _z(row: Row | None, figure: str) -> float:
    """cm; nan where it is not known."""
    largest = None if row is None else row.figures[figure]["z"]
    return np.nan if largest is None else 0.1 * largest


def _particles(table: Sequence[Row], timed: Result) -> str:
    found = []
    for n, (seconds, lost, z) in _THESIS_RUNS.items():
        of_drive = {row.variant: row for row in table if row.film.name in ("drive", "drive-many")}
        both = [of_drive.get(f"{n}, {words}") for words in _METHODS.values()]
        fps = timed.get(f"{n} particles, whole frame", {}).get("fps")
        ours = ["–" if row is None else f"{row.lost} of {row.runs}" for row in both]
        largest = fixed(_z(both[0], "position_max_mm"), 1)
        found.append((f"{n:,}", seconds, fixed(1.0 / fps if fps else np.nan, 3), lost, *ours, z, largest))
    head = (
        *("particles", "thesis, s per picture", "ours, s"),
        *("lost: thesis", "lost: ours", "lost: ours, all as in the thesis"),
        *("largest error in z: thesis", "ours, cm"),
    )
    return markdown(pd.DataFrame(found, columns=list(head)))


def _speeds(timed: Result) -> str:
    found = [(name, s["fps"], s["mean_fps"], s["p90_ms"]) for name, s in timed.items()]
    head = ["", "median fps", "mean fps", "90th percentile, ms"]
    return markdown(pd.DataFrame(found, columns=head), {"90th percentile, ms": 1})


def _honesty(value: float | None) -> str:
    return f"> {_ABSURD:.0f}" if value is not None and value > _ABSURD else shown(value)


def _cells(row: Row) -> dict[str, str]:
    f = row.figures
    return {
        "film": f"{row.film.name}: {row.film.words}",
        "particles": row.variant,
        "runs": str(row.runs),
        "lost": str(row.lost),
        "tracked, %": f"{100.0 * row.tracked:.1f}",
        f"found in {wand.FOUND_WITHIN}": str(row.found),
        "p95 x  y  z, cm": axes(f["position_p95_mm"], ".2f", 0.1),
        "max x  y  z, cm": axes(f["position_max_mm"], ".2f", 0.1),
        "rotation p95, max, °": f"{shown(f['rotation_p95_deg'], '.2f')}  {shown(f['rotation_max_deg'], '.2f')}",
        "ANEES position, rotation": f"{_honesty(f['anees']['position'])}  {_honesty(f['anees']['rotation'])}",
        "within 95 %, %": fixed(f["within_95"], 1, 100.0),
    }


def _drawings(table: Sequence[Row], shown_film: Result) -> list[Drawing]:
    of_drive = {
        method: sorted(
            [
                (int(row.variant.split(",")[0]), row)
                for row in table
                if row.variant.endswith(words) and row.film.name in ("drive", "drive-many")
            ],
            key=lambda pair: pair[0],
        )
        for method, words in _METHODS.items()
    }
    found = [Drawing("wand-particles", lambda canvas: _draw_particles(canvas, of_drive), (7.2, 3.4))]
    variants = shown_film.get("variants", {})
    runs = {name: variants[name][0] for name in (_OURS, _THESIS) if variants.get(name)}
    if _OURS in runs and runs[_OURS]["index"]:
        found.append(Drawing("wand-drive", lambda canvas: _draw_drive(canvas, runs), (7.2, 5.4)))
    return found if any(len(pairs) > 1 for pairs in of_drive.values()) else found[1:]


def _draw_particles(canvas: Any, of_drive: dict[str, list[tuple[int, Row]]]) -> None:
    axes_ = canvas.subplots(1, 2)
    panels = (
        ("distance (z), 95th percentile, cm", 10.0, lambda f: f["position_p95_mm"]["z"], 0.1),
        ("rotation, 95th percentile, °", 4.0, lambda f: f["rotation_p95_deg"], 1.0),
    )
    for ax, (label, limit, value, scale) in zip(axes_, panels, strict=True):
        for k, (method, pairs) in enumerate(of_drive.items()):
            points = [(n, scale * value(r.figures), r) for n, r in pairs if value(r.figures) is not None]
            ax.plot([p[0] for p in points], [p[1] for p in points], marker="o", color=f"C{k}", label=method)
            label_points(ax, [(f"{row.lost} of {row.runs} lost", n, y) for n, y, row in points], radius=2.0)
        ax.axhline(limit, color="0.5", linestyle=(0, (4, 3)), linewidth=0.9)
        ax.set(xscale="log", yscale="log", xlabel="particles", ylabel=label)
        ax.margins(x=0.16, y=0.16)
        plain_numbers(ax.yaxis)
        counts = sorted({n for pairs in of_drive.values() for n, _ in pairs})
        ax.set_xticks(counts, [f"{n:,}" for n in counts])
        ax.xaxis.minorticks_off()
    canvas.legend(*axes_[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)


def _draw_drive(canvas: Any, runs: dict[str, Result]) -> None:
    axes_ = canvas.subplots(4, 1, sharex=True)
    for k, (name, kept) in enumerate(runs.items()):
        frame, errors, sigma = _along(kept)
        for ax, error, s in zip(axes_, errors.T, sigma.T, strict=True):
            if k == 0:
                ax.fill_between(frame, -2.0 * s, 2.0 * s, color=f"C{k}", alpha=0.2, linewidth=0.0)
                reach = 1.3 * max(float(np.max(2.0 * s)), float(np.max(np.abs(error))))
                ax.set_ylim(-reach, reach)
            ax.plot(frame, error, color=f"C{k}", linewidth=1.0, label=name.replace("known start", "ours"))
    for ax, (axis, most) in zip(axes_, _THESIS_MAX.items(), strict=True):
        reach = max(ax.get_ylim()[1], 1.15 * most)
        ax.set_ylim(-reach if axis != "rotation" else -0.05 * reach, reach)
        ax.axhline(most, color="0.5", linestyle=(0, (4, 3)), linewidth=0.9)
        if axis != "rotation":
            ax.axhline(-most, color="0.5", linestyle=(0, (4, 3)), linewidth=0.9)
        ax.set_ylabel(f"{axis}, °" if axis == "rotation" else f"{axis}, cm")
    axes_[-1].set_xlabel("frame")
    canvas.legend(*axes_[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)


def _along(kept: Result) -> tuple[Any, Any, Any]:
    """Frames (n,), errors (n, 4) of x, y, z in cm and of the rotation's angle in °, and their events."""
    (run,), (truth,) = wand.restored([kept])
    shift = 100.0 * (run.position - truth.position)
    turn = np.rad2deg(np.linalg.norm(log(run.rotation @ truth.rotation.transpose(0, 2, 1)), axis=1))
    variance = np.diagonal(run.covariance, axis1=1, axis2=2)
    angle = np.rad2deg(np.sqrt(variance[:, 3:].sum(axis=1)))
    return run.stamp, np.c_[shift, turn], np.c_[100.0 * np.sqrt(variance[:, :3]), angle]
