"""What the experiments on points on the ball are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import THESIS, plain_numbers
from spheremouse.experiments.surface import (
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

_DISCS_23 = {"near": 7.4, "far": 8.9}  # Wittich 2017, table 23
_CIRCLES = (20, 40)  # deg, on the map


def section(request: Request, results: Results) -> Section:
    """Table 13, the maps, the scatter, and the area."""
    caps = {view: results[f"cap-{view}"] for view in VIEWS if "bins" in results.get(f"cap-{view}", {})}
    numbers: dict[str, Any] = {
        view: {k: c[k] for k in ("sights", "bins", "chi_square_image", "chi_square_total")} for view, c in caps.items()
    }
    parts: list[str | Table | Figure] = [_table_13(caps.get("far", {}).get("table 13"), numbers)]
    parts += [_about_13(caps), _scatter_table(caps)]
    if caps:
        parts += [
            _about_scatter(caps),
            Figure(
                "surface-map",
                "Standard deviation of a disc's place along the ball's surface (mm), all over what the camera sees, in "
                "the direction in which it is known worst and in the one in which it is known best. Camera pose and "
                "ball as calibrated, centres as certain as discs there were. Circles are angles from the point that "
                "faces the camera; outside the dashed one no wholly visible disc was found.",
                lambda figure: _draw_maps(figure, caps),
                (7.2, 6.6),
            ),
            Figure(
                "surface-scatter",
                "Claimed standard deviation (lines) and true error (dots, RMS) of a disc's place along the worst and "
                "the best direction, against the angle from the point of the ball that faces the camera. Filled: with "
                "errors of camera pose, ball and image; hollow, dotted: of the image alone.",
                lambda figure: _draw_scatter(figure, caps),
                (7.2, 3.6),
            ),
        ]
    area = results.get("area", {"error": "missing"})
    parts += _area_parts(area, numbers)
    failed = failures(results)
    if failed:
        parts.append("What failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), numbers)


def _table_13(five: Result | None, numbers: dict[str, Any]) -> Table:
    head = ("", "X, Y, Z, mm", "ρ XY", "ρ XZ", "ρ YZ", "σ X, mm", "σ Y, mm", "σ Z, mm")
    rows = []
    for i, (place, correlation, sigma) in enumerate(TABLE_13):
        where = ", ".join(f"{x:.0f}" for x in place)
        rows.append((f"{i + 1}, thesis", where, *(f"{x:.2f}" for x in correlation), *(f"{x:.1f}" for x in sigma)))
        for name, title in (("as the thesis", "with the thesis' pose and ball"), ("ours", "with our calibration")):
            cells = ["failed"] * 6
            if five is not None:
                p = five[name][i]
                cells = [*(f"{x:.2f}" for x in p["correlation"]), *(f"{x:.1f}" for x in p["sigma"])]
            rows.append((title, "", *cells))
    numbers["table 13"] = five
    return Table(head, tuple(rows), "Table 13. Points on the ball")


def _about_13(caps: dict[str, Result]) -> str:
    five = caps.get("far", {}).get("table 13")
    if not five:
        return ""
    theirs = _rms([s for _, _, s in TABLE_13])
    fed, ours, apart = (_rms([p["sigma"] for p in five[name]]) for name in ("as the thesis", "ours", "uncorrelated"))
    a, b = (
        np.array(x).ravel() for x in ([p["correlation"] for p in five["as the thesis"]], [c for _, c, _ in TABLE_13])
    )
    strong = np.abs(b) > 0.6
    same = int(np.count_nonzero(np.sign(a[strong]) == np.sign(b[strong])))
    return (
        f"Fed with the thesis' covariances of pose and ball (tables 11 and 12) and its {SIGMA_B:g} px, our "
        f"propagation gives {fed:.1f} mm RMS where the thesis has {theirs:.1f} mm, and {same} of its "
        f"{int(np.count_nonzero(strong))} correlations above 0.6 with their sign; where the real camera stood "
        f"is not published, ours is that of S2. With our own calibration it is {ours:.1f} mm: pose and ball are known "
        "better, and their errors are correlated and cancel in part, which is carried along; without that correlation "
        f"it would be {apart:.1f} mm."
    )


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _scatter_table(caps: dict[str, Result]) -> Table:
    head = ("camera", "discs seen", "image alone: chi-square / 2", "with pose and ball: chi-square / 2")
    rows = []
    for view in VIEWS:
        c = caps.get(view)
        if c is None:
            rows.append((view, "failed", "", ""))
        else:
            rows.append((view, str(c["sights"]), f"{c['chi_square_image']:.2f}", f"{c['chi_square_total']:.2f}"))
    return Table(head, tuple(rows), "True errors squared over claimed variances; 1 is honest")


def _about_scatter(caps: dict[str, Result]) -> str:
    said = []
    for view, c in caps.items():
        ends = []
        for b in (c["bins"][0], c["bins"][-1]):
            whole, image = b["total sigma"][0], b["image sigma"][0]
            ends.append(
                f"{whole:.2f} mm at {b['angle']:.0f}° from the middle, the image alone {image:.2f} mm: "
                f"{100.0 * (image / whole) ** 2:.0f} % of the variance"
            )
        said.append(f"{view}: {'; '.join(ends)}")
    return (
        "Along the worst direction a single sight is certain to\n\n"
        + "\n".join(f"- {line}" for line in said)
        + "\n\nThe rest is camera pose and ball, which are off alike in every frame. "
        + _of_claims(caps)
    )


def _of_claims(caps: dict[str, Result]) -> str:
    """Whether the image's share is claimed larger or smaller than it is, from chi-square."""
    chi = {view: c["chi_square_image"] for view, c in caps.items()}
    told = ", ".join(f"{x:.2f} ({view})" for view, x in chi.items())
    if max(chi.values()) < 1.0:
        return (
            f"The image's share is claimed larger than it is (chi-square / 2: {told}; hollow dots below dotted lines): "
            "renders have neither print nor lens, for which a floor of "
            f"{kit.settings_of().discs.sigma:g} px stands in the detector."
        )
    return f"Chi-square / 2 of the image's share is {told}: above 1 it is claimed smaller than it is."


