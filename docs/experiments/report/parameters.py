"""Numbers and figures of the page on the two parameters of the classic filter."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import r1
from experiments.kit.film import settings_of
from experiments.kit.job import Results
from experiments.parameters import EXACT, SIGMA_B, SIGMA_W, key_of
from experiments.parameters import THESIS as TYPED
from experiments.report.frames import by, markdown, tidy
from experiments.report.labels import label_level
from experiments.report.page import MISSING, Page
from experiments.report.plot import BOUND, THESIS, Drawing, plain_numbers
from spheremouse.simulate.ball.film import SimulationOptions

_FILMS = {"r1": "R1-like", "s1": "S1, ours", "far26": "far26"}
_QUANTITIES = {
    "trackball.r": "trackball",
    "surface_speed_r.combined": "r",
    "attitude_rmse_deg.combined": "attitude",
    "rate_rmse_deg_s.combined": "rate",
    "surface_speed_rmse_mm_s.combined": "speed",
    "lost_episodes": "lost",
    "detection.centre_rms_px": "centres",
    "mean_discs": "discs",
    "frames": "frames",
}
_BESIDE = {
    **{f"so3.{key}": f"so3_{name}" for key, name in _QUANTITIES.items()},
    "bound.attitude_deg.combined": "bound_attitude",
    "bound.rate_deg_s.combined": "bound_rate",
    "truth.trackball.r": "true_trackball",
}
_THESIS = pd.DataFrame([{"film": "thesis", "w": w, "b": b, "ratio": w / b} for w in SIGMA_W for b in SIGMA_B])
_THESIS = _THESIS.assign(grid="published", **{name: np.ravel(grid) for name, grid in TYPED.items()})
_RADII = {"exact": EXACT, "usual": settings_of().euler.radial_sigma}  # m
_PIXELS = "σ_b changes rates by"
_DETECTORS = {"usual": "our detector", "published": "published detector"}
_COLOURS = ("C3", "C4", "C5")  # by sigma_b; C0 to C2 are the trackers'
_OURS: dict[str, Any] = {"marker": "o", "linestyle": "-"}
_SQUARES: dict[str, Any] = {"marker": "s", "markerfacecolor": "none", **THESIS}
_SO3: dict[str, Any] = {"linestyle": "-.", "linewidth": 1.2, "color": "C2"}
_Beside = dict[Any, dict[Any, float]]  # numbers by film and name


def page(results: Results) -> Page:
    """Tables 14 to 18, and why they differ."""
    cells, beside = _cells(results), _beside(results)
    tables = cells[cells["grid"].isin(["usual", "so3"])]
    shared = cells[cells["w"].isin(SIGMA_W)]  # by the thesis
    exact = shared[shared["grid"] == "exact"]
    on_r1, on_s1 = (shared[(shared["grid"] == "usual") & (shared["film"] == _FILMS[key])] for key in ("r1", "s1"))
    scaled = cells[(cells["grid"] == "scaled") & (cells["film"] == _FILMS["s1"])]
    films = [_FILMS[key] for key in ("s1", "far26") if key in results or key == "s1"]
    factors, best = _factors(shared, films), _best_by_detector(cells, films)
    change = factors.xs("exact", level="grid") / factors.xs("usual", level="grid")
    values = {
        "pace": r1.PACE,
        "noise_r1": r1.OPTIONS["noise"],
        "noise": SimulationOptions().noise,
        "frames": tables.loc[tables["film"].isin(films), "frames"].max(),
        "table_14": _table(tables, "trackball", [_FILMS["r1"]], 3, 3),
        "table_15": _table(tables, "r", films, 3, 4),
        "table_16": _table(tables, "attitude", films, 2, 4),
        "table_17": _table(tables, "rate", films, 2, 2),
        "table_18": _table(tables, "speed", films, 2, 2),
        "r1": beside[_FILMS["r1"]],
        "s1": beside[_FILMS["s1"]],
        "best_r1": _best(
            cells[(cells["film"] == _FILMS["r1"]) & (cells["grid"] == "usual")], "trackball", highest=True
        ),
        "best_rate": _best(on_s1, "rate"),
        "best_attitude": _best(on_s1, "attitude"),
        "lost_r1": (on_r1["lost"] >= 5.0).sum(min_count=1),
        "lost_s1": (on_s1["lost"] > 0.0).sum(min_count=1),
        "same_ratio": _spread(on_s1, ["ratio"]).max(),
        "same_w": _spread(on_s1, ["w"]).max(),
        "same_scale": _spread(scaled, ["ratio"])["rate"].max(),
        "radii_mm": {grid: 1e3 * radius for grid, radius in _RADII.items()},
        "exact_attitude": _table(exact, "attitude", films, 2, 2),
        "exact_rate": _table(exact, "rate", films, 2, 2),
        "factors": _factors_table(factors),
        "nearer": change[["rates: median", "attitudes: median"]].max(axis=None),
        "steadier": change[_PIXELS].max(),
        "exact_film": films[-1],
        "published": _by_detector(cells, films),
        "best_published": _best_table(best),
        "trust": (best["w"].xs("usual", level="grid") / best["w"].xs("published", level="grid")).min(),
    }
    return Page(values, tuple(_figures(cells, beside, films)))


def _cells(results: Results) -> pd.DataFrame:
    """A row per film, grid and cell, `so3` behind all σ_w; factors are those between ours and the thesis'."""
    records: list[dict[str, Any]] = []
    for film, result in results.items():
        column = {key_of(float(w), SIGMA_B[0]): cell for w, cell in (result.get("published") or {}).items()}
        grids = {"usual": result["cells"], "published": column, **{k: result.get(k, {}) for k in ("exact", "scaled")}}
        records += [{"film": _FILMS[film], "grid": "so3", "w": np.inf, "b": b, **result["so3"]} for b in SIGMA_B]
        for grid, of in grids.items():
            for key, cell in of.items():
                w, b = map(float, key.split("/"))
                records.append({"film": _FILMS[film], "grid": grid, "w": w, "b": b, "ratio": round(w / b, 9), **cell})
    cells = tidy(records).rename(columns=_QUANTITIES)
    cells = cells.reindex(columns=["film", "grid", "w", "b", "ratio", *_QUANTITIES.values()])
    cells = cells.astype(dict.fromkeys(_QUANTITIES.values(), float))
    typed = _THESIS.set_index(["w", "b"]).reindex(pd.MultiIndex.from_frame(cells[["w", "b"]]))
    for name in ("rate", "attitude"):
        factor = cells[name] / typed[name].to_numpy()
        cells[f"{name} factor"] = np.maximum(factor, 1.0 / factor)
    return cells


