"""The filter models compared.

Wittich 2017, section 4.6, table 19: `ekf1` keeps the discs as first seen, `ekf2` estimates them too.
Both use Euler angles, as published, and run with our detector and with the published one (`blobs`). On a film like R1,
at several paces of its player, the correlation is that with the log of a simulated trackball. On films like S1 it is
that with the true mouse speeds. The thesis' mouse speed is in its px/s.
"""

import pandas as pd

from experiments.kit import detections, r1
from experiments.kit.film import Film, film_like_s1, settings_of, tracked
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Part, Table, tidy
from spheremouse.evaluation.run import Run

TITLE = "Filter models (Wittich 2017, table 19)"
THESIS = (  # film, filter, correlation, rates °/s, mouse speed px/s
    ("R1", "EKF1, thesis", 0.962, None, None),
    ("R1", "EKF2, thesis", 0.963, None, None),
    ("S1", "EKF1, thesis", 0.998, 1.59, 0.15),
    ("S1", "EKF2, thesis", 0.999, 1.09, 0.11),
)
PACES = (0.75, 1.0)  # beside that of the film like R1
PUBLISHED = "-blobs"


def jobs(request: Request) -> list[Job]:
    frames = 90 if request.quick else 300
    seconds = 4.0 if request.quick else r1.SECONDS
    found = [
        Job("r1", play, {"seconds": seconds, "pace": r1.PACE, "published": not request.quick}, cost=1.4 * seconds),
        Job("s1", compared, {"path": None, "frames": frames}, cost=0.025 * frames),
    ]
    if request.datasets is not None:
        path = str(request.datasets / "far26")
        found.append(Job("far26", compared, {"path": path, "frames": frames}, cost=0.02 * frames))
    if not request.quick:
        found += [
            Job(f"pace-{pace:g}", play, {"seconds": seconds, "pace": pace, "published": False}, cost=1.4 * seconds)
            for pace in PACES
        ]
    return found


def play(seconds: float, pace: float, published: bool) -> Result:
    """All filters on a film like R1, with their agreement with the trackball."""
    film, mouse = r1.filmed(seconds, pace)
    radius = film.rig.ball.radius
    assert film.truth.motion is not None
    true = r1.of_truth(film.truth.motion, mouse, radius)
    rows = {}
    for name, run in _runs(film, published).items():
        agreed = r1.of_run(run, mouse, radius)
        said = detections.errors(run, film.truth, radius)
        rows[name] = {**said, "trackball": {} if agreed is None else {"r": agreed.r}}
    return {"rows": rows, "truth": {} if true is None else {"r": true.r}}


def compared(path: str | None, frames: int) -> Result:
    film = film_like_s1(path, frames)
    runs = _runs(film, published=True)
    return {"rows": {name: detections.errors(run, film.truth, film.rig.ball.radius) for name, run in runs.items()}}


def _runs(film: Film, published: bool) -> dict[str, Run]:
    """By the filters' names; with the published detector the classic ones once more."""
    runs: dict[str, Run] = {}
    for detector, suffix in (("default", ""), ("blobs", PUBLISHED))[: 1 + published]:
        seen = detections.look_at(film, settings_of([f"detector={detector}", "tracker=ekf2"]))
        for name in ("ekf1", "ekf2"):
            runs[name + suffix] = detections.filtered(seen, settings_of([f"tracker={name}"]), film)
    runs["so3"] = tracked(film, settings_of()).run
    return runs


# ---- section ----


def section(results: Results) -> list[Part]:
    records = [
        {
            "film": film, "true": result.get("truth", {}).get("r"), "filter": who, **row,
            "r": row.get("trackball", {}).get("r", row["surface_speed_r"]["combined"])
        }
        for film, result in results.items()
        for who, row in result["rows"].items()
    ]  # fmt: skip
    runs = tidy(
        records,
        {
            "film": "film", "filter": "filter", "r": "correlation", "true": "correlation of the true motion",
            "rate_rmse_deg_s.combined": RATE, "surface_speed_rmse_mm_s.combined": "mouse speed, mm/s",
            "attitude_rmse_deg.combined": ATTITUDE, "tracked": "tracked", "frames": "frames",
            "lost_episodes": "times lost", "mean_discs": "discs", "detection.centre_rms_px": "centres, px"
        }
    )  # fmt: skip
    thesis = pd.DataFrame(THESIS, columns=["film", "filter", "correlation", RATE, "mouse speed, mm/s"])
    return [Table("Errors by film and filter (table 19)", pd.concat([thesis, runs]), ["film"], {"correlation": 5})]
