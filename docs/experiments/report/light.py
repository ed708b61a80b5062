"""Numbers and figures of the page on noise and brightness."""

from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.film import TRACKERS
from experiments.kit.job import Result, Results
from experiments.light import SIGMAS, THESIS_24, WORST, decoded, key_of
from experiments.report.frames import markdown, rms, tidy
from experiments.report.labels import label_points
from experiments.report.page import Page
from experiments.report.plot import BOUND, THESIS, Drawing

LARGE = ("shown",)  # data of the figures
_FILMS = {"s1": "S1, ours", "far26": "far26"}
_QUANTITIES = {"rate_rmse_deg_s.combined": "rate", "detection.centre_rms_60_px": "centres", "frames": "frames"}
_THESIS = pd.DataFrame(
    [
        {"level": level, "filter": "thesis", "sigma": sigma, "rate": rate}
        for level, row in THESIS_24.items()
        for sigma, rate in zip(SIGMAS, row, strict=True)
    ],
).astype({"rate": float})
_LOOKS: dict[str, dict[str, Any]] = {
    **{who: {"label": who, "color": f"C{k}", "marker": "osD"[k]} for k, who in enumerate(TRACKERS)},
    "bound": {"label": "Cramér-Rao bound", "color": "0.5", **BOUND},
    "thesis": {"label": "thesis", "color": "C3", "marker": "x", **THESIS},
}
_AXES = ("C3", "C4", "C5")  # of angles and axes; C0 to C2 are the trackers'


def page(results: Results) -> Page:
    """Table 24 and figs. 40 and 41."""
    runs, shown = _runs(results), _shown(results)
    films = [film for film in _FILMS if film in set(runs["film"])]
    over_l = runs.groupby(["film", "filter", "sigma"])[["rate", "centres"]].agg(rms)
    over_l = over_l.reindex(pd.MultiIndex.from_product([_FILMS, TRACKERS, SIGMAS], names=over_l.index.names))
    darkest = (runs["film"] == "s1") & (runs["level"] == min(THESIS_24)) & (runs["sigma"] == max(SIGMAS))
    over_thesis = over_l["rate"].xs("s1").xs("ekf2") / _THESIS.dropna().groupby("sigma")["rate"].agg(rms)
    errors = _attitude_errors(shown)
    values = {
        "frames": runs["frames"].max(),
        "far26": "far26" in films,
        **{f"rates_{film}": _rates(runs[runs["film"] == film]) for film in _FILMS},
        "poses_missed": sum("error" in cell for result in results.values() for cell in result["cells"].values()),
        "dark": runs.loc[darkest & (runs["filter"] == "so3"), "rate"].max(),
        "over_thesis": over_thesis,
        "most_over_thesis": over_thesis.max(skipna=False),
        "growth": _growth(over_l, films),
        "largest": errors[list("xyz")].max(axis=None, skipna=False),
        "hump": (errors["middle"] / errors[["first", "last"]].max(axis=1)).max(skipna=False),
        "attitude": markdown(errors, dict.fromkeys(errors.columns, 3)),
    }
    drawings = [_figure_rates(runs, films)] if films else []
    return Page(values, (*drawings, *([_figure_picture(shown), _figure_attitude(shown)] if shown else [])))


def _runs(results: Results) -> pd.DataFrame:
    """A row per film, brightness, noise and filter; the bound is one of these."""
    records: list[dict[str, Any]] = []
    for film, level in product(_FILMS, THESIS_24):
        for sigma, cell in results.get(key_of(film, level), {"cells": {}})["cells"].items():
            limit = {"rate_rmse_deg_s": (cell.get("bound") or {}).get("rate_deg_s")}
            for who, row in {**cell.get("rows", {}), "bound": limit}.items():
                records.append({"film": film, "level": level, "sigma": int(sigma), "filter": who, **row})
    runs = tidy(records).rename(columns=_QUANTITIES)
    return runs.reindex(columns=["film", "level", "sigma", "filter", *_QUANTITIES.values()])


def _shown(results: Results) -> Result | None:
    """Return the data of figures 40 and 41."""
    level, sigma = WORST
    return results.get(key_of("s1", level), {"cells": {}})["cells"].get(str(sigma), {}).get("shown")


def _rates(runs: pd.DataFrame) -> str:
    table = pd.concat([_THESIS, runs]).pivot(index=["level", "filter"], columns="sigma", values="rate")
    table = table.reindex(index=list(product(THESIS_24, ("thesis", *TRACKERS))), columns=list(SIGMAS)).reset_index()
    table["level"] = [f"{level:+d}" for level in table["level"]]
    table["filter"] = ["thesis, EKF2" if who == "thesis" else f"`{who}`" for who in table["filter"]]
    table.columns = ["l", "filter", *(f"σ_r = {sigma}" for sigma in SIGMAS)]
    return markdown(table, dict.fromkeys(table.columns, 2), sparse=["l"])


