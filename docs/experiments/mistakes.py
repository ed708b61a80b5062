"""A calibration that is wrong: lens distortion left uncorrected, an evening with a tape measure and a good eye.

Wittich 2017, sections 4.10 and 5, holds that markers placed by eye and distances taken by tape are accurate enough. The
film is right and the rig is wrong, and so are the camera's pose and everything after it. The sent motion of the pointer
is compared with the true one: how much faster it goes (scale), its angle in the worst direction, and the remaining
error (wobble), which no setting can correct. `ekf1` and `ekf2` get the true acceleration. `so3, no lift` is not asked
whether the ball was lifted, `so3, told` knows how uncertain the lengths are.

In an evening everything is wrong at once: the focal length by 3 % (one standard deviation), the principal point by
6 px, the radius by 2 mm, the ball's centre by 10 mm, the targets by 3 mm in each coordinate, and an unknown lens. A rig
counts as lost if no pose is found or the film is lost. It is good if the pointer is straight to 2°, steady to 5 %, and
the ball never lost.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Claim, Part, Plot, Table, by, tidy, where
from experiments.kit.tour import FAR_OFF, FOLLOWED, SHARE, brief, filmed, least, moved, suited
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import Truth
from spheremouse.errors import PoseError
from spheremouse.evaluate.metrics import Run, surface_travel
from spheremouse.geometry.camera import project_sphere
from spheremouse.geometry.rotation import Array, log

TITLE = "A calibration that is wrong (Wittich 2017, chapter 5)"
TRACKERS = kit.TRACKERS
FREE = "so3, no lift"  # not asked whether the ball was lifted off its bearings
TOLD = "so3, told"  # how uncertain the lengths are
STRAIGHT = 2.0  # °, a pointer that goes where the hand pushes
STEADY = 100.0 * SHARE  # %, of the motion, that is neither scale nor direction
EVENING = {"focal": 0.03, "principal": 6.0, "radius": 0.002, "centre": 0.01, "targets": 0.003}  # m, px; 1 sigma
LENS = 0.1  # −k1 of an evening
_SHORTEST, _NARROW = 10, 0.1  # frames, and fraction of the turns about other axes, for an estimate of the scale
_QUICKLY = "pose.frames=5"  # the film's first frames show the same
PER_UNIT = {"focal": 1e2, "radius": 1e3, "centre": 1e3, "targets": 1e3, "lens": 1.0, "evening": 1.0}  # SI to the axis


@dataclass(frozen=True, slots=True)
class Kind:
    """A mistake; values in SI units."""

    name: str
    label: str  # of the axis
    whole: tuple[float, ...]
    quick: tuple[float, ...]
    draws: int  # how often at each value, where chance decides
    log: bool
    typical: float


KINDS = {
    k.name: k
    for k in (
        Kind("focal", "focal length, %", (-0.1, -0.05, -0.02, -0.01, 0.01, 0.02, 0.05, 0.1), (0.05,), 1, False, 0.05),
        Kind(
            "radius", "radius, mm", (-0.02, -0.01, -0.005, -0.002, -0.001, 0.001, 0.002, 0.005, 0.01, 0.02), (0.01,),
            1, False, 0.01,
        ),
        Kind("centre", "centre, mm", (0.001, 0.002, 0.005, 0.01, 0.02), (0.01,), 2, True, 0.01),
        Kind("targets", "targets, mm", (0.0005, 0.001, 0.002, 0.005, 0.01), (0.005,), 2, True, 0.005),
        Kind("lens", "lens, −k1", (0.01, 0.025, 0.05, 0.1, 0.2), (0.1,), 1, True, 0.1),
        Kind("evening", "errors, times those of an evening", (0.1, 0.25, 0.5, 1.0, 2.0), (1.0,), 4, True, 1.0),
    )
}  # fmt: skip
ALONE = ("focal", "radius", "centre", "targets", "lens")


TOGETHER = {"camera": ("focal", "radius"), "places": ("centre", "targets")}  # in a job


def jobs(request: Request) -> list[Job]:
    """Films through a right lens, by many wrong rigs each; and one per strength of a lens, with its evenings."""
    seeds, seconds = ((1,), 1.5) if request.quick else ((1, 2), 3.5)
    groups = {"alone": ALONE[:-1]} if request.quick else TOGETHER
    found = []
    for seed in seeds:
        what = {"seed": seed, "seconds": seconds}
        for group, names in groups.items():
            many = {name: _tried(KINDS[name], request) for name in names}
            plain = {name: list(tried) for name, tried in many.items()}
            found.append(Job(f"{group}-{seed}", with_mistakes, {**what, "mistakes": plain}, cost=_cost(seconds, many)))
        for k1 in _tried(KINDS["lens"], request)[0]:
            many = {"lens": ([k1], 1), "evening": ([k1 / LENS], _tried(KINDS["evening"], request)[1])}
            parameters = {**what, "mistakes": {name: list(tried) for name, tried in many.items()}, "k1": k1}
            found.append(Job(f"lens-{k1:g}-{seed}", with_mistakes, parameters, cost=_cost(seconds, many)))
    return found


Tried = tuple[list[float], int]  # values, and draws of each


def _tried(kind: Kind, request: Request) -> Tried:
    return (list(kind.quick), 1) if request.quick else (list(kind.whole), kind.draws)


def _cost(seconds: float, mistakes: dict[str, Tried]) -> float:
    """s, about: the film, and the rigs of which the right one is the first."""
    return 2.5 + 0.5 * seconds * (2 + sum(len(values) * draws for values, draws in mistakes.values()))


# ---- wrong rigs ----


def wrong(rig: Rig, mistake: str, value: float, draw: int) -> Rig:
    """The rig with a mistake of a size; where chance decides, `draw` is its seed. Nothing says that it is wrong."""
    rng = np.random.default_rng([draw, sorted(KINDS).index(mistake)])
    if mistake == "focal":
        return _off(rig, focal=value)
    if mistake == "radius":
        return _off(rig, radius=value)
    if mistake == "centre":
        direction = rng.standard_normal(3)
        return _off(rig, centre=value * direction / np.linalg.norm(direction))
    if mistake == "targets":
        return _off(rig, targets=value * rng.standard_normal(rig.targets.position.shape))
    flat = replace(rig, camera=replace(rig.camera, distortion=np.zeros(5)))
    if mistake == "lens":
        return flat
    assert mistake == "evening", mistake
    e = {name: value * sigma for name, sigma in EVENING.items()}
    return _off(
        flat,
        focal=e["focal"] * float(rng.standard_normal()),
        principal=e["principal"] * rng.standard_normal(2),
        radius=e["radius"] * float(rng.standard_normal()),
        centre=e["centre"] * rng.standard_normal(3),
        targets=e["targets"] * rng.standard_normal(rig.targets.position.shape),
    )


def _off(
    rig: Rig,
    *,
    focal: float = 0.0,
    principal: Array | None = None,
    radius: float = 0.0,
    centre: Array | None = None,
    targets: Array | None = None,
) -> Rig:
    """`focal` a share; `radius` m; `principal` (2,) px; `centre` (3,) m, of the ball; `targets` (n, 3) m.

    A centre in the wrong place is all targets in the wrong place: positions count from it.
    """
    c, t = rig.camera, rig.targets
    x, y = (0.0, 0.0) if principal is None else principal
    camera = replace(c, fx=c.fx * (1.0 + focal), fy=c.fy * (1.0 + focal), cx=c.cx + float(x), cy=c.cy + float(y))
    position = t.position - (0.0 if centre is None else centre) + (0.0 if targets is None else targets)
    ball = replace(rig.ball, radius=rig.ball.radius + radius)
    return replace(rig, camera=camera, ball=ball, targets=replace(t, position=position))


def told(rig: Rig, value: float) -> Rig:
    """An evening's rig that says how uncertain its lengths are; of the focal length it cannot."""
    e, n = {name: value * sigma for name, sigma in EVENING.items()}, len(rig.targets.position)
    own, common = np.eye(3 * n), np.kron(np.ones((n, n)), np.eye(3))
    covariance = np.diag([0.0, 0.0, 0.0, e["radius"] ** 2])
    targets = replace(rig.targets, covariance=e["targets"] ** 2 * own + e["centre"] ** 2 * common)
    return replace(rig, ball=replace(rig.ball, covariance=covariance), targets=targets)


