"""Numbers and figures of the page on where to put the camera."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.kit.job import Results
from experiments.places import DISCS, FAR, FOCAL, LENSES, NEAR_BEST, NOISE, TOP, Place, Size
from experiments.report.frames import markdown, tidy
from experiments.report.labels import label_points
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing

_POSED = 3  # targets that make a pose
_SPAN = 1.5  # times the least error: the least that colours tell apart
_HEADS = {"attitude": "attitude, °", "rate": "rate, °/s"}
_DIGITS = {"attitude, °": 4, "rate, °/s": 3, "discs in view": 1, "best from, m": 1}
_SOURCES = {
    "map": "map",
    "bound": "film's bound",
    "true pose": "`so3`, true pose",
    "own pose": "`so3`, own pose",
}
_MARKS = {"true pose": "o", "own pose": "x"}


def page(results: Results) -> Page:
    """The maps, the films beside them, and where to put the camera."""
    maps, films = _maps(results), _films(results)
    around, along = (maps[maps["part"] == part].sort_values("attitude") for part in ("directions", "distances"))
    seen = around[around["targets"] >= _POSED]
    whole, posed = films["true pose.lost"] == 0, films["own pose.lost"].notna()
    over = pd.DataFrame({name: films[f"true pose.{name}"] / films[f"map.{name}"] for name in _HEADS})[whole]
    values = {
        "discs": DISCS,
        "noise": NOISE,
        "far": FAR,
        "focal": FOCAL,
        "near": 100.0 * (NEAR_BEST - 1.0),
        "top": TOP,
        "frames": films["true pose.frames"].max(),
        "directions": _directions(around, seen),
        "tried": len(around),
        "seen": len(seen),
        "near_best": 100.0 * (around["attitude"] <= NEAR_BEST * around["attitude"].min()).mean(),
        "within": seen[["azimuth", "elevation"]].agg(["min", "max"]).to_dict(),
        "rate": around["rate"].agg(["min", "max"]).to_dict(),
        "distances": _distances(along),
        "best_from": along.groupby("lens")["distance"].first().reindex(LENSES).tolist(),
        "farthest": along["distance"].max(),
        "film_attitude": _beside(
            films, "attitude", {"map.targets": "targets in view", "true pose.mean_discs": "discs used"}
        ),
        "film_rate": _beside(films, "rate", {f"{p}.lost": f"lost, {p}" for p in ("true pose", "own pose")}),
        "films": len(films),
        "whole": whole.sum(),
        "over": over.agg(["median", "min", "max"]).to_dict(),
        "unposed": (~posed).sum(),
        "whole_unposed": (whole & ~posed).sum(),
        "posed_as_seen": 100.0 * (posed == (films["map.targets"] >= _POSED)).mean(),
        "lost_by_pose": (films["own pose.lost"] - films["true pose.lost"]).max(),
        "sizes": _sizes(next((r["noise"] for r in results.values() if "noise" in r), [])),
    }
    drawings = [_figure_directions(around, films)] if len(around) else []
    return Page(values, (*drawings, *([_figure_distances(along, films)] if len(along) else [])))


def _maps(results: Results) -> pd.DataFrame:
    """A row per place of the maps of directions and of distances."""
    records = [
        {"part": key.partition("-")[0], **Place(*entry["place"])._asdict(), **entry}
        for key, result in results.items()
        for entry in result.get("map", ())
    ]
    return _named(records, ["part", *Place._fields, *_HEADS, "discs", "targets"])


def _films(results: Results) -> pd.DataFrame:
    """A row per film: the map's value with the film's own discs, its bound, and `so3` with both poses."""
    expected = {Place(*e["place"]).key: e for result in results.values() for e in result.get("checked", ())}
    records = [
        {**Place(*result["place"])._asdict(), "map": expected.get(key), **result}
        for key, result in results.items()
        if "place" in result
    ]
    errors = [f"{source}.{name}" for source in _SOURCES for name in _HEADS]
    counts = [f"{pose}.{name}" for pose in ("true pose", "own pose") for name in ("frames", "tracked")]
    films = _named(records, [*Place._fields, *errors, *counts, "map.targets", "true pose.mean_discs"])
    lost = {f"{pose}.lost": films[f"{pose}.frames"] - films[f"{pose}.tracked"] for pose in ("true pose", "own pose")}
    return films.assign(**lost)


def _named(records: list[dict[str, Any]], columns: list[str]) -> pd.DataFrame:
    """Return the records with these columns; errors are combined ones, and have no unit in their names."""
    rows = tidy(records)
    rows.columns = rows.columns.astype(str).str.replace(r"(_rmse)?_deg(_s)?(\.combined)?$", "", regex=True)
    rows = rows.reindex(columns=columns)
    return rows.assign(lens=np.where(rows["focal"] == FOCAL, *LENSES))


def _directions(around: pd.DataFrame, seen: pd.DataFrame) -> str:
    """The best one and the worst, of all and of those that see the targets."""
    picked = {
        "best": around[:1],
        "worst": around[-1:],
        "best that sees three targets": seen[:1],
        "worst that sees three targets": seen[-1:],
    }
    columns = {"azimuth": "azimuth, °", "elevation": "elevation, °", **_HEADS, "discs": "discs in view"}
    table = pd.concat(picked, names=["direction"])[list(columns)].rename(columns=columns)
    return markdown(table.reset_index("direction"), _DIGITS)


def _distances(along: pd.DataFrame) -> str:
    """The best one with each lens, those that are nearly as good, and those that see the targets."""
    least = along.groupby("lens")["attitude"].transform("min")
    table = along.groupby("lens").first().reindex(LENSES)[["distance", "attitude", "discs"]]
    for name, chosen in {"near": along["attitude"] <= NEAR_BEST * least, "seen": along["targets"] >= _POSED}.items():
        table[name] = along[chosen].sort_values("distance").groupby("lens")["distance"].agg(_listed)
    near = f"within {100.0 * (NEAR_BEST - 1.0):.0f} % of that from, m"
    named = {"distance": "best from, m", "discs": "discs in view", "seen": "three targets in view from, m"}
    return markdown(table.reset_index().rename(columns={**named, **_HEADS, "near": near}), _DIGITS)


def _listed(values: "pd.Series[float]") -> str:
    return ", ".join(f"{x:g}" for x in values)


def _beside(films: pd.DataFrame, name: str, others: dict[str, str]) -> str:
    """The errors of films beside what was expected of them."""
    columns = {f"{source}.{name}": head for source, head in _SOURCES.items()}
    places = [f"{a:g}°, {e:g}°, {d:g} m, {f:.0f} px" for a, e, d, f in films[list(Place._fields)].to_numpy()]
    table = films[[*others, *columns]].rename(columns={**others, **columns})
    table.insert(0, "azimuth, elevation, distance, focal length", places)
    return markdown(table, {**dict.fromkeys(columns.values(), _DIGITS[_HEADS[name]]), "discs used": 1})


def _sizes(noise: Sequence[Sequence[float]]) -> str:
    sizes = pd.DataFrame(noise, columns=list(Size._fields), dtype=float)
    bounds = [f"{area / np.sqrt(2.0):.0f} to {area * np.sqrt(2.0):.0f}" for area in sizes["area"]]
    columns = {"discs": sizes["discs"], "found, %": 100.0 * sizes["share"], "centre RMS per axis, px": sizes["sigma"]}
    return markdown(pd.DataFrame({"area, px²": bounds, **columns}), {"centre RMS per axis, px": 3})


def _figure_directions(around: pd.DataFrame, films: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        from matplotlib.colors import LogNorm
        from matplotlib.patheffects import Normal, Stroke
        from matplotlib.ticker import NullFormatter

        axes = canvas.subplots(1, 2, sharey=True)
        grid = around.pivot(index="elevation", columns="azimuth")
        usable = (grid["targets"] >= _POSED).to_numpy()
        here = films[(films["distance"] == FAR) & (films["focal"] == FOCAL)]
        for ax, name in zip(axes, _HEADS, strict=True):
            values, found = grid[name], here.dropna(subset=[f"true pose.{name}"])
            low = values.min(axis=None)
            high = max(_SPAN * low, 1.0001 * values.max(axis=None), *found[f"true pose.{name}"])
            norm = LogNorm(low, high)
            shown = ax.pcolormesh(values.columns, values.index, values, norm=norm, shading="nearest", rasterized=False)
            _outline(ax, list(values.columns), list(values.index), usable)
            errors = found[["azimuth", "elevation", f"true pose.{name}"]].to_numpy()
            for x, y, error in errors:
                ax.scatter(x, y, s=60, c=[error], norm=norm, edgecolors="white", linewidths=1.2)
            label_points(
                ax,
                [(f"{error:.{_DIGITS[_HEADS[name]]}f}", x, y) for x, y, error in errors],
                radius=4.0,
                color="white",  # on the map, whatever the page is
                path_effects=[Stroke(linewidth=2.0, foreground="#222222"), Normal()],
            )
            ax.set(title=_HEADS[name], xlabel="azimuth, °")
            ax.grid(visible=False)
            bar = canvas.colorbar(shown, ax=ax, location="bottom", aspect=30)
            ticks = _ticks(low, high)
            bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
            bar.ax.xaxis.set_minor_formatter(NullFormatter())
            bar.ax.minorticks_off()
            bar.set_label("darker: better")
        axes[0].set_ylabel("elevation, °")

    return Drawing("places-directions", draw, (7.2, 4.2))


def _outline(ax: Any, x: Sequence[float], y: Sequence[float], where: NDArray[np.bool_]) -> None:
    """A line around cells of a grid, seen on dark cells and on bright ones."""
    from matplotlib.collections import LineCollection

    dx, dy = (np.min(np.diff(v)) if len(v) > 1 else 10.0 for v in (x, y))
    padded, sides = np.pad(where, 1), []
    for i, j in np.argwhere(where):
        left, right, low, high = x[j] - dx / 2.0, x[j] + dx / 2.0, y[i] - dy / 2.0, y[i] + dy / 2.0
        around = {
            (1, 0): [(left, low), (left, high)],
            (1, 2): [(right, low), (right, high)],
            (0, 1): [(left, low), (right, low)],
            (2, 1): [(left, high), (right, high)],
        }
        sides += [line for (di, dj), line in around.items() if not padded[i + di, j + dj]]
    for colour, width in (("#222222", 3.4), ("white", 1.6)):  # on the map, whatever the page is
        ax.add_collection(LineCollection(sides, colors=colour, linewidths=width, capstyle="round"))


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers within bounds."""
    most = 0.5 * (high - low)
    step = 10.0 ** np.floor(np.log10(most))
    step *= max(k for k in (1.0, 2.0, 5.0) if k * step <= most)
    return (step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)).tolist()


