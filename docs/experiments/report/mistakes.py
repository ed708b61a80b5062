"""Numbers and figures of the page on a calibration that is wrong."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.job import Results
from experiments.kit.tour import FAR_OFF, FOLLOWED
from experiments.mistakes import (
    ALONE,
    EVENING,
    FREE,
    KINDS,
    LENS,
    PER_UNIT,
    STEADY,
    STRAIGHT,
    TOLD,
    TRACKERS,
    Kind,
)
from experiments.report.cells import COLOURS
from experiments.report.frames import by, markdown, tidy
from experiments.report.labels import End, label_ends
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing, plain_numbers

_WHO = (*TRACKERS, FREE)
_LABELS = {
    "attitude": "attitude, °",
    "rate": "rate, °/s",
    "off": "scale off by, %",
    "direction": "astray by, °",
    "wobble": "wobble, %",
}
_LOOKS: dict[str, dict[str, Any]] = {
    "ekf1": {"color": COLOURS["ekf1"], "marker": "s", "linestyle": "-"},
    "ekf2": {"color": COLOURS["ekf2"], "marker": "D", "linestyle": (0, (5, 1.5))},
    "so3": {"color": COLOURS["so3"], "marker": "o", "linestyle": "-"},
    FREE: {"color": "C5", "marker": "^", "linestyle": (0, (1.5, 1))},
    TOLD: {"color": "C3", "marker": "v", "linestyle": (0, (5, 1.5))},
}
_COLUMNS = (
    *("film", "edge", "bound.attitude", "bound.rate", "mistake", "size", "filter"),
    *("attitude", "rate", "scale", "direction", "wobble", "lost", "tracked", "frames"),
)
_WOBBLE = {
    "size": "size",
    "so3": "wobble of `so3`, %",
    "ekf2": "wobble of `ekf2`, %",
    "tried": "sizes tried",
    "more": "sizes at which `so3` wobbles more",
}
_DIGITS = {**dict.fromkeys((*_LABELS.values(), "scale, %", _WOBBLE["so3"], _WOBBLE["ekf2"]), 1), _LABELS["attitude"]: 2}


def page(results: Results) -> Page:
    """Each mistake alone, all together, and what may be off by how much."""
    runs = _runs(results)
    wrong = runs[runs["size"] != 0.0]
    alone = wrong[wrong["mistake"].isin(ALONE)]
    right = runs[(runs["size"] == 0.0) & (runs["filter"] == "so3")].drop_duplicates("film")
    right_rig = right[[*_LABELS, "bound.attitude", "bound.rate"]].median()
    medians = _medians(runs)
    wobble = _wobble(medians)
    evening = medians[(medians["mistake"] == "evening") & (medians["size"] == 1.0)].set_index("filter")
    told, silent = evening.reindex([TOLD, "so3"])[["attitude", "direction", "wobble"]].to_numpy()
    values = {
        "films": len(right),
        "right": right_rig,
        "right_well": runs.loc[(runs["size"] == 0.0) & runs["filter"].isin(["so3", FREE]), "well"].all(),
        "followed": FOLLOWED,
        "far_off": FAR_OFF,
        "rigs": np.count_nonzero(alone["filter"] == "so3"),
        "stopped": (alone["lost"] > 0).groupby(alone["filter"]).sum().reindex(list(_WHO)),
        "typical": _typical(medians),
        "edge": wrong.loc[(wrong["mistake"] == "lens") & (wrong["size"] == LENS), "edge"].median(),
        "more_often": wobble["more"] / wobble["tried"],
        "wobble": _by_mistake(wobble, _WOBBLE),
        "tables": {name: _table(kind, medians[medians["mistake"] == name]) for name, kind in KINDS.items()},
        "sigma": EVENING,
        "lens": LENS,
        "straight": STRAIGHT,
        "steady": STEADY,
        "evenings": evening["rigs"].max(),
        "evening": _evening(evening),
        "worse": np.min(told / silent),
        "most_well": evening["well"].max(),
        "borne": _borne(wrong),
    }
    drawings = (
        _figure("mistakes-errors", alone, ("attitude", "rate"), right_rig),
        _figure("mistakes-mouse", alone, ("off", "direction", "wobble"), right_rig),
        _figure_evening(wrong[wrong["mistake"] == "evening"], right_rig),
    )
    return Page(values, drawings)


def _runs(results: Results) -> pd.DataFrame:
    """A row per mistake, rig and filter; the right rig has size 0, and of a rig without a pose nothing is known."""
    records: list[dict[str, Any]] = []
    for key, result in results.items():
        group, *rest = key.split("-")
        film = {"film": "-".join(rest) if group == "lens" else rest[-1], "edge": result["edge"]}
        film["bound"] = result["bound"] or {}
        for mistake, sizes in result["mistakes"].items():
            rigs = [(0.0, result["right"]), *((float(size), rig) for size, of in sizes.items() for rig in of)]
            for size, rig in rigs:
                rows = rig.get("rows", {})
                who = (*_WHO, TOLD) if mistake == "evening" and size else _WHO
                records += [{**film, "mistake": mistake, "size": size, "filter": w, **rows.get(w, {})} for w in who]
    runs = tidy(records).reindex(columns=_COLUMNS)
    followed = (runs["lost"] == 0) & (runs["tracked"] >= FOLLOWED * runs["frames"])
    return runs.assign(
        off=runs["scale"].abs(),
        gone=~(followed & (runs["attitude"] <= FAR_OFF)),
        well=followed & (runs["direction"] <= STRAIGHT) & (runs["wobble"] <= STEADY),
    ).sort_values("size", kind="stable")


def _medians(runs: pd.DataFrame) -> pd.DataFrame:
    """A row per mistake, size and filter."""
    return by(
        runs,
        ["mistake", "size", "filter"],
        rigs=("film", "size"),
        scale=("scale", "median"),
        **{name: (name, "median") for name in _LABELS},
        lost=("gone", "sum"),
        tracked=("tracked", "sum"),
        frames=("frames", "sum"),
        well=("well", "sum"),
    )


def _table(kind: Kind, medians: pd.DataFrame) -> str:
    sizes = (PER_UNIT[kind.name] * medians["size"]).map("{:g}".format)
    shown = medians.assign(
        size=sizes.where(medians["size"] != 0.0, "right rig"),
        rigs=medians["rigs"].map(str).where(medians["filter"] == _WHO[0], ""),
        filter="`" + medians["filter"] + "`",
        held=100.0 * medians["tracked"] / medians["frames"],
    )
    columns = {"size": kind.label, "rigs": "rigs", "filter": "filter", **_LABELS, "lost": "lost"}
    columns["held"] = "frames tracked, %"
    return markdown(shown[list(columns)].rename(columns=columns), _DIGITS, sparse=[kind.label])


def _typical(medians: pd.DataFrame) -> str:
    """Results of `so3` with each mistake of a likely size."""
    so3 = medians[medians["filter"] == "so3"].set_index(["mistake", "size"])
    rows = so3.reindex([(name, KINDS[name].typical) for name in ALONE]).reset_index("size")
    columns = {"scale": "scale, %", **{name: _LABELS[name] for name in ("direction", "wobble", "attitude")}}
    return _by_mistake(rows, {"size": "size", **columns})


def _wobble(medians: pd.DataFrame) -> pd.DataFrame:
    """By mistake: the size at which `so3` and `ekf2` differ most, and at how many `so3` wobbles more."""
    both = medians[medians["size"] != 0.0].pivot(index=["mistake", "size"], columns="filter", values="wobble")
    both = both.reindex(columns=["so3", "ekf2"]).dropna().reset_index("size")
    both["apart"] = (both["so3"] - both["ekf2"]).abs()
    most = both.sort_values("apart").groupby("mistake").tail(1)
    counts = (both["so3"] > both["ekf2"]).groupby("mistake").agg(tried="size", more="sum")
    return most.join(counts).reindex(list(ALONE))


def _evening(evening: pd.DataFrame) -> str:
    shown = evening.reset_index().assign(filter="`" + evening.index + "`")
    columns = {"filter": "filter", **_LABELS, "lost": "lost", "well": "well"}
    return markdown(shown[list(columns)].rename(columns=columns), _DIGITS)


def _borne(wrong: pd.DataFrame) -> str:
    """The largest size of each mistake, either way, up to which all rigs do well."""
    size = wrong["size"].abs()
    well = wrong["well"].groupby([wrong["mistake"], wrong["filter"], size]).all().astype(int)
    so_far = well.groupby(level=["mistake", "filter"]).cummin()
    largest = so_far[so_far == 1].reset_index("size").groupby(["mistake", "filter"])["size"].max().unstack()
    rows = largest.reindex(index=list(KINDS), columns=["so3", FREE])
    rows["least"] = size.groupby(wrong["mistake"]).min()
    columns = {"so3": "`so3`", FREE: f"`{FREE}`", "least": "least tried"}
    return _by_mistake(rows, columns, sizes=list(columns))


def _by_mistake(rows: pd.DataFrame, columns: Mapping[str, str], sizes: Sequence[str] = ("size",)) -> str:
    """A row per mistake, with sizes in the unit of its label."""
    shown = rows.assign(mistake=[KINDS[name].label for name in rows.index])
    for name in sizes:
        shown[name] = (rows[name] * rows.index.map(PER_UNIT)).map("{:g}".format, na_action="ignore")
    return markdown(shown[["mistake", *columns]].rename(columns=columns), _DIGITS)


def _figure(name: str, wrong: pd.DataFrame, quantities: Sequence[str], right: "pd.Series[float]") -> Drawing:
    def draw(canvas: Any) -> None:
        mistakes = wrong.groupby("mistake")
        names = [name for name in ALONE if name in mistakes.groups]
        if not names:
            return
        grid = canvas.subplots(len(quantities), len(names), sharey="row", squeeze=False)
        for row, quantity in zip(grid, quantities, strict=True):
            for ax, mistake in zip(row, names, strict=True):
                ends = _panel(ax, KINDS[mistake], mistakes.get_group(mistake), quantity, right)
                ax.tick_params(labelsize=7.5)
                if ax is row[-1]:
                    label_ends(ax, ends)
            row[0].set_ylabel(_LABELS[quantity])
            plain_numbers(row[0].yaxis)
        for ax, mistake in zip(grid[-1], names, strict=True):
            ax.set_xlabel(KINDS[mistake].label)

    return Drawing(name, draw, (7.2, 1.4 + 1.3 * len(quantities)))


def _figure_evening(wrong: pd.DataFrame, right: "pd.Series[float]") -> Drawing:
    def draw(canvas: Any) -> None:
        grid = canvas.subplots(2, 3)
        for ax, quantity in zip(grid.ravel(), _LABELS, strict=False):
            ends = _panel(ax, KINDS["evening"], wrong, quantity, right, span=True)
            ax.set_ylabel(_LABELS[quantity])
            plain_numbers(ax.yaxis)
            label_ends(ax, ends)
        grid[1, 2].remove()
        for ax in (*grid[1, :2], grid[0, 2]):
            ax.set_xlabel("errors, evenings")

    return Drawing("mistakes-evening", draw, (7.2, 4.2))


def _panel(
    ax: Any, kind: Kind, wrong: pd.DataFrame, quantity: str, right: "pd.Series[float]", span: bool = False
) -> list[End]:
    """Draw the lines of a quantity; names, ends and colours."""
    ends: list[End] = []
    columns = {name: (quantity, name) for name in ("median", "min", "max")}
    found = by(
        wrong.assign(size=PER_UNIT[kind.name] * wrong["size"]), ["filter", "size"], **columns, gone=("gone", "any")
    )
    for who, line in found.dropna().groupby("filter", sort=False):
        look = _LOOKS[str(who)]
        ax.plot(line["size"], line["median"], color=look["color"], linestyle=look["linestyle"])
        for gone, points in line.groupby("gone"):
            mark = {"marker": "x", "markersize": 6} if gone else {"marker": look["marker"], "markersize": 3}
            ax.plot(points["size"], points["median"], color=look["color"], linestyle="", **mark)
        if span and who == "so3":
            ax.fill_between(line["size"], line["min"], line["max"], color=look["color"], alpha=0.13, linewidth=0)
        ends.append(End(str(who), line["median"].iloc[-1], look["color"]))
    name, level = ("bound", f"bound.{quantity}") if quantity in ("attitude", "rate") else ("right rig", quantity)
    if right[level] > 0.0:
        ax.axhline(right[level], color="0.5", **BOUND)
        ends.append(End(name, right[level], "0.5"))
    ax.set_yscale("log")
    if kind.log:
        ax.set_xscale("log")
        plain_numbers(ax.xaxis)
        sizes = found["size"].unique()
        ticks = sizes if len(sizes) <= 3 else sizes[[0, len(sizes) // 2, -1]]
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.minorticks_off()
    return ends
