"""What the experiments on the filters are said to show: tables, figures and sentences."""

from typing import Any, TypeGuard

import numpy as np

from spheremouse.experiments.filters import ENOUGH, PACES, PUBLISHED, THESIS
from spheremouse.experiments.kit import r1
from spheremouse.experiments.kit.film import TRACKERS, settings_of
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.report.page import failures, value
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball import profile
from spheremouse.simulate.ball.film import SimulationOptions

_THESIS_RATES = (1.59, 1.09)  # °/s, EKF1 and EKF2 on S1
_FAR_OFF = 1.0  # °, an attitude that went wrong
_SOME = 0.005  # of the frames
_VAGUE = 0.1  # of a scale: its standard deviation is no more than that where it is known


def section(request: Request, results: Results) -> Section:
    """Table 19, the figures, the livelier players."""
    like_r1, s1, far26 = results.get("r1"), results.get("s1"), results.get("far26")
    parts: list[str | Table | Figure] = [
        "`ekf1` keeps the discs as they were first seen, `ekf2` estimates them along; both on Euler angles, as "
        "published. Camera pose found from the film. With our detector, and with the published one (`blobs`). On the "
        "film like R1, which is ours, the correlation is that with the log of a simulated trackball, on the others "
        f"that with the true mouse speeds. {_films(results)}"
    ]
    if request.datasets is None:
        parts.append("The reference recording far26 was not at hand: its rows are left out.")
    parts.append(_table(request, like_r1, s1, far26))
    if _good(s1):
        parts.append(_said_of_s1(s1))
    if _good(far26):
        parts.append(_said_of_far26(far26))
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
    return Section(tuple(part for part in parts if part), figures)


def _films(results: Results) -> str:
    """How long they are, and how noisy."""
    frames = {
        name: result["rows"]["so3"]["frames"] for name, result in results.items() if _good(result) and "rows" in result
    }
    noise = {"r1": r1.OPTIONS["noise"], "s1": SimulationOptions().noise, "far26": 0.0}
    told = [
        f"{title} {frames[name]}, noise of {noise[name]:g} grey values"
        for name, title in (("r1", "R1-like"), ("s1", "S1, ours"), ("far26", "far26"))
        if name in frames
    ]
    return f"Frames: {'; '.join(told)}; the thesis' S1 has 300." if told else ""


def _good(result: Result | None) -> TypeGuard[Result]:
    return result is not None and "error" not in result


def _label(name: str) -> str:
    tracker = name.removesuffix(PUBLISHED)
    return f"`{tracker}`, published detector" if name.endswith(PUBLISHED) else f"`{tracker}`"


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
                    value(row, "attitude_rmse_deg", "combined", digits=4),
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
    rates = {name: row["rate_rmse_deg_s"]["combined"] for name, row in rows.items()}
    if any(rates[name] is None for name in TRACKERS):
        return ""
    one, two, so3 = (rates[name] for name in TRACKERS)
    thesis = _THESIS_RATES[1] / _THESIS_RATES[0]
    assumed, true = settings_of().euler.acceleration_sigma, acceleration(profile.thesis())
    said = [
        f"In the thesis `ekf2` has {thesis:.2f} times the rate error of `ekf1`; on our S1 {two / one:.2f} times with "
        "our detector"
        + (": centres that are good from the first sight need no improving." if two > 0.9 * one else "."),
        _published(rows),
        f"Both assume an acceleration of {assumed:g} rad/s²; that of the film is {true:.2f} rad/s² (mean): see the "
        "grids of σ_w.",
    ]
    one_a, two_a = (rows[name]["attitude_rmse_deg"]["combined"] for name in ("ekf1", "ekf2"))
    if one_a is not None and two_a is not None:
        what = (
            "What the state of the discs brings is the attitude"
            if two_a < 0.95 * one_a
            else "Nor does the state of the discs bring a better attitude here"
        )
        said.append(f"{what}: `ekf2` {two_a:.3f}°, `ekf1` {one_a:.3f}°.")
    said.append(f"`so3` has {so3 / two:.2f} times the rate error of `ekf2`.")
    return " ".join(s for s in said if s)


def acceleration(motion: profile.Profile) -> float:
    """Mean angular acceleration, rad/s²."""
    t = np.linspace(0.0, motion.seconds, 2001)[:-1]
    steps = np.diff(motion.rate(t), axis=0) / (t[1] - t[0])
    return float(np.mean(np.linalg.norm(steps, axis=1)))


