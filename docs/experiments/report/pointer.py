"""Numbers and figures of the page on the pointer between frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.job import Result, Results
from experiments.kit.world import DISCS, RATES
from experiments.pointer import (
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
from experiments.report.cells import banded, plain, rate_axis, spread, trials
from experiments.report.frames import markdown, tidy
from experiments.report.labels import End, label_ends, label_level
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing
from spheremouse.output.pointer import PointerSettings

_LOOK: dict[str, tuple[str, str, Any]] = {
    NONE: ("C1", "s", "-"),
    ONE: ("C3", "v", "-"),
    NEXT: ("C2", "D", "-"),
    DEFAULT: ("C0", "o", "-"),
}
LARGE = ("path", "true", "t")  # data of the figures
_METRICS = {"delay": "delay, ms", "off": "distance (RMS), counts", "rough": "roughness, counts"}
_DIGITS = {"delay, ms": 0, "distance (RMS), counts": 1, "roughness, counts": 2}
_PLAYS = ["fps", "seed", "pointer", *_METRICS]
_STOPS = ["fps", "pointer", "down", "beyond"]
_SHORT = STOPPED[0]  # s
_CM = 0.1  # of the ball's surface per count: 600 counts/rad, 0.6 m radius


def page(results: Results) -> Page:
    """Errors of each way to move the pointer, in play and when the ball is stopped."""
    plays, films, more = _plays(results, "play"), _plays(results, "film"), _plays(results, "play", more=True)
    played = [result for _, _, result in trials(results, "play")]
    rough = {name: tidy(played).get(f"{name} rough", pd.Series(dtype=float)).median() for name in ("true", "whole")}
    stops, stopped = _stops(results), {key[0]: result for key, _, result in trials(results, "stop")}
    medians = plays.groupby(["pointer", "fps"])[list(_METRICS)].median()
    medians = medians.reindex(pd.MultiIndex.from_product([_LOOK, RATES]))
    short = stops[stops["down"] == _SHORT].groupby(["pointer", "fps"])["beyond"].median().reindex(medians.index)
    too_far = stops[stops["pointer"] == NONE].groupby("fps")["beyond"].max().reindex(RATES)
    values = {
        "discs": DISCS,
        "reports": PointerSettings().rate,
        "fixed_ms": 1e3 * FIXED,
        "frames": FRAMES,
        "late": {fps: 1e3 * latency(fps) for fps in (30.0, 60.0)},
        "horizon": 1e3 * PointerSettings().horizon,
        "shown_ms": 1e3 * SHOWN,
        "near": NEAR,
        "jump": JUMP,
        "too_far": {"at_15": too_far[RATES[0]], "else": too_far[list(RATES[1:])].max(skipna=False)},
        "play": medians.to_dict("index"),
        "smoother": medians["rough"][NONE, 30.0] / medians["rough"][DEFAULT, 30.0],
        "short_stop": short.to_dict(),
        "short_cm": _CM * short[DEFAULT, 30.0],
        "tracked": min((result["tracked"] for result in played), default=np.nan),
        "least_tracked": TRACKED,
        "speed": np.degrees(SPEED),
        "short_ms": 1e3 * _SHORT,
        "apart": max((result["apart"] for result in played), default=np.nan),
        "true_rough": rough["true"],
        "whole_rough": rough["whole"],
        "plays": _play_table(plays),
        "more": _play_table(more, list(MORE)),
        "stops": _stop_table(stops),
        "films": _film_table(plays, films),
    }
    drawings = [_play_figure(plays, rough["whole"])] if len(plays) else []
    return Page(values, (*drawings, *([_stop_figure(stops, stopped)] if stopped else [])))


def _plays(results: Results, kind: str, more: bool = False) -> pd.DataFrame:
    """A row per motion and way of moving the pointer, or (more) setting of it."""
    records = [
        {"fps": key[0], "seed": key[1], "pointer": way, **found}
        for key, _, result in trials(results, kind)
        for way, found in (result.get("more", {}) if more else result).items()
        if isinstance(found, dict) and way != "more"
    ]
    return tidy(records).reindex(columns=_PLAYS).sort_values("fps", kind="stable")


def _stops(results: Results) -> pd.DataFrame:
    """A row per stop and way: counts that the pointer goes beyond."""
    records = [
        {"fps": key[0], "pointer": way, "down": down, "beyond": beyond}
        for key, _, result in trials(results, "stop")
        for way in _LOOK
        for down in STOPPED
        for beyond in result[way][f"{down:g}"]
    ]
    return tidy(records).reindex(columns=_STOPS).sort_values("fps", kind="stable")


def _play_table(plays: pd.DataFrame, ways: Sequence[str] = (NONE, ONE, DEFAULT, NEXT, EXACT)) -> str:
    """Medians over motions."""
    medians = plays.groupby(["fps", "pointer"])[list(_METRICS)].median()
    rows = medians.reindex(pd.MultiIndex.from_product([plays["fps"].unique(), ways], names=["Hz", "pointer"]))
    return markdown(rows.rename(columns=_METRICS).reset_index(), _DIGITS, sparse=["Hz"])


def _film_table(plays: pd.DataFrame, films: pd.DataFrame) -> str:
    """Filmed motions beside the same ones without pictures."""
    both = films.merge(plays, on=["fps", "seed", "pointer"], suffixes=(", filmed", ""))
    columns = {
        f"{metric}{sight}": f"{_METRICS[metric]}{sight}" for metric in ("off", "rough") for sight in (", filmed", "")
    }
    table = both[both["pointer"].isin([NONE, DEFAULT])][["pointer", *columns]].rename(columns=columns)
    return markdown(table, {head: 1 if head.startswith("distance") else 2 for head in columns.values()})


def _stop_table(stops: pd.DataFrame) -> str:
    def cell(beyond: Any) -> str:
        return f"{beyond.median():.0f} ({beyond.max():.0f})"

    table = stops.pivot_table(index=["fps", "pointer"], columns="down", values="beyond", aggfunc=cell)
    ways = pd.MultiIndex.from_product([stops["fps"].unique(), (NONE, ONE, DEFAULT, NEXT)], names=["Hz", "pointer"])
    heads = {down: f"stopped in {1e3 * down:g} ms" for down in STOPPED}
    return markdown(table.reindex(index=ways, columns=STOPPED).rename(columns=heads).reset_index(), 0, sparse=["Hz"])


def _play_figure(plays: pd.DataFrame, whole: float) -> Drawing:
    rates = sorted(plays["fps"].unique())

    def draw(canvas: Any) -> None:
        from matplotlib.lines import Line2D

        for ax, (metric, label) in zip(canvas.subplots(1, 3), _METRICS.items(), strict=True):
            known = plays.dropna(subset=metric)
            for way, look in _LOOK.items():
                found = spread(known[known["pointer"] == way].groupby("fps")[metric])
                if len(found):
                    banded(ax, found.index, found, look, alpha=0.2)
            best = known[known["pointer"] == EXACT].groupby("fps")[metric].median()
            ax.plot(best.index, best, color="C4", **BOUND)
            if metric == "rough":
                ax.axhline(whole, color="0.5", **BOUND)
                label_level(ax, whole, "whole counts")
            if metric != "delay":
                ax.set_yscale("log")
                plain(ax.yaxis)
            if metric == "rough":
                ax.set_ylim(bottom=0.75 * whole)
            ax.set_title(label)
            rate_axis(ax, rates)
        handles = [Line2D([], [], color=c, marker=m, label=way, linestyle=d) for way, (c, m, d) in _LOOK.items()]
        handles.append(Line2D([], [], color="C4", label=EXACT, **BOUND))
        canvas.legend(handles=handles, loc="outside lower center", ncols=5)

    return Drawing("pointer", draw, (7.2, 3.5))


def _stop_figure(stops: pd.DataFrame, stopped: dict[float, Result]) -> Drawing:
    shown = min(stopped, key=lambda fps: abs(np.log(fps / 30.0)))
    result, short = stopped[shown], stops[stops["down"] == _SHORT]

    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        t, true = np.array(result["t"]) - result["end"], np.array(result["true"])
        near = (t > -0.25) & (t < 0.3)
        left.plot(1e3 * t[near], (true - true[-1])[near], color="0.5", linestyle="-", linewidth=4.0, alpha=0.6)
        for way in (NONE, ONE, DEFAULT):
            path = np.array(result[way]["path"]) - true[-1]
            left.step(1e3 * t[near], path[near], where="post", color=_LOOK[way][0], linestyle="-")
        left.set(
            xlabel="ms after the stop", ylabel="counts beyond", title=f"a stop within {1e3 * _SHORT:g} ms, {shown:g} Hz"
        )
        left.annotate(
            "the ball", (295.0, 0.0), xytext=(0, -6), textcoords="offset points", color="0.5", fontsize=8.0,
            va="top", ha="right",
        )  # fmt: skip
        found = {way: spread(short[short["pointer"] == way].groupby("fps")["beyond"]) for way in (NONE, ONE, DEFAULT)}
        for way, spans in found.items():
            banded(right, spans.index, spans, _LOOK[way], alpha=0.2)
        top = 1.4 * max(10.0, *(spans["median"].max() for spans in found.values()))
        right.set(title="overshoot, counts", ylim=(-0.03 * top, top))
        for fps, most in found[DEFAULT]["max"].items():
            if most > top:
                right.annotate(f"to {most:.0f}", (fps, top), xytext=(3, -8), textcoords="offset points",
                               color=_LOOK[DEFAULT][0], fontsize=8.0)  # fmt: skip
        rates = sorted(stopped)
        rate_axis(right, rates)
        ends = [End(way, spans["median"].iloc[-1], _LOOK[way][0]) for way, spans in found.items()]
        label_ends(right, ends)

    return Drawing("pointer-stop", draw, (7.2, 3.2))
