"""The filter models compared: errors, and mouse speeds over time.

Wittich 2017, section 4.6, table 19, figs. 35 to 37: `ekf1`, `ekf2` and `so3` on a film like R1, against the log of the
trackball, and on films like S1, against the truth. And on livelier play than that.
"""

from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from spheremouse.evaluate.lag import travel
from spheremouse.evaluate.match import match, turning
from spheremouse.evaluate.metrics import Run, surface_speeds
from spheremouse.experiments import r1, sights
from spheremouse.experiments.experiment import Figure, Job, Request, Result, Results, Section, Table
from spheremouse.experiments.kit import TRACKERS, Film, made, options_of, settings_of, taken, tracked
from spheremouse.experiments.report import failures, value
from spheremouse.rotation import Array
from spheremouse.simulate import prepare
from spheremouse.simulate.trackball import MouseLog
from spheremouse.simulate.truth import Truth

TITLE = "Filter models (Wittich 2017, table 19, figs. 35 to 37)"

THESIS = (  # film, filter, correlation, rates °/s, mouse speed px/s
    ("R1", "EKF1, thesis", "0.962", "–", "–"),
    ("R1", "EKF2, thesis", "0.963", "–", "–"),
    ("S1", "EKF1, thesis", "0.998", "1.59", "0.15 px/s"),
    ("S1", "EKF2, thesis", "0.999", "1.09", "0.11 px/s"),
)
PACES = (0.75, 1.0)  # beside that of the film like R1
_SHOWN = 10.0  # s, of the film like R1 in the figure
_PUBLISHED = "-blobs"
_ENOUGH = 2  # discs that hold an attitude


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
    return _compared(made(prepare(options_of({"seconds": frames / 30.0})), "S1"))


def recorded(path: str, frames: int) -> Result:
    """All filters on the reference recording like S1."""
    return _compared(taken(Path(path), frames))


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
    for detector, suffix in (("default", ""), ("blobs", _PUBLISHED))[: 1 + published]:
        seen = sights.look_at(film, settings_of([f"detector={detector}", "tracker=ekf2"]))
        for name in ("ekf1", "ekf2"):
            runs[name + suffix] = sights.filtered(seen, settings_of([f"tracker={name}"]), film)
    runs["so3"] = tracked(film, settings_of()).run
    return runs


def _row(run: Run, film: Film) -> Result:
    motion, radius = film.truth.motion, film.rig.ball.radius
    assert motion is not None
    speed, true = surface_speeds(run, motion, radius)
    off = np.linalg.norm(speed - true, axis=1)
    few = np.array([len(run.used[k]) < _ENOUGH for k in run.tracked[1:]])
    return {
        **sights.errors(run, film.truth, radius),
        "largest_mm_s": float(off.max()) if len(off) else None,
        "few_share": float(few.mean()) if len(few) else None,
    }


def _times(run: Run) -> Array:
    """Of the speeds, s."""
    k = run.tracked
    return run.stamp[k[np.isin(k - 1, k)]]


def _window(run: Run, seconds: float) -> float:
    """Where the figure begins, s: so that it shows how the run loses the ball for the first time, if it does."""
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
    counts = travel(mouse).at(stamp + agreed.lag)
    speed = np.diff(counts, axis=0) / np.diff(stamp)[:, None] / agreed.scale
    return {"t": _plain(stamp[1:]), "speed": _plain(speed)}


def _matched(run: Run, mouse: MouseLog) -> Result:
    """What `spheremouse match` finds, beside what was simulated."""
    found = match(turning(run), mouse)
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


# ---- for a reader ----


def section(request: Request, results: Results) -> Section:
    """Table 19, the figures, the livelier players."""
    like_r1, s1, far26 = results.get("r1"), results.get("s1"), results.get("far26")
    parts: list[str | Table | Figure] = [
        "`ekf1` keeps the discs as they were first seen, `ekf2` estimates them along; both on Euler angles, as "
        "published. Camera pose found from the film. With our detector, and with the published one (`blobs`). On the "
        "film like R1, which is ours, the correlation is that with the log of a simulated trackball, on the others "
        "that with the true mouse speeds."
    ]
    if request.datasets is None:
        parts.append("The reference recording far26 was not at hand: its rows are left out.")
    parts.append(_table(request, like_r1, s1, far26))
    if _good(s1):
        parts.append(_said_of_s1(s1))
    if _good(like_r1):
        parts += [_said_of_r1(like_r1), _figure_r1(like_r1)]
    if _good(s1):
        parts.append(_figure_s1(s1))
    paces = {r1.PACE: like_r1, **{p: results.get(f"pace-{p:g}") for p in PACES}}
    if any(p != r1.PACE and r is not None for p, r in paces.items()):
        parts += [
            "The same player at other paces; 1 is that of `spheremouse simulate --motion play`. The classic filters "
            "reckon with little acceleration, and hold what they do not expect for other discs.",
            _pace_table(paces),
        ]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    figures = {
        name: result if "error" in result else {k: v for k, v in result.items() if k != "series"}
        for name, result in results.items()
    }
    return Section(tuple(parts), figures)


