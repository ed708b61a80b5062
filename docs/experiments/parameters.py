"""The classic filter's two parameters: assumed acceleration sigma_w and noise of a disc's centre sigma_b.

Wittich 2017, section 4.5, tables 14 to 18: `ekf2` on a film like R1, compared with the trackball's log, and on films
like S1, compared with the truth. `so3` has neither parameter.
"""

from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import detections, r1
from experiments.kit.film import Film, film_like_s1, settings_of, tracked
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Part, Plot, Table, tidy
from spheremouse.evaluation.run import Run

TITLE = "Assumed acceleration and noise of the discs (Wittich 2017, tables 14 to 18)"
SIGMA_W = (0.001, 0.01, 0.1, 1.0)  # rad/s², those of the thesis
SIGMA_B = (0.1, 1.0, 10.0)  # px
BEYOND = 10.0  # rad/s², a row of ours

SPEED = "mouse speed, mm/s (thesis: px/s)"
QUANTITIES = {
    "correlation, R1": ("Correlation with the trackball, R1", 14),
    "correlation, S1": ("Correlation of mouse speeds, S1", 15), ATTITUDE: ("RMSE of the attitude, °, S1", 16),
    RATE: ("RMSE of the rates, °/s, S1", 17), SPEED: ("RMSE of the mouse speed, mm/s (thesis: px/s), S1", 18)
}  # fmt: skip
Grid = tuple[tuple[float, ...], ...]
THESIS: dict[str, Grid] = {  # by quantity: rows by sigma_w, columns by sigma_b
    "trackball": ((0.645, 0.594, 0.678), (0.902, 0.794, 0.527), (0.962, 0.948, 0.778), (0.947, 0.956, 0.954)),
    "r": ((0.979, 0.973, 0.965), (0.995, 0.991, 0.990), (0.999, 0.998, 0.998), (0.998, 0.996, 0.995)),
    "attitude": ((2.68, 2.96, 3.14), (0.72, 0.89, 0.93), (0.18, 0.27, 0.27), (0.11, 0.13, 0.15)),
    "rate": ((5.42, 6.04, 6.04), (2.23, 2.98, 3.10), (1.09, 1.60, 1.61), (1.52, 1.90, 2.12)),
    "speed": ((0.49, 0.56, 0.64), (0.23, 0.30, 0.34), (0.11, 0.15, 0.15), (0.15, 0.20, 0.21)),  # px/s
}


def jobs(request: Request) -> list[Job]:
    frames = 90 if request.quick else 300
    seconds = 4.0 if request.quick else r1.SECONDS
    found = [
        Job("r1", like_r1, {"seconds": seconds}, cost=1.8 * seconds),
        Job("s1", compared, {"path": None, "frames": frames}, cost=0.065 * frames),
    ]
    if request.datasets is not None:
        path = str(request.datasets / "far26")
        found.append(Job("far26", compared, {"path": path, "frames": frames}, cost=0.055 * frames))
    return found


def like_r1(seconds: float) -> Result:
    """The grid on the film like R1, each cell with its agreement with the trackball."""
    film, mouse = r1.filmed(seconds)
    radius = film.rig.ball.radius

    def extended(run: Run) -> Result:
        return {**detections.errors(run, film.truth, radius), "trackball": _agreement(r1.of_run(run, mouse, radius))}

    assert film.truth.motion is not None
    true = _agreement(r1.of_truth(film.truth.motion, mouse, radius))
    return {**_grid(film, extended), "truth": {"trackball": true}}


def compared(path: str | None, frames: int) -> Result:
    film = film_like_s1(path, frames)
    return _grid(film, lambda run: detections.errors(run, film.truth, film.rig.ball.radius))


def _grid(film: Film, judge: Any) -> Result:
    """All cells by "sigma_w/sigma_b", and so3."""
    seen, cells = detections.look_at(film, settings_of(["tracker=ekf2"])), {}
    for b in SIGMA_B:
        noisy = detections.with_sigma(seen, b)
        for w in (*SIGMA_W, BEYOND):
            settings = settings_of(["tracker=ekf2", f"euler.acceleration_sigma={w}"])
            cells[key_of(w, b)] = judge(detections.filtered(noisy, settings, film))
    return {"cells": cells, "so3": judge(tracked(film, settings_of()).run)}


def _agreement(found: r1.Agreement | None) -> Result:
    return {} if found is None else {"r": found.r, "lag_s": found.lag, "scale": found.scale}


def key_of(w: float, b: float) -> str:
    return f"{w:g}/{b:g}"


# ---- section ----


def section(results: Results) -> list[Part]:
    cells = _tidy(results)
    like_s1 = cells[cells["film"] != "r1"]
    return [
        *(
            Table(f"{caption} (table {number})", _wide(cells if number == 14 else like_s1, column))
            for column, (caption, number) in QUANTITIES.items()
        ),
        Plot(
            "parameters", "Errors of `ekf2` against σ_w/σ_b, by film.", cells[cells["σ_w, rad/s²"] < np.inf], "σ_w/σ_b",
            [ATTITUDE, RATE], "film", log="xy"
        )
    ]  # fmt: skip


def _tidy(results: Results) -> pd.DataFrame:
    """A row for each film and cell; `so3` has an infinite σ_w, the thesis' cells are a film of their own."""
    records: list[dict[str, Any]] = []
    for film, result in results.items():
        cells = {**result["cells"], **{f"inf/{b}": result["so3"] for b in SIGMA_B}}
        records += [
            {"film": film, "w": float(key.split("/")[0]), "b": float(key.split("/")[1]), **cell}
            for key, cell in cells.items()
        ]
    names = {"film": "film", "w": "σ_w, rad/s²", "b": "σ_b, px", "trackball.r": "correlation, R1"}
    names |= {"surface_speed_r.combined": "correlation, S1", "attitude_rmse_deg.combined": ATTITUDE}
    names |= {
        "rate_rmse_deg_s.combined": RATE,
        "surface_speed_rmse_mm_s.combined": SPEED,
        "lost_episodes": "times lost",
    }
    cells = tidy(records, names)
    thesis = [dict(zip(("σ_w, rad/s²", "σ_b, px"), (w, b), strict=True)) for w in SIGMA_W for b in SIGMA_B]
    printed = {name: np.ravel(THESIS[key]) for name, key in zip(QUANTITIES, THESIS, strict=True)}
    cells = pd.concat([pd.DataFrame(thesis).assign(film="thesis", **printed), cells])
    return cells.assign(**{"σ_w/σ_b": (cells["σ_w, rad/s²"] / cells["σ_b, px"]).round(9)})


def _wide(cells: pd.DataFrame, column: str) -> pd.DataFrame:
    """A line for each σ_w, and one for `so3`."""
    cells = cells.dropna(subset=[column])
    names = "σ_b " + cells["σ_b, px"].map("{:g}".format) + " px: " + cells["film"]
    wide = cells.assign(name=names).pivot(index="σ_w, rad/s²", columns="name", values=column).reset_index()
    return wide.assign(**{"σ_w, rad/s²": ["so3" if w == np.inf else f"{w:g}" for w in wide["σ_w, rad/s²"]]})
