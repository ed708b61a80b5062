"""What the experiments on the camera's pose are said to show: tables, figures and sentences."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from spheremouse.ball.pose import PoseSettings
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.thesis import THESIS_TABLES
from spheremouse.experiments.poses import BLANK, NAMES, NOISE, STRONG, VIEWS, VIEWS_USED
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import THESIS

_CLEAR = 0.1  # a correlation whose sign means something


def section(request: Request, results: Results) -> Section:
    """Three tables of the thesis, how honest standard deviations are, and what more views bring."""
    parts: list[str | Table | Figure] = [
        f"Four ring targets on the device's frame give the pose of the camera. The tables use {VIEWS_USED} views of a "
        f"still scene with noise of {NOISE:g} grey values. Ours, in brackets the thesis' value. Angles are the "
        "thesis' ω, φ, κ. Standard deviations and correlations are those of a camera where the thesis' stands; errors "
        "are RMS over all cameras, which stand up to some centimetres away from it.",
    ]
    numbers: dict[str, Any] = {}
    cases = (
        ("12", "far", "calibrated", "R1: far camera, targets and ball as calibrated from six photos with a tape"),
        ("21", "far", "exact", "S2: far camera, targets known exactly"),
        ("22", "near", "exact", "S4: near camera, targets known exactly"),
    )
    for table, view, kind, about in cases:
        entries, own = _entries(results, view, kind), _own(results, view, kind)
        where = {} if own is None else {k: own[k] for k in ("sigma", "correlation")}
        numbers[f"table {table}"] = {**_summary(entries), **where}
        rows = _rows(entries, own, THESIS_TABLES[table], _failed(results, view))
        parts.append(Table(("", *NAMES), rows, f"Table {table}. {about}"))
    parts += ["\n\n".join(_why(results)), _honest(results, numbers), _of_drawn(numbers)]
    if "far26" in results:
        parts.append(_far26(results["far26"], numbers))
    else:
        parts.append("The shared Blender recording was not at hand: its rows are left out.")
    curves = {view: _curves(results, view) for view in VIEWS}
    numbers["error against views"] = curves
    if any(curves.values()):
        parts.append(_gain(curves))
        parts.append(
            Figure(
                "poses-views",
                "Error of the camera's position (length of the error vector, RMS over cameras) and its claimed "
                f"standard deviation against the number of views of a still scene, with noise of {STRONG:g} grey "
                "values. Were views independent, the standard deviation would follow the dotted line: from noise "
                "alone, falling with the root of their number.",
                lambda figure: _draw(figure, curves, _far26_curve(results.get("far26"))),
                (7.2, 3.6),
            )
        )
    failed = failures(results)
    if failed:
        parts.append("What failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), numbers)


def _entries(results: Results, view: str, kind: str, film: str = "table", views: int = VIEWS_USED) -> list[Result]:
    """Of all cameras that film; those that failed are missing."""
    found = [r[film]["counts"].get(str(views), {}) for r in _cameras(results, view)]
    return [f[kind] for f in found if kind in f]


def _own(results: Results, view: str, kind: str) -> Result | None:
    """Of the camera that stands where the thesis' does; None where that one failed."""
    found = results.get(f"{view}-0", {})
    return found["table"]["counts"].get(str(VIEWS_USED), {}).get(kind) if "table" in found else None


def _failed(results: Results, view: str) -> int:
    """How many cameras did."""
    return sum(key.startswith(f"{view}-") and "error" in r for key, r in results.items())


def _cameras(results: Results, view: str) -> list[Result]:
    return [r for key, r in results.items() if key.startswith(f"{view}-") and "error" not in r]


def _summary(entries: list[Result]) -> Result:
    if not entries:
        return {"cameras": 0}
    error, sigma = np.array([e["error"] for e in entries]), np.array([e["sigma"] for e in entries])
    chi = [e["chi_square"] for e in entries]
    return {
        "cameras": len(entries),
        "error_rms": np.sqrt(np.mean(error**2, axis=0)).tolist(),
        "largest": float(np.max(np.abs(error / sigma))),
        "chi_square": float(np.mean(chi)) / 6.0,
        "band": _band(6 * len(chi)),
    }


def _band(freedom: int) -> list[float]:
    """95 % of chi-square over its degrees of freedom."""
    return [float(2.0 * gammaincinv(0.5 * freedom, p) / freedom) for p in (0.025, 0.975)]