def _growth(over_l: pd.DataFrame, films: list[str]) -> str:
    """Centres with the least and the most noise, and the errors' growth between them."""
    least, most = (over_l.xs(sigma, level="sigma") for sigma in (SIGMAS[0], SIGMAS[-1]))
    growth = most["rate"] / least["rate"]
    columns = {f"centres, σ_r = {SIGMAS[0]}": least["centres"].xs("so3", level="filter")}
    columns |= {f"centres, σ_r = {SIGMAS[-1]}": most["centres"].xs("so3", level="filter")}
    columns |= {f"growth, `{who}`": growth.xs(who, level="filter") for who in TRACKERS}
    table = pd.DataFrame(columns).reindex(films)
    table.insert(0, "film", [_FILMS[film] for film in films])
    return markdown(table, {name: 2 if "centres" in name else 1 for name in table.columns})


def _attitude_errors(shown: Result | None) -> pd.DataFrame:
    """The largest about each axis, and the RMS of the length in the thirds of the film, by filter."""
    rows = []
    for who in ("ekf2", "so3"):
        series = shown["series"][who] if shown else {"t": [], "error": []}
        error = pd.DataFrame(series["error"], columns=list("xyz"), dtype=float)
        third = np.minimum(3.0 * np.array(series["t"]) / max(series["t"], default=1.0), 2.0).astype(int)
        length = np.square(error).sum(axis=1).groupby(third).mean().pow(0.5).reindex(range(3))
        rows.append([f"`{who}`", *error.abs().max(), *length])
    return pd.DataFrame(rows, columns=["filter", *"xyz", "first", "middle", "last"])


def _figure_rates(runs: pd.DataFrame, films: list[str]) -> Drawing:
    ranges = runs.groupby(["film", "filter", "sigma"])["rate"].agg(["median", "min", "max"]).dropna()
    thesis = _THESIS.groupby("sigma")["rate"].agg(["median", "min", "max"])

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, len(films), sharey=True, squeeze=False)[0]
        for ax, film in zip(axes, films, strict=True):
            for who, look in _LOOKS.items():
                of = thesis if who == "thesis" else ranges.loc[film].loc[who]
                ax.fill_between(of.index, of["min"], of["max"], color=look["color"], alpha=0.15, lw=0)
                ax.plot(of.index, of["median"], **look)
            ax.set(title=_FILMS[film], xlabel=r"noise $\sigma_r$, grey values", xticks=SIGMAS)
        axes[0].set_ylim(bottom=0.0)
        axes[0].set_ylabel("rate RMSE, °/s")
        canvas.legend(*axes[-1].get_legend_handles_labels(), loc="outside upper center", ncols=5)

    return Drawing("light-rates", draw, (7.2, 3.5))


def _figure_picture(shown: Result) -> Drawing:
    picture = shown["picture"]

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, 2)
        for ax, name, title in zip(axes, ("before", "after"), ("as filmed", "as tracked"), strict=True):
            ax.imshow(decoded(picture[name]), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            ax.set_title(title)
            ax.set_axis_off()
        for u, v in picture["used"]:
            axes[1].plot(u, v, marker="o", markersize=16, markerfacecolor="none", color="C1", linestyle="none")

    return Drawing("light-picture", draw, (7.2, 3.0))


def _figure_attitude(shown: Result) -> Drawing:
    series, truth = shown["series"], shown["truth"]

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1 + len(series), 1, sharex=True, gridspec_kw={"height_ratios": [1.3, 1, 1]})
        for i, name in enumerate("ωφκ"):
            line = axes[0].plot(truth["t"], np.array(truth["angles"])[:, i], color=_AXES[i], linestyle="-")[0]
            k = int(np.argmax(np.abs(np.array(truth["angles"])[:, i])))
            label_points(
                axes[0], [(name, truth["t"][k], truth["angles"][k][i])], 0.0, color=line.get_color(), fontsize=9.0
            )
        axes[0].set_ylabel("true angles, °")
        for ax, (name, s) in zip(axes[1:], series.items(), strict=True):
            if s["t"]:
                for i, axis in enumerate("xyz"):
                    colour = _AXES[i]
                    ax.plot(s["t"], np.array(s["error"])[:, i], color=colour, linewidth=0.9, linestyle="-", label=axis)
            if shown["bound"] is not None:
                limit = np.array(shown["bound"]) / np.sqrt(3.0)
                ax.plot(series["so3"]["t"], limit, color="0.5", label="± Cramér-Rao bound", **BOUND)
                ax.plot(series["so3"]["t"], -limit, color="0.5", **BOUND)
            ax.set_ylabel(f"{name}: error, °")
        for ax in axes[2:]:
            ax.sharey(axes[1])
        axes[-1].set_xlabel("time, s")
        handles, labels = axes[1].get_legend_handles_labels()
        canvas.legend(handles, labels, loc="outside upper center", ncols=4)

    return Drawing("light-attitude", draw, (7.2, 4.6))
