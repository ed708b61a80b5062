"""A calibration that is wrong: lens distortion left uncorrected, lengths taken by tape and eye.

Wittich 2017, sections 4.10 and 5, holds that markers placed by eye and distances taken by tape are accurate enough. The
film is right and the rig is wrong, and so are the camera's pose and everything after it. The sent motion of the pointer
is compared with the true one: how much faster it goes (scale), its angle in the worst direction, and the remaining
error (wobble), which no setting can correct. `ekf1` and `ekf2` get the true acceleration. A rig counts as lost if no
pose is found or the film is lost. It is good if the pointer is straight to 2°, steady to 5 %, and the ball never lost.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Part, Plot, Table, by, tidy
from experiments.kit.tour import FAR_OFF, FOLLOWED, SHARE, brief, filmed, suited
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import Truth
from spheremouse.errors import PoseError
from spheremouse.evaluation.metrics import surface_travel
from spheremouse.evaluation.run import Run
from spheremouse.geometry.rotation import Array, log

TITLE = "A calibration that is wrong (Wittich 2017, chapter 5)"
TRACKERS = kit.TRACKERS
STRAIGHT = 2.0  # °, a pointer that goes where the hand pushes
STEADY = 100.0 * SHARE  # %, of the motion, that is neither scale nor direction
_MIN_FRAMES, _MIN_TURN_FRACTION = (
    10,
    0.1,
)  # frames, and fraction of the turns about other axes, for an estimate of the scale
_QUICKLY = "pose.frames=5"  # the film's first frames show the same


class Kind(NamedTuple):
    """A mistake; values in SI units."""

    label: str  # of the axis
    per_unit: float  # of the axis in an SI unit
    whole: tuple[float, ...]
    quick: float
    draws: int = 1  # how often at each value, where chance decides


KINDS = {
    "focal": Kind("focal length, %", 1e2, (-0.1, -0.05, -0.02, -0.01, 0.01, 0.02, 0.05, 0.1), 0.05),
    "radius": Kind("radius, mm", 1e3, (-0.02, -0.01, -0.005, -0.002, -0.001, 0.001, 0.002, 0.005, 0.01, 0.02), 0.01),
    "centre": Kind("centre, mm", 1e3, (0.001, 0.002, 0.005, 0.01, 0.02), 0.01, 2),
    "targets": Kind("targets, mm", 1e3, (0.0005, 0.001, 0.002, 0.005, 0.01), 0.005, 2),
    "lens": Kind("lens, −k1", 1.0, (0.01, 0.025, 0.05, 0.1, 0.2), 0.1),
}
TOGETHER = {"camera": ("focal", "radius"), "places": ("centre", "targets")}  # in a job
_SEEDS = {"centre": 0, "targets": 5}  # of what chance decides


def jobs(request: Request) -> list[Job]:
    seeds, seconds = ((1,), 1.5) if request.quick else ((1, 2), 3.5)
    groups = {"alone": ("focal", "radius", "centre", "targets")} if request.quick else TOGETHER
    found = []
    for seed in seeds:
        wanted = [(group, {name: _tried(name, request) for name in names}, 0.0) for group, names in groups.items()]
        wanted += [(f"lens-{k1:g}", {"lens": ([k1], 1)}, k1) for k1 in _tried("lens", request)[0]]
        for name, mistakes, k1 in wanted:
            plain = {mistake: list(tried) for mistake, tried in mistakes.items()}
            parameters = {"seed": seed, "seconds": seconds, "mistakes": plain, "k1": k1}
            rigs = 2 + sum(len(values) * draws for values, draws in mistakes.values())
            found.append(Job(f"{name}-{seed}", with_mistakes, parameters, cost=2.5 + 0.5 * seconds * rigs))
    return found


Tried = tuple[list[float], int]  # values, and draws of each


def _tried(mistake: str, request: Request) -> Tried:
    kind = KINDS[mistake]
    return ([kind.quick], 1) if request.quick else (list(kind.whole), kind.draws)


# ---- wrong rigs ----


def wrong(rig: Rig, mistake: str, value: float, draw: int) -> Rig:
    """The rig with a mistake of a size; where chance decides, `draw` is its seed. Nothing says that it is wrong.

    A centre in the wrong place is all targets in the wrong place: positions count from it.
    """
    c, t = rig.camera, rig.targets
    if mistake == "focal":
        return replace(rig, camera=replace(c, fx=c.fx * (1.0 + value), fy=c.fy * (1.0 + value)))
    if mistake == "radius":
        return replace(rig, ball=replace(rig.ball, radius=rig.ball.radius + value))
    if mistake == "lens":
        return replace(rig, camera=replace(c, distortion=np.zeros(5)))
    rng = np.random.default_rng([draw, _SEEDS[mistake]])
    if mistake == "targets":
        return replace(rig, targets=replace(t, position=t.position + value * rng.standard_normal(t.position.shape)))
    assert mistake == "centre", mistake
    direction = rng.standard_normal(3)
    shift = value * direction / np.linalg.norm(direction)
    return replace(rig, targets=replace(t, position=t.position - shift))


# ---- films ----


def with_mistakes(seed: int, seconds: float, mistakes: dict[str, Tried], k1: float) -> Result:
    """One film by many wrong rigs, each with the pose that it finds. `k1`: of the film's lens, a barrel."""
    film = filmed({"dist": [-k1, 0.0, 0.0, 0.0, 0.0]}, seed, seconds)
    found: Result = {}
    for name, (values, draws) in mistakes.items():
        found[name] = {
            f"{value:g}": [followed(film, wrong(film.rig, name, value, 100 * seed + k)) for k in range(draws)]
            for value in values
        }
    return {"mistakes": found, "right": followed(film, film.rig)}