def _good(result: Result | None) -> TypeGuard[Result]:
    return result is not None and "error" not in result


def _label(name: str) -> str:
    tracker = name.removesuffix(_PUBLISHED)
    return f"`{tracker}`, published detector" if name.endswith(_PUBLISHED) else f"`{tracker}`"


def _table(request: Request, like_r1: Result | None, s1: Result | None, far26: Result | None) -> Table:
    rows: list[tuple[str, ...]] = []
    films = [("R1", "R1-like", like_r1, "trackball"), ("S1", "S1, ours", s1, "surface_speed_r")]
    if request.datasets is not None:
        films.append(("", "far26", far26, "surface_speed_r"))
    for thesis, name, result, agreement in films:
        rows += [(film, who, r, rate, speed, "–", "–", "–") for film, who, r, rate, speed in THESIS if film == thesis]
        if not _good(result):
            rows.append((name, *((("failed",) if result else ("not run",)) + ("–",) * 6)))
            continue
        for who, row in result["rows"].items():
            r = ("trackball", "r") if agreement == "trackball" else ("surface_speed_r", "combined")
            rows.append(
                (
                    name,
                    _label(who),
                    value(row, *r, digits=5),
                    value(row, "rate_rmse_deg_s", "combined"),
                    value(row, "surface_speed_rmse_mm_s", "combined", digits=1) + " mm/s",
                    value(row, "largest_mm_s", digits=0),
                    value(row, "attitude_rmse_deg", "combined", digits=3),
                    f"{row['tracked']} of {row['frames']}, {row['lost_episodes']}",
                )
            )
    head = (
        *("film", "filter", "correlation", "rate RMSE, °/s", "mouse speed RMSE", "largest error of it, mm/s"),
        *("attitude RMSE, °", "frames tracked, times lost"),
    )
    return Table(head, tuple(rows))


def _said_of_s1(result: Result) -> str:
    rows = result["rows"]
    one, two, so3 = (rows[name]["rate_rmse_deg_s"]["combined"] for name in TRACKERS)
    published = rows["ekf2" + _PUBLISHED]
    share = published["rate_rmse_deg_s"]["combined"] / rows["ekf1" + _PUBLISHED]["rate_rmse_deg_s"]["combined"]
    return (
        f"In the thesis `ekf2` has 0.69 times the rate error of `ekf1`; on our S1 {share:.2f} times with the published "
        f"detector, {two / one:.2f} times with ours: centres that are good from the first sight need no improving, and "
        "what is left is the assumed acceleration of 0.1 rad/s², a third of the true one, which both share (see the "
        "grids of σ_w). What the state of the discs brings is the attitude: "
        f"{value(rows['ekf2'], 'attitude_rmse_deg', 'combined', digits=3)}° against "
        f"{value(rows['ekf1'], 'attitude_rmse_deg', 'combined', digits=3)}°. `so3` has {so3 / two:.2f} times the rate "
        f"error of `ekf2`. With the published detector `ekf2` uses {published['mean_discs']:.1f} discs per frame "
        f"({rows['ekf2']['mean_discs']:.1f} with ours; the thesis stores 4.9), with centres good to "
        f"{published['detection']['centre_rms_px']:.2f} px ({rows['ekf2']['detection']['centre_rms_px']:.2f}); in "
        f"{100.0 * published['few_share']:.0f} % of the frames it uses fewer than {_ENOUGH} "
        f"({100.0 * rows['ekf2']['few_share']:.0f} %), and then nothing holds the attitude."
    )


def _said_of_r1(result: Result) -> str:
    rows, found, true = result["rows"], result["match"], result["truth"]
    best = f"The true motion agrees with the trackball's log by {true['r']:.4f}: that is the most. " if true else ""
    each = [
        f"`{name}` {rows[name]['lost_episodes']} times (largest error of the speed "
        f"{value(rows[name], 'largest_mm_s', digits=0)} mm/s)"
        for name in TRACKERS
    ]
    lost = f"The ball is lost by {', '.join(each)}. "
    told = ""
    if found:
        told = (
            f"`match` finds the trackball's lag and scale from the run of `so3`: {found['lag_ms']:.1f} ± "
            f"{found['lag_sigma_ms']:.1f} ms and {found['scale']:.1f} ± {found['scale_sigma']:.1f} counts/rad "
            f"(simulated: {1e3 * r1.LAG:.0f} ms, to which clock and reports add, and {r1.SCALE:.0f})."
        )
    return best + lost + told


