"""What the experiments on light are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.experiments.kit.film import TRACKERS
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.light import SIGMAS, THESIS_24, WORST, decoded, key_of
from spheremouse.experiments.report.page import failures, value
from spheremouse.experiments.report.plot import BOUND, THESIS

_AXES = ("C3", "C4", "C5")  # of angles and axes; C0 to C2 are the trackers'
_CLEARLY = 1.25  # times: less than that is no growth


def section(request: Request, results: Results) -> Section:
    """Table 24 and the figures."""
    films = [("s1", "S1, ours")]
    if request.datasets is not None and not request.quick:
        films.append(("far26", "far26"))
    parts: list[str | Table | Figure] = [
        f"Films like S1{_length(results)}. Normal noise of σ_r grey values on every channel of every pixel, and l "
        "grey values added to all: rate RMSE, combined. Camera pose found from the same bad pictures, our detector."
    ]
    if request.datasets is None:
        parts.append("The reference recording far26 was not at hand: its table is left out.")
    parts += [_table(results, key, name, request.quick) for key, name in films]
    said = _said(results)
    if said:
        parts.append(said)
    present = [(key, name) for key, name in films if _curves(results, key)]
    if present and not request.quick:
        parts.append(_figure_rates(results, present))
    shown = _shown(results)
    if shown is not None:
        parts += [_figure_picture(shown), _figure_attitude(shown), _said_of_attitude(shown)]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(parts), {key: _without_pictures(result) for key, result in results.items()})


def _length(results: Results) -> str:
    """Frames of a film, where one says."""
    cells = [c for r in results.values() if "error" not in r for c in r["cells"].values() if "error" not in c]
    frames = {c["rows"]["so3"].get("frames") for c in cells} - {None}
    return f" ({max(frames)} frames, the thesis' have 300)" if frames else ""


def _cell(results: Results, film: str, level: int, sigma: int) -> Result | None:
    result = results.get(key_of(film, level))
    return result if result is None or "error" in result else result["cells"].get(str(sigma))


def _table(results: Results, film: str, name: str, quick: bool) -> Table:
    rows = []
    for level, thesis in THESIS_24.items():
        if quick and results.get(key_of(film, level)) is None:
            continue
        typed = ("targets not found" if x is None else f"{x:.2f}" for x in thesis)
        rows.append((f"{level:+d}", "thesis, EKF2", *typed))
        for who in TRACKERS:
            cells = [_cell(results, film, level, sigma) for sigma in SIGMAS]
            shown = (
                value(c if c is None or "error" in c else c["rows"][who], "rate_rmse_deg_s", "combined") for c in cells
            )
            rows.append((f"{level:+d}", f"`{who}`", *shown))
    return Table(("l", "filter", *(f"σ_r = {s}" for s in SIGMAS)), tuple(rows), f"Rate RMSE, °/s, {name} (table 24)")


def _said(results: Results) -> str:
    """What noise and light do, in numbers."""
    said = []
    failed = [
        f"l = {level:+d}, σ_r = {sigma} on {film}"
        for film in ("s1", "far26")
        for level in THESIS_24
        for sigma in SIGMAS
        if "error" in (_cell(results, film, level, sigma) or {})
    ]
    dark = _cell(results, "s1", -50, 15)
    if dark is not None and "error" not in dark:
        said.append(
            "In the dark under the strongest noise (l = -50, σ_r = 15), where the thesis finds only two of its four "
            "targets, ours are found; the rate error of `so3` is "
            f"{value(dark['rows']['so3'], 'rate_rmse_deg_s', 'combined')} °/s."
        )
    ours = [_mean_rate(results, "s1", sigma, "ekf2") for sigma in SIGMAS]
    typed = [[row[i] for row in THESIS_24.values()] for i in range(len(SIGMAS))]
    theirs = [float(np.sqrt(np.mean(np.square([x for x in column if x is not None])))) for column in typed]
    known = [(s, a, b) for s, a, b in zip(SIGMAS, ours, theirs, strict=True) if np.isfinite(a)]
    if known:
        said.append(
            "The rate error of our `ekf2` over that of the thesis' (RMS over l): "
            + ", ".join(f"{a / b:.2f} at σ_r = {s}" for s, a, b in known)
            + ". The filter is the same, the detector is not: what the published one makes of it stands under *Filter "
            "models* and *Near and far camera*."
        )
    if failed:
        said.append(f"No camera pose was found at {'; '.join(failed)}.")
    for film, name in (("s1", "our S1"), ("far26", "far26")):
        few, many = (_mean_noise(results, film, sigma) for sigma in (SIGMAS[0], SIGMAS[-1]))
        if few and many:
            gains = ", ".join(
                f"`{who}` {_mean_rate(results, film, SIGMAS[-1], who) / _mean_rate(results, film, SIGMAS[0], who):.1f}"
                for who in TRACKERS
            )
            said.append(
                f"On {name} the centres of discs of 60 px² and more are good to {few:.2f} px at σ_r = {SIGMAS[0]} and "
                f"to {many:.2f} px at {SIGMAS[-1]} (RMS over l); the rate errors grow by a factor of: {gains}."
            )
    return " ".join(said)


def _values(results: Results, film: str, sigma: int, path: tuple[str, ...]) -> list[float]:
    found = []
    for level in THESIS_24:
        x: Any = _cell(results, film, level, sigma)
        for name in path:
            x = x.get(name) if isinstance(x, dict) else None
        if x is not None:
            found.append(float(x))
    return found


def _mean_noise(results: Results, film: str, sigma: int) -> float | None:
    values = _values(results, film, sigma, ("rows", "so3", "detection", "centre_rms_60_px"))
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _mean_rate(results: Results, film: str, sigma: int, who: str) -> float:
    values = _values(results, film, sigma, ("rows", who, "rate_rmse_deg_s", "combined"))
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def _curves(results: Results, film: str) -> bool:
    return any(_values(results, film, s, ("rows", "so3", "rate_rmse_deg_s", "combined")) for s in SIGMAS)


def _figure_rates(results: Results, films: list[tuple[str, str]]) -> Figure:
    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, len(films), sharey=True, squeeze=False)[0]
        handles: list[Any] = []
        for ax, (film, name) in zip(axes, films, strict=True):
            ax.set_title(name)
            handles = []
            for k, who in enumerate(TRACKERS):
                how = {"color": f"C{k}", "marker": "osD"[k]}
                handles += _band(ax, results, film, ("rows", who, "rate_rmse_deg_s", "combined"), who, how)
            path = ("bound", "rate_deg_s", "combined")
            handles += _band(ax, results, film, path, "Cramér-Rao bound", {"color": "0.5", **BOUND})
            known = [[x for x in column if x is not None] for column in zip(*THESIS_24.values(), strict=True)]
            middle = [float(np.median(c)) for c in known]
            ax.fill_between(SIGMAS, [min(c) for c in known], [max(c) for c in known], color="C3", alpha=0.15, lw=0)
            handles += ax.plot(SIGMAS, middle, color="C3", marker="x", label="thesis", **THESIS)
            ax.set(xlabel=r"noise $\sigma_r$, grey values", xticks=SIGMAS)
        axes[0].set_ylim(bottom=0.0)
        axes[0].set_ylabel("rate RMSE, °/s")
        canvas.legend(handles=handles, loc="outside upper center", ncols=5)

    return Figure(
        "light-rates",
        "Rate errors under noise: medians over the brightnesses l = -50 to +50, and the range of all of them. "
        "The bound is for the centres that `so3` measured.",
        draw,
        (7.2, 3.5),
    )


def _band(ax: Any, results: Results, film: str, path: tuple[str, ...], label: str, how: dict[str, Any]) -> list[Any]:
    columns = [(s, _values(results, film, s, path)) for s in SIGMAS]
    columns = [(s, v) for s, v in columns if v]
    x = [s for s, _ in columns]
    ax.fill_between(x, [min(v) for _, v in columns], [max(v) for _, v in columns], color=how["color"], alpha=0.15, lw=0)
    return ax.plot(x, [float(np.median(v)) for _, v in columns], label=label, **how)


def _shown(results: Results) -> Result | None:
    cell = _cell(results, "s1", *WORST)
    return None if cell is None or "error" in cell else cell.get("shown")


def _figure_picture(shown: Result) -> Figure:
    picture = shown["picture"]

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, 2)
        for ax, name, title in zip(axes, ("before", "after"), ("as filmed", "as tracked"), strict=True):
            ax.imshow(decoded(picture[name]), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            ax.set_title(title)
            ax.set_axis_off()
        for u, v in picture["used"]:
            axes[1].plot(u, v, marker="o", markersize=16, markerfacecolor="none", color="C1", linestyle="none")

    return Figure(
        "light-picture",
        f"The middle of the ball in our S1, before and after l = {WORST[0]:+d}, σ_r = {WORST[1]} (as fig. 40). Rings: "
        f"the discs that `so3` used.",
        draw,
        (7.2, 3.0),
    )


def _figure_attitude(shown: Result) -> Figure:
    series, truth = shown["series"], shown["truth"]

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1 + len(series), 1, sharex=True, gridspec_kw={"height_ratios": [1.3, 1, 1]})
        for i, name in enumerate("ωφκ"):
            line = axes[0].plot(truth["t"], np.array(truth["angles"])[:, i], color=_AXES[i], linestyle="-")[0]
            k = int(np.argmax(np.abs(np.array(truth["angles"])[:, i])))
            axes[0].annotate(name, (truth["t"][k], truth["angles"][k][i]), color=line.get_color(), va="bottom")
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

    return Figure(
        "light-attitude",
        f"Attitude under l = {WORST[0]:+d}, σ_r = {WORST[1]} on our S1: truth, and errors about the device's axes (as "
        "fig. 41). The bound is one standard deviation, the mean of the three axes.",
        draw,
        (7.2, 4.6),
    )


def _said_of_attitude(shown: Result) -> str:
    said = []
    for name, s in shown["series"].items():
        if not s["t"]:
            said.append(f"`{name}` tracked nothing")
            continue
        error, part = np.array(s["error"]), np.array(s["t"]) / s["t"][-1]
        most = np.abs(error).max(axis=0)
        length = np.linalg.norm(error, axis=1)
        thirds = [
            float(np.sqrt(np.mean(np.square(length[w])))) if np.any(w) else 0.0
            for w in (part < 1 / 3, (part >= 1 / 3) & (part < 2 / 3), part >= 2 / 3)
        ]
        if thirds[1] > _CLEARLY * max(thirds[0], thirds[2]):
            course = "grows to the middle and shrinks again, as there"
        elif thirds[2] > _CLEARLY * thirds[0] and thirds[2] >= thirds[1]:
            course = "grows to the end"
        else:
            course = "has no such course"
        axes = ", ".join(f"{x:.3f}" for x in most)
        rms = ", ".join(f"{x:.3f}" for x in thirds)
        said.append(f"`{name}` {axes}° about x, y, z; its length (RMS of the film's thirds: {rms}°) {course}")
    return (
        "The largest attitude error in this film about an axis, in the thesis below 1° about each, growing up to the "
        "middle of the film and shrinking as the ball turns back: " + "; ".join(said) + "."
    )


def _without_pictures(result: Result) -> Result:
    if "error" in result:
        return result
    cells = {k: {n: v for n, v in c.items() if n != "shown"} for k, c in result["cells"].items()}
    return {**result, "cells": cells}
