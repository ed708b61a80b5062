"""Numbers and figures of the page on the camera's pose from four targets."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import gammaincinv

from experiments.kit.job import Result, Results
from experiments.kit.thesis import THESIS_TABLES
from experiments.poses import NAMES, NOISE, STRONG, VIEWS, VIEWS_USED
from experiments.report.frames import markdown, rms, tidy
from experiments.report.page import Page, fixed, table
from experiments.report.plot import BOUND, THESIS, Drawing
from spheremouse.ball.pose import TARGET_SIGMA_PX
from spheremouse.geometry.rotation import Array

LARGE = ("correlation", "entries")  # of the poses, for which the page has the figures
_HEAD = ("", *(f"{name}, mm" for name in NAMES[:3]), *(f"{name}, °" for name in NAMES[3:]))
_DIGITS = (3, 3, 3, 4, 4, 4)
_ERROR, _SIGMA = ([f"{what}.{name}" for name in NAMES] for what in ("error", "sigma"))
_CASES = {
    ("table", "exact"): "rendered, targets exact",
    ("table", "calibrated"): "rendered, targets calibrated",
    ("drawn", "calibrated"): "centres drawn, targets calibrated",
}


def page(results: Results) -> Page:
    """Tables 12, 21 and 22, errors against what is claimed, and what more views bring."""
    poses = tidy(_records(results))
    shared = poses["camera"] == "far26"
    cameras, recorded = poses[~shared], poses[shared]
    tables, figure = cameras[cameras["film"] == "table"], cameras[cameras["film"] == "figure"]
    honest, curves = _honest(cameras), _curves(figure)
    exact, calibrated = ({view: _of(tables, view, targets) for view in VIEWS} for targets in ("exact", "calibrated"))
    far26 = recorded[recorded["film"] == "table"].mean(numeric_only=True)
    few, many = figure["views"].min(), figure["views"].max()
    first, last = (curves.reindex([(view, n) for view in VIEWS]).droplevel(1) for n in (few, many))
    values = {
        "views": VIEWS_USED,
        "noise": NOISE,
        "strong": STRONG,
        "floor": TARGET_SIGMA_PX,
        "cameras": tables["camera"].nunique(),
        "table_12": _beside_the_thesis(calibrated["far"], "12"),
        "table_21": _beside_the_thesis(exact["far"], "21"),
        "table_22": _beside_the_thesis(exact["near"], "22"),
        "own_12": _of_thesis_camera(calibrated["far"]).to_dict(),
        "own_21": _of_thesis_camera(exact["far"]).to_dict(),
        "centres": tables.groupby("view")[["common_px", "scatter_px"]].agg(rms).reindex(VIEWS).to_dict("index"),
        "worst_22": _worst("22"),
        "share": honest["chi"].pow(0.5).xs(("table", "exact"), level=("film", "targets")).to_dict(),
        "chi_drawn": honest["chi"].xs(("drawn", "calibrated"), level=("film", "targets")).to_dict(),
        "over_band": (honest["chi"] / honest["high"]).max(skipna=False),
        "honest": _honest_table(honest),
        "far26": far26.to_dict() if len(recorded) else None,
        "far26_table": _far26_table(far26),
        "gain": _gain_table(first, last, few, many),
        "left": (last / first).to_dict("index"),
        "over_noise": (last["exact error"] / last["independent"]).to_dict(),
    }
    drawing = _figure(curves, recorded[recorded["film"] == "figure"])
    return Page(values, (drawing,) if len(curves) else ())


def _records(results: Results) -> Iterator[dict[str, Any]]:
    """A pose each: of a camera from so many views, with targets known exactly or as calibrated."""
    for key, result in results.items():
        view, _, camera = key.partition("-")
        if view == "drawn":
            for entry in result["entries"]:
                about = {"view": camera, "camera": "drawn", "film": "drawn", "targets": "calibrated"}
                yield {**about, "views": VIEWS_USED, "common_px": np.nan, "scatter_px": np.nan, **_named(entry)}
            continue
        for film, found in result.items():
            for views, by_targets in found["counts"].items():
                for targets, entry in by_targets.items():
                    about = {"view": view, "camera": camera or key, "film": film, "targets": targets}
                    centres = {name: found[name] for name in ("common_px", "scatter_px")}
                    yield {**about, "views": int(views), **centres, **_named(entry)}


def _named(entry: Result) -> Result:
    found = {what: dict(zip(NAMES, entry[what], strict=True)) for what in ("error", "sigma")}
    correlation = {a: dict(zip(NAMES, row, strict=True)) for a, row in zip(NAMES, entry["correlation"], strict=True)}
    return {**found, "correlation": correlation, "chi_square": entry["chi_square"]}


def _of(cameras: pd.DataFrame, view: str, targets: str) -> pd.DataFrame:
    return cameras[(cameras["view"] == view) & (cameras["targets"] == targets)]


def _of_thesis_camera(cameras: pd.DataFrame) -> "pd.Series[float]":
    """Return the means of seed 0, at the place of the thesis' camera."""
    return cameras[cameras["camera"] == "0"].mean(numeric_only=True)