# ---- films ----


def with_mistakes(seed: int, seconds: float, mistakes: dict[str, Tried], k1: float = 0.0) -> Result:
    """One film by many wrong rigs, each with the pose that it finds. `k1`: of the film's lens, a barrel."""
    film = filmed({"dist": [-k1, 0.0, 0.0, 0.0, 0.0]}, seed, seconds)
    found: Result = {}
    for name, (values, draws) in mistakes.items():
        cells: Result = {}
        for value in values:
            rigs = [wrong(film.rig, name, value, 100 * seed + k) for k in range(draws)]
            say = [told(rig, value) if name == "evening" else None for rig in rigs]
            cells[f"{value:g}"] = [followed(film, rig, more) for rig, more in zip(rigs, say, strict=True)]
        found[name] = cells
    return {"mistakes": found, **_right(film), "edge": at_edge(film, k1)}


def at_edge(film: kit.Film, k1: float) -> float:
    """Pixels by which the lens moves the outline of the ball, mean."""
    pose = film.truth.pose
    assert pose is not None, "a film made here knows where the camera stands"
    centre, shape = project_sphere(pose.to_cam(film.rig.ball.centre), film.rig.ball.radius)
    angle = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    outline = centre + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ np.linalg.cholesky(shape).T
    return float(np.mean(film.rig.camera.fx * k1 * np.linalg.norm(outline, axis=1) ** 3))


