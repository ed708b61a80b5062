"""Numbers and figures of the page on the near and the far camera."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.job import Result, Results
from experiments.near_far import DISCS, NOISE, THESIS, VARIANTS, VIEWS
from experiments.report.frames import by, markdown, rms, tidy
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing, plain_numbers

_QUANTITIES = {"attitude": ("attitude_rmse_deg", "°"), "rate": ("rate_rmse_deg_s", "°/s")}
_ERRORS = {f"{what} {a}, {unit}": f"{key}.{a}" for what, (key, unit) in _QUANTITIES.items() for a in "xyz"}
_COLUMNS = ["frames", "tracked", "mean_discs", "detection.centre_rms_px", *_ERRORS.values()]
_KEYS = ["view", "filter"]
_THESIS = pd.DataFrame(
    [[THESIS[view]["discs"], *THESIS[view]["attitude"], *THESIS[view]["rate"]] for view in VIEWS],
    index=pd.MultiIndex.from_product([VIEWS, ["thesis"]], names=_KEYS),
    columns=["discs", *_ERRORS],
)


def page(results: Results) -> Page:
    """Table 23, and the figure of its rates and attitudes."""
    runs = _runs(results)
    means = by(
        runs,
        _KEYS,
        discs=("mean_discs", "mean"),
        **{name: (column, rms) for name, column in _ERRORS.items()},
        untracked=("untracked", lambda frames: frames.sum(min_count=1)),
        centres=("detection.centre_rms_px", "mean"),
    ).set_index(_KEYS)
    means = means.reindex(pd.MultiIndex.from_product([VIEWS, [*VARIANTS, "bound"]], names=_KEYS))
    combined = _combined(means)
    near, far = (means["discs"].loc[(view, "so3")] for view in ("near", "far"))
    values = {
        "discs": DISCS,
        "noise": NOISE,
        "films": runs[runs["filter"] == "so3"].groupby("view").size().reindex(VIEWS),
        "table_23": _table_23(means),
        "more_discs": 100.0 * (far / near - 1.0),
        "ratios": _ratios(combined),
        "posed": {view: _posed(results.get(f"posed-{view}")) for view in VIEWS},
        "detectors": _detectors(means, combined),
    }
    return Page(values, (_figure(means),))


def _runs(results: Results) -> pd.DataFrame:
    """A row per film and filter; the bound is one of these."""
    records: list[dict[str, Any]] = []
    for key, film in results.items():
        view = key.partition("-")[0]
        if view in VIEWS:
            bound = film["bound"] or {"attitude_deg": {}, "rate_deg_s": {}}
            limit = {"attitude_rmse_deg": bound["attitude_deg"], "rate_rmse_deg_s": bound["rate_deg_s"]}
            rows = {**film["trackers"], "bound": limit}
            records += [{"view": view, "filter": who, **row} for who, row in rows.items()]
    runs = tidy(records).reindex(columns=[*_KEYS, *_COLUMNS]).astype(dict.fromkeys(_COLUMNS, float))
    return runs.assign(untracked=runs["frames"] - runs["tracked"])


def _combined(means: pd.DataFrame) -> pd.DataFrame:
    """Errors of all three axes together."""
    both = pd.concat([_THESIS, means])
    axes = {what: [name for name in _ERRORS if name.startswith(what)] for what in _QUANTITIES}
    return pd.DataFrame({what: np.linalg.norm(both[of], axis=1) for what, of in axes.items()}, index=both.index)


def _table_23(means: pd.DataFrame) -> str:
    head = {"discs": "discs", **{name: name for name in _ERRORS}, "untracked": "frames not tracked"}
    rows = pd.MultiIndex.from_product([VIEWS, ["thesis", *VARIANTS, "bound"]], names=_KEYS)
    table = pd.concat([_THESIS.map("{:g}".format), means]).reindex(index=rows, columns=list(head)).rename(columns=head)
    digits = {name: 4 if "attitude" in name else 2 for name in _ERRORS}
    return markdown(table.reset_index(), {"discs": 1, **digits}, sparse=["view"])


def _ratios(combined: pd.DataFrame) -> str:
    """Near over far."""
    return markdown((combined.loc["near"] / combined.loc["far"]).T.rename_axis("error of").reset_index())


def _posed(result: Result | None) -> dict[str, float]:
    """The attitude errors with poses as wrong as the thesis'."""
    if result is None or not result["attitude"]:
        return dict.fromkeys(("least", "most", "lost"), np.nan)
    return {"least": result["attitude"][0], "most": result["attitude"][-1], "lost": result["lost"]}


def _detectors(means: pd.DataFrame, combined: pd.DataFrame) -> str:
    rows = [
        [view, detector, combined["rate"][view, who], means["centres"][view, who]]
        for view in VIEWS
        for detector, who in {"published": "ekf2, blobs", "ours": "ekf2"}.items()
    ]
    columns = ["view", "detector", "rate RMSE, combined, °/s", "centres off by, px"]
    return markdown(pd.DataFrame(rows, columns=columns), sparse=["view"])


def _figure(means: pd.DataFrame) -> Drawing:
    looks = dict(zip(VARIANTS, (("C4", "v"), ("C0", "o"), ("C1", "s"), ("C2", "D")), strict=True))
    looks = {who: {"color": colour, "marker": mark, "linestyle": ""} for who, (colour, mark) in looks.items()}
    thesis: dict[str, Any] = {"color": "C3", "marker": "x", "linestyle": "", "markersize": 6}

    def draw(canvas: Any) -> None:
        from matplotlib.lines import Line2D

        axes, x = canvas.subplots(2, 2, sharex=True, sharey="row"), np.arange(3)
        for row, (what, (_, unit)) in zip(axes, _QUANTITIES.items(), strict=True):
            names = [name for name in _ERRORS if name.startswith(what)]
            for ax, view in zip(row, VIEWS, strict=True):
                for k, (who, look) in enumerate(looks.items()):
                    ax.plot(x + 0.15 * (k - 1.5), means.loc[(view, who), names], **look)
                ax.plot(x - 0.38, _THESIS.loc[(view, "thesis"), names], **thesis)
                for i, least in enumerate(means.loc[(view, "bound"), names]):
                    ax.plot([i - 0.3, i + 0.3], [least, least], color="0.5", **BOUND)
                ax.set_yscale("log")
                plain_numbers(ax.yaxis)
                ax.set_xticks(x, ["x", "y", "z"])
                ax.grid(visible=False, axis="x")
            row[0].set_ylabel(f"{what} RMSE, {unit}")
        for ax, view in zip(axes[0], VIEWS, strict=True):
            ax.set_title(f"{view} camera")
        all_looks = {"thesis, EKF2": thesis, **looks, "bound": {"color": "0.5", **BOUND}}
        handles = [Line2D([], [], label=who, **look) for who, look in all_looks.items()]
        canvas.legend(handles=handles, loc="outside lower center", ncols=6, handlelength=1.4, columnspacing=1.2)

    return Drawing("near-far", draw, (7.2, 4.6))
