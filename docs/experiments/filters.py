"""The filter models compared: errors, and mouse speeds over time.

Wittich 2017, section 4.6, table 19, figs. 35 to 37: `ekf1` keeps the discs as first seen, `ekf2` estimates them too.
Both use Euler angles, as published, and run with our detector and with the published one (`blobs`). On a film like R1,
at several paces of its player, the correlation is that with the log of a simulated trackball. On films like S1 it is
that with the true mouse speeds. The thesis' mouse speed is in its px/s.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import detections, r1
from experiments.kit.film import (
    TRACKERS,
    Film,
    film_from_dataset,
    film_of,
    options_of,
    settings_of,
    tracked,
)
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Claim, Part, Plot, Table, tidy, where
from spheremouse.ball.truth import Truth
from spheremouse.evaluate.metrics import Run, surface_speeds
from spheremouse.evaluate.trackball import CountPath, RotationSteps, match
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.film import prepare

TITLE = "Filter models (Wittich 2017, table 19, figs. 35 to 37)"
THESIS = (  # film, filter, correlation, rates °/s, mouse speed px/s
    ("R1", "EKF1, thesis", 0.962, None, None),
    ("R1", "EKF2, thesis", 0.963, None, None),
    ("S1", "EKF1, thesis", 0.998, 1.59, 0.15),
    ("S1", "EKF2, thesis", 0.999, 1.09, 0.11),
)
PACES = (0.75, 1.0)  # beside that of the film like R1
_SHOWN = 10.0  # s, of the film like R1 in the figure
PUBLISHED = "-blobs"
ENOUGH = 2  # discs that hold an attitude


def jobs(request: Request) -> list[Job]:
    """One per film."""
    frames = 90 if request.quick else 300
    seconds = 4.0 if request.quick else r1.SECONDS
    found = [
        Job("r1", play, {"seconds": seconds, "pace": r1.PACE, "published": not request.quick}, cost=1.4 * seconds),
        Job("s1", simulated, {"frames": frames}, cost=0.025 * frames),
    ]
    if request.datasets is not None:
        path = str(request.datasets / "far26")
        found.append(Job("far26", recorded, {"path": path, "frames": frames}, cost=0.02 * frames))
    if not request.quick:
        found += [
            Job(f"pace-{pace:g}", play, {"seconds": seconds, "pace": pace, "published": False}, cost=1.4 * seconds)
            for pace in PACES
        ]
    return found


def play(seconds: float, pace: float, published: bool) -> Result:
    """All filters on a film like R1, with their agreement with the trackball and their speeds over time."""
    film, mouse = r1.filmed(seconds, pace)
    radius = film.rig.ball.radius
    rows, series = {}, {}
    runs = _runs(film, published)
    begin = _window(runs["ekf2"], seconds)
    for name, run in runs.items():
        agreed = r1.of_run(run, mouse, radius)
        rows[name] = _row(run, film)
        rows[name]["trackball"] = {} if agreed is None else {"r": agreed.r, "lag_s": agreed.lag}
        if name in TRACKERS:
            series[name] = _over_time(run, film, begin)
    assert film.truth.motion is not None
    true = r1.of_truth(film.truth.motion, mouse, radius)
    return {
        "rows": rows,
        "series": series,
        "log": None if true is None else _log_over_time(film.truth.motion, mouse, true, begin),
        "truth": {} if true is None else {"r": true.r, "lag_s": true.lag},
        "match": _matched(runs["so3"], mouse),
        "from": begin,
        "to": min(seconds, begin + _SHOWN),
    }


def simulated(frames: int) -> Result:
    """All filters on a film like S1."""
    return _compared(film_of(prepare(options_of({"seconds": frames / 30.0})), "S1"))


def recorded(path: str, frames: int) -> Result:
    """All filters on the reference recording like S1."""
    return _compared(film_from_dataset(Path(path), frames))


def _compared(film: Film) -> Result:
    runs = _runs(film, published=True)
    series: Result = {}
    motion = film.truth.motion
    assert motion is not None
    for name in TRACKERS:
        speed, true = surface_speeds(runs[name], motion, film.rig.ball.radius)
        series[name] = {"t": _plain(_times(runs[name])), "error": _plain(speed - true), "true": _plain(true)}
    return {"rows": {name: _row(run, film) for name, run in runs.items()}, "series": series}


def _runs(film: Film, published: bool) -> dict[str, Run]:
    """By the filters' names; with the published detector the classic ones once more."""
    runs: dict[str, Run] = {}
    for detector, suffix in (("default", ""), ("blobs", PUBLISHED))[: 1 + published]:
        seen = detections.look_at(film, settings_of([f"detector={detector}", "tracker=ekf2"]))
        for name in ("ekf1", "ekf2"):
            runs[name + suffix] = detections.filtered(seen, settings_of([f"tracker={name}"]), film)
    runs["so3"] = tracked(film, settings_of()).run
    return runs


def _row(run: Run, film: Film) -> Result:
    motion, radius = film.truth.motion, film.rig.ball.radius
    assert motion is not None
    speed, true = surface_speeds(run, motion, radius)
    off = np.linalg.norm(speed - true, axis=1)
    few = np.array([len(run.used[k]) < ENOUGH for k in run.tracked[1:]])
    return {
        **detections.errors(run, film.truth, radius),
        "largest_mm_s": float(off.max()) if len(off) else None,
        "few_share": float(few.mean()) if len(few) else None,
    }


def _times(run: Run) -> Array:
    """Return the stamps of the speeds, s."""
    return run.stamp[run.steps]


