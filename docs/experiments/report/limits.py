"""Numbers and figures of the page on limits: how fast and how suddenly a ball may turn, with blur and without."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.film import TRACKERS
from experiments.kit.job import Results
from experiments.kit.world import DISCS, HOLD, NEW, NOISE, RATES, WHO, WRONG
from experiments.limits import (
    ACCELERATIONS,
    EXPOSURES,
    FASTEST,
    FILMED_SECONDS,
    HARDEST,
    LADDER,
    PUSH,
    SLOWEST,
    WHOLE,
    in_degrees,
)
from experiments.report.cells import (
    BESIDE,
    LOOK,
    banded,
    legend_below,
    plain,
    rate_axis,
    span,
    spread,
    trials,
)
from experiments.report.covers import finding_again, hiding
from experiments.report.frames import by, markdown, tidy
from experiments.report.labels import End, label_ends, label_level
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing
from spheremouse.simulate.ball.film import default_scene

_GENTLEST = ACCELERATIONS[0]  # rad/s²
_SOFTEST = 1.0  # rad/s², the least that is tried
_FLICK = 400.0  # °/s, about the fastest that hands turn the ball
_STOP = 100.0  # rad/s², of a stop by hand (`So3Settings.levels`)
_FLICKED = min(ACCELERATIONS, key=lambda a: abs(np.log(a / _STOP)))
_USUAL = 60.0  # Hz, of the camera whose exposures are compared
_ALL = 0.99  # of what was tried
_SPEEDS = ["fps", "ball", "filter", "acceleration", "rate", "push"]
_FILMS = ["fps", "exposure", "ball", "filter", "rate", "in pictures", "without"]


def page(results: Results) -> Page:
    """Return the page of its parts: rates, films, hiding and recovery."""
    parts = [part(results) for part in (_speeds, _films, hiding, finding_again)]
    values = {name: value for part in parts for name, value in part.values.items()}
    return Page(values, tuple(drawing for part in parts for drawing in part.drawings))


def _speeds(results: Results) -> Page:
    """Highest rates, °/s, by acceleration, and the highest acceleration to PUSH, without pictures."""
    records = [
        dict(zip(_SPEEDS, (*key, who, acceleration, in_degrees(rate), found["acceleration"]), strict=True))
        for key, _, result in trials(results, "speed")
        for who, found in result.items()
        for acceleration, rate in zip(ACCELERATIONS, found["rate"], strict=True)
    ]
    rows = tidy(records).reindex(columns=_SPEEDS)
    gentle, flicked = (rows[rows["acceleration"] == a] for a in (_GENTLEST, _FLICKED))
    medians = by(gentle, ["fps", "filter"], balls=("ball", "size"), rate=("rate", "median"), push=("push", "median"))
    worst = flicked.groupby(["filter", "fps"])["rate"].min().reindex(pd.MultiIndex.from_product([WHO, RATES]))
    first = medians[medians["fps"] == RATES[0]].set_index("filter").reindex(WHO)
    values = {
        "discs": DISCS,
        "balls": medians["balls"].max(),
        "hold": HOLD,
        "wrong": WRONG,
        "fastest": in_degrees(FASTEST),
        "hardest": HARDEST,
        "push": in_degrees(PUSH),
        "softest": _SOFTEST,
        "softly": PUSH**2 / (2.0 * _SOFTEST),
        "gentlest": _GENTLEST,
        "flick": _FLICK,
        "flicked": _FLICKED,
        "stop": _STOP,
        "speeds": _speed_table(medians),
        "slowest_camera": RATES[0],
        "fastest_camera": RATES[-1],
        "soft": first.to_dict("index"),
        "flick_ours": worst[["so3", NEW]].min(skipna=False),
        "flick_published": worst[list(TRACKERS[:2])].max(skipna=False),
    }
    return Page(values, (_speed_figure(rows), _map_figure(rows)) if len(rows) else ())


def _speed_table(medians: pd.DataFrame) -> str:
    rate, push = f"rate, °/s, at {_GENTLEST:g} rad/s²", f"acceleration, rad/s², to {in_degrees(PUSH):.0f} °/s"
    columns = {
        "Hz": medians["fps"],
        "filter": [f"`{who}`" for who in medians["filter"]],
        rate: [_limit(x, in_degrees(SLOWEST), in_degrees(FASTEST)) for x in medians["rate"]],
        push: [_limit(x, _SOFTEST, HARDEST) for x in medians["push"]],
        "which is between two frames from, rad/s²": PUSH * medians["fps"],
    }
    return markdown(pd.DataFrame(columns), 0, sparse=["Hz", "which is between two frames from, rad/s²"])


def _limit(value: float, least: float, most: float) -> str:
    if value <= 0.0:
        return f"< {least:.0f}"
    return f"≥ {most:.0f}" if value > _ALL * most else f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"


def _speed_figure(rows: pd.DataFrame) -> Drawing:
    rates = sorted(rows["fps"].unique())
    gentle = rows[rows["acceleration"] == _GENTLEST]

    def draw(canvas: Any) -> None:
        for ax, (column, label, least, most) in zip(
            canvas.subplots(1, 2),
            (
                ("rate", f"highest rate at {_GENTLEST:g} rad/s², °/s", 20.0, in_degrees(FASTEST)),
                ("push", f"highest acceleration to {in_degrees(PUSH):.0f} °/s, rad/s²", _SOFTEST, HARDEST),
            ),
            strict=True,
        ):
            ends = []
            for who, look in LOOK.items():
                reached = gentle[gentle["filter"] == who].set_index("fps")[column].clip(lower=least)
                found = spread(reached.groupby("fps"))
                banded(ax, found.index * BESIDE[who], found, look)
                ends.append(End(who, found["median"].iloc[-1], look[0]))
            if column == "push":
                between = [PUSH * fps for fps in rates]
                ax.plot(rates, between, color="0.5", **BOUND)
                ends.append(End("between\ntwo frames", between[-1], "0.5"))
            ax.axhline(most, color="0.5", **BOUND)
            label_level(ax, most, "all that was tried")
            ax.set(yscale="log", ylim=(least, 2.0 * most), title=label)
            plain(ax.yaxis)
            rate_axis(ax, rates)
            label_ends(ax, ends)

    return Drawing("limits-speed", draw, (7.2, 3.2))


def _map_figure(rows: pd.DataFrame) -> Drawing:
    reached = rows.groupby(["fps", "filter", "acceleration"])["rate"].median().clip(lower=20.0)
    rates = sorted(rows["fps"].unique())

    def draw(canvas: Any) -> None:
        axes = np.atleast_1d(canvas.subplots(1, len(rates), sharey=True))
        for ax, fps in zip(axes, rates, strict=True):
            for who, (colour, mark, dash) in LOOK.items():
                ax.plot(ACCELERATIONS, reached[fps, who], color=colour, marker=mark, linestyle=dash)
                ax.fill_between(ACCELERATIONS, 20.0, reached[fps, who], color=colour, alpha=0.06, lw=0)
            between = [in_degrees(a / fps) for a in ACCELERATIONS]
            ax.plot(ACCELERATIONS, between, color="0.5", linestyle="--", linewidth=0.7)
            ax.axvline(_STOP, color="0.5", **BOUND)
            ax.axhline(_FLICK, color="0.5", **BOUND)
            ax.set(xscale="log", yscale="log", ylim=(20.0, 1.5 * in_degrees(FASTEST)), title=f"{fps:g} Hz")
            ax.set_xticks(ACCELERATIONS, [f"{a:g}" for a in ACCELERATIONS])
            ax.minorticks_off()
            plain(ax.yaxis)
        axes[0].set_ylabel("rate reached, °/s")
        axes[len(axes) // 2].set_xlabel("acceleration, rad/s²")
        legend_below(canvas, WHO)

    return Drawing("limits-map", draw, (7.2, 2.9))


def _films(results: Results) -> Page:
    """Highest rates, °/s, that are followed in pictures, by exposure, ms."""
    records = [
        dict(zip(_FILMS, (*key, who, *map(in_degrees, (result[who], *sharp))), strict=True))
        for key, _, result in trials(results, "film")
        for who in TRACKERS
        for sharp in [result.get("sharp", {}).get(who, (np.nan, np.nan))]
    ]
    rows = tidy(records).reindex(columns=_FILMS).sort_values(["fps", "exposure"], kind="stable")
    sharp, usual = rows.dropna(), rows[rows["fps"] == _USUAL]
    least = usual[usual["filter"] == "so3"].groupby("exposure")["rate"].min()
    values = {
        "noise": NOISE,
        "film_seconds": FILMED_SECONDS,
        "filmed": in_degrees(LADDER[-1]),
        "way": in_degrees(WHOLE),
        "sharp": _sharp_table(sharp),
        "sharp_gain": (sharp["in pictures"] - sharp["without"]).min(),
        "films": _film_table(rows),
        "exposed": least.reindex([1e3 * e for e in EXPOSURES]).to_dict(),
        "exposed_least": least.min(),
    }
    return Page(values, (_film_figure(rows),) if usual["exposure"].nunique() > 1 else ())


def _sharp_table(sharp: pd.DataFrame) -> str:
    """Rates up to which each follows where all of the way from rest is seen."""
    columns = {name: [_limit(x, 0.0, in_degrees(WHOLE)) for x in sharp[name]] for name in ("in pictures", "without")}
    return markdown(pd.DataFrame({"filter": [f"`{who}`" for who in sharp["filter"]], **columns}))


def _film_table(rows: pd.DataFrame) -> str:
    keys = ["fps", "exposure"]
    table = rows.groupby([*keys, "filter"], sort=False)["rate"].agg(span).unstack("filter", sort=False)
    table = table.reindex(columns=TRACKERS).rename(columns={who: f"`{who}`" for who in TRACKERS})
    smeared = [in_degrees(_width(1e-3 * e)) for e in table.index.get_level_values("exposure")]
    table.insert(0, "smeared over a disc's width at, °/s", smeared)
    table.insert(0, "balls", rows.groupby(keys)["ball"].nunique())
    return markdown(table.reset_index().rename(columns={"fps": "Hz", "exposure": "exposure, ms"}), 0)


def _width(exposure: float) -> float:
    """rad/s, at which a disc in the middle of the ball moves by its own width while it is exposed for so many s."""
    return 2.0 * default_scene(1).disc_angle / exposure if exposure else np.nan


def _film_figure(rows: pd.DataFrame) -> Drawing:
    shown = rows.assign(rate=rows["rate"].clip(lower=30.0))
    usual = shown[shown["fps"] == _USUAL]
    exposures = sorted(usual["exposure"].unique())
    place = {e: k for k, e in enumerate(exposures)}

    def draw(canvas: Any) -> None:
        ax = canvas.subplots()
        ends = []
        for who in TRACKERS:
            colour, mark, _ = LOOK[who]
            found = spread(usual[usual["filter"] == who].groupby("exposure")["rate"])
            banded(ax, range(len(exposures)), found, LOOK[who])
            ends.append(End(who, found["median"].iloc[-1], colour))
            others = shown[(shown["fps"] != _USUAL) & (shown["filter"] == who) & shown["exposure"].isin(exposures)]
            for _, (fps, e, rate) in others.groupby(["fps", "exposure"])["rate"].median().reset_index().iterrows():
                x = place[e] + (0.12 if fps > _USUAL else -0.12)
                ax.plot([x], [rate], color=colour, marker=mark, markerfacecolor="none", linestyle="")
        smeared = [(place[e], in_degrees(_width(1e-3 * e))) for e in exposures if e]
        ax.plot(*zip(*smeared, strict=True), color="0.5", **BOUND)
        ends.append(End("smear: a disc's width", smeared[-1][1], "0.5"))
        ax.axhline(in_degrees(LADDER[-1]), color="0.5", linewidth=0.6)
        ax.set(yscale="log", xlabel="exposure, ms", ylabel="highest rate followed, °/s", ylim=(30.0, 4000.0))
        ax.set_xticks(range(len(exposures)), [f"{e:g}" for e in exposures])
        plain(ax.yaxis)
        label_ends(ax, ends)

    return Drawing("limits-exposure", draw, (7.2, 3.0))
