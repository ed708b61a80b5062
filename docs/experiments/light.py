"""Noise and brightness added to a film: how the errors grow.

Wittich 2017, section 4.9, table 24, figs. 40 and 41: normal noise of standard deviation sigma_r and a constant l on all
channels of all pixels, 8 bits again.
"""

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

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
from experiments.kit.job import Job, Request, Result
from spheremouse.errors import PoseError
from spheremouse.evaluate.metrics import Run, attitude_error, run_bound
from spheremouse.geometry.rotation import Array, to_euler
from spheremouse.simulate.ball.degrade import degraded
from spheremouse.simulate.ball.film import prepare

SIGMAS = (1, 5, 10, 15)  # grey values
THESIS_24: dict[int, tuple[float | None, ...]] = {  # °/s by l; None: targets not found
    -50: (1.20, 1.29, 1.62, None),
    -25: (0.98, 1.04, 1.18, 1.47),
    25: (1.06, 1.20, 1.25, 1.59),
    50: (1.06, 1.04, 1.09, 1.42),
}
WORST = (50, 15)  # l and sigma_r of figs. 40 and 41
_CROP = (280, 210)  # px, of the picture


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
    """A row of the grid on a film like S1; with what figs. 40 and 41 show, where it is theirs."""
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
        limit = run_bound(runs["so3"], film.truth, film.rig)
        cells[str(sigma)] = {"rows": rows, "bound": bound_rms(limit)}
        if (level, sigma) == WORST:
            series = {name: _error_over_time(runs[name], film) for name in ("ekf2", "so3")}
            claimed = None if limit is None else np.rad2deg(np.sqrt(np.trace(limit.attitude, axis1=1, axis2=2)))
            cells[str(sigma)]["shown"] = {
                "series": series,
                "truth": _angles(film),
                "bound": None if claimed is None else _plain(claimed),
                "picture": _picture(film, worse, runs["so3"]),
            }
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


def _angles(film: Film) -> Result:
    """omega, phi, kappa of the truth, °."""
    motion = film.truth.motion
    assert motion is not None
    n = len(film.frames)
    angles = np.array([to_euler(R) for R in motion.attitude[:n]])
    return {"t": _plain(motion.stamp[:n]), "angles": _plain(np.rad2deg(np.unwrap(angles, axis=0)))}


def _picture(film: Film, worse: Film, run: Run) -> Result:
    """The middle of the ball in the middle of the film, before and after, and the discs that the filter used there."""
    k = len(film.frames) // 2
    w, h = _CROP
    camera = film.rig.camera
    left, top = round(camera.cx - w / 2), round(camera.cy - h / 2)
    at = np.flatnonzero(run.frame == k)
    used = run.used[at[0]] - (left, top) if len(at) else np.zeros((0, 2))
    inside = np.all((used >= 0.0) & (used <= (w - 1, h - 1)), axis=1)
    return {
        "frame": k,
        "before": _encoded(film.frames[k].image[top : top + h, left : left + w]),
        "after": _encoded(worse.frames[k].image[top : top + h, left : left + w]),
        "used": _plain(used[inside]),
    }


def _encoded(image: Any) -> str:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode("ascii")


def decoded(text: str) -> Any:
    return cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_GRAYSCALE)


def _plain(values: Array) -> list[Any]:
    return np.round(values, 5).tolist()


def key_of(film: str, level: int) -> str:
    return f"{film}{level:+d}"