def _rows(
    entries: list[Result], own: Result | None, thesis: dict[str, Any], failed: int
) -> tuple[tuple[str, ...], ...]:
    if not entries:
        return (("all cameras", *(["failed"] * 6)),)
    s = _summary(entries)
    rows = []
    units, digits = ["mm"] * 3 + ["°"] * 3, [3] * 3 + [4] * 3

    def line(name: str, ours: Sequence[float], printed: Sequence[float] | None) -> tuple[str, ...]:
        theirs = [""] * 6 if printed is None else [f" ({p:g})" for p in printed]
        cells = (f"{o:z.{d}f}{t} {u}" for o, d, t, u in zip(ours, digits, theirs, units, strict=True))
        return (name, *cells)

    if own is None:
        rows.append(("where the thesis' camera stands", *(["failed"] * 6)))
    else:
        for i, printed in enumerate(thesis["correlation"], start=1):
            cells = [f"{own['correlation'][i][j]:z.3f} ({printed[j]:.3f})" for j in range(i)]
            rows.append((f"correlation {NAMES[i]}", *cells, *[""] * (6 - i)))
        rows.append(line("standard deviation", own["sigma"], thesis["sigma"]))
    some = f", {failed} failed" if failed else ""
    rows.append(line(f"error, {s['cameras']} cameras{some}", s["error_rms"], thesis.get("error")))
    over = np.array(s["error_rms"]) / np.sqrt(np.mean([np.square(e["sigma"]) for e in entries], axis=0))
    printed = thesis.get("error")
    theirs = [""] * 6 if printed is None else [f" ({e / d:.1f})" for e, d in zip(printed, thesis["sigma"], strict=True)]
    rows.append(("error / standard deviation", *(f"{o:.2f}{t}" for o, t in zip(over, theirs, strict=True))))
    return tuple(rows)


def _why(results: Results) -> list[str]:
    """Where we differ, from what was measured."""
    floor = PoseSettings().target_sigma
    said = []
    found = {v: _centre_errors(results, v) for v in VIEWS}
    centres = {v: c for v, c in found.items() if c is not None}
    if len(centres) == len(VIEWS):
        common = ", ".join(f"{c[0]:.3f} px ({v})" for v, c in centres.items())
        scatter = ", ".join(f"{c[1]:.3f} px ({v})" for v, c in centres.items())
        share = {v: np.sqrt(_summary(_entries(results, v, "exact"))["chi_square"]) for v in VIEWS}
        shares = ", ".join(f"{s:.2f} ({v})" for v, s in share.items())
        reason = (
            f". {floor:g} px are assumed for what no averaging removes (print, lens, sampling), and a rendered target "
            "has neither print nor lens: its"
            if max(share.values()) < 1.0
            else f", {floor:g} px assumed for what no averaging removes (print, lens, sampling). The target's"
        )
        said.append(
            f"With exact targets our errors are {shares} of our standard deviations (root of chi-square / 6){reason} "
            f"centre, averaged over all views, is off by {common} RMS per axis; single views scatter by {scatter}. The "
            "thesis counts its 30 views as independent, and its errors of the near camera are up to "
            f"{_worst('22'):.1f} of its standard deviations."
        )
    a, b, printed = (
        _own(results, "far", "exact"),
        _own(results, "far", "calibrated"),
        THESIS_TABLES["12"]["correlation"],
    )
    if a is not None and b is not None:
        said.append(
            "In table 12 the correlations of Z0 with Y0 and ω0 are those of targets known exactly "
            f"({printed[1][1]:.2f} and {printed[2][2]:.2f}; ours then {a['correlation'][2][1]:.2f} and "
            f"{a['correlation'][3][2]:.2f}, table 21). Ours carry the joint covariance of calibrated targets along: "
            "a target field that is shifted as a whole shifts the camera, so that the standard deviation of Z0 grows "
            f"from {a['sigma'][2]:.2f} to {b['sigma'][2]:.2f} mm and those correlations change to "
            f"{b['correlation'][2][1]:.2f} and {b['correlation'][3][2]:.2f}. Where the real camera of R1 stood is not "
            "published; ours is that of S2." + _other_signs(b)
        )
    return said