def _pace_table(paces: dict[float, Result | None]) -> Table:
    rows = []
    for pace, result in paces.items():
        if not _good(result):
            rows.append((f"{pace:g}", "failed" if result else "not run", *("–",) * len(TRACKERS)))
            continue
        cells = []
        for name in TRACKERS:
            row = result["rows"][name]
            cells.append(
                f"{value(row, 'trackball', 'r', digits=3)}, {value(row, 'rate_rmse_deg_s', 'combined')} °/s, lost "
                f"{row['lost_episodes']}×"
            )
        rows.append((f"{pace:g}", value(result["truth"], "r", digits=3), *cells))
    head = ("pace", "true motion", *(f"`{name}`" for name in TRACKERS))
    return Table(head, tuple(rows), "Correlation with the trackball, rate RMSE, times lost in the film")


def _figure_r1(result: Result) -> Figure:
    series, log = result["series"], result["log"]
    pale = {"color": "0.5", "alpha": 0.55, "linewidth": 2.4, "linestyle": "-"}

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(2, len(TRACKERS), sharex=True, sharey="row", squeeze=False)
        for column, (name, ax) in enumerate(zip(TRACKERS, axes.T, strict=True)):
            ax[0].set_title(name)
            ax[1].set_xlabel("time, s")
            for axis in range(2):
                if log is not None:
                    ax[axis].plot(log["t"], np.array(log["speed"])[:, axis], **pale)
                if series[name]["t"]:
                    t, speed = _gapped(series[name], "t"), _gapped(series[name], "speed")
                    ax[axis].plot(t, speed[:, axis], color=f"C{column}", linewidth=0.9, linestyle="-")
        for axis, letter in enumerate("xy"):
            axes[axis, 0].set_ylabel(f"mouse speed {letter}, mm/s")
        handles = [axes[0, 0].plot([], [], label="trackball's log", **pale)[0]]
        for column, name in enumerate(TRACKERS):
            handles += axes[0, 0].plot([], [], color=f"C{column}", linewidth=0.9, linestyle="-", label=name)
        canvas.legend(handles=handles, loc="outside upper center", ncols=4)

    return Figure(
        "filters-r1",
        f"Mouse speeds from {result['from']:g} to {result['to']:g} s of the film like R1 (as fig. 35), the trackball's "
        "brought over by the lag and the scale at which the true motion agrees with it best. A gap, or a fall to zero: "
        "the ball is lost.",
        draw,
        (7.2, 4.0),
    )


def _figure_s1(result: Result) -> Figure:
    series = result["series"]

    def draw(canvas: Any) -> None:
        rows = 1 + len(TRACKERS)
        axes = canvas.subplots(rows, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": [1.6] + [1.0] * 3})
        truth = max(series.values(), key=lambda s: len(s["t"]))
        biggest = np.concatenate([np.abs(_gapped(s, "error")).ravel() for s in series.values() if s["t"]])
        most = 1.1 * float(np.nanmax(biggest)) if len(biggest) else 1.0
        for axis, letter in enumerate("xy"):
            axes[0, axis].set_title(letter)
            axes[0, axis].plot(_gapped(truth, "t"), _gapped(truth, "true")[:, axis], color="0.5", linestyle="-")
            for k, name in enumerate(TRACKERS):
                ax, s = axes[1 + k, axis], series[name]
                ax.set_ylim(-most, most)
                if s["t"]:
                    ax.plot(_gapped(s, "t"), _gapped(s, "error")[:, axis], color=f"C{k}", linewidth=0.9, linestyle="-")
                rms = result["rows"][name]["surface_speed_rmse_mm_s"][letter]
                words = name if rms is None else f"{name}, RMS {rms:.2f} mm/s"
                ax.annotate(words, (0.01, 0.97), xycoords="axes fraction", va="top", fontsize=8)
            axes[-1, axis].set_xlabel("time, s")
        axes[0, 0].set_ylabel("true speed,\nmm/s")
        for ax in axes[1:, 0]:
            ax.set_ylabel("error,\nmm/s")
        canvas.align_ylabels(axes[:, 0])

    return Figure(
        "filters-s1",
        "True mouse speeds of our S1, and the errors of those sent (as figs. 36 and 37).",
        draw,
        (7.2, 5.0),
    )


def _gapped(series: Result, key: str) -> Array:
    """Values with nan where frames are missing: a curve breaks there."""
    t, values = np.array(series["t"], dtype=float), np.array(series[key], dtype=float)
    if len(t) < 2:
        return values
    missing = np.flatnonzero(np.diff(t) > 1.5 * np.median(np.diff(t))) + 1
    return np.insert(values, missing, np.nan, axis=0)
