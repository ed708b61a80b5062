"""Errors by frame rate, resolution, motion blur and rolling shutter, beside the theoretical bound.

Wittich 2017, chapter 5, leaves frame rate and resolution open. The ball turns from rest to rest about one axis after
the other; each film has other places of the discs and another order of the axes. `ekf1` and `ekf2` get the true
acceleration as σ_w. Films of a lower frame rate are the film of 240 Hz with each second, third, ... frame taken. The
field of view stays with the resolution. `so3` knows the readout of a rolling shutter, or estimates it, or assumes that
there is none; `ekf1` and `ekf2` take all rows for simultaneous.

A film is lost if the tracker lost the ball, tracked less than 90 % of the frames, or is off by more than 1° (RMS).
Where no target is found, the camera's pose is given.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import detections, tour
from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Part, Plot, Table, by, tidy, where
from spheremouse.ball.rig import UNKNOWN_READOUT
from spheremouse.errors import PoseError

TITLE = "How the camera films: frame rate, resolution, blur, rolling shutter (Wittich 2017, chapter 5)"
FASTEST = 240  # frames per second, of the film from which the slower ones are taken


@dataclass(frozen=True, slots=True)
class Kind:
    """One thing that is varied; a value is a word of the jobs' keys."""

    name: str
    title: str
    label: str  # of the axis
    whole: tuple[str, ...]  # values
    quick: tuple[str, ...]
    plain: str  # the value of the film without anything special
    log: bool
    shown: tuple[str, ...]  # lines


KINDS = {
    k.name: k
    for k in (
        Kind(
            "rate", "Frame rate", "frames per second", ("15", "20", "30", "40", "60", "80", "120", "240"),
            ("15", "30", "60", "240"), "", log=True, shown=(*tour.CLASSIC, tour.PUBLISHED, tour.KNOWN),
        ),
        Kind(
            "size", "Resolution", "rows of the picture", ("320x240", "480x360", "640x480", "1280x720",
            "1920x1080"), ("320x240", "640x480"), "640x480", log=True, shown=(*tour.CLASSIC, tour.KNOWN),
        ),
        Kind(
            "blur", "Motion blur", "exposure, ms", ("0", "8", "16", "24", "33"), ("0", "33"), "0", log=False,
            shown=(*tour.CLASSIC, tour.KNOWN),
        ),
        Kind(
            "readout", "Rolling shutter", "readout, ms", ("0", "10", "20", "30"), ("0", "30"), "0", log=False,
            shown=(*tour.CLASSIC, tour.IGNORED, tour.ESTIMATED, tour.KNOWN),
        ),
    )
}  # fmt: skip


def jobs(request: Request) -> list[Job]:
    seeds, seconds = ((1,), 1.0) if request.quick else ((1, 2, 3), 3.5)
    found = []
    for seed in seeds:
        what = {"seed": seed, "seconds": seconds}
        rates = [int(v) for v in _values(KINDS["rate"], request)]
        found.append(Job(f"rate-{seed}", at_rates, {**what, "rates": rates}, cost=3.0 + 6.0 * seconds))
        found.append(Job(f"plain-{seed}", with_film, {**what, "film": {}}, cost=2.5 + 1.0 * seconds))
        for kind in ("size", "blur", "readout"):
            for word in _values(KINDS[kind], request):
                if word != KINDS[kind].plain:
                    film = _film(kind, word)
                    found.append(Job(f"{kind}-{word}-{seed}", with_film, {**what, "film": film}, cost=_cost(film)))
    return found


def _values(kind: Kind, request: Request) -> tuple[str, ...]:
    return kind.quick if request.quick else kind.whole


def _film(kind: str, word: str) -> dict[str, Any]:
    if kind == "size":
        return {"size": [int(x) for x in word.split("x")]}
    seconds = min(1e-3 * float(word), 1.0 / tour.USUAL)
    return {"blur": seconds} if kind == "blur" else {"readout": seconds}


def _cost(film: dict[str, Any]) -> float:
    width, height = film.get("size", (640, 480))
    return 2.5 + 2.0 * width * height / (640 * 480)


# ---- films ----


