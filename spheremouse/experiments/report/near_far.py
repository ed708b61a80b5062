"""What the experiments on the near and the far camera are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.near_far import DISCS, NOISE, THESIS, VARIANTS, VIEWS
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND, plain_numbers
from spheremouse.simulate.ball.film import View

_KEYS = {"attitude": ("attitude_rmse_deg", "°", 4), "rate": ("rate_rmse_deg_s", "°/s", 2)}
_LEAST = {"attitude": "attitude_deg", "rate": "rate_deg_s"}  # of the bound


def section(request: Request, results: Results) -> Section:
    """Table 23, and the figure of its rates and attitudes."""
    found = {view: _of_view(results, view) for view in VIEWS}
    films = {v: _films(results, v) for v in VIEWS}
    parts: list[str | Table | Figure] = [
        f"{DISCS} discs, the thesis' motion and cameras, noise of {NOISE:g} grey values; RMS over films "
        f"with other places of the discs, {films['near']} from near, {films['far']} from far. The camera's pose "
        "is found from the pictures. `ekf2, blobs` is the thesis' filter with the thesis' detector; the others have "
        "ours. The thesis' rates are those of Euler angles, ours those of the angular velocity; its discs are those "
        "stored, ours those used in a frame. The bound is that of the centres which `so3` measured.",
        Table(("", "thesis", *VARIANTS, "bound"), _rows(found), "Table 23"),
        _why(found, {view: r for view in VIEWS if "attitude" in (r := results.get(f"posed-{view}", {}))}),
    ]
    if any(found.values()):
        parts.append(
            Figure(
                "near-far",
                "Errors of attitude and rate per axis (RMS) before the near and the far camera. Crosses: the thesis; "
                "dotted bars: the Cramér-Rao bound.",
                lambda figure: _draw(figure, found),
                (7.2, 4.6),
            )
        )
    failed = failures(results)
    failed += [
        f"- {key}, {name}: {t['error']}"
        for key, r in results.items()
        for name, t in r.get("trackers", {}).items()
        if "error" in t
    ]
    if failed:
        parts.append("What failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), found)


def _films(results: Results, view: str) -> str:
    """How many there are, and how many failed."""
    of_view = [r for k, r in results.items() if k.startswith(f"{view}-")]
    failed = sum("error" in r for r in of_view)
    return f"{len(of_view) - failed}" + (f" ({failed} of {len(of_view)} failed)" if failed else "")


def _of_view(results: Results, view: str) -> dict[str, Any]:
    """By tracker, and the bound: RMS over films per axis, discs in use, frames lost; {} where no film was tracked."""
    films = [r for k, r in results.items() if k.startswith(f"{view}-") and "error" not in r]
    found: dict[str, Any] = {}
    for name in VARIANTS:
        reports = [f["trackers"][name] for f in films if "error" not in f["trackers"][name]]
        reports = [r for r in reports if r["tracked"]]
        if reports:
            found[name] = {
                "discs": float(np.mean([r["mean_discs"] for r in reports])),
                "untracked": sum(r["frames"] - r["tracked"] for r in reports),
                "centre_px": float(np.mean([r["detection"]["centre_rms_px"] or np.nan for r in reports])),
                **{k: _rms([[r[key][a] for a in "xyz"] for r in reports]) for k, (key, _, _) in _KEYS.items()},
            }
    bounds = [f["bound"] for f in films if f["bound"]]
    if bounds:
        found["bound"] = {k: _rms([[b[least][a] for a in "xyz"] for b in bounds]) for k, least in _LEAST.items()}
    return found


def _rms(rows: list[list[float]]) -> list[float]:
    return np.sqrt(np.mean(np.square(rows), axis=0)).tolist()


def _rows(found: dict[str, dict[str, Any]]) -> tuple[tuple[str, ...], ...]:
    rows = []
    for view in VIEWS:
        here, thesis = found[view], THESIS[view]
        discs = [f"{here[n]['discs']:.1f}" if n in here else "failed" for n in VARIANTS]
        rows.append((f"{view}: discs", f"{thesis['discs']:.1f}", *discs, ""))
        for what, (_, unit, digits) in _KEYS.items():
            for i, axis in enumerate("xyz"):
                cells = [f"{here[n][what][i]:.{digits}f}" if n in here else "failed" for n in (*VARIANTS, "bound")]
                rows.append((f"{view}: {what} {axis}, {unit}", f"{thesis[what][i]:.2f}", *cells))
        lost = [str(here[n]["untracked"]) if n in here else "failed" for n in VARIANTS]
        rows.append((f"{view}: frames not tracked", "", *lost, ""))
    return tuple(rows)


def _combined(values: Any) -> float:
    return float(np.linalg.norm(values))


def _why(found: dict[str, dict[str, Any]], wrongly_posed: dict[View, Result]) -> str:
    """Near against far, and ours against the thesis', from what was measured."""
    if not all("so3" in found[v] and "ekf2" in found[v] for v in VIEWS):
        return ""
    near, far = found["near"], found["far"]
    said = [
        f"The far camera has {_more(far['so3']['discs'] / near['so3']['discs'])} discs in use than the near one "
        f"(thesis: {_more(THESIS['far']['discs'] / THESIS['near']['discs'])}); see the visible area of the ball."
    ]
    for what in _KEYS:
        ratios = [
            f"{_combined(near[n][what]) / _combined(far[n][what]):.2f} (`{n}`)"
            for n in VARIANTS
            if n in near and n in far
        ]
        if "bound" in near and "bound" in far:
            ratios.append(f"{_combined(near['bound'][what]) / _combined(far['bound'][what]):.2f} (the bound)")
        printed = _combined(THESIS["near"][what]) / _combined(THESIS["far"][what])
        said.append(f"Near over far, the combined error of {what} is {', '.join(ratios)}; in the thesis {printed:.2f}.")
    if _alike(near, far):
        said.append(
            "Neither the thesis' filter nor its detector makes the attitude so much worse before the near camera here."
        )
    if wrongly_posed:
        said.append(_of_poses(wrongly_posed))
    if "ekf2, blobs" in near and "ekf2, blobs" in far:
        said.append(_of_detectors(found))
    return " ".join(s for s in said if s)


