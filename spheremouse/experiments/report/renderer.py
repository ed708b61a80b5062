"""What the experiments on the renderer are said to show: tables, figures and sentences."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.renderer import AREAS, ASKED, GREY, LINEAR, REACH, RINGS, STEP
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND, THESIS, plain_numbers
from spheremouse.geometry.rotation import Array

_WORST = 3  # discs


def section(request: Request, results: Results) -> Section:
    """Centres, edges, levels."""
    if request.datasets is None:
        return Section(("The shared Blender recording was not at hand: nothing to compare the renderer with.",), {})
    good = [r for r in results.values() if "error" not in r]
    failed = failures(results)
    said = ["What failed:\n\n" + "\n".join(failed)] if failed else []
    if not good:
        return Section(("No frame could be compared.", *said), {})
    rows = np.array([[np.nan if x is None else x for x in row] for r in good for row in r["rows"]]).reshape(-1, 10)
    edges = {name: _profile(np.sum([r["edges"][name] for r in good], axis=0)) for name in (*GREY, LINEAR)}
    blur = {name: blur_of(*edges[name]) for name in edges}
    middle = {name: middle_of(*edges[name]) for name in edges}
    geometry = [r["geometry"] for r in good if r["geometry"]]
    levels = np.array([level for r in good for level in r["levels"]]).reshape(-1, 4)
    both = rows[np.all(np.isfinite(rows), axis=1)]
    frames = sum(r["frames"] for r in good)
    whole = _rms(both[:, 4:6] - both[:, 7:9])
    numbers: dict[str, Any] = {
        "frames": frames,
        "discs": len(both),
        "difference_px": whole,
        "blur_px": blur,
        "edge_px": middle,
        "geometry": np.max(geometry, axis=0).tolist() if geometry else None,
        "rings": _by(both, 0, tuple(pairwise(RINGS))),
        "areas": _by(both, 1, AREAS),
    }
    head = (
        "discs",
        "number",
        "ours - Blender, px",
        "ours - truth, px",
        "Blender - truth, px",
        "median difference per axis, px",
        "claimed by the detector, px",
    )
    table = Table(
        head, tuple(_row(entry) for entry in [*numbers["areas"], _entry("all", both)]), "Centres, RMS per axis"
    )
    parts: list[str | Table | Figure] = [
        f"{frames} frames of far26 were rendered anew from its description and its true attitudes. Over the "
        f"{len(both)} discs that both pictures show whole and the default detector finds in both ({len(rows)} are "
        f"shown) its centres differ by {whole:.3f} px RMS per axis; {ASKED:g} px are asked. "
        f"{_verdict(numbers, both)}",
        _about_geometry(numbers["geometry"]),
        table,
        Figure(
            "renderer",
            "Left: differences of the discs' centres (RMS per axis) against their place on the ball's picture. Right: "
            "how the edge of a disc runs from dark (0) to light (1), by the distance of pixels from the projected "
            "edge.",
            lambda figure: _draw(figure, numbers["rings"], edges),
            (7.2, 3.4),
        ),
        _about_edges(blur, middle, levels),
    ]
    return Section((*(p for p in parts if p), *said), numbers)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x)))) if x.size else float("nan")


def _entry(name: str, rows: Array) -> Result:
    true, ours, theirs = rows[:, 2:4], rows[:, 4:6], rows[:, 7:9]
    numbers = {
        "between": _rms(ours - theirs),
        "ours": _rms(ours - true),
        "Blender": _rms(theirs - true),
        "half": float(np.median(np.abs(ours - theirs))) if len(rows) else float("nan"),
        "claimed": _rms(rows[:, 9]),
    }
    return {"name": name, "discs": len(rows), **numbers}


def _by(rows: Array, column: int, bounds: Sequence[tuple[float, float]]) -> list[Result]:
    """Entries of the discs between bounds; empty ones are left out."""
    found = []
    for low, high in bounds:
        here = rows[(rows[:, column] >= low) & (rows[:, column] < high)]
        if len(here):
            name = f"{low:g} to {high:g} px²" if np.isfinite(high) else f"above {low:g} px²"
            found.append({**_entry(name, here), "low": low, "high": min(high, 1e9)})
    return found


def _row(entry: Result) -> tuple[str, ...]:
    return (
        entry["name"],
        str(entry["discs"]),
        *(f"{entry[k]:.3f}" for k in ("between", "ours", "Blender", "half", "claimed")),
    )


def _verdict(numbers: dict[str, Any], rows: Array) -> str:
    """Where it is reached, and where not."""
    if not numbers["areas"]:
        return "No disc was found in both."
    if numbers["difference_px"] <= ASKED:
        return "It is reached."
    reached = [a for a in numbers["areas"] if a["between"] <= ASKED]
    missed = [a for a in numbers["areas"] if a["between"] > ASKED]
    return (
        "It is missed for discs of "
        + ", ".join(f"{a['name']} ({a['between']:.3f} px)" for a in missed)
        + (", reached for those " + ", ".join(a["name"] for a in reached) if reached else "")
        + f". {_of_missed(rows, missed)}"
    )


def _of_missed(rows: Array, missed: list[Result]) -> str:
    """Where the discs of such areas are, how many of them make the difference, and who is off the truth."""
    chosen = [(rows[:, 1] >= a["low"]) & (rows[:, 1] < a["high"]) for a in missed]
    here = rows[np.any(chosen, axis=0)]
    squares = np.sort(np.sum((here[:, 4:6] - here[:, 7:9]) ** 2, axis=1))[::-1]
    worst = 100.0 * float(squares[:_WORST].sum() / squares.sum())
    ours, theirs = (_rms(here[:, k : k + 2] - here[:, 2:4]) for k in (4, 7))
    most = f"the {_WORST} worst of them make {worst:.0f} % of the squared sum; " if len(here) > _WORST else ""
    return (
        f"The {len(here)} discs of the missed classes lie at {here[:, 0].min():.2f} of the way from the middle of the "
        f"ball's picture to its limb and beyond (median {np.median(here[:, 0]):.2f}); {most}Blender's centres are off "
        f"the truth by {theirs:.3f} px there, ours by {ours:.3f} px."
    )


def _about_geometry(geometry: list[float] | None) -> str:
    if geometry is None:
        return ""
    return (
        f"The geometry is the same: projected centres differ by at most {geometry[0]:.4f} px, centroids of projected "
        f"discs by {geometry[1]:.3f} px, their areas by {100 * geometry[2]:.1f} %."
    )


def _profile(sums: Array) -> tuple[list[float], list[float]]:
    """Distances (px) and mean shares of cells in which there are pixels."""
    full = np.flatnonzero(sums[1] > 0)
    at = (full + 0.5) * STEP - REACH
    return at.tolist(), (sums[0][full] / sums[1][full]).tolist()


def blur_of(at: Sequence[float], share: Sequence[float]) -> float | None:
    """Standard deviation (px) of the blur that makes such an edge: of its derivative; None of too few cells."""
    x, y = np.array(at), np.clip(np.array(share), 0.0, 1.0)
    if len(x) < 10:
        return None
    mass, middle = np.diff(y), 0.5 * (x[1:] + x[:-1])
    mass = np.where(np.abs(middle) < 2.0, np.maximum(mass, 0.0), 0.0)
    if mass.sum() <= 0.0:
        return None
    mean = float(mass @ middle / mass.sum())
    return float(np.sqrt(mass @ (middle - mean) ** 2 / mass.sum()))


def middle_of(at: Sequence[float], share: Sequence[float]) -> float | None:
    """Where an edge crosses one half, px; None where it does not."""
    x, y = np.array(at), np.array(share)
    cross = np.flatnonzero((y[:-1] < 0.5) & (y[1:] >= 0.5))
    if len(cross) == 0:
        return None
    k = cross[len(cross) // 2]
    return float(x[k] + (0.5 - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k]))


def _about_edges(blur: dict[str, float | None], middle: dict[str, float | None], levels: Array) -> str:
    said = []
    values = [blur[n] for n in (*GREY, LINEAR)] + [middle[n] for n in (*GREY, LINEAR)]
    if all(v is not None for v in values):
        a, b, f, c, d, e = (float(v or 0.0) for v in values)
        said.append(
            f"Edges are blurred by {a:.2f} px in ours and {b:.2f} px in Blender's pictures (standard deviation; a box "
            f"of one pixel has {1 / np.sqrt(12):.2f} px). Half way between dark and light lie pixels at {c:+.2f} px in "
            f"ours, at {d:+.2f} px in Blender's: it mixes light and then applies the curve of sRGB, which makes half "
            f"covered pixels lighter. With the curve undone that is {e:+.2f} px, and the blur {f:.2f} px."
        )
    if len(levels):
        m = np.median(levels, axis=0)
        said.append(
            f"Grey values are {m[0]:.0f} and {m[1]:.0f} in discs, {m[2]:.0f} and {m[3]:.0f} around them (medians, ours "
            "and Blender's)."
        )
    return " ".join(said)


def _draw(figure: Any, rings: list[Result], edges: dict[str, tuple[list[float], list[float]]]) -> None:
    left, right = figure.subplots(1, 2)
    at = [0.5 * (r["low"] + r["high"]) for r in rings]
    for key, label, colour, mark in (
        ("between", "ours - Blender", "C0", "o"),
        ("ours", "ours - truth", "C2", "s"),
        ("Blender", "Blender - truth", "C1", "D"),
    ):
        left.plot(at, [r[key] for r in rings], color=colour, marker=mark, label=label)
    left.axhline(ASKED, color="C3", **THESIS)
    left.annotate("asked", (0.02, ASKED), (0, 3), textcoords="offset points", color="C3")
    left.set(
        xlabel="place on the ball's picture (0 middle, 1 limb)",
        ylabel="centres, px RMS per axis",
        yscale="log",
        xlim=(0, 1),
    )
    plain_numbers(left.yaxis)
    left.legend(loc="upper center")
    for name, colour in zip(GREY, ("C2", "C1"), strict=True):
        right.plot(*edges[name], color=colour, label=name)
    right.plot(*edges[LINEAR], color="C1", label=LINEAR, **BOUND)
    right.set(xlabel="distance from the edge, px (inside negative)", ylabel="grey value, 0 disc, 1 ball")
    right.legend(loc="lower right")