def _right(film: kit.Film) -> Result:
    """Track a film with the true rig, and return its bound."""
    tracked = kit.tracked(film, kit.settings_of())
    assert film.truth.motion is not None, "a film made here knows its motion"
    return {
        "right": followed(film, film.rig),
        "bound": least(kit.bound(film, tracked)),
        "moved": moved(film.truth.motion),
    }


def followed(film: kit.Film, rig: Rig, more: Rig | None = None) -> Result:
    """A film by all trackers with a rig that may be wrong, by `so3` with `more` as well; a pose that is not found says
    so. The truth is that of the film."""
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
    there = replace(rig, pose=seen.pose)
    usual = kit.settings_of()
    runs["so3"] = kit.tracked(film, usual, rig=there).run
    runs[FREE] = kit.tracked(film, replace(usual, loss=replace(usual.loss, lifted=1.0)), rig=there).run
    if more is not None:
        with suppress(PoseError):  # then it has no row
            runs[TOLD] = kit.tracked(film, kit.settings_of([_QUICKLY]), rig=more).run
    rows: Result = {}
    for name, run in runs.items():
        moves = mouse(run, truth.motion, rig.ball.radius, radius)
        rows[name] = {**brief(detections.errors(run, truth, radius)), **(moves or {})}
    return {"rows": rows}


def mouse(run: Run, motion: Truth, assumed: float, true: float) -> dict[str, float] | None:
    """Return the effect on the pointer: `sent` = A `made`, (2, 3), by least squares over the frames that were tracked.

    `scale`: how much faster it goes, %, mean of both axes. `direction`: by how many degrees it goes astray, in the
    worst direction. `spin`: % of the turn about the vertical that gets into it. `wobble`: what A does not explain, % of
    the motion: no setting of scale or axes removes it. Radii in m: `assumed` is that by which it was sent.
    """
    k = run.tracked
    k = k[np.isin(k - 1, k)]
    if len(k) < _SHORTEST:
        return None
    R = motion.attitude
    made = log(R[run.frame[k]] @ R[run.frame[k - 1]].transpose(0, 2, 1))
    return pointer_errors(surface_travel(run.rotation[k], assumed), 1e3 * true * made[:, [2, 0, 1]])


