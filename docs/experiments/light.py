"""Noise and brightness added to a film: how the errors grow.

Wittich 2017, section 4.9, table 24, fig. 41: normal noise of standard deviation sigma_r and a constant l on all
channels of all pixels, 8 bits again. Values are combined, with our detector. The camera's pose comes from the same
degraded pictures. At l = -50 and sigma_r = 15 the thesis finds only two of its four targets.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import detections
from experiments.kit.film import (
    TRACKERS,
    Film,
    bound_rms,
    film_from_dataset,
    film_of,
    options_of,
    settings_of,
    tracked,
)
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, ERRORS, RATE, Claim, Part, Plot, Table, by, filter_rows, rms, tidy, where
from spheremouse.errors import PoseError
from spheremouse.evaluate.metrics import Run, attitude_error, run_bound
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.events import degraded
from spheremouse.simulate.ball.film import prepare

TITLE = "Noise and brightness (Wittich 2017, table 24, fig. 41)"
SIGMAS = (1, 5, 10, 15)  # grey values
THESIS_24: dict[int, tuple[float | None, ...]] = {  # °/s by l; None: targets not found
    -50: (1.20, 1.29, 1.62, None),
    -25: (0.98, 1.04, 1.18, 1.47),
    25: (1.06, 1.20, 1.25, 1.59),
    50: (1.06, 1.04, 1.09, 1.42),
}
WORST = (50, 15)  # l and sigma_r of fig. 41


def jobs(request: Request) -> list[Job]:
    """One per film and brightness."""
    levels, sigmas, frames = ((-50, 50), (15,), 75) if request.quick else (tuple(THESIS_24), SIGMAS, 300)
    found = []
    for level in levels:
        what = {"level": level, "sigmas": list(sigmas), "frames": frames}
        found.append(Job(key_of("s1", level), simulated, what, cost=0.02 * frames * (1 + len(sigmas))))
        if request.datasets is not None and not request.quick:
            path = str(request.datasets / "far26")
            found.append(
                Job(key_of("far26", level), recorded, {"path": path, **what}, cost=0.02 * frames * (1 + len(sigmas)))
            )
    return found


def simulated(level: int, sigmas: list[int], frames: int) -> Result:
    """A row of the grid on a film like S1; with the attitude errors over time of fig. 41 for its l and sigma_r."""
    return _row(film_of(prepare(options_of({"seconds": frames / 30.0})), "S1"), level, sigmas)


def recorded(path: str, level: int, sigmas: list[int], frames: int) -> Result:
    """A row of the grid on the reference recording."""
    return _row(film_from_dataset(Path(path), frames), level, sigmas)


def _row(film: Film, level: int, sigmas: list[int]) -> Result:
    """By sigma_r: the filters' errors and the bound, or why there are none."""
    cells: Result = {}
    for sigma in sigmas:
        frames = tuple(degraded(iter(film.frames), float(sigma), float(level)))
        worse = replace(film, frames=frames)
        try:
            runs = _runs(worse)
        except PoseError as e:
            cells[str(sigma)] = {"error": str(e)}
            continue
        rows = {name: detections.errors(run, film.truth, film.rig.ball.radius) for name, run in runs.items()}
        cells[str(sigma)] = {"rows": rows, "bound": bound_rms(run_bound(runs["so3"], film.truth, film.rig))}
        if (level, sigma) == WORST:
            cells[str(sigma)]["series"] = {name: _error_over_time(runs[name], film) for name in ("ekf2", "so3")}
    return {"cells": cells}


def _runs(film: Film) -> dict[str, Run]:
    seen = detections.look_at(film, settings_of(["tracker=ekf2"]))
    runs = {n: detections.filtered(seen, settings_of([f"tracker={n}"]), film) for n in TRACKERS if n != "so3"}
    return {**runs, "so3": tracked(film, settings_of()).run}


def _error_over_time(run: Run, film: Film) -> Result:
    """Error rotation vector, °, in `obj`, of the tracked frames."""
    assert film.truth.motion is not None
    k = run.tracked
    error = attitude_error(run.attitude[k], film.truth.motion.attitude[run.frame[k]]) if len(k) else np.zeros((0, 3))
    return {"t": _plain(run.stamp[k]), "error": _plain(np.rad2deg(error))}


def _plain(values: Array) -> list[Any]:
    return np.round(values, 5).tolist()


def key_of(film: str, level: int) -> str:
    return f"{film}{level:+d}"


# ---- section ----


def section(results: Results) -> list[Part]:
    """Table 24 for each film, and the attitude errors of fig. 41."""
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
    missed = sum("error" in cell for result in results.values() for cell in result["cells"].values())
    ours = where(over_l, film="s1", filter="ekf2").set_index("σ_r")[RATE]
    factor = (ours / thesis.dropna().groupby("σ_r")[RATE].agg(rms)).max(skipna=False)
    films = pd.concat([thesis.assign(film=film) for film in runs["film"].unique()])
    return [
        Table("Rate RMSE, °/s (table 24)", wide.sort_values(["film", "l"], kind="stable"), ["film", "l"]),
        Claim("The camera's pose is found in every film, even in the darkest and noisiest one.", missed == 0),
        Claim(
            f"The rate errors of our `ekf2` are smaller than the thesis' under any noise, at most {factor:.2f} of "
            "them. The filter is the same, the detector is not.",
            factor < 1.0,
        ),
        Table("RMS over l; centres are those of discs of 60 px² and more", over_l, ["film", "filter"]),
        Plot(
            "light-rates",
            "Rate errors under noise: medians over the brightnesses, and their range.",
            pd.concat([runs, films]),
            "σ_r",
            [RATE],
            "filter",
            "film",
        ),
        *_figure_41(results),
    ]


def _figure_41(results: Results) -> list[Part]:
    """Attitude errors about the device's axes under the worst light and noise, °."""
    level, sigma = WORST
    series = results.get(key_of("s1", level), {"cells": {}})["cells"].get(str(sigma), {}).get("series", {})
    parts = [
        pd.DataFrame(s["error"], columns=list("xyz"), dtype=float).assign(filter=who, **{"time, s": s["t"]})
        for who, s in series.items()
    ]
    if not parts:
        return []
    errors = pd.concat(parts).melt(["filter", "time, s"], var_name="axis", value_name="attitude error, °")
    largest = errors["attitude error, °"].abs().groupby([errors["filter"], errors["axis"]]).max().unstack()
    return [
        Table(f"Largest attitude errors about each axis under l = {level:+d}, σ_r = {sigma}, °", largest.reset_index()),
        Claim(
            "In the thesis the error is below 1° about each axis and grows up to the middle of the film. Ours is "
            "smaller.",
            bool((largest < 1.0).to_numpy().all()),
        ),
        Plot(
            "light-attitude",
            "Attitude errors in that film (as fig. 41).",
            errors,
            "time, s",
            ["attitude error, °"],
            "filter",
            "axis",
        ),
    ]