def _more(ratio: float) -> str:
    return f"{abs(ratio - 1.0):.0%} {'more' if ratio >= 1.0 else 'fewer'}".replace("%", " %")


def _alike(near: dict[str, Any], far: dict[str, Any]) -> bool:
    """Whether no variant of ours gets as much worse before the near camera as the thesis."""
    printed = _combined(THESIS["near"]["attitude"]) / _combined(THESIS["far"]["attitude"])
    both = [n for n in VARIANTS if n in near and n in far]
    return all(_combined(near[n]["attitude"]) < 0.7 * printed * _combined(far[n]["attitude"]) for n in both)


def _of_poses(wrongly_posed: dict[View, Result]) -> str:
    """What the thesis' errors of the camera's pose do to our films."""
    each, explained = [], []
    for view, result in wrongly_posed.items():
        printed, off = _combined(THESIS[view]["attitude"]), result["attitude"]
        gone = f", lost with {result['lost']} of {result['lost'] + len(off)}" if result["lost"] else ""
        if not off:
            each.append(f"{view}, the ball is lost with all")
            continue
        each.append(f"{view} {off[0]:.2f} to {off[-1]:.2f}°{gone} (thesis: {printed:.2f}°)")
        if off[0] <= printed <= off[-1]:
            explained.append(f"before the {view} camera its pose alone explains the thesis' attitude")
        elif printed > off[-1]:
            explained.append(
                f"before the {view} camera its pose explains up to {off[-1]:.2f}° of it, and what makes the rest was "
                "not found"
            )
        else:
            explained.append(f"before the {view} camera the thesis is better than any of these")
    return (
        "With a pose off by as much as the thesis' (tables 21 and 22, where signs are not printed: all were tried) the "
        f"attitude of `ekf2` is off by: {'; '.join(each)}. {_sentence('; '.join(explained))}"
    ).strip()


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _of_detectors(found: dict[str, dict[str, Any]]) -> str:
    """The published detector against ours, with the same filter on the same films."""
    told = []
    for v in VIEWS:
        theirs, ours = found[v]["ekf2, blobs"], found[v]["ekf2"]
        rates = f"{_combined(theirs['rate']):.2f} against {_combined(ours['rate']):.2f} °/s"
        told.append(f"{v} {rates} with centres off by {theirs['centre_px']:.2f} against {ours['centre_px']:.2f} px")
    return f"With `ekf2` on the same films, the published detector against ours: {'; '.join(told)}."


def _draw(figure: Any, found: dict[str, dict[str, Any]]) -> None:
    from matplotlib.lines import Line2D

    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    names = list(VARIANTS)
    colours, marks = ("C4", "C0", "C1", "C2"), ("v", "o", "s", "D")
    for row, (what, (_, unit, _)) in zip(axes, _KEYS.items(), strict=True):
        for ax, view in zip(row, VIEWS, strict=True):
            here = found[view]
            for k, name in enumerate(names):
                if name in here:
                    x = np.arange(3) + 0.15 * (k - 1.5)
                    ax.plot(x, here[name][what], color=colours[k], linestyle="", marker=marks[k])
            ax.plot(np.arange(3) - 0.38, THESIS[view][what], color="C3", linestyle="", marker="x", markersize=6)
            if "bound" in here:
                for i, least in enumerate(here["bound"][what]):
                    ax.plot([i - 0.3, i + 0.3], [least, least], color="0.5", **BOUND)
            ax.set_yscale("log")
            plain_numbers(ax.yaxis)
            ax.set_xticks(range(3), ["x", "y", "z"])
            ax.grid(visible=False, axis="x")
        row[0].set_ylabel(f"{what} RMSE, {unit}")
    for ax, view in zip(axes[0], VIEWS, strict=True):
        ax.set_title(f"{view} camera")
    handles = [Line2D([], [], color="C3", marker="x", linestyle="", markersize=6, label="thesis, EKF2")]
    handles += [
        Line2D([], [], color=c, marker=m, linestyle="", label=n) for c, m, n in zip(colours, marks, names, strict=True)
    ]
    handles.append(Line2D([], [], color="0.5", label="bound", **BOUND))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, handlelength=1.4, columnspacing=1.2)
