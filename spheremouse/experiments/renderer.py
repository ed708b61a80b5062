"""Our renderer against the shared Blender recording: the same scene and attitudes, filmed by both.

Each frame of far26 is rendered anew from its description and truth. The default detector measures the discs in both
pictures; edges of discs are compared as they run from dark to light.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import assign
from spheremouse.ball.detect.appearance import Appearance, appearance
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import VISIBLE, DiscTruth, Truth
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Job, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.plot import BOUND, THESIS, plain_numbers
from spheremouse.experiments.kit.report import failures
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.film import Renderer, RenderOptions, Scene, default_scene

TITLE = "The renderer against Blender"

_ASKED = 0.05  # px RMS per axis between the two, for discs that both show whole
_MATCH = 3.0  # px
_RINGS = (0.0, 0.2, 0.4, 0.6, 0.7, 0.8, 0.9, 1.0)  # of the ball's radius in the picture
_AREAS = ((10.0, 30.0), (30.0, 60.0), (60.0, np.inf))  # px²
_STEP, _REACH = 0.1, 2.5  # px, of an edge's profile: cells, and how far to either side
_GREY = ("ours", "Blender")
_LINEAR = "Blender, linear light"


def jobs(request: Request) -> list[Job]:
    """A few frames of far26; nothing where it is not at hand."""
    if request.datasets is None:
        return []
    step, parts = (25, 1) if request.quick else (2, 3)
    path = str(request.datasets / "far26")
    return [
        Job(f"far26-{part}", compared, {"path": path, "first": part * step, "step": parts * step})
        for part in range(parts)
    ]


# ---- jobs ----


@dataclass(frozen=True, slots=True)
class _Recorded:
    """The attitudes of a recording, at its own stamps."""

    motion: Truth

    @property
    def seconds(self) -> float:
        """s, of the last frame."""
        return float(self.motion.stamp[-1])

    def attitude(self, t: Array) -> Array:
        """(n, 3, 3) of the nearest frames."""
        return self.motion.attitude[self._nearest(t)]

    def rate(self, t: Array) -> Array:
        """(n, 3) rad/s."""
        return self.motion.rate[self._nearest(t)]

    def _nearest(self, t: Array) -> NDArray[np.intp]:
        return np.abs(self.motion.stamp[None] - np.asarray(t)[:, None]).argmin(axis=1)


def same_scene(film: kit.Film) -> Scene:
    """The reference geometry with the recording's camera, targets and discs."""
    rig, truth = film.rig, film.truth
    assert truth.pose is not None, "the recording knows where its camera stands"
    assert truth.directions is not None, "and how its discs lie"
    scene = default_scene(len(truth.directions), "far")
    return replace(
        scene,
        camera=rig.camera,
        pose=truth.pose,
        ball_radius=rig.ball.radius,
        disc_directions=truth.directions,
        disc_radius=rig.disc_radius,
        targets=rig.targets,
    )


def compared(path: str, first: int, step: int) -> Result:
    """Every `step`th frame from `first` on, filmed by both: discs (a row each), edges, levels."""
    film = kit.taken(Path(path))
    scene = same_scene(film)
    motion, discs = film.truth.motion, film.truth.discs
    assert motion is not None, "the recording knows its motion"
    assert discs is not None, "and where its discs are"
    renderer, profile = Renderer(scene, RenderOptions()), _Recorded(motion)
    rig = film.rig
    detector = disc_detector(kit.settings_of().discs, rig, scene.pose)
    rows: list[list[float]] = []
    edges = {name: np.zeros((2, round(2 * _REACH / _STEP))) for name in (*_GREY, _LINEAR)}
    levels: list[list[float]] = []
    geometry: list[list[float]] = []
    for k in range(first, len(film.frames), step):
        shot = renderer.frame(profile, float(motion.stamp[k]), k, np.random.default_rng(k))
        pictures = (shot.frame.image, film.frames[k].image)
        own, whole = _whole_in_both(shot.discs, discs.of_frame(k))
        apart = [
            np.linalg.norm(a - b, axis=1) for a, b in ((own.centre, whole.centre), (own.blob_centre, whole.blob_centre))
        ]
        geometry += np.stack([*apart, np.abs(own.area / whole.area - 1.0)], axis=1).tolist()
        directions = scene.disc_directions[whole.disc] @ motion.attitude[k].T
        looks = appearance(directions, rig, scene.pose)
        found = [_measured(detector.detect(p), whole.centre) for p in pictures]
        radius = np.linalg.norm(_from_middle(whole.centre, rig, scene), axis=1)
        for i in range(len(whole)):
            rows.append([radius[i], whole.area[i], *whole.centre[i], *found[0][i], *found[1][i]])
        for name, picture in zip(_GREY, pictures, strict=True):
            _add_edges(edges[name], picture, looks)
        _add_edges(edges[_LINEAR], _light(pictures[1]), looks)
        levels += _levels(pictures, looks)
    return {
        "frames": len(range(first, len(film.frames), step)),
        "rows": [[None if np.isnan(x) else round(float(x), 5) for x in row] for row in rows],
        "edges": {name: edges[name].tolist() for name in edges},
        "geometry": np.max(geometry, axis=0).tolist() if geometry else [],
        "levels": np.round(levels, 2).tolist(),
    }


def _whole_in_both(ours: DiscTruth, theirs: DiscTruth) -> tuple[DiscTruth, DiscTruth]:
    """Discs that both say are wholly visible, as each has them."""
    keep = (theirs.state == VISIBLE) & (theirs.area >= _AREAS[0][0])
    _, a, b = np.intersect1d(ours.disc, np.where(keep, theirs.disc, -1), return_indices=True)
    shown = ours.state[a] == VISIBLE
    a, b = a[shown], b[shown]
    own, whole = (DiscTruth(*(getattr(t, n)[k] for n in DiscTruth.__slots__)) for t, k in ((ours, a), (theirs, b)))
    return own, whole