def _figure_distances(along: pd.DataFrame, films: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        from matplotlib.ticker import StrMethodFormatter

        ahead = films[(films["azimuth"] == 0) & (films["elevation"] == 0)]
        for ax, (name, head) in zip(canvas.subplots(1, 2), _HEADS.items(), strict=True):
            for k, lens in enumerate(LENSES):
                line, filmed = along[along["lens"] == lens].sort_values("distance"), ahead[ahead["lens"] == lens]
                ax.plot(line["distance"], line[name], color=f"C{k}", **BOUND)
                for pose, mark in _MARKS.items():
                    ax.plot(filmed["distance"], filmed[f"{pose}.{name}"], color=f"C{k}", marker=mark, linestyle="")
            ax.set(xscale="log", yscale="log", ylabel=head.replace(name, f"{name} error"))
            ax.set_xlabel("distance from the ball's centre, m")
            ax.set_ylim(top=TOP * along[name].min())
            ax.set_xticks([1, 1.5, 2, 3, 4], ["1", "1.5", "2", "3", "4"])
            ax.minorticks_off()
            ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=4)

    return Drawing("places-distances", draw, (7.2, 3.4))


def _handles() -> list[Any]:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=f"C{k}", label=f"bound, {lens}", **BOUND) for k, lens in enumerate(LENSES)]
    marks = [Line2D([], [], color="0.5", marker=m, linestyle="", label=f"so3, {pose}") for pose, m in _MARKS.items()]
    return [*lines, *marks]