def followed(film: kit.Film, rig: Rig) -> Result:
    """A film by all trackers with a rig that may be wrong; a pose that is not found says so."""
    truth, radius = film.truth, film.rig.ball.radius
    assert truth.motion is not None, "a film made here knows its motion"
    try:
        seen = detections.look_at(replace(film, rig=rig), kit.settings_of(["tracker=ekf2", _QUICKLY]))
    except PoseError as e:
        return {"error": str(e)}
    runs = {
        name: detections.filtered(seen, kit.settings_of([f"tracker={name}", suited(truth.motion)]), film)
        for name in TRACKERS
        if name != "so3"
    }
    runs["so3"] = kit.tracked(film, kit.settings_of(), rig=replace(rig, pose=seen.pose)).run
    rows: Result = {}
    for name, run in runs.items():
        moves = mouse(run, truth.motion, rig.ball.radius, radius)
        rows[name] = {**brief(detections.errors(run, truth, radius)), **(moves or {})}
    return {"rows": rows}


def mouse(run: Run, motion: Truth, assumed: float, true: float) -> dict[str, float] | None:
    """Return the effect on the pointer: `sent` = A `made`, (2, 3), by least squares over the frames that were tracked.

    `scale`: how much faster it goes, %, mean of both axes. `direction`: by how many degrees it goes astray, in the
    worst direction. `spin`: % of the turn about the vertical that gets into it. `wobble`: the residual of that fit, %
    of the motion: no setting of scale or axes removes it. Radii in m: `assumed` is that by which it was sent.
    """
    k = run.tracked
    k = k[np.isin(k - 1, k)]
    if len(k) < _MIN_FRAMES:
        return None
    R = motion.attitude
    made = log(R[run.frame[k]] @ R[run.frame[k - 1]].transpose(0, 2, 1))
    return pointer_errors(surface_travel(run.rotation[k], assumed), 1e3 * true * made[:, [2, 0, 1]])