def _area_parts(area: Result, numbers: dict[str, Any]) -> list[str | Table | Figure]:
    head = (
        "camera", "distance, m", "thesis, m²", "formula, m²", "counted, m²", "frame hides", "one hand hides more",
        "two hands", "of 50 discs in view",
    )  # fmt: skip
    title = "Visible area of the ball (Wittich 2017, fig. 39)"
    if "views" not in area:
        return [Table(head, tuple((v, *["failed"] * 8) for v in VIEWS), title)]
    numbers["area"] = area
    rows, left = [], {}
    for view, a in area["views"].items():
        left[view] = a["behind frame"]
        of_frame = a["behind frame"]
        rows.append(
            (
                view,
                f"{a['distance']:.2f}",
                f"{FIGURE_39[view][1]:.2f}",
                f"{visible_cap(a['distance'], RADIUS):.2f}",
                f"{a['alone']:.2f}",
                f"{100 * (1 - of_frame / a['alone']):.0f} %",
                f"{100 * (1 - a['one hand'] / of_frame):.0f} %",
                f"{100 * (1 - a['two hands'] / of_frame):.0f} %",
                f"{50 * of_frame / (4.0 * np.pi * RADIUS**2):.1f}",
            )
        )
    v = area["views"]
    hides = {view: 100 * (1 - a["behind frame"] / a["alone"]) for view, a in v.items()}
    bare, kept = v["far"]["alone"] / v["near"]["alone"], left["far"] / left["near"]
    pairs = [*zip(area["distance"], area["alone"], strict=True), *((a["distance"], a["alone"]) for a in v.values())]
    off = max(abs(counted / visible_cap(d, RADIUS) - 1.0) for d, counted in pairs if d > RADIUS)
    text = (
        "The thesis' areas are too large: from 2.35 m no more than "
        f"{visible_cap(2.35, RADIUS):.2f} m² of a ball of {RADIUS:g} m radius can be seen. Counting which of many "
        f"points the renderer's rays meet first differs from the formula by at most {100 * off:.1f} %. The far camera "
        f"sees {_more(bare)} of the bare ball than the near one and, in the frame of the reference recordings, "
        f"{_more(kept)} of what the frame leaves: it hides {hides['near']:.0f} % before the near camera and "
        f"{hides['far']:.0f} % before the far one. {_of_thesis_frame(bare, kept)}"
    )
    figure = Figure(
        "surface-area",
        "Visible area of the ball against the camera's distance from its centre: formula, points counted with the "
        "renderer's rays, what the frame leaves of it, and the thesis' values, which no sphere of this size can have.",
        lambda canvas: _draw_area(canvas, area),
        (7.2, 3.4),
    )
    return [Table(head, tuple(rows), title), text, figure]


def _more(ratio: float) -> str:
    return f"{100 * abs(ratio - 1.0):.0f} % {'more' if ratio >= 1.0 else 'less'}"


def _of_thesis_frame(bare: float, kept: float) -> str:
    """What the thesis' frame hid, from its numbers of discs in table 23."""
    discs = _DISCS_23["far"] / _DISCS_23["near"]
    told = f"The thesis has {_more(discs).replace('less', 'fewer')} discs before its far camera"
    if discs < bare < kept:
        return f"{told}: its frame hid more from the far camera, ours hides more from the near one."
    return f"{told}."


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


def _draw_scatter(figure: Any, caps: dict[str, Result]) -> None:
    from matplotlib.lines import Line2D

    axes = figure.subplots(1, len(caps), sharey=True, squeeze=False)[0]
    for ax, (view, c) in zip(axes, caps.items(), strict=True):
        angle = [b["angle"] for b in c["bins"]]
        for k, colour in ((0, "C1"), (1, "C0")):
            for name, line, face in (("total", "-", colour), ("image", ":", "none")):
                ax.plot(angle, [b[f"{name} sigma"][k] for b in c["bins"]], color=colour, linestyle=line)
                ax.plot(
                    angle,
                    [b[f"{name} error"][k] for b in c["bins"]],
                    color=colour,
                    linestyle="",
                    marker="o",
                    markerfacecolor=face,
                )
        ax.set(title=f"{view} camera", xlabel="angle from the middle, °", yscale="log")
        plain_numbers(ax.yaxis)
    axes[0].set_ylabel("along the surface, mm")
    handles = [
        Line2D([], [], color="C1", marker="o", label="worst direction, all errors"),
        Line2D([], [], color="C0", marker="o", label="best direction, all errors"),
        Line2D([], [], color="C1", linestyle=":", marker="o", markerfacecolor="none", label="worst, image alone"),
        Line2D([], [], color="C0", linestyle=":", marker="o", markerfacecolor="none", label="best, image alone"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, handlelength=2.6)


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
