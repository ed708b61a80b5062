"""Numbers and figures of the page on the renderer."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.job import Results
from experiments.renderer import AREAS, ASKED, GREY, LINEAR, REACH, RINGS, STEP
from experiments.report.frames import markdown
from experiments.report.page import Page
from experiments.report.plot import BOUND, THESIS, Drawing, plain_numbers

LARGE = ("rows", "levels", "edges")  # of each disc and edge
_DISC = ["place", "area", "true u", "true v", "ours u", "ours v", "", "Blender u", "Blender v", "claimed"]
_LEVELS = ["ours_inside", "Blender_inside", "ours_around", "Blender_around"]
_COLUMNS = {
    "number": "number",
    "difference": "ours - Blender, px",
    "ours": "ours - truth, px",
    "Blender": "Blender - truth, px",
    "half": "median difference per axis, px",
    "claimed": "claimed by the detector, px",
}
_COLOURS = {"difference": ("C0", "o"), "ours": ("C2", "s"), "Blender": ("C1", "D")}
_FEW = 3  # discs, the worst


def page(results: Results) -> Page:
    """Centres, edges, levels."""
    done = results.values()
    discs = pd.DataFrame([disc for r in done for disc in r["rows"]], columns=_DISC, dtype=float)
    levels = pd.DataFrame([level for r in done for level in r["levels"]], columns=_LEVELS, dtype=float)
    apart = [r["geometry"] for r in done if r["geometry"]]
    errors, edges = _errors(discs), _edges(results)
    least, low, bound = (area for area, _ in AREAS)
    names = [f"{least:g} to {low:g} px²", f"{low:g} to {bound:g} px²", f"above {bound:g} px²"]
    by_area, whole = _classes(errors, "area", [least, low, bound, np.inf], names), _classes(errors, "area", [0, np.inf])
    values = {
        "frames": sum(r["frames"] for r in done),
        "seen": len(discs),
        "found": len(discs.dropna()),
        "asked": ASKED,
        "area": {"least": least, "low": low, "bound": bound},
        **dict(zip(("small", "middling", "large"), by_area.to_dict("records"), strict=True)),
        "every": whole.loc["all"].to_dict(),
        "near_limb": _about(errors[errors["area"] < bound]),
        "few": _FEW,
        "geometry": pd.DataFrame(apart, columns=["centre", "centroid", "area"]).max().to_dict(),
        "centres": _table(pd.concat([by_area, whole])),
        "blur": {name: blur_of(edges[name]) for name in edges},
        "edge": {name: middle_of(edges[name]) for name in edges},
        "linear": LINEAR,
        "box": 1.0 / np.sqrt(12.0),
        "levels": levels.median().to_dict(),
    }
    by_place = _classes(errors, "place", RINGS, [0.5 * (a + b) for a, b in pairwise(RINGS)])
    return Page(values, (Drawing("renderer", lambda canvas: _draw(canvas, by_place, edges)),))


def _errors(discs: pd.DataFrame) -> pd.DataFrame:
    """Two rows, an axis each, for each disc that is found in both pictures: errors and differences of centres, px."""
    found = discs.dropna()
    true, ours, theirs = (found[[f"{who} u", f"{who} v"]].to_numpy().ravel() for who in ("true", *GREY))
    both = found.loc[np.repeat(found.index, 2), ["place", "area", "claimed"]]
    return both.assign(difference=ours - theirs, ours=ours - true, Blender=theirs - true)


def _classes(errors: pd.DataFrame, by: str, bounds: Sequence[float], names: Sequence[Any] = ("all",)) -> pd.DataFrame:
    """RMS per axis of the discs between bounds, their number, and the median; nan where there are none."""
    classes = pd.cut(errors[by], list(bounds), right=False, labels=list(names))
    squares = (errors[["difference", "ours", "Blender", "claimed"]] ** 2).groupby(classes, observed=False)
    half = errors["difference"].abs().groupby(classes, observed=False).median()
    return (squares.mean() ** 0.5).assign(number=squares.size() / 2, half=half)


def _about(errors: pd.DataFrame) -> dict[Any, float]:
    """Errors of discs, where they lie, and what share of the squared differences the worst few make."""
    squares = (errors["difference"] ** 2).groupby(level=0).sum()
    return {
        **_classes(errors, "area", [0, np.inf]).loc["all"].to_dict(),
        "least": errors["place"].min(),
        "median": errors["place"].median(),
        "share": (squares / squares.sum()).nlargest(_FEW).sum(min_count=1),
    }


def _table(classes: pd.DataFrame) -> str:
    made = classes[list(_COLUMNS)].rename(columns=_COLUMNS).reset_index(names="discs")
    return markdown(made, dict.fromkeys([name for name in _COLUMNS.values() if name != "number"], 3))


def _edges(results: Results) -> pd.DataFrame:
    """How light pixels are (0 disc, 1 ball) by their distance (px) from an edge; nan where there are none."""
    sums = {name: np.sum([r["edges"][name] for r in results.values()], axis=0) for name in (*GREY, LINEAR)}
    lights = {name: light / np.where(pixels > 0, pixels, np.nan) for name, (light, pixels) in sums.items()}
    return pd.DataFrame(lights, index=(np.arange(round(2 * REACH / STEP)) + 0.5) * STEP - REACH)


def blur_of(edge: "pd.Series[float]") -> float:
    """Standard deviation (px) of the blur that makes such an edge: of its derivative; nan of too few cells."""
    edge = edge.dropna().clip(0.0, 1.0)
    x = edge.index.to_numpy(float)
    at = 0.5 * (x[1:] + x[:-1])
    mass = np.where(np.abs(at) < 2.0, np.maximum(np.diff(edge), 0.0), 0.0)
    if len(x) < 10 or not np.any(mass):
        return np.nan
    return float(np.sqrt(np.average((at - np.average(at, weights=mass)) ** 2, weights=mass)))


def middle_of(edge: "pd.Series[float]") -> float:
    """Where an edge crosses one half, px; nan where it does not."""
    edge = edge.dropna()
    x, y = edge.index.to_numpy(float), edge.to_numpy()
    cross = np.flatnonzero((y[:-1] < 0.5) & (y[1:] >= 0.5))
    if len(cross) == 0:
        return np.nan
    k = cross[len(cross) // 2]
    return float(x[k] + (0.5 - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k]))


def _draw(canvas: Any, by_place: pd.DataFrame, edges: pd.DataFrame) -> None:
    left, right = canvas.subplots(1, 2)
    known = by_place.dropna()
    for name, (colour, mark) in _COLOURS.items():
        label = _COLUMNS[name].removesuffix(", px")
        left.plot(known.index.to_numpy(float), known[name], color=colour, marker=mark, label=label)
    left.axhline(ASKED, color="C3", **THESIS)
    left.annotate("asked", (0.02, ASKED), (0, 3), textcoords="offset points", color="C3")
    place = "place on the ball's picture (0 middle, 1 limb)"
    left.set(xlabel=place, ylabel="centres, px RMS per axis", yscale="log", xlim=(0, 1))
    plain_numbers(left.yaxis)
    left.legend(loc="upper center")
    looks: list[dict[str, Any]] = [{"color": "C2"}, {"color": "C1"}, {"color": "C1", **BOUND}]
    for name, look in zip((*GREY, LINEAR), looks, strict=True):
        edge = edges[name].dropna()
        right.plot(edge.index, edge, label=name, **look)
    right.set(xlabel="distance from the edge, px (inside negative)", ylabel="grey value, 0 disc, 1 ball")
    right.legend(loc="lower right")
