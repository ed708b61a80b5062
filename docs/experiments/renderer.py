"""Our renderer against the shared Blender recording: the same scene and attitudes, filmed by both.

Each frame of far26 is rendered again from its description and truth. The default detector measures the discs in both
pictures; edges of discs are compared as they run from dark to light. Blender mixes light and then applies the curve of
sRGB, which makes half covered pixels lighter.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Table
from spheremouse.ball.detect.appearance import Appearance, appearance
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.truth import VISIBLE, DiscTruth, Truth
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.film import Renderer, RenderOptions, Scene, default_scene

TITLE = "The renderer against Blender"
_MATCH = 3.0  # px
AREAS = ((10.0, 30.0), (30.0, 60.0), (60.0, np.inf))  # px²
STEP, REACH = 0.1, 2.5  # px, of an edge's profile: cells, and how far to either side
GREY = ("ours", "Blender")
LINEAR = "Blender, linear light"


def jobs(request: Request) -> list[Job]:
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
        return float(self.motion.stamp[-1])

    def attitude(self, t: Array) -> Array:
        return self.motion.attitude[self._nearest(t)]

    def rate(self, t: Array) -> Array:
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
        scene, camera=rig.camera, pose=truth.pose, ball_radius=rig.ball.radius, disc_directions=truth.directions,
        disc_radius=rig.disc_radius, targets=rig.targets
    )  # fmt: skip


def compared(path: str, first: int, step: int) -> Result:
    """Every `step`th frame from `first` on, filmed by both: discs (a row each), edges."""
    film = kit.film_from_dataset(Path(path))
    scene = same_scene(film)
    motion, discs = film.truth.motion, film.truth.discs
    assert motion is not None, "the recording knows its motion"
    assert discs is not None, "and where its discs are"
    renderer, profile = Renderer(scene, RenderOptions()), _Recorded(motion)
    rig = film.rig
    detector = disc_detector(kit.settings_of().discs, rig, scene.pose)
    rows: list[list[float]] = []
    edges = {name: np.zeros((2, round(2 * REACH / STEP))) for name in (*GREY, LINEAR)}
    geometry: list[list[float]] = []
    for k in range(first, len(film.frames), step):
        shot = renderer.frame(profile, float(motion.stamp[k]), k, np.random.default_rng(k))
        pictures = (shot.frame.image, film.frames[k].image)
        own, whole = whole_in_both(shot.discs, discs.of_frame(k))
        apart = [
            np.linalg.norm(a - b, axis=1) for a, b in ((own.centre, whole.centre), (own.blob_centre, whole.blob_centre))
        ]
        geometry += np.stack([*apart, np.abs(own.area / whole.area - 1.0)], axis=1).tolist()
        directions = scene.disc_directions[whole.disc] @ motion.attitude[k].T
        looks = appearance(directions, rig, scene.pose)
        found = [measured_centres(detector.detect(p), whole.centre) for p in pictures]
        for i in range(len(whole)):
            rows.append([whole.area[i], *whole.centre[i], *found[0][i], *found[1][i]])
        for name, picture in zip(GREY, pictures, strict=True):
            add_edges(edges[name], picture, looks)
        add_edges(edges[LINEAR], linear_light(pictures[1]), looks)
    return {
        "frames": len(range(first, len(film.frames), step)),
        "rows": [[None if np.isnan(x) else round(float(x), 5) for x in row] for row in rows],
        "edges": {name: edges[name].tolist() for name in edges},
        "geometry": np.max(geometry, axis=0).tolist() if geometry else [],
    }


def whole_in_both(ours: DiscTruth, theirs: DiscTruth) -> tuple[DiscTruth, DiscTruth]:
    """Discs that both say are wholly visible, as each has them."""
    keep = (theirs.state == VISIBLE) & (theirs.area >= AREAS[0][0])
    _, a, b = np.intersect1d(ours.disc, np.where(keep, theirs.disc, -1), return_indices=True)
    shown = ours.state[a] == VISIBLE
    a, b = a[shown], b[shown]
    own, whole = (DiscTruth(*(getattr(t, n)[k] for n in DiscTruth.__slots__)) for t, k in ((ours, a), (theirs, b)))
    return own, whole


def measured_centres(found: Detections, true: Array) -> Array:
    """Centres at the discs and their claimed standard deviation, (n, 3) px; nan where there is none."""
    at = np.full((len(true), 3), np.nan)
    i, j = assign(np.linalg.norm(true[:, None] - found.centre[None], axis=2), _MATCH)
    at[i, :2] = found.centre[j]
    at[i, 2] = np.sqrt(0.5 * np.trace(found.covariance[j], axis1=1, axis2=2))
    return at


def linear_light(picture: Any) -> Array:
    """Grey values of a picture as light, 0..255: the curve of sRGB (IEC 61966-2-1) undone."""
    x = picture / 255.0
    return 255.0 * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


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


def add_edges(edges: Array, picture: Any, look: Appearance) -> None:
    """Adds to sums and counts (2, cells) the darkness of pixels by their distance from the edges of large discs."""
    for i in np.flatnonzero(look.whole & (look.area >= 60.0)):
        cells = _cells(look, int(i), picture.shape[:2], REACH + 1.5)
        if cells is None:
            continue
        distance, at = cells
        grey = _grey(picture, at)
        inside, outside = grey[distance < -REACH], grey[(distance > REACH) & (distance < REACH + 1.5)]
        if len(inside) < 4 or np.ptp(outside) > 25.0:  # a strut, or a highlight, is near
            continue
        near = np.abs(distance) < REACH
        share = (grey[near] - inside.mean()) / (outside.mean() - inside.mean())
        cell = ((distance[near] + REACH) / STEP).astype(int)
        np.add.at(edges[0], cell, share)
        np.add.at(edges[1], cell, 1.0)


# ---- section ----


def section(results: Results) -> list[Part]:
    done = results.values()
    names = ["area", "true u", "true v", "ours u", "ours v", "", "Blender u", "Blender v", "claimed"]
    discs = pd.DataFrame([disc for r in done for disc in r["rows"]], columns=names, dtype=float).dropna()
    true, ours, theirs = (discs[[f"{who} u", f"{who} v"]].to_numpy().ravel() for who in ("true", *GREY))
    both = discs.loc[np.repeat(discs.index, 2), ["area", "claimed"]]  # a row for each axis
    errors = both.assign(
        **{"ours - Blender": ours - theirs, "ours - truth": ours - true, "Blender - truth": theirs - true}
    )
    by_area = _classes(errors)
    edges = edge_profiles(results)
    apart = pd.DataFrame([r["geometry"] for r in done if r["geometry"]], columns=["centre, px", "centroid, px", "area"])
    return [
        Table("Centres by the area of the discs, RMS per axis, px", by_area),
        Table("Largest differences of projected discs; area as a fraction", apart.max().to_frame().T),
        Table(
            "Standard deviation of the blur of edges; a box of one pixel has 0.29 px",
            pd.DataFrame([[n, blur_of(edges[n])] for n in edges], columns=["picture", "blur, px"]),
        ),
    ]


def _classes(errors: pd.DataFrame) -> pd.DataFrame:
    """RMS per axis of the discs by their area, and their number."""
    names = [f"{a:g} to {b:g} px²" for a, b in AREAS]
    classes = pd.cut(errors["area"], [*(a for a, _ in AREAS), np.inf], right=False, labels=names)
    values = errors.drop(columns="area")
    found = (values**2).groupby(classes, observed=True).mean() ** 0.5
    return found.assign(discs=values.groupby(classes, observed=True).size() // 2).reset_index()


def edge_profiles(results: Results) -> pd.DataFrame:
    """Lightness of pixels (0 disc, 1 ball) by their distance (px) from an edge; nan where there are none."""
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
