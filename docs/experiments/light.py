"""Noise and brightness added to a film: how the errors grow.

Wittich 2017, section 4.9, table 24: normal noise of standard deviation sigma_r and a constant l on all
channels of all pixels, 8 bits again. Values are combined, with our detector. The camera's pose comes from the same
degraded pictures. At l = -50 and sigma_r = 15 the thesis finds only two of its four targets.
"""

from dataclasses import replace

import pandas as pd

from experiments.kit import detections
from experiments.kit.film import TRACKERS, bound_rms, film_like_s1
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, ERRORS, RATE, Part, Plot, Table, by, filter_rows, rms, tidy, where
from spheremouse.errors import PoseError
from spheremouse.evaluation.metrics import run_bound
from spheremouse.simulate.ball.events import degrade

TITLE = "Noise and brightness (Wittich 2017, table 24)"
SIGMAS = (1, 5, 10, 15)  # grey values
THESIS_24: dict[int, tuple[float | None, ...]] = {  # °/s by l; None: targets not found
    -50: (1.20, 1.29, 1.62, None),
    -25: (0.98, 1.04, 1.18, 1.47),
    25: (1.06, 1.20, 1.25, 1.59),
    50: (1.06, 1.04, 1.09, 1.42),
}


def jobs(request: Request) -> list[Job]:
    levels, sigmas, frames = ((-50, 50), (15,), 75) if request.quick else (tuple(THESIS_24), SIGMAS, 300)
    films: dict[str, str | None] = {"s1": None}
    if request.datasets is not None and not request.quick:
        films["far26"] = str(request.datasets / "far26")
    cost, what = 0.02 * frames * (1 + len(sigmas)), {"sigmas": list(sigmas), "frames": frames}
    return [
        Job(key_of(name, level), graded, {"path": path, "level": level, **what}, cost)
        for level in levels
        for name, path in films.items()
    ]


def graded(path: str | None, level: int, sigmas: list[int], frames: int) -> Result:
    """Return by sigma_r the filters' errors and the bound, or the reason why there are none."""
    film, cells = film_like_s1(path, frames), {}
    for sigma in sigmas:
        worse = replace(film, frames=tuple(degrade(iter(film.frames), float(sigma), float(level))))
        try:
            runs = detections.all_runs(worse)
        except PoseError as e:
            cells[str(sigma)] = {"error": str(e)}
            continue
        rows = {name: detections.errors(run, film.truth, film.rig.ball.radius) for name, run in runs.items()}
        cells[str(sigma)] = {"rows": rows, "bound": bound_rms(run_bound(runs["so3"], film.truth, film.rig))}
    return {"cells": cells}


def key_of(film: str, level: int) -> str:
    return f"{film}{level:+d}"


# ---- section ----


def section(results: Results) -> list[Part]:
    records = []
    for key, result in results.items():
        film, level = key[:-3], int(key[-3:])
        for sigma, cell in result["cells"].items():
            about = {"film": film, "l": level, "σ_r": int(sigma)}
            records += filter_rows(about, cell.get("rows", {}), cell.get("bound"))
    columns = {"film": "film", "l": "l", "σ_r": "σ_r", "filter": "filter", **ERRORS}
    runs = tidy(records, {**columns, "detection.centre_rms_60_px": "centres, px"})
    typed = [
        ["thesis", level, "thesis, EKF2", sigma, rate]
        for level, row in THESIS_24.items()
        for sigma, rate in zip(SIGMAS, row, strict=True)
    ]
    thesis = pd.DataFrame(typed, columns=["film", "l", "filter", "σ_r", RATE]).astype({RATE: float})
    wide = (
        pd.concat([thesis, where(runs, filter=list(TRACKERS))])
        .pivot(index=["film", "l", "filter"], columns="σ_r", values=RATE)
        .add_prefix("σ_r = ")
        .reset_index()
    )
    over_l = by(runs, ["film", "filter", "σ_r"], {"centres, px": rms, ATTITUDE: rms, RATE: rms})
    films = pd.concat([thesis.assign(film=film) for film in runs["film"].unique()])
    return [
        Table("Rate RMSE, °/s (table 24)", wide.sort_values(["film", "l"], kind="stable"), ["film", "l"]),
        Table("RMS over l; centres are those of discs of 60 px² and more", over_l, ["film", "filter"]),
        Plot(
            "light-rates", "Rate errors under noise: medians over the brightnesses, and their range.",
            pd.concat([runs, films]), "σ_r", [RATE], "filter", "film"
        )
    ]  # fmt: skip