def _beside(results: Results) -> _Beside:
    """Return for each film the results of `so3`, the bound and the true motion."""
    kept = ("so3", "bound", "truth")
    rows = tidy({"film": _FILMS[film], **{k: r[k] for k in kept if k in r}} for film, r in results.items())
    rows = rows.set_index("film").rename(columns=_BESIDE)
    return rows.reindex(index=list(_FILMS.values()), columns=list(_BESIDE.values())).to_dict("index")


def _table(cells: pd.DataFrame, what: str, films: Sequence[str], printed: int, digits: int) -> str:
    """A quantity by σ_w and σ_b; digits of the thesis' values and of ours."""
    names = {(b, film): f"σ_b {b:g} px: {film}" for b in SIGMA_B for film in ("thesis", *films)}
    shown = {name: printed if film == "thesis" else digits for (_, film), name in names.items()}
    return _wide(pd.concat([_THESIS, cells]), what, ["b", "film"], names, shown)


def _by_detector(cells: pd.DataFrame, films: Sequence[str]) -> str:
    """Rates with both detectors at the smallest σ_b."""
    names = {("thesis", "published"): "thesis"}
    names |= {(film, grid): f"{film}: {detector}" for film in films for grid, detector in _DETECTORS.items()}
    both = pd.concat([_THESIS, cells])
    both = both[(both["b"] == SIGMA_B[0]) & (both["grid"] != "so3")]
    return _wide(both, "rate", ["film", "grid"], names, dict.fromkeys(names.values(), 2))


