"""The hand-held ball: accuracy, runs that lose it, start without a pose, speed.

Grzonka 2005, chapter 4: a 10 cm ball with discs in two colours, on a robot that drives as in the thesis, and in a hand.
All films are simulated, except the shared recording of such a drive. A run loses the ball as `spheremouse evaluate`
says. In the thesis the largest errors with 350 particles are 3, 15 and 40 cm and 7°, at 0.71 s a picture; with 50
particles it loses 2 of 3 runs.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from experiments import wand_films as wand
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Table
from spheremouse.evaluation.wand import errors

TITLE = "The hand-held ball (Grzonka 2005, chapter 4)"
SPEEDS = "speeds"


def jobs(request: Request) -> list[Job]:
    films = [
        Job(job.key, film, {"key": job.key, "quick": request.quick}, cost=_cost(job.film))
        for job in wand.jobs(request.quick)
    ]
    if request.datasets is not None:
        path, shared = str(request.datasets / wand.RECORDING), wand.recording_film(request.quick)
        for k, variant in enumerate(shared.variants):
            what = {"path": path, "quick": request.quick, "variant": k}
            films.append(Job(wand.recording_key(variant), recorded, what, cost=6.0 * len(shared.seeds)))
    return [*films, Job(SPEEDS, speeds, {"frames": 20 if request.quick else 60}, cost=25.0, alone=True)]


def _cost(film: wand.Film) -> float:
    """s of one core, about: drives have a tenth of the frames of hand-held films, and most are small pictures."""
    if film.name == "drive":
        return 2.0 * len(film.variants)
    return sum(6.0 * v.settings.particles / 5000 for v in film.variants) if film.name == "drive-many" else 16.0


def film(key: str, quick: bool) -> Result:
    (job,) = [job for job in wand.jobs(quick) if job.key == key]
    return wand.work(job)


def recorded(path: str, quick: bool, variant: int) -> Result:
    film = wand.recording_film(quick)
    return wand.work_recording(Path(path), film.variants[variant], film.seeds)


def speeds(frames: int) -> Result:
    return wand.measure_speeds(frames)


# ---- section ----


class Row(NamedTuple):
    """One film with one variant, over its seeds."""

    film: wand.Film
    variant: str
    runs: int  # that were made; several balls count each
    lost: int
    found: int  # within `FOUND_WITHIN` frames
    tracked: float  # share of the frames
    figures: dict[str, Any]  # as evaluate.wand.errors


def section(results: Results) -> list[Part]:
    timed = results.get(SPEEDS, {})
    table = rows({key: result for key, result in results.items() if key != SPEEDS})
    return [
        Table("Films and trackers", pd.DataFrame(map(_cells, table)), ["film"]),
        Table(
            "Speed, one core (thesis: 1.4 fps with 350 particles, 0.37 with 5000)",
            pd.DataFrame([{"": name, **speed} for name, speed in timed.items()]),
        ),
    ]


def rows(results: Results) -> list[Row]:
    """Sum up the runs of each film and variant, and of the shared recording; `results` by the jobs' keys."""
    found = []
    for film in wand.films(quick=False):
        of_film = [results[key] for seed in film.seeds if (key := wand.Job(film, seed).key) in results]
        found += [(film, v, [k for r in of_film for k in r["variants"].get(v.name, ())]) for v in film.variants]
    film = wand.recording_film(quick=False)
    for variant in film.variants:
        result = results.get(wand.recording_key(variant), {"variants": {}})
        found.append((film, variant, result["variants"].get(variant.name, ())))
    return [_row(film, variant, kept) for film, variant, kept in found if kept]


def _row(film: wand.Film, variant: wand.Variant, kept: Sequence[Result]) -> Row:
    soon = sum(k["found_from"] is not None and k["found_from"] < wand.FOUND_WITHIN for k in kept)
    tracked = sum(len(k["index"]) for k in kept) / sum(k["frames"] for k in kept)
    lost = sum(k["lost"] for k in kept)
    return Row(film, variant.name, len(kept), lost, soon, tracked, errors(*wand.restored(kept)))


def _cells(row: Row) -> dict[str, Any]:
    f, anees = row.figures, row.figures["anees"]
    p95, most = ({a: f[f"position_{name}_mm"][a] for a in "xyz"} for name in ("p95", "max"))
    return {
        "film": f"{row.film.name}: {row.film.words}", "particles": row.variant, "runs": row.runs, "lost": row.lost,
        "tracked, %": 100.0 * row.tracked, f"found in {wand.FOUND_WITHIN}": row.found,
        **{f"{a} p95, mm": p95[a] for a in p95}, **{f"{a} max, mm": most[a] for a in most},
        "rotation p95, °": f["rotation_p95_deg"], "rotation max, °": f["rotation_max_deg"],
        **{f"ANEES, {name}": min(x, 1e3) if (x := anees[name]) is not None else None for name in anees}
    }  # fmt: skip