def at_rates(seed: int, seconds: float, rates: list[int]) -> Result:
    """Track one film at 240 frames per second, and each second, third, ... frame of it."""
    assert all(FASTEST % rate == 0 for rate in rates), "a rate must divide that of the film"
    film = tour.filmed({"fps": float(FASTEST)}, seed, seconds)
    seen = detections.look_at(film, kit.settings_of(["tracker=ekf2"]))
    found: Result = {}
    for rate in rates:
        every = FASTEST // rate
        fewer = replace(seen, stamps=seen.stamps[::every], detections=seen.detections[::every])
        found[str(rate)] = tour.followed(tour.thinned(film, every), fewer, {tour.KNOWN: film.rig}, published=True)
    return {"points": found}


def with_film(seed: int, seconds: float, film: dict[str, Any]) -> Result:
    """One film by all trackers. If the targets are not found, the true pose is used, and the report states it."""
    shot = tour.filmed(film, seed, seconds)
    settings, said = kit.settings_of(["tracker=ekf2"]), None
    try:
        seen = detections.look_at(shot, settings)
    except PoseError as e:
        said = str(e)
        shot = replace(shot, rig=replace(shot.rig, pose=shot.truth.pose))
        seen = detections.look_at(shot, settings)
    rigs = {tour.KNOWN: shot.rig}
    if shot.rig.readout_s > 0.0:
        none = replace(shot.rig, readout_s=0.0)
        rigs |= {tour.ESTIMATED: replace(none, readout_sigma_s=UNKNOWN_READOUT), tour.IGNORED: none}
    return {**tour.followed(shot, seen, rigs), "pose": said}


# ---- section ----


def section(results: Results) -> list[Part]:
    runs = _runs(results)
    limits = {"films": "size", "lost": "sum", "pose given": "sum", ATTITUDE: _median, RATE: _median, "speed": "median"}
    medians = by(runs.assign(films=0), ["kind", "value", "filter"], limits)
    enough = (medians[ATTITUDE] < tour.NEAR) & (medians[RATE] < tour.SHARE * medians["speed"]) & (medians["lost"] == 0)
    good = medians[enough & (medians["filter"] != "bound")]
    reach = good.groupby(["kind", "filter"], sort=False)["value"].agg(", ".join).unstack("kind", sort=False)
    parts: list[Part] = []
    for name, kind in KINDS.items():
        rows = where(runs, kind=name)
        rows = rows.assign(**{kind.label: [float(value.rpartition("x")[2]) for value in rows["value"]]})
        table = where(medians, kind=name).drop(columns=["kind", "speed"])
        parts += [
            Table(f"{kind.title}: medians over the films", table, ["value", "films"]),
            Plot(
                f"viewing-{name}", f"{kind.title}: combined errors, median of the films with their range.", rows,
                kind.label, [ATTITUDE, RATE], "filter", log="xy" if kind.log else "y"
            )
        ]  # fmt: skip
    return [
        *parts,
        Table(
            f"Values at which no film is lost, the attitude is good to {tour.NEAR:g}° and the rate to "
            f"{100 * tour.SHARE:g} % of the ball's own",
            reach.reset_index().fillna("none"),
        ),
    ]


def _median(values: "pd.Series[float]") -> float:
    """nan where one is not known."""
    return float(np.median(np.asarray(values, float)))


def _runs(results: Results) -> pd.DataFrame:
    """A row for each film and filter, in the order of what is varied.

    The film without anything special stands for a value of three kinds. Without a rolling shutter its readout is as
    good as known.
    """
    films = []
    for key, result in results.items():
        kind, _, rest = key.partition("-")
        if kind == "rate":
            films += [(kind, value, point) for value, point in result["points"].items()]
        elif kind == "plain":
            films += [(k.name, k.plain, result) for k in KINDS.values() if k.plain]
        else:
            films.append((kind, rest.rpartition("-")[0], result))
    order = list(KINDS)
    records = []
    for kind, value, film in sorted(films, key=lambda f: (order.index(f[0]), KINDS[f[0]].whole.index(f[1]))):
        about = {"kind": kind, "value": value, "speed": film["moved"]["rms"], "pose given": bool(film.get("pose"))}
        for who in KINDS[kind].shown:
            row = film["rows"].get(who, film["rows"][tour.KNOWN])
            records.append({**about, "filter": who, **_errors(row), "lost": tour.is_lost(row)})
        records.append({**about, "filter": "bound", **_errors(film["bound"] or {}), "lost": False})
    return tidy(records)


def _errors(row: Result) -> Result:
    return {ATTITUDE: row.get("attitude"), RATE: row.get("rate")}
