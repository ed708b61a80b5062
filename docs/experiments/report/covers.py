"""Numbers and figures of the page on limits: a ball that is covered, and found again."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from experiments.covers import AFTER, ATTITUDE, COUNTS, COVERED, FPS, GROWS, RATE, STAYS, TURNING
from experiments.kit.film import TRACKERS
from experiments.kit.job import Results
from experiments.kit.world import DISCS
from experiments.limits import in_degrees
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
from experiments.report.frames import markdown, tidy
from experiments.report.labels import End, label_ends, label_level
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing

_HIDDEN = ["discs", "ball", "sight", "cover", "filter", "hidden"]
_WAITS = ["fps", "ball", "sight", "filter", "what", "ms", "frames"]
_FILMED, _BARE = "filmed", ""  # trials with pictures, and the others, which they check


def hiding(results: Results) -> Page:
    """Share of the visible ball that is hidden when it is lost, by cover."""
    records = [
        dict(zip(_HIDDEN, (*key, sight, cover, who, 100.0 * share), strict=True))
        for key, sight, result in trials(results, "cover")
        for cover, shares in result.items()
        for who, share in shares.items()
    ]
    rows = tidy(records).reindex(columns=_HIDDEN)
    bare = rows[rows["sight"] == _BARE]
    both = rows.pivot(index=["discs", "ball", "cover", "filter"], columns="sight", values="hidden")
    apart = both.reindex(columns=[_BARE, _FILMED]).diff(axis=1)[_FILMED].abs()
    values = {
        "grows": GROWS,
        "cover_fps": FPS,
        "apart": {"median": apart.median(), "most": apart.max()},
        "hidden": _hidden_table(bare, ["discs", "cover"]),
        "hidden_filmed": _hidden_table(rows[rows["sight"] == _FILMED], ["cover"]),
        "worst": bare[bare["filter"] == "so3"].groupby("discs")["hidden"].min().reindex(COUNTS).to_dict(),
    }
    return Page(values, (_cover_figure(bare),) if len(bare) else ())


def _hidden_table(rows: pd.DataFrame, keys: list[str]) -> str:
    def cell(shares: Any) -> str:
        return span(shares, {0.0: "lost before"})

    table = rows.pivot_table(index=keys, columns="filter", values="hidden", aggfunc=cell, sort=False)
    named = {who: f"`{who}`" for who in TRACKERS}
    return markdown(table.reindex(columns=TRACKERS).rename(columns=named).reset_index(), 0, sparse=["discs"])


def _cover_figure(bare: pd.DataFrame) -> Drawing:
    counts = sorted(bare["discs"].unique())
    discs = DISCS if DISCS in counts else counts[0]
    kinds = bare[bare["discs"] == discs].groupby(["filter", "cover"], sort=False)["hidden"]

    def draw(canvas: Any) -> None:
        several = len(counts) > 1
        left, *rest = canvas.subplots(1, 2, width_ratios=(1.35, 1.0), sharey=True) if several else [canvas.subplots()]
        for k, who in enumerate(TRACKERS):
            colour, mark, _ = LOOK[who]
            for j, ends in enumerate(spread(kinds).loc[who].itertuples()):
                x = j + 0.2 * (k - 1)
                left.plot([x, x], [ends.min, ends.max], color=colour, linestyle="-", linewidth=3.0, alpha=0.3)
                left.plot([x], [ends.median], color=colour, marker=mark, linestyle="")
        names = spread(kinds).loc[TRACKERS[0]].index
        left.set_xticks(range(len(names)), ["\n".join(name.rsplit(" ", 1)) for name in names])
        left.tick_params(axis="x", labelsize=7.5)
        left.set(ylabel="hidden when it is lost, %", ylim=(0.0, 102.0), title=f"{discs:g} discs")
        left.grid(visible=False, axis="x")
        if not rest:
            legend_below(canvas, TRACKERS)
            return
        (right,), labels = rest, []
        over = spread(bare.groupby(["filter", "discs"])["hidden"])
        for who in TRACKERS:
            colour, mark, dash = LOOK[who]
            right.plot(counts, over.loc[who]["median"], color=colour, marker=mark, linestyle=dash)
            right.plot(counts, over.loc[who]["min"], color=colour, linestyle=dash, linewidth=0.7)
            labels.append(End(who, over.loc[who]["median"].iloc[-1], colour))
        right.set(xscale="log", xlabel="discs on the ball", title="median and worst cover", ylim=(0.0, 102.0))
        right.set_xticks(counts, [f"{n:g}" for n in counts])
        right.minorticks_off()
        label_ends(right, labels)

    return Drawing("limits-cover", draw, (7.2, 3.2))


def finding_again(results: Results) -> Page:
    """Time from a full cover to right attitude and rate."""
    rows = tidy(_waits(results)).reindex(columns=_WAITS)
    bare = rows[rows["sight"] == _BARE]
    both = rows.pivot(index=["fps", "ball", "filter", "what"], columns="sight", values="ms")
    both = both.reindex(columns=[_BARE, _FILMED]).dropna()
    attitude = bare[bare["what"] == "attitude"]
    values = {
        "turning": in_degrees(TURNING),
        "turned": in_degrees(TURNING * COVERED),
        "covered": COVERED,
        "right": {"attitude": ATTITUDE, "rate": in_degrees(RATE), "stays": STAYS},
        "again": _again_table(bare),
        "again_filmed": _again_table(rows[rows["sight"] == _FILMED]),
        "as_filmed": (both[_BARE] == both[_FILMED]).mean(),
        "begun": bare["ms"].notna().mean(),
        "known_frames": attitude[attitude["filter"] == "so3"]["frames"].max(),
        "published_found": np.isfinite(attitude[attitude["filter"].isin(TRACKERS[:2])]["ms"]).mean(),
    }
    return Page(values, (_again_figure(bare),) if len(bare) else ())


def _waits(results: Results) -> Iterator[dict[str, Any]]:
    """A row per trial, filter and quantity: inf where it is never right again, nan where the ball was lost before."""
    for key, sight, result in trials(results, "again"):
        for who, found in result.items():
            for what in ("attitude", "rate"):
                wait = {} if "error" in found else found[what] or {"ms": np.inf, "frames": np.inf}
                # from when the cover goes to the first frame after it half an interval passes on average
                ms, frames = wait.get("ms", np.nan) + 500.0 / key[0], wait.get("frames", np.nan)
                yield dict(zip(_WAITS, (*key, sight, who, what, ms, frames), strict=True))


def _again_table(rows: pd.DataFrame) -> str:
    def cell(waits: Any) -> str:
        return span(waits, {np.inf: "never"})

    columns = {(unit, what): f"{what}, {unit}" for what in ("attitude", "rate") for unit in ("ms", "frames")}
    table = rows.pivot_table(index=["fps", "filter"], columns="what", values=["ms", "frames"], aggfunc=cell, sort=False)
    table = table.reindex(columns=list(columns)).set_axis(list(columns.values()), axis=1)
    table = table.rename(lambda who: f"`{who}`", level="filter").reset_index().rename(columns={"fps": "Hz"})
    return markdown(table, 0, sparse=["Hz"])


def _again_figure(bare: pd.DataFrame) -> Drawing:
    never, rates = 1e3 * AFTER, sorted(bare["fps"].unique())
    shown = bare.dropna().assign(ms=bare["ms"].clip(upper=never))

    def draw(canvas: Any) -> None:
        for ax, what in zip(canvas.subplots(1, 2, sharey=True), ("attitude", "rate"), strict=True):
            ends = []
            for who, look in LOOK.items():
                waits = spread(shown[(shown["what"] == what) & (shown["filter"] == who)].groupby("fps")["ms"])
                if len(waits):
                    banded(ax, waits.index * BESIDE[who], waits, look)
                    ends.append(End(who, waits["median"].iloc[-1], look[0]))
            ax.axhline(never, color="0.5", **BOUND)
            label_level(ax, never, f"never (in {AFTER:g} s)")
            ax.set(yscale="log", ylim=(1.0, 2.2 * never), title=f"{what} right again")
            plain(ax.yaxis)
            rate_axis(ax, rates)
            label_ends(ax, ends)
            if what == "attitude":
                ax.set_ylabel("ms after the cover went")

    return Drawing("limits-again", draw, (7.2, 3.2))
