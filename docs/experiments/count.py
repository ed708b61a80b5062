"""Errors against the number of discs on the ball, beside the theoretical bound.

Wittich 2017, section 4.7, table 20: 26, 50 and 74 discs (sets S1, S2, S3); here 6 to 100, on several layouts.
"""

import numpy as np
import pandas as pd

from experiments.kit import detections, render
from experiments.kit.film import TRACKERS, bound_rms, film_of, options_of
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE
from spheremouse.evaluation.bound import Bound
from spheremouse.evaluation.metrics import run_bound
from spheremouse.simulate.ball.film import prepare

TITLE = "Number of discs (Wittich 2017, table 20)"
COUNTS = (6, 10, 16, 26, 36, 50, 74, 100)
LAYOUTS = (0, 1, 2)
_KNOWN = 1.0  # rad/s, standard deviation of a rate of which something is known
STORED = {26: 4.9, 50: 8.9, 74: 14.5}
ATTITUDE_20 = {26: (0.100, 0.086, 0.122), 50: (0.070, 0.067, 0.083), 74: (0.040, 0.056, 0.080)}  # °
RATE_20 = {26: (0.595, 0.481, 0.773), 50: (0.551, 0.407, 0.624), 74: (0.456, 0.406, 0.561)}  # °/s


def jobs(request: Request) -> list[Job]:
    counts, layouts, frames = (tuple(STORED), (0,), 90) if request.quick else (COUNTS, LAYOUTS, 300)
    return [
        Job(key_of(n, k), with_discs, {"discs": n, "layout": k, "frames": frames}, cost=(0.02 + 0.0003 * n) * frames)
        for n in counts
        for k in layouts
    ]


def with_discs(discs: int, layout: int, frames: int) -> Result:
    film = film_of(prepare(options_of({"discs": discs, "layout": layout, "seconds": frames / 30.0})))
    radius = film.rig.ball.radius
    runs = detections.all_runs(film)
    rows = {name: detections.errors(run, film.truth, radius) for name, run in runs.items()}
    return {"rows": rows, "bound": bound_rms(_where_known(run_bound(runs["so3"], film.truth, film.rig)))}


def _where_known(limit: Bound | None) -> Bound | None:
    """The frames in which something is known of the rate: with few discs there may be none in view for a while."""
    if limit is None:
        return None
    known = np.trace(limit.rate, axis1=1, axis2=2) < _KNOWN**2
    known[0] = True  # the reference
    return limit.take(np.flatnonzero(known)) if np.count_nonzero(known) > 1 else None


def key_of(discs: int, layout: int) -> str:
    return f"{discs}-{layout}"


# ---- section ----


def section(results: Results) -> list[render.Part]:
    records = []
    for key, result in results.items():
        discs, layout = map(int, key.split("-"))
        records += render.filter_rows({"discs": discs, "layout": layout}, result["rows"], result["bound"])
    columns = {"discs": "discs", "layout": "films", "filter": "filter", "mean_discs": "used per frame"}
    columns |= {"detection.centre_rms_px": "centres, px", "lost_episodes": "times lost", **render.ERRORS, **render.AXES}
    runs = render.tidy(records, columns)
    how = {
        "films": "size",
        "used per frame": "mean",
        "centres, px": "mean",
        ATTITUDE: render.rms,
        RATE: render.rms,
    }
    means = render.by(runs, ["discs", "filter"], {**how, "times lost": "sum"})
    typed = [[n, "thesis, EKF2", STORED[n], *ATTITUDE_20[n], *RATE_20[n]] for n in STORED]
    thesis = pd.DataFrame(typed, columns=["discs", "filter", "used per frame", *render.AXES.values()])
    names = list(render.AXES.values())
    thesis = thesis.assign(**{ATTITUDE: render.lengths(thesis, names[:3]), RATE: render.lengths(thesis, names[3:])})
    first = render.where(runs, films=0, discs=list(STORED), filter=list(TRACKERS))
    both = pd.concat([thesis, first])[["discs", "filter", "used per frame", *names]]
    return [
        render.Table(
            "RMSE per axis on the first layout (table 20; the thesis counts stored discs)",
            both.sort_values("discs", kind="stable"), ["discs"]
        ),
        render.Table("Combined RMSE by the number of discs, over the films", means, ["discs", "films"]),
        render.Plot(
            "count", "Errors against the number of discs, and the bound for the centres that `so3` measured.",
            pd.concat([runs, thesis]), "discs", [ATTITUDE, RATE], "filter", log="xy"
        )
    ]  # fmt: skip