def _beside_the_thesis(cameras: pd.DataFrame, number: str) -> str:
    """Correlations and standard deviations of the thesis' camera, errors of all; the thesis' in brackets."""
    own, (error, sigma) = _of_thesis_camera(cameras), _printed(number)
    ours, claimed = (cameras[names].pow(2).mean().pow(0.5) for names in (_ERROR, _SIGMA))
    rows = [
        _row(f"correlation {name}", (own[f"correlation.{name}.{other}"] for other in NAMES), [3] * 6, below, ".3f")
        for name, below in zip(NAMES[1:], THESIS_TABLES[number]["correlation"], strict=True)
    ]
    rows.append(_row("standard deviation", own[_SIGMA], _DIGITS, sigma, "g"))
    rows.append(_row("error", ours, _DIGITS, error, "g"))
    rows.append(_row("error / standard deviation", ours.to_numpy() / claimed.to_numpy(), [2] * 6, error / sigma, ".1f"))
    return table(_HEAD, rows)


def _far26_table(own: "pd.Series[float]") -> str:
    error, sigma = _printed("21")
    rows = (("error", _ERROR, error), ("standard deviation", _SIGMA, sigma))
    return table(_HEAD, [_row(name, own[names], _DIGITS, theirs, "g") for name, names, theirs in rows])


def _printed(number: str) -> tuple[Array, Array]:
    """Errors and standard deviations of a table of the thesis; the error of R1 is not known."""
    return np.array(THESIS_TABLES[number].get("error", [np.nan] * 6)), np.array(THESIS_TABLES[number]["sigma"])


def _worst(number: str) -> float:
    """Return the largest ratio of the thesis' errors to their standard deviations."""
    error, sigma = _printed(number)
    return float(np.max(error / sigma))


def _row(name: str, ours: Iterable[float], digits: Iterable[int], theirs: Iterable[float], form: str) -> list[str]:
    """As many cells as the thesis has values, of six; what rounds to nothing has no sign."""
    cells = [
        fixed(round(x, d) + 0.0, d) + ("" if np.isnan(printed) else f" ({printed:{form}})")
        for x, d, printed in zip(ours, digits, theirs, strict=False)
    ]
    return [name, *cells, *[""] * (6 - len(cells))]


def _honest(cameras: pd.DataFrame) -> pd.DataFrame:
    """Mean of chi-square over its six degrees of freedom, the band that has 95 % of it, and the largest error."""
    over = np.abs(cameras[_ERROR].to_numpy() / cameras[_SIGMA].to_numpy())
    found = cameras.assign(largest=over.max(axis=1)).groupby(["view", "film", "targets"])
    found = found.agg(cameras=("views", "size"), chi=("chi_square", "mean"), largest=("largest", "max"))
    found = found.reindex([(view, *case) for view in VIEWS for case in _CASES])
    low, high = (gammaincinv(3.0 * found["cameras"], p) / (3.0 * found["cameras"]) for p in (0.025, 0.975))
    return found.assign(chi=found["chi"] / 6.0, low=low, high=high)