def pointer_errors(sent: Array, made: Array) -> dict[str, float] | None:
    """`sent` (n, 2) mm of the pointer, `made` (n, 3) mm: across, along, spin."""
    spread = np.linalg.svd(made, compute_uv=False)
    if spread[-1] <= _NARROW * spread[0]:
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
    """Each mistake, all together, and what may be off by how much."""
    runs = _runs(results)
    how = {"rigs": "size", **dict.fromkeys(_QUANTITIES.values(), "median"), "lost": "sum", "good": "sum"}
    medians = by(runs.assign(rigs=0), ["mistake", "size", "filter"], how)
    wrong = runs[runs["size"] != 0.0]
    lost = (where(wrong, mistake=[KINDS[name].label for name in ALONE])).groupby("filter")["lost"].sum()
    both = medians[medians["size"] != 0.0].pivot(index=["mistake", "size"], columns="filter", values="wobble, %")
    both = both.reindex(columns=["so3", "ekf2"]).dropna()
    more = (both["so3"] > both["ekf2"]).groupby(level="mistake", sort=False).mean()
    evening = where(medians, mistake=KINDS["evening"].label, size=1.0).set_index("filter")
    return [
        *(
            Table(f"{label} (medians)", rows.drop(columns="mistake"), ["size", "rigs"])
            for label, rows in medians.groupby("mistake", sort=False)
        ),
        Table("The largest size up to which all rigs are good (– if even the least is too much)", _borne(wrong)),
        Claim(
            "`so3` loses the ball more often than `ekf2`, since it may take the ball for lifted if discs do not "
            "turn about the rig's centre.",
            lost.get("so3", 0) > lost.get(FREE, 0) >= lost.get("ekf2", np.inf),
        ),
        Claim(
            "`so3` wobbles more than `ekf2` with a wrong focal length, radius, centre or lens. With wrong targets it "
            "wobbles less, at most sizes.",
            more.get(KINDS["targets"].label, 1.0) < 0.5 < more.drop(KINDS["targets"].label, errors="ignore").min(),
        ),
        Claim(
            "After most evenings no filter sends a pointer that is straight and steady.",
            len(evening) and evening["good"].max() < 0.5 * evening["rigs"].max(),
        ),
        *(
            Plot(
                f"mistakes-{name}",
                f"Errors of {words} by mistake: medians and range of the wrong rigs.",
                wrong,
                "size",
                columns,
                "filter",
                "mistake",
                log="y",
            )
            for name, words, columns in (
                ("errors", "attitude and rate", [ATTITUDE, RATE]),
                ("mouse", "the pointer", ["scale off by, %", "direction, °", "wobble, %"]),
            )
        ),
    ]


_QUANTITIES = {
    "attitude": ATTITUDE,
    "rate": RATE,
    "scale": "scale, %",
    "off": "scale off by, %",
    "direction": "direction, °",
    "wobble": "wobble, %",
}


def _runs(results: Results) -> pd.DataFrame:
    """A row for each mistake, rig and filter, in units of the labels; the right rig has size 0."""
    records: list[dict[str, Any]] = []
    for result in results.values():
        for mistake, sizes in result["mistakes"].items():
            rigs = [(0.0, result["right"]), *((float(size), rig) for size, of in sizes.items() for rig in of)]
            for size, rig in rigs:
                who = (*TRACKERS, FREE, TOLD) if mistake == "evening" and size else (*TRACKERS, FREE)
                about = {
                    "mistake": KINDS[mistake].label,
                    "order": list(KINDS).index(mistake),
                    "size": size * PER_UNIT[mistake],
                }
                records += [{**about, "filter": w, **rig.get("rows", {}).get(w, {})} for w in who]
    columns = (
        "mistake",
        "order",
        "size",
        "filter",
        "attitude",
        "rate",
        "scale",
        "direction",
        "wobble",
        "lost",
        "tracked",
    )
    runs = tidy(records, [*columns, "frames"]).sort_values(["order", "size"], kind="stable").drop(columns="order")
    followed = (runs["lost"] == 0) & (runs["tracked"] >= FOLLOWED * runs["frames"])
    good = followed & (runs["direction"] <= STRAIGHT) & (runs["wobble"] <= STEADY)
    runs = runs.assign(off=runs["scale"].abs(), lost=~(followed & (runs["attitude"] <= FAR_OFF)), good=good)
    return runs.rename(columns=_QUANTITIES)


def _borne(wrong: pd.DataFrame) -> pd.DataFrame:
    """By mistake and filter; sizes count either way."""
    size = wrong["size"].abs()
    good = (
        wrong["good"]
        .groupby([wrong["mistake"], wrong["filter"], size], sort=False)
        .all()
        .astype(int)
        .sort_index(level="size")
    )
    so_far = good.groupby(level=["mistake", "filter"]).cummin()
    largest = so_far[so_far == 1].reset_index("size").groupby(["mistake", "filter"])["size"].max().unstack("filter")
    rows = largest.reindex(index=wrong["mistake"].unique(), columns=["so3", FREE])
    return rows.assign(**{"least tried": size.groupby(wrong["mistake"]).min()}).reset_index()