def _other_signs(ours: Result) -> str:
    """Of kappa0 in table 12, where they differ, beside those that the thesis has in table 21."""
    r1, s2 = (THESIS_TABLES[table]["correlation"][4] for table in ("12", "21"))
    other = [
        j for j in range(5) if abs(r1[j]) > _CLEAR and abs(s2[j]) > _CLEAR and r1[j] * ours["correlation"][5][j] < 0
    ]
    if not other:
        return ""
    told = " and ".join(
        f"{NAMES[j]} ({ours['correlation'][5][j]:+.2f} against {r1[j]:+.2f}; table 21: {s2[j]:+.2f})" for j in other
    )
    same = all(s2[j] * ours["correlation"][5][j] > 0 for j in other)
    return f" The correlation of κ0 has the other sign with {told}" + (
        ": ours has the signs of the thesis' own S2, its R1 stands apart; the camera may have stood otherwise there."
        if same
        else "."
    )


def _of_drawn(numbers: dict[str, Any]) -> str:
    """Why drawn centres give less than 1, if they do."""
    found = {v: numbers[k]["chi_square"] for v in VIEWS if (k := f"{v}, centres drawn, targets calibrated") in numbers}
    if not found:
        return ""
    told = ", ".join(f"{x:.2f} ({v})" for v, x in found.items())
    return f"Drawn centres are off by what is assumed of them: chi-square / 6 is {told}." + (
        " With four targets the residuals have two degrees of freedom; large ones enlarge a covariance, small ones "
        "never shrink it, which keeps the mean below 1."
        if max(found.values()) < 1.0
        else ""
    )


def _centre_errors(results: Results, view: str, film: str = "table") -> tuple[float, float] | None:
    """RMS over cameras of what views have in common, and of their scatter; px."""
    found = [r[film] for r in _cameras(results, view)]
    if not found:
        return None
    return _rms(r["common_px"] for r in found), _rms(r["scatter_px"] for r in found)


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))


def _worst(table: str) -> float:
    thesis = THESIS_TABLES[table]
    return max(e / s for e, s in zip(thesis["error"], thesis["sigma"], strict=True))


def _honest(results: Results, numbers: dict[str, Any]) -> Table:
    """Errors squared over covariance: 1 per degree of freedom is honest."""
    rows = []
    for view in VIEWS:
        cases = [
            ("rendered, targets exact", _entries(results, view, "exact")),
            ("rendered, targets calibrated", _entries(results, view, "calibrated")),
            ("centres drawn, targets calibrated", results.get(f"drawn-{view}", {}).get("entries", [])),
        ]
        for name, entries in cases:
            if not entries:
                rows.append((f"{view}, {name}", "0", "failed", BLANK, BLANK, BLANK))
                continue
            s = _summary(entries)
            numbers[f"{view}, {name}"] = {k: s[k] for k in ("cameras", "chi_square", "band", "largest")}
            low, high = s["band"]
            chi = s["chi_square"]
            verdict = "too sure" if chi > high else "careful" if chi < low else "honest"
            band = f"{low:.2f} to {high:.2f}"
            rows.append((f"{view}, {name}", str(s["cameras"]), f"{chi:.3f}", band, verdict, f"{s['largest']:.1f}"))
    for table, name in (("21", "far"), ("22", "near")):
        rows.append((f"{name}, thesis, table {table}", "1", BLANK, BLANK, BLANK, f"{_worst(table):.1f}"))
    head = ("", "cameras", "chi-square / 6", "95 % band of 1", "", "largest error / standard deviation")
    return Table(head, tuple(rows), "How honest the covariances are")


def _far26(result: Result, numbers: dict[str, Any]) -> Table:
    """The shared recording beside table 21."""
    head = ("", *NAMES)
    title = "far26, the shared Blender recording of the far camera, with the same noise (in brackets: table 21)"
    if "error" in result:
        return Table(head, (("error", *["failed"] * 6),), title)
    film, thesis = result["table"], THESIS_TABLES["21"]
    found = film["counts"][str(VIEWS_USED)]["exact"]
    numbers["far26"] = {**found, "common_px": film["common_px"], "scatter_px": film["scatter_px"]}
    units, digits = ["mm"] * 3 + ["°"] * 3, [3] * 3 + [4] * 3
    rows = [
        (
            name,
            *(
                f"{o:{sign}z.{d}f} ({t:g}) {u}"
                for o, d, t, u in zip(found[key], digits, thesis[key], units, strict=True)
            ),
        )
        for name, key, sign in (("error", "error", "+"), ("standard deviation", "sigma", ""))
    ]
    title += (
        f". Chi-square / 6 is {found['chi_square'] / 6.0:.3f}; targets' centres are off by {film['common_px']:.3f} px "
        f"RMS per axis and scatter by {film['scatter_px']:.3f} px"
    )
    return Table(head, tuple(rows), title)