def _published(rows: Result) -> str:
    """The two filters with the published detector, and why they cannot be compared, if so."""
    runs = [rows.get(name + PUBLISHED) for name in ("ekf1", "ekf2")]
    if any(run is None or run["rate_rmse_deg_s"]["combined"] is None for run in runs):
        return "With the published detector nothing is tracked."
    one, two = (run for run in runs if run is not None)
    ours = rows["ekf2"]
    used = (
        f"With that detector `ekf2` uses {value(two, 'mean_discs', digits=1)} discs per frame "
        f"({value(ours, 'mean_discs', digits=1)} with ours; the thesis stores 4.9), with centres good to "
        f"{value(two, 'detection', 'centre_rms_px')} px ({value(ours, 'detection', 'centre_rms_px')}); "
        + (
            f"in {value(two, 'few_share', digits=0, factor=100.0)} % of the frames it uses fewer than {ENOUGH} "
            f"({value(ours, 'few_share', digits=0, factor=100.0)} %), and then nothing holds the attitude."
            if (two["few_share"] or 0.0) >= _SOME
            else f"it hardly ever uses fewer than {ENOUGH}, so that it is not for want of discs."
        )
    )
    wrong = [run["attitude_rmse_deg"]["combined"] or 0.0 for run in (one, two)]
    lost = [run["lost_episodes"] for run in (one, two)]
    if max(wrong) > _FAR_OFF or max(lost) > 0:
        return (
            "No comparison with the published detector: with it the attitude goes wrong by "
            f"{wrong[0]:.1f}° (`ekf1`) and {wrong[1]:.1f}° (`ekf2`), and the ball is lost {_times_lost(lost[0])} and "
            f"{_times_lost(lost[1])}. {used}"
        )
    share = two["rate_rmse_deg_s"]["combined"] / one["rate_rmse_deg_s"]["combined"]
    return f"With the published detector it is {share:.2f} times. {used}"


def _times_lost(n: int) -> str:
    return {0: "never", 1: "once"}.get(n, f"{n} times")


def _said_of_far26(result: Result) -> str:
    """Where the mouse speed of so3 is worse than that of a stiff filter, and why."""
    two, so3 = result["rows"]["ekf2"], result["rows"]["so3"]
    speeds = [row["surface_speed_rmse_mm_s"]["combined"] for row in (two, so3)]
    rates = [row["rate_rmse_deg_s"]["combined"] for row in (two, so3)]
    if None in (*speeds, *rates) or speeds[1] <= speeds[0]:
        return ""
    return (
        f"On far26 the mouse speed of `so3` is off by {speeds[1]:.1f} mm/s, that of `ekf2` by {speeds[0]:.1f} mm/s, "
        f"and its rate by {rates[1]:.2f} against {rates[0]:.2f} °/s: what is sent favours a filter that reckons with "
        "little acceleration where the motion is smooth; on livelier motion that filter loses the ball "
        "([accuracy](accuracy.md))."
    )


def _said_of_r1(result: Result) -> str:
    rows, true = result["rows"], result["truth"]
    said = []
    if true:
        said.append(
            f"The true motion agrees with the trackball's log by {true['r']:.4f}: a tracker can hardly agree better."
        )
    each = [
        f"`{name}` {_times_lost(rows[name]['lost_episodes'])} (largest error of the speed "
        f"{value(rows[name], 'largest_mm_s', digits=0)} mm/s)"
        for name in TRACKERS
    ]
    said.append(f"The ball is lost by {', '.join(each)}.")
    one, two = (rows[name]["attitude_rmse_deg"]["combined"] for name in ("ekf1", "ekf2"))
    if one is not None and two is not None and two > 1.05 * one:
        said.append(
            f"Here `ekf2` has the worse attitude of the published filters ({two:.1f}° against {one:.1f}°): both lose "
            "the ball, and by how much they are off from then on is chance."
            if rows["ekf1"]["lost_episodes"] and rows["ekf2"]["lost_episodes"]
            else f"Here `ekf2` has the worse attitude of the published filters ({two:.1f}° against {one:.1f}°)."
        )
    said.append(_said_of_match(result["match"]))
    return " ".join(s for s in said if s)


def _said_of_match(found: Result) -> str:
    if not found:
        return ""
    lag = f"{found['lag_ms']:.1f} ± {found['lag_sigma_ms']:.1f} ms"
    simulated_lag = f"{1e3 * r1.LAG:.0f} ms, to which clock and reports add"
    if found["scale_sigma"] > _VAGUE * abs(found["scale"]):
        return (
            f"`match` finds the trackball's lag from the run of `so3`: {lag} (simulated: {simulated_lag}). The film is "
            "too short to tell the scale."
        )
    return (
        f"`match` finds the trackball's lag and scale from the run of `so3`: {lag} and {found['scale']:.1f} ± "
        f"{found['scale_sigma']:.1f} counts/rad (simulated: {simulated_lag}, and {r1.SCALE:.0f})."
    )


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
