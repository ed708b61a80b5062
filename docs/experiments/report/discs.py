"""Numbers and figures of the page on discs: their size, their places, hands on the ball."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.discs import DISCS, HANDS, LAYOUTS, NEARLY, NOISE, SETTLE, SIZES, TRIAL_HIDDEN, TRIAL_SIGMA
from experiments.kit.film import TRACKERS
from experiments.kit.job import Results
from experiments.kit.tour import FAR_OFF, FOLLOWED
from experiments.report.frames import by, markdown, tidy
from experiments.report.page import Page, fixed
from experiments.report.plot import BOUND, Drawing, decades
from spheremouse.evaluate.metrics import MIN_AREA

_RECOGNISED = 99.0  # % of the pictures: good enough
_CASES = {"size": [str(mm) for mm in SIZES], "layout": list(LAYOUTS), "hands": list(HANDS)}
_QUANTITIES = {"attitude": "°", "rate": "°/s"}
_COLUMNS = {
    "attitude_rmse_deg.combined": "attitude",
    "rate_rmse_deg_s.combined": "rate",
    "so3.mean_discs": "used",
    "so3.detection.centre_rms_px": "centre",
}
_OF_FILMS = ("diameter_px", "whole", "in_view", "recognised", "mistaken", "used")
_HEADS = {  # of columns beside the errors, with digits
    "diameter_px": ("diameter, px", 1),
    "whole": ("wholly in view, %", 0),
    "in_view": ("discs in view, least", 1),
    "recognised": ("recognised, %", 1),
    "mistaken": ("mistaken, %", 1),
    "used": ("discs used", 1),
    "centre": ("centre RMS, px", 3),
}
_LOOKS: dict[str, dict[str, Any]] = {who: {"color": f"C{k}", "marker": "sDo"[k]} for k, who in enumerate(TRACKERS)}


def page(results: Results) -> Page:
    """Sizes, places, hands: each with its errors, a figure and what to do."""
    means = _means(_runs(results))
    every = pd.MultiIndex.from_tuples([(kind, name) for kind, names in _CASES.items() for name in names])
    wide = means.pivot(index=["kind", "name"], columns="filter").reindex(every)
    size, layout, hand = (means[means["kind"] == kind] for kind in _CASES)
    sizes, layouts, hands = (wide.loc[kind] for kind in _CASES)
    values = {
        "discs": DISCS,
        "noise": NOISE,
        "films": means["films"].max(),
        "far_off": FAR_OFF,
        "followed": FOLLOWED,
        "min_area": MIN_AREA,
        "nearly": NEARLY,
        "missing": TRIAL_HIDDEN,
        "sure": np.degrees(TRIAL_SIGMA),
        "recognised": _RECOGNISED,
        "settle": SETTLE,
        "sizes": sizes,
        "layouts": layouts,
        "hands": hands,
        "lost": {kind: wide.loc[kind]["lost"][list(TRACKERS)] for kind in _CASES},
        "times": hands["attitude"]["so3"] / hands["attitude"]["so3"]["none"],
        "tables": {
            "size": _table(size, "radius, mm", ["diameter_px", "whole", "used", "centre"]),
            "layout": _table(layout, "places", ["in_view", "recognised", "mistaken", "used"]),
            "hands": _table(hand, "hands", ["whole", "used"]),
        },
        "unfound": ", ".join(f"{key} ({r['unfound']})" for key, r in results.items() if "unfound" in r),
    }
    figures = ((_figure_sizes, size), (_figure_layouts, layout), (_figure_hands, hand))
    return Page(values, tuple(figure(means) for figure, means in figures if not means.empty))


def _runs(results: Results) -> pd.DataFrame:
    """A row per film and filter; the bound is one of these."""
    records: list[dict[str, Any]] = []
    for key, result in results.items():
        kind, name, _ = key.split("-")
        film = {**result, "kind": kind, "name": name.replace("_", " "), "so3": result["rows"].get("so3")}
        rows, bound = film.pop("rows"), film.pop("bound") or {}
        limit = {"attitude_rmse_deg": bound.get("attitude_deg"), "rate_rmse_deg_s": bound.get("rate_deg_s")}
        records += [{**film, "filter": who, **rows.get(who, {})} for who in TRACKERS]
        records.append({**film, "filter": "bound", **limit})
    runs = tidy(records).rename(columns=_COLUMNS)
    more = ["attitude", "rate", "tracked", "lost_episodes", "centre", *_OF_FILMS]
    runs = runs.reindex(columns=runs.columns.union(more))
    followed = (runs["lost_episodes"] == 0) & (runs["tracked"] >= FOLLOWED * runs["frames"])
    order = {name: k for k, name in enumerate(name for names in _CASES.values() for name in names)}
    return runs.assign(
        lost=(runs["filter"] != "bound") & ~(followed & (runs["attitude"] <= FAR_OFF)),
        whole=100.0 * runs["in_view_share"],
        recognised=100.0 * runs["recognised"],
        mistaken=100.0 * runs["mistaken"],
    ).sort_values("name", key=lambda names: names.map(order), kind="stable")


def _means(runs: pd.DataFrame) -> pd.DataFrame:
    """A row per case and filter, over the films: medians of errors, with their span, and means of the rest."""
    medians = {name: (name, "median") for name in (*_QUANTITIES, "centre")}
    spans = {f"{name} {end}": (name, end) for name in _QUANTITIES for end in ("min", "max")}
    means = {name: (name, "mean") for name in _OF_FILMS}
    return by(
        runs, ["kind", "name", "filter"], films=("lost", "size"), lost=("lost", "sum"), **medians, **spans, **means
    )


def _table(means: pd.DataFrame, first: str, about: Sequence[str]) -> str:
    """A row per filter, the first with what is common; where most films were lost there is no error to compare."""
    most, bound = 2 * means["lost"] >= means["films"], means["filter"] == "bound"
    top = means["filter"] == TRACKERS[0]
    shown = pd.DataFrame({first: means["name"].map(_layout_name)})
    shown["films"] = means["films"].astype(str)
    for name in about:
        head, digits = _HEADS[name]
        shown[head] = means[name].map(lambda x, digits=digits: fixed(x, digits))
    shown = shown.where(top, "")
    shown["filter"] = ("`" + means["filter"] + "`").where(~bound, "bound")
    for name, digits in (("attitude", 4), ("rate", 3)):
        errors = means[name].map(lambda x, digits=digits: fixed(x, digits))
        shown[f"{name}, {_QUANTITIES[name]}"] = errors.where(~most, "lost")
    shown["lost"] = (means["lost"].astype(str) + " of " + means["films"].astype(str)).where(~bound, "")
    return markdown(shown)


def _layout_name(name: str) -> str:
    about = LAYOUTS.get(name, name)
    return name if name == about else f"{name}: {about}"


def _figure_sizes(sizes: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        radii = sizes["name"].map(float)
        for ax in _panels(canvas, sizes.assign(x=radii), "radius of a disc, mm"):
            ax.set_xscale("log")
            ax.set_xticks(radii.unique(), sizes["name"].unique())
            ax.minorticks_off()

    return Drawing("discs-size", draw, (7.2, 3.5))


def _figure_hands(hands: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        for ax in _panels(canvas, hands.assign(x=hands["whole"]), "discs wholly in view, %"):
            ax.invert_xaxis()

    return Drawing("discs-hands", draw, (7.2, 3.5))


def _panels(canvas: Any, means: pd.DataFrame, label: str) -> Any:
    """Attitude and rate over `x`, a line per filter, and the bound."""
    axes = canvas.subplots(1, 2)
    for ax, (quantity, unit) in zip(axes, _QUANTITIES.items(), strict=True):
        for k, (who, look) in enumerate(_LOOKS.items()):
            line = means[means["filter"] == who]
            known, nothing = line.dropna(subset=[quantity]), line[line[quantity].isna()]
            ax.plot(known["x"], known[quantity], color=look["color"], linestyle="-")
            ends = known[f"{quantity} min"], known[f"{quantity} max"]
            ax.vlines(known["x"], *ends, color=look["color"], linewidth=0.8)
            _points(ax, known, known["x"], known[quantity], look)
            high = [0.98 - 0.05 * k] * len(nothing)
            how = {"marker": "x", "linestyle": "", "transform": ax.get_xaxis_transform()}
            ax.plot(nothing["x"], high, color=look["color"], **how)
        bound = means[means["filter"] == "bound"]
        ax.plot(bound["x"], bound[quantity], color="0.5", **BOUND)
        ax.set(yscale="log", xlabel=label, ylabel=f"{quantity} RMSE, {unit}")
        decades(ax.yaxis)
    _legend(canvas)
    return axes


def _figure_layouts(layouts: pd.DataFrame) -> Drawing:
    names = layouts["name"].unique()[::-1].tolist()

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, 2, sharey=True)
        for ax, (quantity, unit) in zip(axes, _QUANTITIES.items(), strict=True):
            for k, (who, look) in enumerate(_LOOKS.items()):
                found = layouts[layouts["filter"] == who]
                _points(ax, found, found[quantity], found["name"].map(names.index) + 0.18 * (1 - k), look)
            bound = layouts[layouts["filter"] == "bound"]
            row = bound["name"].map(names.index)
            ax.vlines(bound[quantity], row - 0.35, row + 0.35, color="0.5", **BOUND)
            ax.set(xscale="log", xlabel=f"{quantity} RMSE, {unit}", ylim=(-0.6, len(names) - 0.4))
            decades(ax.xaxis, (1.0,))
            ax.grid(visible=False, axis="y")
        axes[0].set_yticks(range(len(names)), names)
        _legend(canvas)

    return Drawing("discs-layout", draw, (7.2, 3.4))


def _points(ax: Any, means: pd.DataFrame, x: "pd.Series[float]", y: "pd.Series[float]", look: dict[str, Any]) -> None:
    """Points of a filter, hollow where some of the films are lost."""
    for lost, inside in ((False, {}), (True, {"markerfacecolor": "none"})):
        some = (means["lost"] > 0) == lost
        ax.plot(x[some], y[some], linestyle="", **look, **inside)


def _legend(canvas: Any) -> None:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], linestyle="-", label=who, **look) for who, look in _LOOKS.items()]
    bound = Line2D([], [], color="0.5", label="Cramér-Rao bound", **BOUND)
    canvas.legend(handles=[*lines, bound], loc="outside upper center", ncols=4)