def _curves(results: Results, view: str) -> dict[str, list[float]]:
    """Against the number of views: error and claimed standard deviation of the position, mm."""
    cameras, centres = _cameras(results, view), _centre_errors(results, view, "figure")
    if not cameras or centres is None:
        return {}
    counts = sorted(int(n) for n in cameras[0]["figure"]["counts"])
    curves: dict[str, list[float]] = {"views": [float(n) for n in counts]}
    for kind in ("exact", "calibrated"):
        for what in ("error", "sigma"):
            curves[f"{kind} {what}"] = [
                _rms(float(np.linalg.norm(e[what][:3])) for e in _entries(results, view, kind, "figure", n))
                for n in counts
            ]
    # the claim is of floor and noise: what of it is noise, were the floor none
    whole = np.hypot(PoseSettings().target_sigma, centres[1] / np.sqrt(counts[-1]))
    one = curves["exact sigma"][-1] / whole * centres[1]
    curves["independent"] = [float(one / np.sqrt(n)) for n in counts]
    return curves


def _far26_curve(result: Result | None) -> dict[str, list[float]]:
    if result is None or "error" in result:
        return {}
    found = result["figure"]["counts"]
    counts = sorted(int(n) for n in found)
    error = [float(np.linalg.norm(found[str(n)]["exact"]["error"][:3])) for n in counts]
    return {"views": [float(n) for n in counts], "error": error}


def _gain(curves: dict[str, dict[str, list[float]]]) -> str:
    """What more views bring, in words."""
    lines = []
    for view, c in curves.items():
        if not c:
            continue
        first, last = c["views"][0], c["views"][-1]
        exact, known, alone = c["exact error"], c["calibrated error"], c["independent"]
        lines.append(
            f"- {view}: with exact targets {exact[0]:.2f} mm from {first:g} view and {exact[-1]:.2f} mm from {last:g} "
            f"(from noise alone {alone[0]:.2f} and {alone[-1]:.2f} mm), with calibrated ones {known[0]:.2f} and "
            f"{known[-1]:.2f} mm"
        )
    return (
        f"More views remove noise and nothing else. With noise of {STRONG:g} grey values the position is off, RMS "
        "over cameras, by\n\n" + "\n".join(lines) + "\n\nWhat sampling, lens, print and calibration are off by stays."
    )


def _draw(figure: Any, curves: dict[str, dict[str, list[float]]], far26: dict[str, list[float]]) -> None:
    from matplotlib.ticker import StrMethodFormatter

    axes = figure.subplots(1, 2, sharey=True)
    for ax, (view, c) in zip(axes, curves.items(), strict=True):
        ax.set_title(f"{view} camera")
        ax.set_xlabel("views")
        ax.set_xscale("log")
        ax.set_yscale("log")
        if not c:
            ax.text(0.5, 0.5, "failed", transform=ax.transAxes, ha="center")
            continue
        n = c["views"]
        ax.plot(n, c["calibrated sigma"], color="C1", linestyle="--", linewidth=1.0)
        ax.plot(n, c["calibrated error"], color="C1", linestyle="-", marker="o")
        ax.plot(n, c["exact sigma"], color="C0", linestyle="--", linewidth=1.0)
        ax.plot(n, c["exact error"], color="C0", linestyle="-", marker="o")
        ax.plot(n, c["independent"], color="C2", linestyle=":", linewidth=1.4)
        if view == "far" and far26:
            ax.plot(far26["views"], far26["error"], color="C3", linestyle="", marker="D")
        ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes[0].set_ylabel("position, mm")
    figure.legend(
        handles=_handles(bool(far26)), loc="outside lower center", ncols=3, handlelength=2.4, columnspacing=1.6
    )


def _handles(far26: bool) -> list[Any]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color="C1", marker="o", label="targets calibrated: error"),
        Line2D([], [], color="C1", label="claimed", **THESIS),
        Line2D([], [], color="C0", marker="o", label="targets exact: error"),
        Line2D([], [], color="C0", label="claimed", **THESIS),
        Line2D([], [], color="C2", linestyle=":", label="were views independent"),
    ]
    if far26:
        handles.append(Line2D([], [], color="C3", marker="D", linestyle="", label="far26 (Blender): error"))
    return handles
