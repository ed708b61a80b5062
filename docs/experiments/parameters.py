"""The classic filter's two parameters: assumed acceleration sigma_w and noise of a disc's centre sigma_b.

Wittich 2017, section 4.5, tables 14 to 18: `ekf2` on a film like R1, compared with the trackball's log, and on films
like S1, compared with the truth. `so3` has neither parameter: a line beside them.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from experiments.kit import detections, r1
from experiments.kit.film import Film, bound, film_from_dataset, film_of, options_of, settings_of, tracked
from experiments.kit.job import Job, Request, Result
from spheremouse.evaluate.metrics import Run
from spheremouse.simulate.ball.film import prepare

SIGMA_W = (0.001, 0.01, 0.1, 1.0)  # rad/s², those of the thesis
SIGMA_B = (0.1, 1.0, 10.0)  # px
BEYOND = 10.0  # rad/s², a row of ours
EXACT = 1e-6  # m: so round the ball is taken to be where only that of the thesis is compared

Grid = tuple[tuple[float, ...], ...]
THESIS: dict[str, Grid] = {  # by quantity: rows by sigma_w, columns by sigma_b
    "trackball": ((0.645, 0.594, 0.678), (0.902, 0.794, 0.527), (0.962, 0.948, 0.778), (0.947, 0.956, 0.954)),
    "r": ((0.979, 0.973, 0.965), (0.995, 0.991, 0.990), (0.999, 0.998, 0.998), (0.998, 0.996, 0.995)),
    "attitude": ((2.68, 2.96, 3.14), (0.72, 0.89, 0.93), (0.18, 0.27, 0.27), (0.11, 0.13, 0.15)),
    "rate": ((5.42, 6.04, 6.04), (2.23, 2.98, 3.10), (1.09, 1.60, 1.61), (1.52, 1.90, 2.12)),
    "speed": ((0.49, 0.56, 0.64), (0.23, 0.30, 0.34), (0.11, 0.15, 0.15), (0.15, 0.20, 0.21)),  # px/s
}


def jobs(request: Request) -> list[Job]:
    """One per film."""
    frames = 90 if request.quick else 300
    seconds = 4.0 if request.quick else r1.SECONDS
    found = [
        Job("r1", like_r1, {"seconds": seconds}, cost=1.8 * seconds),
        Job("s1", simulated, {"frames": frames, "published": not request.quick}, cost=0.065 * frames),
    ]
    if request.datasets is not None:
        path = str(request.datasets / "far26")
        found.append(
            Job(
                "far26", recorded, {"path": path, "frames": frames, "published": not request.quick}, cost=0.055 * frames
            )
        )
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


def simulated(frames: int, published: bool) -> Result:
    """The grid on a film like S1: 26 discs, far camera, the thesis' motion."""
    return _compared(film_of(prepare(options_of({"seconds": frames / 30.0})), "S1"), published)


def recorded(path: str, frames: int, published: bool) -> Result:
    """The grid on the reference recording like S1."""
    return _compared(film_from_dataset(Path(path), frames), published)


def _compared(film: Film, published: bool) -> Result:
    def judge(run: Run) -> Result:
        return detections.errors(run, film.truth, film.rig.ball.radius)

    return {
        **_grid(film, judge),
        "exact": _exact(film, judge),
        "scaled": _scaled(film, judge),
        "published": _published(film, judge) if published else None,
    }


def _grid(film: Film, judge: Any) -> Result:
    """All cells by "sigma_w/sigma_b", so3, and the bound for the noise that the centres really have."""
    seen = detections.look_at(film, settings_of(["tracker=ekf2"]))
    cells = {}
    for b in SIGMA_B:
        noisy = detections.with_sigma(seen, b)
        for w in (*SIGMA_W, BEYOND):
            settings = settings_of(["tracker=ekf2", f"euler.acceleration_sigma={w}"])
            cells[key_of(w, b)] = judge(detections.filtered(noisy, settings, film))
    best = tracked(film, settings_of())
    so3 = judge(best.run)
    noise = so3["detection"]["centre_rms_px"]
    return {"cells": cells, "so3": so3, "bound": bound(film, best), "centre_rms_px": noise}


def _exact(film: Film, judge: Any) -> Result:
    """The thesis' cells with a ball taken as exact: eq. 120 then leaves a point no variance along the radius."""
    seen = detections.look_at(film, settings_of(["tracker=ekf2"]))
    cells = {}
    for b in SIGMA_B:
        noisy = detections.with_sigma(seen, b)
        for w in SIGMA_W:
            settings = settings_of(["tracker=ekf2", f"euler.acceleration_sigma={w}"])
            settings = replace(settings, euler=replace(settings.euler, radial_sigma=EXACT))
            cells[key_of(w, b)] = judge(detections.filtered(noisy, settings, film))
    return cells


def _scaled(film: Film, judge: Any) -> Result:
    """Cells in which everything that the filter assumes grows along with sigma_b, from the first column on."""
    seen, usual = detections.look_at(film, settings_of(["tracker=ekf2"])), settings_of().euler
    cells = {}
    for b in SIGMA_B:
        noisy, k = detections.with_sigma(seen, b), b / SIGMA_B[0]
        for w in SIGMA_W[:3]:
            assumed = replace(
                usual,
                acceleration_sigma=k * w,
                start_sigma=k * usual.start_sigma,
                radial_sigma=k * usual.radial_sigma,
            )
            settings = replace(settings_of(["tracker=ekf2"]), euler=assumed)
            cells[key_of(k * w, b)] = judge(detections.filtered(noisy, settings, film))
    return cells


def _published(film: Film, judge: Any) -> Result:
    """The first column with the published detector, by sigma_w."""
    seen = detections.with_sigma(detections.look_at(film, settings_of(["detector=blobs", "tracker=ekf2"])), SIGMA_B[0])
    settings = {w: settings_of(["tracker=ekf2", f"euler.acceleration_sigma={w}"]) for w in (*SIGMA_W, BEYOND)}
    return {f"{w:g}": judge(detections.filtered(seen, s, film)) for w, s in settings.items()}


def _agreement(found: r1.Agreement | None) -> Result:
    return {} if found is None else {"r": found.r, "lag_s": found.lag, "scale": found.scale}


def key_of(w: float, b: float) -> str:
    return f"{w:g}/{b:g}"
