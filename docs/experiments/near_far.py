"""The near camera against the far one: discs in use, errors of attitude and rate, by the three trackers.

Wittich 2017, table 23: 50 discs, the motion of figure 30, ten seconds. Values are the RMS over films with other places
of the discs. `ekf2, blobs` is the thesis' filter with the thesis' detector; the others have ours. The thesis' rates are
those of Euler angles, ours those of the angular velocity. The thesis counts stored discs, we count those used in a
frame. Tables 21 and 22 give the thesis' pose errors without signs, so all signs are tried.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd

from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, AXES, ERRORS, RATE, Part, Table, by, filter_rows, lengths, rms, tidy
from experiments.kit.thesis import THESIS_TABLES
from spheremouse.geometry.rotation import exp
from spheremouse.session.offline import initialise
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.options import View

TITLE = "Near and far camera (Wittich 2017, table 23)"
VIEWS: tuple[View, ...] = ("near", "far")
DISCS = 50
NOISE = 3.0  # grey values
VARIANTS = {
    "ekf2, blobs": ("tracker=ekf2", "detector=blobs"),  # both as published
    "ekf1": ("tracker=ekf1",),
    "ekf2": ("tracker=ekf2",),
    "so3": ("tracker=so3",),
}
_TABLE: dict[View, str] = {"near": "22", "far": "21"}  # of the thesis' poses
THESIS = {
    "near": {"discs": 7.4, "attitude": (0.23, 0.13, 0.21), "rate": (0.46, 0.35, 0.58)},
    "far": {"discs": 8.9, "attitude": (0.07, 0.07, 0.08), "rate": (0.55, 0.41, 0.62)},
}


def jobs(request: Request) -> list[Job]:
    seeds, seconds = (1, 1.5) if request.quick else (4, None)
    work = [
        Job(f"{view}-{seed}", followed, {"view": view, "seed": seed, "seconds": seconds})
        for view in VIEWS
        for seed in range(seeds)
    ]
    whole = not request.quick  # the first second hardly turns, and tells nothing of a wrong pose
    return work + [Job(f"posed-{view}", posed, {"view": view, "seconds": seconds}, 25.0) for view in VIEWS if whole]


def followed(view: View, seed: int, seconds: float | None) -> Result:
    """A film by all trackers, with the camera's own pose, and the bound for what was in view."""
    options = kit.options_of({"discs": DISCS, "view": view, "seed": seed, "noise": NOISE, "seconds": seconds})
    film = kit.film_of(prepare(options), f"{view}-{seed}")
    pose = initialise(iter(film.frames), film.rig, kit.settings_of()).pose  # looked for once: the same for all
    rig = replace(film.rig, pose=pose)
    found: Result = kit.track_all(film, {name: kit.settings_of(v) for name, v in VARIANTS.items()}, rig=rig)
    return {"frames": len(film.frames), "trackers": found, "bound": found["so3"].get("bound")}


def posed(view: View, seconds: float | None) -> Result:
    """Attitude errors of `ekf2` (deg, combined) with poses as wrong as the thesis', whose signs are not printed: all.

    To turn the whole error about is to turn the errors of the attitude about, near enough: half of the signs do.
    """
    film = kit.film_of(prepare(kit.options_of({"discs": DISCS, "view": view, "noise": NOISE, "seconds": seconds})))
    settings, true = kit.settings_of(["tracker=ekf2"]), film.truth.pose
    assert true is not None, "a film made here knows its camera"
    seen = detections.look_at(film, settings)
    off = np.array(THESIS_TABLES[_TABLE[view]]["error"]) * np.repeat([1e-3, np.radians(1.0)], 3)
    found, lost = [], 0
    for signs in product((-1.0, 1.0), repeat=5):
        d = off * (1.0, *signs)
        pose = replace(true, position=true.position + d[:3], rotation=exp(d[3:]) @ true.rotation)
        said = detections.errors(
            detections.filtered(replace(seen, pose=pose), settings, film), film.truth, film.rig.ball.radius
        )
        whole = said["tracked"] == said["frames"] and said["lost_episodes"] == 0
        found += [said["attitude_rmse_deg"]["combined"]] if whole else []
        lost += not whole
    return {"attitude": sorted(found), "lost": lost}


# ---- section ----


def section(results: Results) -> list[Part]:
    records = []
    for key, result in results.items():
        view, _, seed = key.partition("-")
        if view != "posed":
            records += filter_rows({"view": view, "films": seed}, result["trackers"], result["bound"])
    columns = {"view": "view", "films": "films", "filter": "filter", "mean_discs": "discs", **ERRORS, **AXES}
    runs = tidy(records, {**columns, "lost_episodes": "times lost", "detection.centre_rms_px": "centres, px"})
    errors = [*ERRORS.values(), *AXES.values()]
    means = by(
        runs,
        ["view", "filter"],
        {"films": "size", "discs": "mean", **dict.fromkeys(errors, rms), "times lost": "sum", "centres, px": "mean"},
    )
    typed = [[v, "thesis", t["discs"], *t["attitude"], *t["rate"]] for v, t in THESIS.items()]
    thesis = pd.DataFrame(typed, columns=["view", "filter", "discs", *AXES.values()])
    axes = list(AXES.values())
    thesis = thesis.assign(**{ATTITUDE: lengths(thesis, axes[:3]), RATE: lengths(thesis, axes[3:])})
    means = pd.concat([thesis, means]).sort_values("view", kind="stable", ascending=False)
    posed = [
        {
            "view": v, "least, °": min(r["attitude"], default=None), "most, °": max(r["attitude"], default=None),
            "lost": r["lost"]
        }
        for v in VIEWS if (r := results.get(f"posed-{v}"))
    ]  # fmt: skip
    parts: list[Part] = [Table("Table 23", means, ["view"])]
    if posed:
        words = "Attitude error of `ekf2` with the thesis' pose errors (thesis: near 0.34°, far 0.13°)"
        parts.append(Table(words, pd.DataFrame(posed)))
    return parts