def _window(run: Run, seconds: float) -> float:
    """Return the begin of the figure, s. It shows the first loss of the ball, if there is one."""
    lost = np.setdiff1d(np.arange(run.tracked[0], len(run.frame)), run.tracked) if len(run.tracked) else np.zeros(0)
    first = float(run.stamp[int(lost[0])]) if len(lost) else 0.0
    return float(np.clip(np.floor(first - 0.5 * _SHOWN), 0.0, max(0.0, seconds - _SHOWN)))


def _over_time(run: Run, film: Film, begin: float) -> Result:
    """The speeds that a run sent, mm/s."""
    assert film.truth.motion is not None
    t = _times(run)
    speed, _ = surface_speeds(run, film.truth.motion, film.rig.ball.radius)
    shown = (t >= begin) & (t < begin + _SHOWN)
    return {"t": _plain(t[shown]), "speed": _plain(speed[shown])}


def _log_over_time(motion: Truth, mouse: MouseLog, agreed: r1.Agreement, begin: float) -> Result:
    """The log's speeds between frames, brought to the ball's by lag and scale as in fig. 28, mm/s."""
    stamp = motion.stamp[(motion.stamp >= begin) & (motion.stamp < begin + _SHOWN)]
    counts = CountPath.from_log(mouse).at(stamp + agreed.lag)
    speed = np.diff(counts, axis=0) / np.diff(stamp)[:, None] / agreed.scale
    return {"t": _plain(stamp[1:]), "speed": _plain(speed)}


def _matched(run: Run, mouse: MouseLog) -> Result:
    """Compare the result of `spheremouse match` with the simulation."""
    found = match(RotationSteps.from_run(run), mouse)
    if found is None:
        return {}
    return {
        "lag_ms": 1e3 * found.lag,
        "lag_sigma_ms": 1e3 * found.lag_sigma,
        "scale": float(0.5 * (found.matrix[0, 2] + found.matrix[1, 0])),
        "scale_sigma": float(np.hypot(found.sigma[0, 2], found.sigma[1, 0]) / 2.0),
    }


def _plain(values: Array) -> list[Any]:
    return np.round(values, 3).tolist()


# ---- section ----


def section(results: Results) -> list[Part]:
    """Table 19, the speeds over time, and the livelier players."""
    records = [
        {
            "film": film,
            "true": result.get("truth", {}).get("r"),
            "filter": who,
            **row,
            "r": row.get("trackball", {}).get("r", row["surface_speed_r"]["combined"]),
        }
        for film, result in results.items()
        for who, row in result["rows"].items()
    ]
    runs = tidy(
        records,
        {
            "film": "film",
            "filter": "filter",
            "r": "correlation",
            "true": "correlation of the true motion",
            "rate_rmse_deg_s.combined": RATE,
            "surface_speed_rmse_mm_s.combined": "mouse speed, mm/s",
            "largest_mm_s": "largest error of it, mm/s",
            "attitude_rmse_deg.combined": ATTITUDE,
            "tracked": "tracked",
            "frames": "frames",
            "lost_episodes": "times lost",
            "mean_discs": "discs",
            "detection.centre_rms_px": "centres, px",
            "few_share": f"share with fewer than {ENOUGH} discs",
        },
    )
    thesis = pd.DataFrame(THESIS, columns=["film", "filter", "correlation", RATE, "mouse speed, mm/s"])
    lost = runs[runs["film"].str.startswith(("r1", "pace"))].groupby("filter")["times lost"]
    s1 = where(runs, film="s1").set_index("filter")
    found = results.get("r1", {}).get("match", {})
    parts: list[Part] = [
        Table("Errors by film and filter (table 19)", pd.concat([thesis, runs]), ["film"], {"correlation": 5}),
        Claim(
            "The state of the discs improves the attitude of `ekf2`, and `so3` has the smaller rate error.",
            len(s1) and s1[ATTITUDE]["ekf2"] < 0.95 * s1[ATTITUDE]["ekf1"] and s1[RATE]["so3"] < s1[RATE]["ekf2"],
        ),
        Claim(
            "The published filters expect little acceleration and take a fast disc for another one. They lose the "
            "ball at every pace of the film like R1, `so3` at none.",
            lost.min().reindex(["ekf1", "ekf2"]).min(skipna=False) > 0 and lost.max().get("so3") == 0,
        ),
        *_speeds(results),
    ]
    if found:
        near = abs(found["scale"] - r1.SCALE) < 3.0 * found["scale_sigma"] < 0.1 * r1.SCALE
        parts.append(
            Claim(
                f"`spheremouse match` finds {found['lag_ms']:.1f} ± {found['lag_sigma_ms']:.1f} ms and "
                f"{found['scale']:.1f} ± {found['scale_sigma']:.1f} counts/rad (simulated: {1e3 * r1.LAG:.0f} ms "
                f"and what the log adds, {r1.SCALE:g} counts/rad).",
                near,
            )
        )
    return parts


def _speeds(results: Results) -> list[Part]:
    """Mouse speeds on the film like R1, and their errors on that like S1."""
    parts: list[Part] = []
    for film, key, label in (("r1", "speed", "mouse speed, mm/s"), ("s1", "error", "error of the mouse speed, mm/s")):
        result = results.get(film, {})
        curves = {"trackball's log": result.get("log"), **result.get("series", {})}
        frames = [
            pd.DataFrame(c[key], columns=["x", "y"]).assign(filter=who, **{"time, s": c["t"]})
            for who, c in curves.items()
            if c and c["t"]
        ]
        if frames:
            rows = pd.concat(frames).melt(["filter", "time, s"], var_name="axis", value_name=label)
            parts.append(
                Plot(f"filters-{film}", f"{label.capitalize()} on {film}.", rows, "time, s", [label], "filter", "axis")
            )
    return parts
