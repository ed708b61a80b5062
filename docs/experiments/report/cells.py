"""Cells, lines and legends that several reports share."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.job import Result, Results
from experiments.kit.tour import ESTIMATED, IGNORED, KNOWN, PUBLISHED
from experiments.kit.world import (
    NEW,
    WHO,
)
from experiments.report.page import MISSING
from experiments.report.plot import decades

COLOURS = {"ekf1": "C0", "ekf2": "C1", PUBLISHED: "C5", KNOWN: "C2", ESTIMATED: "C3", IGNORED: "C5", "bound": "0.5"}
MARKS = {"ekf1": "s", "ekf2": "D", PUBLISHED: "d", KNOWN: "o", ESTIMATED: "v", IGNORED: "^"}
DASHES = {
    "ekf1": "-", "ekf2": (0, (5, 1.5)), PUBLISHED: (0, (1.5, 1)), KNOWN: "-", ESTIMATED: (0, (5, 1.5)),
    IGNORED: (0, (1.5, 1)),
}  # fmt: skip


LOOK = {"ekf1": ("C0", "s", "-"), "ekf2": ("C1", "D", "--"), "so3": ("C2", "o", "-"), NEW: ("C3", "v", "--")}
BESIDE = {who: 1.0 + 0.015 * k for k, who in enumerate(WHO)}  # lines that would hide each other: a little to the right


def trials(results: Results, kind: str) -> Iterator[tuple[list[float], str, Result]]:
    """Numbers of the keys `kind-1-2` and `kind-1-2-filmed`, what the last word is, and results."""
    for key, result in results.items():
        name, *numbers = key.removesuffix("-filmed").split("-")
        if name == kind:
            yield list(map(float, numbers)), "filmed" if key.endswith("-filmed") else "", result


def span(values: Iterable[float], words: Mapping[float, str] | None = None) -> str:
    """Least and most of those that are known, in whole numbers; some numbers are words."""
    known = [x for x in values if not np.isnan(x)]
    rounded = [float(np.round(x)) for x in (min(known), max(known))] if known else []
    said = [(words or {0.0: "none"}).get(x, f"{x:.0f}") for x in rounded]
    return " – ".join(dict.fromkeys(said)) or MISSING


def spread(groups: Any) -> pd.DataFrame:
    """Median, least and most of each group of a column."""
    return groups.agg(["median", "min", "max"])


def banded(ax: Any, x: Any, found: pd.DataFrame, look: tuple[str, str, Any], alpha: float = 0.15) -> None:
    """A line through the medians of a `spread` at x, and a band from the least to the most."""
    colour, mark, dash = look
    ax.plot(x, found["median"], color=colour, marker=mark, linestyle=dash)
    ax.fill_between(x, found["min"], found["max"], color=colour, alpha=alpha, lw=0)


def plain(axis: Any) -> None:
    """Numbers as they are on a logarithmic axis."""
    decades(axis, (1.0, 2.0, 5.0), 15)


def rate_axis(ax: Any, rates: Sequence[float]) -> None:
    """Frame rates."""
    ax.set(xscale="log", xlabel="frame rate, Hz")
    ax.set_xticks(list(rates), [f"{r:g}" for r in rates])
    ax.xaxis.minorticks_off()


def legend_below(canvas: Any, who: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    looks: list[Any] = [dict(zip(("color", "marker", "linestyle"), LOOK[w], strict=True)) for w in who]
    handles = [Line2D([], [], label=w, **how) for w, how in zip(who, looks, strict=True)]
    canvas.legend(handles=handles, loc="outside lower center", ncols=5)
