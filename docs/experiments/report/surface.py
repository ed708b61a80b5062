"""Numbers and figures of the page on points on the ball."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import film as kit
from experiments.kit.job import Result, Results
from experiments.report.frames import markdown, tidy
from experiments.report.page import Page
from experiments.report.plot import THESIS, Drawing, plain_numbers
from experiments.surface import (
    FIGURE_39,
    LEVELS,
    RADIUS,
    RINGS,
    SIGMA_B,
    TABLE_13,
    TURN,
    VIEWS,
    visible_cap,
)
from spheremouse.geometry.rotation import Array

_DISCS_23 = {"near": 7.4, "far": 8.9}  # Wittich 2017, table 23
_STRONG = 0.6  # a correlation whose sign is compared
_CIRCLES = (20, 40)  # deg, on the map
_BY = {
    "thesis": "thesis",
    "as the thesis": "with the thesis' pose and ball",
    "ours": "with our calibration",
    "uncorrelated": "",
}


def page(results: Results) -> Page:
    """Table 13, the scatter of points beside what is claimed of it, and the area that is seen."""
    caps = {view: results[f"cap-{view}"] for view in VIEWS if f"cap-{view}" in results}
    points, bins, views = _points(caps.get("far", {})), _bins(caps), _views(results.get("area"))
    theirs, fed = (points[points["by"] == name][["XY", "XZ", "YZ"]].to_numpy() for name in ("thesis", "as the thesis"))
    strong = np.abs(theirs) > _STRONG
    columns = {
        "detections": "discs seen",
        "chi_square_image": "image alone: chi-square / 2",
        "chi_square_total": "with pose and ball: chi-square / 2",
    }
    chi = pd.DataFrame({view: {name: caps[view][name] for name in columns} for view in caps}).T
    chi = chi.reindex(index=list(VIEWS), columns=list(columns)).astype(float)
    far, near = views.loc["far"], views.loc["near"]
    values = {
        "table_13": _table_13(points),
        "sigma_b": SIGMA_B,
        "sigma": {name: _rms(points[points["by"] == name][["X", "Y", "Z"]].to_numpy()) for name in _BY},
        "same_sign": np.sum(np.sign(fed[strong]) == np.sign(theirs[strong])) if "far" in caps else np.nan,
        "strong": int(np.sum(strong)),
        "chi_table": markdown(
            chi.rename(columns=columns).reset_index(names="camera"), dict(zip(columns.values(), (0, 2, 2), strict=True))
        ),
        "chi": chi["chi_square_image"].to_dict(),
        "ends": _ends(bins),
        "floor": kit.settings_of().discs.sigma,
        "area_table": _area_table(views),
        "most": visible_cap(FIGURE_39["far"][0], RADIUS),
        "radius": RADIUS,
        "counted_off": _counted_off(results.get("area")),
        "more": {
            "bare": far["alone"] / near["alone"] - 1.0,
            "framed": far["behind frame"] / near["behind frame"] - 1.0,
            "thesis": _DISCS_23["far"] / _DISCS_23["near"] - 1.0,
        },
        "hides": views["frame hides"].to_dict(),
    }
    drawings: list[Drawing] = []
    if caps:
        drawings.append(Drawing("surface-map", lambda canvas: _draw_maps(canvas, caps), (7.2, 6.6)))
        drawings.append(Drawing("surface-scatter", lambda canvas: _draw_scatter(canvas, bins), (7.2, 3.6)))
    if "area" in results:
        drawings.append(Drawing("surface-area", lambda canvas: _draw_area(canvas, results["area"]), (7.2, 3.4)))
    return Page(values, tuple(drawings))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _points(far: Result) -> pd.DataFrame:
    """The places of table 13, each by the thesis and by what the points are made with."""
    found = far.get("table 13", {})
    records: list[dict[str, Any]] = []
    for i, (place, correlation, sigma) in enumerate(TABLE_13):
        described = {
            name: found[name][i] if found else {"correlation": [np.nan] * 3, "sigma": [np.nan] * 3}
            for name in _BY
            if name != "thesis"
        }
        for name, point in {"thesis": {"correlation": correlation, "sigma": sigma}, **described}.items():
            values = zip(("XY", "XZ", "YZ", "X", "Y", "Z"), (*point["correlation"], *point["sigma"]), strict=True)
            records.append({"point": i + 1, "by": name, "place": place, **dict(values)})
    return tidy(records)


def _table_13(points: pd.DataFrame) -> str:
    shown = points[points["by"] != "uncorrelated"]
    columns = {f"ρ {a}": shown[a] for a in ("XY", "XZ", "YZ")} | {f"σ {a}, mm": shown[a] for a in "XYZ"}
    places = [", ".join(f"{x:.0f}" for x in place) for place in shown["place"]]
    made = pd.DataFrame({"point": shown["point"], "X, Y, Z, mm": places, "": shown["by"].map(_BY), **columns})
    return markdown(made, {"point": 0, **{name: 2 if "ρ" in name else 1 for name in columns}}, ["point", "X, Y, Z, mm"])


def _bins(caps: dict[str, Result]) -> pd.DataFrame:
    """RMS errors and standard deviations by the angle from the middle: of all errors and of the image alone, mm."""
    records: list[dict[str, Any]] = []
    for view, cap in caps.items():
        for b in cap["bins"]:
            for k, direction in enumerate(("worst", "best")):
                found = {what: b[what][k] for what in ("total sigma", "total error", "image sigma", "image error")}
                records.append({"view": view, "angle": b["angle"], "direction": direction, **found})
    return tidy(records)


def _ends(bins: pd.DataFrame) -> str:
    """In the middle of the ball and at the limb."""
    if bins.empty:
        return ""
    worst = bins[bins["direction"] == "worst"].groupby("view", sort=False)
    ends = pd.concat([worst.head(1), worst.tail(1)]).sort_index()
    columns = {
        "camera": ends["view"],
        "from the middle, °": ends["angle"],
        "all errors, mm": ends["total sigma"],
        "image alone, mm": ends["image sigma"],
        "its share of the variance, %": 100.0 * (ends["image sigma"] / ends["total sigma"]) ** 2,
    }
    return markdown(pd.DataFrame(columns), {"all errors, mm": 2, "image alone, mm": 2}, ["camera"])


def _views(area: Result | None) -> pd.DataFrame:
    """What each camera sees of the ball, m², and which share of it frame and hands hide."""
    columns = ["distance", "alone", "behind frame", "one hand", "two hands"]
    found = (
        pd.DataFrame.from_dict(area["views"] if area else {}, "index")
        .reindex(list(VIEWS), columns=columns)
        .astype(float)
    )
    hidden = {f"{hands} hides": 1.0 - found[hands] / found["behind frame"] for hands in ("one hand", "two hands")}
    return found.assign(**{"frame hides": 1.0 - found["behind frame"] / found["alone"]}, **hidden)


def _area_table(views: pd.DataFrame) -> str:
    columns = {
        "camera": list(VIEWS),
        "distance, m": views["distance"],
        "thesis, m²": [FIGURE_39[view][1] for view in VIEWS],
        "formula, m²": [visible_cap(d, RADIUS) for d in views["distance"]],
        "counted, m²": views["alone"],
        "frame hides, %": 100.0 * views["frame hides"],
        "one hand hides more, %": 100.0 * views["one hand hides"],
        "two hands, %": 100.0 * views["two hands hides"],
        "of 50 discs in view": 50.0 * views["behind frame"] / (4.0 * np.pi * RADIUS**2),
    }
    digits = {name: 2 if "m" in name.split(", ")[-1] else 1 if "discs" in name else 0 for name in columns}
    return markdown(pd.DataFrame(columns), digits)


def _counted_off(area: Result | None) -> float:
    """The most by which areas that were counted differ from the formula, over it."""
    if area is None:
        return np.nan
    views = area["views"].values()
    pairs = [*zip(area["distance"], area["alone"], strict=True), *((a["distance"], a["alone"]) for a in views)]
    return max(abs(counted / visible_cap(d, RADIUS) - 1.0) for d, counted in pairs if d > RADIUS)


def _draw_maps(figure: Any, caps: dict[str, Result]) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm
    from matplotlib.patheffects import withStroke

    axes = figure.subplots(2, len(caps), squeeze=False)
    norm = BoundaryNorm(LEVELS, colormaps["cividis"].N, extend="max")
    filled = None
    for column, (view, c) in zip(axes.T, caps.items(), strict=True):
        angle, turn = np.meshgrid(np.linspace(0.0, c["map"]["limb_deg"] - 1.0, RINGS), TURN)
        for ax, name in zip(column, ("worst", "best"), strict=True):
            x, y = angle * np.cos(turn), -angle * np.sin(turn)
            filled = ax.contourf(x, y, np.array(c["map"][name]), LEVELS, norm=norm, extend="max")
            ax.set(title=f"{view} camera, {name} direction", xticks=[], yticks=[], aspect="equal")
            ax.grid(visible=False)
            for side in ax.spines.values():
                side.set_visible(False)
            edge = c["map"]["seen_to_deg"]
            ax.plot(edge * np.cos(TURN), edge * np.sin(TURN), color="#202020", **THESIS)
            for ring in _CIRCLES:
                x, y = ring * np.cos(TURN), ring * np.sin(TURN)
                ax.plot(x, y, color="w", linestyle="-", linewidth=0.6, alpha=0.8)
                text = ax.text(0.0, ring, f"{ring}°", color="w", fontsize=7, ha="center", va="center")
                text.set_path_effects([withStroke(linewidth=2.5, foreground="#202020")])
    figure.colorbar(filled, ax=axes, label="standard deviation, mm", shrink=0.6, ticks=LEVELS, format="{x:g}")


def _draw_scatter(figure: Any, bins: pd.DataFrame) -> None:
    axes = figure.subplots(1, bins["view"].nunique(), sharey=True, squeeze=False)[0]
    for ax, (view, here) in zip(axes, bins.groupby("view", sort=False), strict=True):
        for name, label, line, face in (("total", "all errors", "-", None), ("image", "image alone", ":", "none")):
            for direction, colour in (("worst", "C1"), ("best", "C0")):
                curve = here[here["direction"] == direction]
                look = {"color": colour, "markerfacecolor": face or colour}
                ax.plot(curve["angle"], curve[f"{name} sigma"], color=colour, linestyle=line)
                ax.plot(curve["angle"], curve[f"{name} error"], marker="o", linestyle="", **look)
                ax.plot([], [], marker="o", linestyle=line, label=f"{direction} direction, {label}", **look)
        ax.set(title=f"{view} camera", xlabel="angle from the middle, °", yscale="log")
        plain_numbers(ax.yaxis)
    axes[0].set_ylabel("along the surface, mm")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, handlelength=2.6)


def _draw_area(figure: Any, area: Result) -> None:
    ax = figure.subplots()
    d = np.linspace(RADIUS, 3.1, 200)
    ax.plot(d, [visible_cap(x, RADIUS) for x in d], color="C0", linestyle="-")
    ax.plot(area["distance"], area["alone"], color="C0", linestyle="", marker="o")
    ax.text(2.85, visible_cap(2.85, RADIUS) + 0.07, "formula, counted (dots)", color="C0", ha="right")
    for view, a in area["views"].items():
        x = a["distance"]
        ax.plot([x, x], [a["two hands"], a["behind frame"]], color="C2", linestyle="-", linewidth=1.0)
        ax.plot([x], [a["behind frame"]], color="C2", linestyle="", marker="s")
        ax.plot([x], [a["two hands"]], color="C2", linestyle="", marker="v")
        ax.annotate("behind the frame", (x, a["behind frame"]), (8, -2), textcoords="offset points", color="C2")
        ax.annotate("and two hands", (x, a["two hands"]), (8, -2), textcoords="offset points", color="C2")
        where, printed = FIGURE_39[view]
        ax.plot([where], [printed], color="C1", linestyle="", marker="x", markersize=7)
        ax.annotate(f"thesis, {view}", (where, printed), (8, -3), textcoords="offset points", color="C1")
    limit = 2.0 * np.pi * RADIUS**2
    ax.axhline(limit, color="C1", **THESIS)
    ax.annotate("half the ball", (0.6, limit), (2, 3), textcoords="offset points", color="C1")
    ax.set(xlabel="distance of the camera from the ball's centre, m", ylabel="area seen, m²", ylim=(0.0, 3.0))