def _wide(
    cells: pd.DataFrame, what: str, across: list[str], names: Mapping[Any, str], digits: Mapping[str, int]
) -> str:
    """A line for each σ_w, and one for `so3`; the columns of `names`."""
    table = cells.pivot(index="w", columns=across, values=what).reindex(columns=list(names))
    table.columns = list(names.values())
    table.index = ["`so3`" if w == np.inf else f"{w:g}" for w in table.index]
    return markdown(table.rename_axis("σ_w, rad/s²").reset_index(), digits)


def _best(cells: pd.DataFrame, what: str, highest: bool = False) -> Mapping[str, Any]:
    """Value and place of the best cell."""
    ranked = cells.dropna(subset=[what]).sort_values(what, ascending=not highest)
    for w, b, x in ranked[["w", "b", what]].to_numpy():
        return {"w": f"{w:g}", "b": f"{b:g}", "value": x}
    return {"w": MISSING, "b": MISSING, "value": np.nan}


def _spread(cells: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Largest over smallest error within each group of cells."""
    groups = cells.groupby(list(keys))[["rate", "attitude"]]
    return groups.max() / groups.min()


def _factors(cells: pd.DataFrame, films: Sequence[str]) -> pd.DataFrame:
    """By film and by how exact the ball is: how far we are from the thesis, and what σ_b changes at the same σ_w."""
    keys = ["film", "grid"]
    found = by(
        cells,
        keys,
        **{f"{name}s: {how}": (f"{name} factor", how) for name in ("rate", "attitude") for how in ("median", "max")},
        **{"ball lost in": ("lost", lambda episodes: (episodes > 0).sum())},
    ).set_index(keys)
    found[_PIXELS] = _spread(cells, [*keys, "w"])["rate"].groupby(level=keys).median()
    return found.reindex(pd.MultiIndex.from_product([films, _RADII], names=keys))


def _factors_table(factors: pd.DataFrame) -> str:
    shown = factors.reset_index()
    shown["grid"] = shown["grid"].map({grid: f"{1e3 * radius:g} mm" for grid, radius in _RADII.items()})
    digits = {"rates: median": 2, "rates: max": 1, "attitudes: median": 2, "attitudes: max": 1, _PIXELS: 1}
    return markdown(shown.rename(columns={"grid": "along the radius"}), digits, sparse=["film"])


def _best_by_detector(cells: pd.DataFrame, films: Sequence[str]) -> pd.DataFrame:
    """The cells with the smallest rate errors, of those at the smallest σ_b."""
    keys = ["film", "grid"]
    ranked = cells[cells["b"] == SIGMA_B[0]].dropna(subset=["rate"]).sort_values("rate", kind="stable")
    best = ranked.groupby(keys).head(1).set_index(keys)
    return best.reindex(pd.MultiIndex.from_product([films, _DETECTORS], names=keys))


def _best_table(best: pd.DataFrame) -> str:
    thesis = {"film": "thesis", "grid": "published", "w": 0.1, "discs": 4.9}  # stored
    shown = pd.concat([pd.DataFrame([thesis]), best.reset_index()])[["film", "grid", "w", "centres", "discs"]]
    shown["grid"] = shown["grid"].map(_DETECTORS)
    shown["w"] = [MISSING if math.isnan(w) else f"{w:g}" for w in shown["w"]]
    shown.columns = ["film", "detector", "σ_w, rad/s²", "centres good to, px", "discs per frame used (thesis: stored)"]
    return markdown(shown, dict(zip(shown.columns, (0, 0, 0, 2, 1), strict=True)), sparse=["film"])


def _figures(cells: pd.DataFrame, beside: _Beside, films: Sequence[str]) -> list[Drawing]:
    """Return the figures of R1, of S1, and of the last film like S1 with an exact ball."""
    r1_like, s1, last = _FILMS["r1"], _FILMS["s1"], films[-1]
    grids = dict(list(cells.groupby(["film", "grid"])))

    def draw_r1(canvas: Any) -> None:
        ax, levels = canvas.subplots(), beside[r1_like]
        ours, thesis = (x.assign(lacking=1.0 - x["trackball"]) for x in (grids[r1_like, "usual"], _THESIS))
        _draw_cells(ax, ours, thesis, "lacking")
        ax.set(ylabel="1 - correlation with the trackball", yscale="log")
        plain_numbers(ax.yaxis)
        true, so3 = (1.0 - levels[name] for name in ("true_trackball", "so3_trackball"))
        same = abs(true - so3) < 0.05 * true
        _level(ax, true, "true motion, and so3" if same else "true motion", BOUND)
        if not same:
            _level(ax, so3, "so3", _SO3, side="right")
        _legend(canvas, ax)

    def draw_s1(canvas: Any) -> None:
        levels = beside[s1]
        for name, ax in _draw_errors(canvas, grids[s1, "usual"], levels, "ratio").items():
            _level(ax, levels[f"so3_{name}"], "so3", _SO3)

    def draw_exact(canvas: Any) -> None:
        _draw_errors(canvas, grids[last, "exact"], beside[last], "w")

    drawings = {
        (r1_like, "usual"): Drawing("parameters-r1", draw_r1, (7.2, 3.4)),
        (s1, "usual"): Drawing("parameters-s1", draw_s1, (7.2, 3.7)),
        (last, "exact"): Drawing("parameters-exact", draw_exact, (7.2, 3.7)),
    }
    return [drawing for which, drawing in drawings.items() if which in grids]


def _draw_errors(canvas: Any, cells: pd.DataFrame, levels: Mapping[str, float], against: str) -> dict[str, Any]:
    """Errors of attitude and rate side by side, ours and the thesis', with the bound; their axes."""
    axes: dict[str, Any] = dict(zip(("attitude", "rate"), canvas.subplots(1, 2), strict=True))
    for (name, ax), unit in zip(axes.items(), ("°", "°/s"), strict=True):
        _draw_cells(ax, cells, _THESIS, name, against)
        ax.set(yscale="log", ylabel=f"{name} RMSE, {unit}")
        plain_numbers(ax.yaxis)
        _level(ax, levels[f"bound_{name}"], "Cramér-Rao bound", BOUND, side="right")
    _legend(canvas, axes["attitude"])
    return axes


def _draw_cells(ax: Any, ours: pd.DataFrame, thesis: pd.DataFrame, what: str, against: str = "ratio") -> None:
    for colour, b in zip(_COLOURS, SIGMA_B, strict=True):
        for cells, look in ((ours, _OURS), (thesis, _SQUARES)):
            line = cells[cells["b"] == b].dropna(subset=[what])
            ax.plot(line[against], line[what], color=colour, **look)
    labels = {"ratio": r"$\sigma_w/\sigma_b$, rad/s² per px", "w": r"$\sigma_w$, rad/s²"}
    ax.set(xscale="log", xlabel=labels[against])


def _level(ax: Any, y: float, name: str, how: Mapping[str, Any], side: str = "left") -> None:
    """A line all across, with its name, and room for that under it."""
    if math.isnan(y):
        return
    look = {"color": "0.5", **how}
    ax.axhline(y, **look)
    label_level(ax, y, name, side, color=look["color"])
    ax.set_ylim(bottom=min(ax.get_ylim()[0], 0.6 * y))


def _legend(canvas: Any, ax: Any) -> None:
    lines = {rf"$\sigma_b$ = {b:g} px": {"color": colour, **_OURS} for colour, b in zip(_COLOURS, SIGMA_B, strict=True)}
    lines |= {"ekf2": {"color": "0.5", **_OURS}, "thesis": {"color": "0.5", **_SQUARES}}
    handles = [ax.plot([], [], label=name, **look)[0] for name, look in lines.items()]
    canvas.legend(handles=handles, loc="outside upper center", ncols=5)
