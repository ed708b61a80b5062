"""Errors by the sizes and places of discs and by hands on them, beside the theoretical bound.

Wittich 2017, chapter 5, leaves the size of the discs open. 26 discs before the far camera; each film has other places
of the discs. For the layouts the ball turns once about the horizontal axis, so that all its sides pass. Hands come
after a second and stay; errors count from half a second later on. Recognition is from one picture, with some discs
hidden. A film is lost as in the section on how the camera films.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, ERRORS, RATE, Part, Plot, Table, by, filter_rows, tidy, where
from experiments.kit.tour import FAR_OFF, FOLLOWED
from spheremouse.ball.associate import identify
from spheremouse.ball.truth import VISIBLE
from spheremouse.calibrate.layout.choose import choose_directions, min_in_view
from spheremouse.errors import PoseError
from spheremouse.geometry.rotation import Array, exp, fibonacci_sphere, log
from spheremouse.simulate.ball.film import HandVisit, Simulation, prepare
from spheremouse.simulate.ball.profile import Gesture, Gestures
from spheremouse.simulate.ball.scene import spread_directions

TITLE = "Discs: their size, their places, hands on the ball (Wittich 2017, chapter 5)"
DISCS = 26
_RADIUS = 0.6  # m, of the ball
NOISE = 3.0  # grey values
_VIEW_ANGLE = np.radians(70.0)  # as `spheremouse layout`
_LAYOUT_SEEDS = 2  # their films are longer, and the seeds differ little
SETTLE = 1.0  # s, before hands come: the camera's pose is found by then
TRIAL_SIGMA = np.radians(0.1)  # of a direction
TRIAL_HIDDEN = 0.2  # probability that a disc in view is hidden
_TRIALS = 300
_TOLERANCE = 0.02  # rad, of a recognised attitude

SIZES = (4, 6, 8, 10, 14, 20, 30)  # mm, radius
LAYOUTS = {
    "designed": "by `spheremouse layout`", "spread": "irregular, pushed apart", "even": "evenly spread (golden spiral)",
    "rows": "in rows", "random": "random", "cluster": "clustered on one side"
}  # fmt: skip
HANDS = {  # right or left, and how large
    "none": (),
    "one": ((True, 1.0),),
    "two": ((True, 1.0), (False, 1.0)),
    "two large": ((True, 1.5), (False, 1.5)),
    "two very large": ((True, 2.2), (False, 2.2)),
}


def jobs(request: Request) -> list[Job]:
    if request.quick:
        sizes, layouts, hands, seeds, frames = (6, 20), ("random",), ("two",), 1, 36
    else:
        sizes, layouts, hands, seeds, frames = SIZES, tuple(LAYOUTS), tuple(HANDS), 3, 120
    work = []
    for seed in range(seeds):
        common = {"seed": seed, "frames": frames}
        cost = 2.0 + 0.04 * frames
        work += [Job(f"size-{mm}-{seed}", of_size, {"millimetres": mm, **common}, cost) for mm in sizes]
        work += [Job(f"hands-{k}-{seed}".replace(" ", "_"), with_hands, {"kind": k, **common}, cost) for k in hands]
        longer = {"seed": seed, "frames": frames if request.quick else 180}
        if seed < _LAYOUT_SEEDS:
            work += [Job(f"layout-{k}-{seed}", laid_out, {"kind": k, **longer}, 1.5 * cost + 1.0) for k in layouts]
    return work


# ---- films ----


def of_size(millimetres: float, seed: int, frames: int) -> Result:
    """Discs of a radius, in the same places for all."""
    simulation = _simulated(seed, frames, _irregular(max(SIZES), seed))
    return _followed(replace(simulation, scene=replace(simulation.scene, disc_radius=1e-3 * millimetres)))


def laid_out(kind: str, seed: int, frames: int) -> Result:
    """Discs in their places; the ball is turned once about the horizontal axis, so that all sides come by."""
    simulation = _simulated(seed, frames, directions_of(kind, seed))
    seconds = frames / simulation.fps
    once = Gestures((Gesture(0.0, seconds, (1.0, 0.0, 0.0), 2.0 * np.pi, 0.3),), seconds)
    result = _followed(replace(simulation, profile=once))
    directions = simulation.scene.disc_directions
    recognised, mistaken = recognition(directions)
    in_view = min_in_view(directions, float(_VIEW_ANGLE))
    return {**result, "in_view": in_view, "recognised": recognised, "mistaken": mistaken}


def recognition(directions: Array) -> tuple[float, float]:
    """Return the fractions of random attitudes that `identify` recognises, and that it mistakes for others."""
    rng, camera, cosine = np.random.default_rng(0), np.array([0.0, 0.0, 1.0]), np.cos(_VIEW_ANGLE)
    recognised = mistaken = 0
    for _ in range(_TRIALS):
        columns, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        R = columns * np.linalg.det(columns) @ exp(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
        seen = directions @ R.T
        seen = seen[(seen[:, 2] > cosine) & (rng.random(len(seen)) >= TRIAL_HIDDEN)]
        seen = seen + TRIAL_SIGMA * rng.standard_normal(seen.shape)
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        horizon = float(np.cos(_VIEW_ANGLE + 0.05))  # a disc near the limb may be in view or not
        found = identify(seen, directions, sigma=float(TRIAL_SIGMA), view_axis=camera, horizon=horizon)
        if found is not None:
            right = bool(np.linalg.norm(log(found.rotation @ R.T)) < _TOLERANCE)
            recognised, mistaken = recognised + right, mistaken + (not right)
    return recognised / _TRIALS, mistaken / _TRIALS


def with_hands(kind: str, seed: int, frames: int) -> Result:
    simulation = _simulated(seed, frames, _irregular(20.0, seed))
    end = 2.0 + frames / simulation.fps
    start = min(SETTLE, 0.25 * frames / simulation.fps)
    visits = tuple(HandVisit(start, end, right, size) for right, size in HANDS[kind])
    return _followed(replace(simulation, options=replace(simulation.options, hands=visits)), start + 0.5)


def _simulated(seed: int, frames: int, directions: Array) -> Simulation:
    simulation = prepare(kit.options_of({"discs": DISCS, "seed": seed, "noise": NOISE, "seconds": frames / 30.0}))
    return replace(simulation, scene=replace(simulation.scene, disc_directions=directions))


def _followed(simulation: Simulation, since: float = 0.0) -> Result:
    """All filters on a film with the pose found from it, the bound, the near discs in view: from `since` on, s."""
    film = kit.film_of(simulation)
    assert film.truth.discs is not None, "a film made here knows its discs"
    stamps = np.array([frame.stamp for frame in film.frames])
    state = film.truth.discs.state[stamps[film.truth.discs.frame] >= since]
    common = {"frames": len(film.frames), "in_view_share": float(np.mean(state == VISIBLE)), **_pixels(simulation)}
    try:
        seen = detections.look_at(film, kit.settings_of(["tracker=ekf2"]))
    except PoseError as e:
        return {**common, "rows": {}, "bound": None, "unfound": str(e)}
    rows, radius = {}, film.rig.ball.radius
    for name in kit.TRACKERS[:2]:
        run = detections.filtered(seen, kit.settings_of([f"tracker={name}"]), film)
        rows[name] = detections.errors(run, film.truth, radius, since)
    tracked = kit.tracked(film, kit.settings_of(), rig=replace(film.rig, pose=seen.pose))
    rows["so3"] = detections.errors(tracked.run, film.truth, radius, since)
    return {**common, "rows": rows, "bound": kit.bound(film, tracked, since)}


def _pixels(simulation: Simulation) -> Result:
    """Diameter of a disc in the middle of the ball."""
    scene = simulation.scene
    gap = float(np.linalg.norm(scene.pose.position)) - scene.ball_radius
    return {"diameter_px": 2.0 * scene.disc_radius * scene.camera.fx / gap}


# ---- places of discs ----


def directions_of(kind: str, seed: int) -> Array:
    """Unit vectors, (26, 3), of a layout; each seed has other places."""
    rng = np.random.default_rng([seed, 9])
    if kind == "designed":
        return choose_directions(DISCS, float(_VIEW_ANGLE), 0.1, seed)
    if kind == "spread":
        return _irregular(20.0, seed)
    if kind == "even":
        return fibonacci_sphere(DISCS) @ exp(rng.normal(size=3)).T
    if kind == "rows":
        return in_rows() @ exp(rng.normal(size=3)).T
    if kind == "random":
        return scattered(rng, -1.0)
    return scattered(rng, float(np.cos(np.radians(75.0))))


def _irregular(millimetres: float, seed: int) -> Array:
    """As `spheremouse simulate` puts discs of a radius."""
    return spread_directions(DISCS, 3.0 * 1e-3 * millimetres / _RADIUS, np.random.default_rng([seed, 10]))


def in_rows() -> Array:
    """Five parallels, each with its discs evenly spaced from the same meridian on: (26, 3)."""
    found = []
    for latitude, n in ((-60, 3), (-30, 6), (0, 8), (30, 6), (60, 3)):
        a, turn = np.radians(latitude), 2.0 * np.pi * np.arange(n) / n
        found.append(np.stack([np.cos(a) * np.cos(turn), np.full(n, np.sin(a)), np.cos(a) * np.sin(turn)], axis=1))
    return np.concatenate(found)


def scattered(rng: np.random.Generator, least: float) -> Array:
    """Random places, (26, 3), whose cosine with Z is above `least`, none nearer to another than three disc radii."""
    apart, found = np.cos(0.1), np.zeros((0, 3))
    while len(found) < DISCS:
        v = rng.standard_normal(3)
        v /= np.linalg.norm(v)
        if v[2] > least and np.all(found @ v < apart):
            found = np.concatenate([found, v[None]])
    return found


# ---- section ----


def section(results: Results) -> list[Part]:
    runs = _runs(results)
    how = {
        "films": "size", "lost": "sum", "diameter, px": "mean", "wholly in view, %": "mean", "in view, least": "mean",
        "recognised, %": "mean", "used": "mean", "centres, px": "median", ATTITUDE: "median", RATE: "median"
    }  # fmt: skip
    medians = by(runs.assign(films=0), ["kind", "value", "filter"], how)
    parts: list[Part] = []
    for kind, title in {"size": "radius of the discs, mm", "layout": "layout", "hands": "hands"}.items():
        rows, table = (where(frame, kind=kind).dropna(axis="columns", how="all") for frame in (runs, medians))
        if len(rows):
            x = rows["value"].astype(float) if kind == "size" else rows["value"]
            parts += [
                Table(
                    f"Medians by {title}", table.drop(columns="kind").rename(columns={"value": title}), [title, "films"]
                ),
                Plot(
                    f"discs-{kind}", f"Errors by {title}: medians and range of the films.", rows.assign(**{title: x}),
                    title, [ATTITUDE, RATE], "filter", log="xy" if kind == "size" else "y"
                )
            ]  # fmt: skip
    return parts


def _runs(results: Results) -> pd.DataFrame:
    """A row for each film and filter, in the order of what is varied."""
    order = [*map(str, SIZES), *LAYOUTS, *HANDS]
    records = []
    for key, result in results.items():
        kind, value, _ = key.split("-")
        common = {name: x for name, x in result.items() if name not in ("rows", "bound")}
        found = {name: result["rows"].get(name, {}) for name in kit.TRACKERS}
        records += filter_rows({**common, "kind": kind, "value": value.replace("_", " ")}, found, result["bound"])
    columns = {
        "diameter_px": "diameter, px", "in_view_share": "wholly in view, %", "in_view": "in view, least",
        "recognised": "recognised, %", "mean_discs": "used", "detection.centre_rms_px": "centres, px", **ERRORS
    }  # fmt: skip
    more = {name: name for name in ("kind", "value", "filter", "lost_episodes", "tracked", "frames")}
    runs = tidy(records, {**more, **columns})
    followed = (runs["lost_episodes"] == 0) & (runs["tracked"] >= FOLLOWED * runs["frames"])
    shares = {name: 100.0 * runs[name] for name in ("wholly in view, %", "recognised, %")}
    runs = runs.assign(lost=(runs["filter"] != "bound") & ~(followed & (runs[ATTITUDE] <= FAR_OFF)), **shares)
    return runs.sort_values("value", key=lambda values: values.map(order.index), kind="stable")
