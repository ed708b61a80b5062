"""What the experiments on the pointer are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.world import DISCS
from spheremouse.experiments.pointer import (
    DEFAULT,
    EXACT,
    FIXED,
    FRAMES,
    JUMP,
    MORE,
    NEAR,
    NEXT,
    NONE,
    ONE,
    SHOWN,
    SPEED,
    STOPPED,
    TRACKED,
    latency,
)
from spheremouse.experiments.report.cells import films_cell, label_lines, plain, rate_axis, those
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND
from spheremouse.output.pointer import PointerSettings

_MARKS = {NONE: ("C1", "s"), ONE: ("C3", "v"), NEXT: ("C2", "D"), DEFAULT: ("C0", "o")}
_MM = 1.0  # of the ball's surface per count: 600 counts/rad, 0.6 m radius
_METRICS = {
    "delay": ("delay, ms", 0),
    "off": ("distance (RMS), counts", 1),
    "rough": ("roughness, counts", 2),
}


def section(request: Request, results: Results) -> Section:
    """What each way of moving the pointer comes to."""
    good = {k: r for k, r in results.items() if "error" not in r}
    plays, stops = _plays(good), {float(k.split("-")[1]): r for k, r in good.items() if k.startswith("stop-")}
    bad = {k: r for k, r in results.items() if "error" in r}
    parts: list[str | Table | Figure] = [_about(good)]
    if plays:
        parts += [_figure(plays), _table(plays, _plays(bad))]
        more = _more_table(good)
        parts += [more] if more else []
    if stops:
        broken = [float(k.split("-")[1]) for k in bad if k.startswith("stop-")]
        parts += [_stop_figure(stops), _stop_table(stops, broken), *([_jumped(stops)] if _jumped(stops) else [])]
    film = _film(good)
    parts += [text for text in (film, _advice(plays, stops)) if text]
    parts += [text for text in (_lost(good),) if text]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    numbers = {k: {n: v for n, v in r.items() if n not in ("t", "true")} for k, r in results.items()}
    for result in numbers.values():
        for name, value in result.items():
            if isinstance(value, dict) and "path" in value:
                result[name] = {k: v for k, v in value.items() if k != "path"}
    return Section(tuple(parts), numbers)


def _plays(good: Results) -> dict[float, list[Result]]:
    """By frame rate; those without pictures."""
    found: dict[float, list[Result]] = {}
    for key, result in good.items():
        if key.startswith("play-"):
            found.setdefault(float(key.split("-")[1]), []).append(result)
    return dict(sorted(found.items()))


def _values(results: list[Result], way: str, metric: str) -> list[float]:
    return [r[way][metric] for r in results if r[way][metric] is not None]


def _median(results: list[Result], way: str, metric: str) -> float | None:
    values = _values(results, way, metric)
    return float(np.median(values)) if values else None


def _about(good: Results) -> str:
    plays = [r for k, r in good.items() if k.startswith("play-")]
    same = ""
    if plays:
        apart = max(r["apart"] for r in plays)
        same = (
            " A horizon of 0 sends each frame's counts as it arrives: it is the pointer without resampling, to the "
            "count."
            if apart == 0.0
            else f" A horizon of 0 differs from the pointer without resampling by up to {apart:.0f} counts."
        )
    return (
        f"`so3` follows a ball of {DISCS} discs before the far camera, without pictures: centres with the detector's "
        "noise "
        "(the detector does not limit here; a film checks it). Its counts and rates go through the daemon's own "
        f"resampling, 600 counts/rad, {PointerSettings().rate:g} reports/s. A frame is assumed to arrive "
        f"{1e3 * FIXED:g} ms "
        f"and {FRAMES:g} frame intervals after its stamp: {1e3 * latency(30.0):.0f} ms at 30 Hz, "
        f"{1e3 * latency(60.0):.0f} ms at 60 Hz. *To the next frame* is a horizon of that and one interval more, *one "
        f"frame* of an interval alone, the default {1e3 * PointerSettings().horizon:g} ms. Delay is by lag search, "
        "between "
        "the pointer as it is shown and the ball; roughness is the RMS of second differences of the pointer's place "
        "every "
        f"{1e3 * SHOWN:g} ms." + same
    )


def _table(plays: dict[float, list[Result]], broken: dict[float, list[Result]]) -> Table:
    rows = []
    for fps in sorted({*plays, *broken}):
        results = plays.get(fps, [])
        made = films_cell(len(results), len(broken.get(fps, [])))
        if not results:
            rows.append((f"{fps:g}", made, *["–"] * 4))
            continue
        for k, way in enumerate((NONE, ONE, DEFAULT, NEXT, EXACT)):
            cells = []
            for metric, (_, digits) in _METRICS.items():
                value = _median(results, way, metric)
                cells.append("none found" if value is None else f"{value:.{digits}f}")
            rows.append((*((f"{fps:g}", made) if k == 0 else ("", "")), way, *cells))
    base = [r for results in plays.values() for r in results]
    true, whole = (float(np.median([r[k] for r in base])) for k in ("true rough", "whole rough"))
    title = (
        "Somebody plays (median over motions). The ball's own roughness is "
        f"{true:.2f} counts, that of its path in whole counts {whole:.2f}"
    )
    return Table(("Hz", "motions", "pointer", *(label for label, _ in _METRICS.values())), tuple(rows), title)


def _more_table(good: Results) -> Table | None:
    found: dict[float, list[Result]] = {}
    for key, result in good.items():
        if "more" in result:
            found.setdefault(float(key.split("-")[1]), []).append(result["more"])
    if not found:
        return None
    rows = []
    for fps, results in sorted(found.items()):
        for name in MORE:
            values = [_median(results, name, metric) for metric in _METRICS]
            cells = [
                "none found" if v is None else f"{v:.{d}f}" for v, (_, d) in zip(values, _METRICS.values(), strict=True)
            ]
            rows.append((f"{fps:g}", name, *cells))
    return Table(("Hz", "setting", *(label for label, _ in _METRICS.values())), tuple(rows), "Other settings")


def _figure(plays: dict[float, list[Result]]) -> Figure:
    whole = float(np.median([r["whole rough"] for results in plays.values() for r in results]))

    def draw(canvas: Any) -> None:
        from matplotlib.lines import Line2D

        axes = canvas.subplots(1, 3)
        rates = list(plays)
        for ax, (metric, (label, _)) in zip(axes, _METRICS.items(), strict=True):
            for way, (colour, mark) in _MARKS.items():
                points = [(fps, _values(plays[fps], way, metric)) for fps in rates]
                points = [(fps, v) for fps, v in points if v]
                if not points:
                    continue
                x, middle = [p[0] for p in points], [float(np.median(p[1])) for p in points]
                ax.plot(x, middle, color=colour, marker=mark, linestyle="-")
                ax.fill_between(
                    x, [min(p[1]) for p in points], [max(p[1]) for p in points], color=colour, alpha=0.2, lw=0
                )
            best = [(fps, _median(plays[fps], EXACT, metric)) for fps in rates]
            ax.plot([f for f, v in best if v is not None], [v for _, v in best if v is not None], color="C4", **BOUND)
            if metric == "rough":
                ax.axhline(whole, color="0.5", **BOUND)
                ax.text(rates[0], 0.97 * whole, "whole counts", color="0.5", fontsize=7.5, va="top")
            if metric != "delay":
                ax.set_yscale("log")
                plain(ax.yaxis)
            if metric == "rough":
                ax.set_ylim(bottom=0.75 * whole)
            ax.set_title(label)
            rate_axis(ax, rates)
        handles = [Line2D([], [], color=c, marker=m, label=w, linestyle="-") for w, (c, m) in _MARKS.items()]
        handles.append(Line2D([], [], color="C4", label=EXACT, **BOUND))
        canvas.legend(handles=handles, loc="outside lower center", ncols=5)

    return Figure(
        "pointer",
        "Delay, distance from the ball and roughness of the pointer while somebody plays, against the camera's frame "
        "rate; "
        "shaded: the span over motions. Dotted: the default, were every attitude exact.",
        draw,
        (7.2, 3.5),
    )


def _beyond(result: Result, way: str, down: float) -> list[float]:
    return result[way][f"{down:g}"]


def _stop_table(stops: dict[float, Result], broken: list[float]) -> Table:
    rows = []
    for fps in sorted({*stops, *broken}):
        if fps not in stops:
            rows.append((f"{fps:g}", "failed", *["–"] * len(STOPPED)))
            continue
        for k, way in enumerate((NONE, ONE, DEFAULT, NEXT)):
            beyond = [_beyond(stops[fps], way, d) for d in STOPPED]
            cells = [f"{np.median(b):.0f} ({max(b):.0f})" for b in beyond]
            rows.append((f"{fps:g}" if k == 0 else "", way, *cells))
    head = ("Hz", "pointer", *(f"stopped in {1e3 * d:g} ms" for d in STOPPED))
    return Table(
        head, tuple(rows), f"Overshoot of a ball stopped from {np.degrees(SPEED):.0f} °/s, counts: median (most)"
    )


def _stop_figure(stops: dict[float, Result]) -> Figure:
    shown = min(stops, key=lambda fps: abs(np.log(fps / 30.0)))
    result, down = stops[shown], STOPPED[0]

    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        t, end = np.array(result["t"]), result["end"]
        near = (t > end - 0.25) & (t < end + 0.3)
        true = np.array(result["true"])
        left.plot(1e3 * (t - end)[near], (true - true[-1])[near], color="0.5", linestyle="-", linewidth=4.0, alpha=0.6)
        for way in (NONE, ONE, DEFAULT):
            path = np.array(result[way]["path"]) - true[-1]
            left.step(1e3 * (t - end)[near], path[near], where="post", color=_MARKS[way][0], linestyle="-")
        left.set(
            xlabel="ms after the stop", ylabel="counts beyond", title=f"a stop within {1e3 * down:g} ms, {shown:g} Hz"
        )
        left.annotate(
            "the ball", (295.0, 0.0), xytext=(0, -6), textcoords="offset points", color="0.5", fontsize=8.0,
            va="top", ha="right",
        )  # fmt: skip
        rates, ends, highest = sorted(stops), [], 0.0
        for way in (NONE, ONE, DEFAULT):
            colour, mark = _MARKS[way]
            values = [_beyond(stops[fps], way, down) for fps in rates]
            middle = [float(np.median(v)) for v in values]
            right.plot(rates, middle, color=colour, marker=mark, linestyle="-")
            right.fill_between(rates, [min(v) for v in values], [max(v) for v in values], color=colour, alpha=0.2, lw=0)
            ends.append((middle[-1], way, colour))
            highest = max(highest, *middle)
        top = 1.4 * max(highest, 10.0)
        right.set(title="overshoot, counts", ylim=(-0.03 * top, top))
        for fps in rates:
            most = max(_beyond(stops[fps], DEFAULT, down))
            if most > top:
                right.annotate(f"to {most:.0f}", (fps, top), xytext=(3, -8), textcoords="offset points",
                               color=_MARKS[DEFAULT][0], fontsize=8.0)  # fmt: skip
        rate_axis(right, rates)
        label_lines(right, rates[-1], ends)

    return Figure(
        "pointer-stop",
        f"A ball of {np.degrees(SPEED):.0f} °/s is stopped by hand: the pointer at one such stop, and how far it "
        "goes beyond "
        "against the frame rate (median; shaded: by when the stop falls between two frames).",
        draw,
        (7.2, 3.2),
    )


def _jumped(stops: dict[float, Result]) -> str:
    """Where the tracker itself said too much, and the pointer with it."""
    most = {fps: max(b for d in STOPPED for b in _beyond(r, NONE, d)) for fps, r in sorted(stops.items())}
    said = [f"{m:.0f} counts at {fps:g} Hz" for fps, m in most.items() if m > JUMP]
    if not said:
        return ""
    return (
        f"Without resampling the pointer goes too far only where the tracker does: by up to {', '.join(said)}. There "
        "its attitude itself was wrong for a moment, and prediction adds to that."
    )


def _film(good: Results) -> str:
    """Pictures against none."""
    said = []
    for key, film in good.items():
        twin = good.get(key.replace("film", "play"))
        if not key.startswith("film-") or twin is None:
            continue
        said += [
            f"{way}: {film[way]['off']:.1f} counts from the ball and roughness {film[way]['rough']:.2f} (without "
            "pictures "
            f"{twin[way]['off']:.1f} and {twin[way]['rough']:.2f})"
            for way in (NONE, DEFAULT)
        ]
    return f"The same motion filmed at 30 Hz: {'; '.join(said)}." if said else ""


def _lost(good: Results) -> str:
    """Where `so3` itself did not follow; the first frame is one."""
    lost = [f"{k} ({100.0 * (1.0 - r['tracked']):.0f} %)" for k, r in good.items() if r.get("tracked", 1.0) < TRACKED]
    return f"Discs did not hold the attitude in part of the frames of {', '.join(lost)}." if lost else ""


def _advice(plays: dict[float, list[Result]], stops: dict[float, Result]) -> str:
    """For who builds a device, from what was measured."""
    said = []
    if plays:
        near = [fps for fps in plays if (_median(plays[fps], DEFAULT, "off") or np.inf) < NEAR]
        reaches = [fps for fps in plays if latency(fps) + 1.0 / fps <= PointerSettings().horizon + 1e-9]
        fps = min(plays, key=lambda f: abs(np.log(f / 30.0)))
        late, led = (_median(plays[fps], way, "delay") for way in (NONE, DEFAULT))
        rough = [_median(plays[fps], way, "rough") for way in (NONE, DEFAULT)]
        if late is not None and led is not None and rough[0] and rough[1]:
            said.append(
                f"At {fps:g} Hz resampling takes the delay from {late:.0f} to {led:.0f} ms and the roughness to "
                f"1/{rough[0] / rough[1]:.0f}."
            )
        if near:
            said.append(
                f"With the default the pointer stays within {NEAR:g} counts of the ball (RMS) "
                f"{those(near, list(plays))}."
            )
        else:
            said.append(f"With the default no frame rate keeps the pointer within {NEAR:g} counts of the ball (RMS).")
        if reaches:
            said.append(
                f"The default horizon reaches to the next frame from {min(reaches):g} Hz on: for slower cameras set "
                f"`pointer.horizon` to latency and one interval{_price(stops, reaches)}."
            )
    if stops:
        down = STOPPED[0]
        by = {fps: float(np.median(_beyond(r, DEFAULT, down))) for fps, r in sorted(stops.items())}
        one = {fps: float(np.median(_beyond(r, ONE, down))) for fps, r in sorted(stops.items())}
        worst, best = max(by, key=by.__getitem__), min(by, key=by.__getitem__)
        usual = min(by, key=lambda f: abs(np.log(f / 30.0)))
        said.append(
            f"A ball of {np.degrees(SPEED):.0f} °/s that is stopped within {1e3 * down:g} ms leaves the default "
            f"pointer {by[usual]:.0f} counts too far at {usual:g} Hz: {0.1 * _MM * by[usual]:.0f} cm of the ball, "
            f"since 1 count is {_MM:g} mm of it. The pointer never runs back: what was too much stays, and is withheld "
            "from later motion the same way."
        )
        said.append(
            f"A stop within {1e3 * down:g} ms costs the default an overshoot of {by[worst]:.0f} counts at {worst:g} "
            "Hz and "
            f"{by[best]:.0f} at {best:g} Hz, a horizon of one frame {one[worst]:.0f} and {one[best]:.0f}: who aims "
            "takes "
            "a faster camera before a shorter horizon."
            if one[worst] > by[best]
            else f"A stop within {1e3 * down:g} ms costs the default an overshoot of {by[worst]:.0f} counts at "
            f"{worst:g} Hz, "
            f"a horizon of one frame {one[worst]:.0f}."
        )
    return " ".join(said)


def _price(stops: dict[float, Result], reaches: list[float]) -> str:
    """What the longer horizon of slower cameras costs where a ball is stopped."""
    slow = {fps: r for fps, r in sorted(stops.items()) if fps < min(reaches)}
    said = [
        f"{np.median(_beyond(r, NEXT, STOPPED[0])):.0f} in place of {np.median(_beyond(r, DEFAULT, STOPPED[0])):.0f} "
        f"counts too far at {fps:g} Hz"
        for fps, r in slow.items()
    ]
    return f" (its price, where a ball is stopped within {1e3 * STOPPED[0]:g} ms: {', '.join(said)})" if said else ""