def _measured(found: Detections, true: Array) -> Array:
    """Centres at the discs and their claimed standard deviation, (n, 3) px; nan where there is none."""
    at = np.full((len(true), 3), np.nan)
    i, j = assign(np.linalg.norm(true[:, None] - found.centre[None], axis=2), _MATCH)
    at[i, :2] = found.centre[j]
    at[i, 2] = np.sqrt(0.5 * np.trace(found.covariance[j], axis1=1, axis2=2))
    return at


def _light(picture: Any) -> Array:
    """Grey values of a picture as light, 0..255: the curve of sRGB (IEC 61966-2-1) undone."""
    x = picture / 255.0
    return 255.0 * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _from_middle(centre: Array, rig: Rig, scene: Scene) -> Array:
    """Offsets from the picture of the ball's centre, over the radius of its outline; the camera looks at it."""
    distance = float(np.linalg.norm(scene.pose.position))
    limb = rig.ball.radius / np.sqrt(distance**2 - rig.ball.radius**2)
    return (centre - (rig.camera.cx, rig.camera.cy)) / (limb * np.array([rig.camera.fx, rig.camera.fy]))


def _cells(look: Appearance, i: int, shape: tuple[int, int], reach: float) -> tuple[Array, NDArray[np.intp]] | None:
    """Signed distance (k,) px of pixels from a disc's edge, inside negative, and their rows and columns (2, k)."""
    middle, S = look.centroid[i], look.shape[i]
    half = np.sqrt(np.diag(S)) + reach
    low, high = np.floor(middle - half).astype(int), np.ceil(middle + half).astype(int) + 1
    if np.any(low < 0) or high[0] > shape[1] or high[1] > shape[0]:
        return None
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    d = np.stack([u.ravel(), v.ravel()], axis=1) - middle
    q = np.sqrt(np.einsum("ni,ij,nj->n", d, np.linalg.inv(S), d))
    slope = np.linalg.norm(d @ np.linalg.inv(S), axis=1) / np.maximum(q, 1e-9)
    return (q - 1.0) / np.maximum(slope, 1e-9), np.stack([v.ravel(), u.ravel()])


def _grey(picture: Any, at: NDArray[np.intp]) -> Array:
    return picture[at[0], at[1]].astype(float).mean(axis=1)


def _add_edges(edges: Array, picture: Any, look: Appearance) -> None:
    """Adds to sums and counts (2, cells) the darkness of pixels by their distance from the edges of large discs."""
    for i in np.flatnonzero(look.whole & (look.area >= 60.0)):
        cells = _cells(look, int(i), picture.shape[:2], _REACH + 1.5)
        if cells is None:
            continue
        distance, at = cells
        grey = _grey(picture, at)
        inside, outside = grey[distance < -_REACH], grey[(distance > _REACH) & (distance < _REACH + 1.5)]
        if len(inside) < 4 or np.ptp(outside) > 25.0:  # a strut, or a highlight, is near
            continue
        near = np.abs(distance) < _REACH
        share = (grey[near] - inside.mean()) / (outside.mean() - inside.mean())
        cell = ((distance[near] + _REACH) / _STEP).astype(int)
        np.add.at(edges[0], cell, share)
        np.add.at(edges[1], cell, 1.0)


def _levels(pictures: Sequence[Any], look: Appearance) -> list[list[float]]:
    """Grey values in and around large discs: inside ours, inside theirs, around ours, around theirs."""
    found = []
    for i in np.flatnonzero(look.whole & (look.area >= 60.0)):
        cells = _cells(look, int(i), pictures[0].shape[:2], 3.0)
        if cells is None:
            continue
        distance, at = cells
        greys = [_grey(p, at) for p in pictures]
        inside, outside = distance < -2.0, (distance > 1.5) & (distance < 3.0)
        if np.any(inside):
            found.append([float(np.median(g[w])) for w in (inside, outside) for g in greys])
    return found


# ---- for a reader ----

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
    edges = {name: _profile(np.sum([r["edges"][name] for r in good], axis=0)) for name in (*_GREY, _LINEAR)}
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
        "rings": _by(both, 0, tuple(pairwise(_RINGS))),
        "areas": _by(both, 1, _AREAS),
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
        f"shown) its centres differ by {whole:.3f} px RMS per axis; {_ASKED:g} px are asked. "
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
    if numbers["difference_px"] <= _ASKED:
        return "It is reached."
    reached = [a for a in numbers["areas"] if a["between"] <= _ASKED]
    missed = [a for a in numbers["areas"] if a["between"] > _ASKED]
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
    at = (full + 0.5) * _STEP - _REACH
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
    values = [blur[n] for n in (*_GREY, _LINEAR)] + [middle[n] for n in (*_GREY, _LINEAR)]
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
    left.axhline(_ASKED, color="C3", **THESIS)
    left.annotate("asked", (0.02, _ASKED), (0, 3), textcoords="offset points", color="C3")
    left.set(
        xlabel="place on the ball's picture (0 middle, 1 limb)",
        ylabel="centres, px RMS per axis",
        yscale="log",
        xlim=(0, 1),
    )
    plain_numbers(left.yaxis)
    left.legend(loc="upper center")
    for name, colour in zip(_GREY, ("C2", "C1"), strict=True):
        right.plot(*edges[name], color=colour, label=name)
    right.plot(*edges[_LINEAR], color="C1", label=_LINEAR, **BOUND)
    right.set(xlabel="distance from the edge, px (inside negative)", ylabel="grey value, 0 disc, 1 ball")
    right.legend(loc="lower right")