def pointer_errors(sent: Array, made: Array) -> dict[str, float] | None:
    """`sent` (n, 2) mm of the pointer, `made` (n, 3) mm: across, along, spin."""
    spread = np.linalg.svd(made, compute_uv=False)
    if spread[-1] <= _MIN_TURN_FRACTION * spread[0]:
        return None  # turns about one axis, or none, are left, so the others stay uncertain
    A = np.linalg.lstsq(made, sent, rcond=None)[0].T
    M, left = A[:, :2], sent - made @ A.T
    if np.linalg.det(M) <= 0.0:
        return None
    angle = np.linspace(0.0, np.pi, 180, endpoint=False)
    u = np.stack([np.cos(angle), np.sin(angle)])
    v = M @ u
    astray = np.degrees(np.arctan2(u[0] * v[1] - u[1] * v[0], np.sum(u * v, axis=0)))
    return {
        "scale": 100.0 * float(np.sqrt(np.linalg.det(M)) - 1.0),
        "direction": float(np.max(np.abs(astray))),
        "spin": 100.0 * float(np.linalg.norm(A[:, 2])),
        "wobble": 100.0 * float(np.linalg.norm(left) / np.linalg.norm(made[:, :2])),
    }


# ---- section ----


def section(results: Results) -> list[Part]:
    runs = _runs(results)
    how = {"rigs": "size", **dict.fromkeys(_QUANTITIES.values(), "median"), "lost": "sum", "good": "sum"}
    medians = by(runs.assign(rigs=0), ["mistake", "size", "filter"], how)
    wrong = runs[runs["size"] != 0.0]
    return [
        *(
            Table(f"{label} (medians)", rows.drop(columns="mistake"), ["size", "rigs"])
            for label, rows in medians.groupby("mistake", sort=False)
        ),
        Table("The largest size up to which all rigs are good (– if even the least is too much)", _borne(wrong)),
        Plot(
            "mistakes", "Errors by mistake: medians and range of the wrong rigs.", wrong, "size",
            [ATTITUDE, "scale off by, %", "direction, °", "wobble, %"], "filter", "mistake", log="y"
        )
    ]  # fmt: skip


_QUANTITIES = {
    "attitude": ATTITUDE, "rate": RATE, "scale": "scale, %", "off": "scale off by, %", "direction": "direction, °",
    "wobble": "wobble, %"
}  # fmt: skip


def _runs(results: Results) -> pd.DataFrame:
    """A row for each mistake, rig and filter, in units of the labels; the right rig has size 0."""
    records: list[dict[str, Any]] = []
    for result in results.values():
        for mistake, sizes in result["mistakes"].items():
            rigs = [(0.0, result["right"]), *((float(size), rig) for size, of in sizes.items() for rig in of)]
            for size, rig in rigs:
                about = {"mistake": KINDS[mistake].label, "order": list(KINDS).index(mistake)}
                about |= {"size": size * KINDS[mistake].per_unit}
                records += [{**about, "filter": w, **rig.get("rows", {}).get(w, {})} for w in TRACKERS]
    columns = (
        "mistake", "order", "size", "filter", "attitude", "rate", "scale", "direction", "wobble", "lost", "tracked"
    )  # fmt: skip
    runs = tidy(records, [*columns, "frames"]).sort_values(["order", "size"], kind="stable").drop(columns="order")
    followed = (runs["lost"] == 0) & (runs["tracked"] >= FOLLOWED * runs["frames"])
    good = followed & (runs["direction"] <= STRAIGHT) & (runs["wobble"] <= STEADY)
    runs = runs.assign(off=runs["scale"].abs(), lost=~(followed & (runs["attitude"] <= FAR_OFF)), good=good)
    return runs.rename(columns=_QUANTITIES)


def _borne(wrong: pd.DataFrame) -> pd.DataFrame:
    """By mistake and filter; sizes count either way."""
    size = wrong["size"].abs()
    good = (
        wrong["good"].groupby(
            [wrong["mistake"], wrong["filter"], size], sort=False
        ).all().astype(int).sort_index(level="size")
    )  # fmt: skip
    so_far = good.groupby(level=["mistake", "filter"]).cummin()
    largest = so_far[so_far == 1].reset_index("size").groupby(["mistake", "filter"])["size"].max().unstack("filter")
    rows = largest.reindex(index=wrong["mistake"].unique(), columns=["so3"])
    return rows.assign(**{"least tried": size.groupby(wrong["mistake"]).min()}).reset_index()
