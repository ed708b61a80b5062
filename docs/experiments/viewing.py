"""Errors by frame rate, resolution, motion blur and rolling shutter, beside the theoretical bound.

Wittich 2017, chapter 5, leaves frame rate and resolution open. The ball turns from rest to rest about one axis after
the other; each film has other places of the discs and another order of the axes.
"""

from dataclasses import dataclass, replace
from typing import Any

from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result
from experiments.kit.tour import (
    CLASSIC,
    ESTIMATED,
    IGNORED,
    KNOWN,
    PUBLISHED,
    USUAL,
    filmed,
    followed,
    thinned,
)
from spheremouse.ball.rig import UNKNOWN_READOUT
from spheremouse.errors import PoseError

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
            ("15", "30", "60", "240"), "", True, (*CLASSIC, PUBLISHED, KNOWN),
        ),
        Kind(
            "size", "Resolution", "rows of the picture", ("320x240", "480x360", "640x480", "1280x720",
            "1920x1080"), ("320x240", "640x480"), "640x480", True, (*CLASSIC, KNOWN),
        ),
        Kind(
            "blur", "Motion blur", "exposure, ms", ("0", "8", "16", "24", "33"), ("0", "33"), "0", False,
            (*CLASSIC, KNOWN),
        ),
        Kind(
            "readout", "Rolling shutter", "readout, ms", ("0", "10", "20", "30"), ("0", "30"), "0", False,
            (*CLASSIC, IGNORED, ESTIMATED, KNOWN),
        ),
    )
}  # fmt: skip


def jobs(request: Request) -> list[Job]:
    """One per film; that at 240 frames per second makes all the slower ones."""
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
    """Options of `simulate` for a value."""
    if kind == "size":
        return {"size": [int(x) for x in word.split("x")]}
    seconds = min(1e-3 * float(word), 1.0 / USUAL)
    return {"blur": seconds} if kind == "blur" else {"readout": seconds}


def _cost(film: dict[str, Any]) -> float:
    """s, about."""
    width, height = film.get("size", (640, 480))
    return 2.5 + 2.0 * width * height / (640 * 480)


# ---- films ----


def at_rates(seed: int, seconds: float, rates: list[int]) -> Result:
    """One film at 240 frames per second, and what it is when only each second, third, ... frame is taken."""
    assert all(FASTEST % rate == 0 for rate in rates), "a rate must divide that of the film"
    film = filmed({"fps": float(FASTEST)}, seed, seconds)
    seen = detections.look_at(film, kit.settings_of(["tracker=ekf2"]))
    found: Result = {}
    for rate in rates:
        every = FASTEST // rate
        fewer = replace(seen, stamps=seen.stamps[::every], detections=seen.detections[::every])
        found[str(rate)] = followed(thinned(film, every), fewer, {KNOWN: film.rig}, published=True)
    return {"points": found}


def with_film(seed: int, seconds: float, film: dict[str, Any]) -> Result:
    """One film by all trackers. If the targets are not found, the true pose is used, and the report states it."""
    shot = filmed(film, seed, seconds)
    settings, said = kit.settings_of(["tracker=ekf2"]), None
    try:
        seen = detections.look_at(shot, settings)
    except PoseError as e:
        said = str(e)
        shot = replace(shot, rig=replace(shot.rig, pose=shot.truth.pose))
        seen = detections.look_at(shot, settings)
    rigs = {KNOWN: shot.rig}
    if shot.rig.readout_s > 0.0:
        none = replace(shot.rig, readout_s=0.0)
        rigs |= {ESTIMATED: replace(none, readout_sigma_s=UNKNOWN_READOUT), IGNORED: none}
    return {**followed(shot, seen, rigs), "pose": said}