def _honest_table(honest: pd.DataFrame) -> str:
    columns = {
        "cameras": "cameras",
        "chi": "chi-square / 6",
        "low": "95 % of 1 from",
        "high": "to",
        "largest": "largest error / standard deviation",
    }
    ours = honest.set_axis([f"{view}, {case}" for view in VIEWS for case in _CASES.values()])
    thesis = {
        f"{view}, thesis, table {number}": (1, _worst(number)) for view, number in (("far", "21"), ("near", "22"))
    }
    both = pd.concat([ours, pd.DataFrame.from_dict(thesis, "index", columns=["cameras", "largest"])])
    digits = dict(zip(columns.values(), (0, 3, 2, 2, 1), strict=True))
    return markdown(both[list(columns)].rename(columns=columns).reset_index(names=""), digits)


def _curves(figure: pd.DataFrame) -> pd.DataFrame:
    """Errors and standard deviations of the position, mm, by view and number of views."""
    lengths = {
        what: np.linalg.norm(figure[names[:3]], axis=1) for what, names in (("error", _ERROR), ("sigma", _SIGMA))
    }
    found = figure.assign(**lengths)
    curves = pd.DataFrame(
        {
            f"{targets} {what}": found[found["targets"] == targets].groupby(["view", "views"])[what].agg(rms)
            for targets in ("exact", "calibrated")
            for what in lengths
        }
    )
    # what is claimed is of floor and noise: what of it is noise, were the floor none
    views = curves.index.get_level_values("views")
    scatter = curves.index.get_level_values("view").map(figure.groupby("view")["scatter_px"].agg(rms).to_dict())
    whole = np.hypot(TARGET_SIGMA_PX, scatter / np.sqrt(figure["views"].max()))
    last = curves.groupby("view")["exact sigma"].transform("last")
    return curves.assign(independent=last / whole * scatter / np.sqrt(views))


def _gain_table(first: pd.DataFrame, last: pd.DataFrame, few: float, many: float) -> str:
    names = {
        "exact error": "targets exact",
        "calibrated error": "targets calibrated",
        "independent": "from noise alone, were views independent",
    }
    ends = {f"from {fixed(few, 0)} view, mm": first, f"from {fixed(many, 0)} views, mm": last}
    rows = [
        [view, label, *(end.loc[view, name] for end in ends.values())]
        for view in VIEWS
        for name, label in names.items()
    ]
    return markdown(pd.DataFrame(rows, columns=["camera", "off by", *ends]), sparse=["camera"])


def _figure(curves: pd.DataFrame, far26: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        from matplotlib.ticker import StrMethodFormatter

        axes = canvas.subplots(1, 2, sharey=True)
        for ax, view in zip(axes, VIEWS, strict=True):
            ax.set(title=f"{view} camera", xlabel="views", xscale="log", yscale="log")
            line = curves[curves.index.get_level_values("view") == view].droplevel("view")
            for targets, colour in (("calibrated", "C1"), ("exact", "C0")):
                error = {"color": colour, "linestyle": "-", "marker": "o", "label": f"targets {targets}: error"}
                ax.plot(line.index, line[f"{targets} error"], **error)
                ax.plot(line.index, line[f"{targets} sigma"], color=colour, label="claimed", **THESIS)
            ax.plot(line.index, line["independent"], color="C2", label="were views independent", **BOUND)
            ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        if len(far26):
            length, look = np.linalg.norm(far26[_ERROR[:3]], axis=1), {"color": "C3", "marker": "D", "linestyle": ""}
            axes[0].plot(far26["views"], length, label="far26 (Blender): error", **look)
        axes[0].set_ylabel("position, mm")
        handles, labels = axes[0].get_legend_handles_labels()
        canvas.legend(handles, labels, loc="outside lower center", ncols=3, handlelength=2.4, columnspacing=1.6)

    return Drawing("poses-views", draw, (7.2, 3.6))
