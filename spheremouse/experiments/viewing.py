"""How the camera films: frame rate, resolution, motion blur, rolling shutter; errors beside the least possible ones.

Wittich 2017, chapter 5, leaves frame rate and resolution open. The ball turns from rest to rest about one axis after
the other; each film has other places of the discs and another order of the axes.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spheremouse.ball.rig import UNKNOWN_READOUT, Rig
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.errors import PoseError
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit import sights
from spheremouse.experiments.kit.job import Job, Request, Result
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.profile import Gesture, Gestures

TITLE = "How the camera films: frame rate, resolution, blur, rolling shutter (Wittich 2017, chapter 5)"

CLASSIC = ("ekf1", "ekf2")
PUBLISHED = "ekf2, as published"  # with the thesis' sigma_w, of a slower motion
KNOWN, ESTIMATED, IGNORED = "so3", "so3, estimated", "so3, ignored"  # the readout
NEAR = 0.1  # °, a good attitude: a millimetre of a ball of 0.6 m radius, one count
SHARE = 0.05  # of the ball's own rate (RMS), a good rate
FAR_OFF = 1.0  # °, an attitude that is lost
FOLLOWED = 0.9  # share of the frames, less of which is a ball that is lost
_NOISE = 3.0  # grey values
_FASTEST = 240  # frames per second, of the film from which the slower ones are taken
_USUAL = 30  # frames per second
_AT_REST = 1e-3  # rad/s²: a filter takes no sigma of zero, and a hundredth of the usual one is as still
_REST, _HASTE = 0.2, np.radians(72.0)  # s before the first turn; rad/s², mean rate of a turn over its length
_AXES = ((1, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 1), (1, 0, -1), (1, 1, 1))  # of the turns, obj


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
    seconds = min(1e-3 * float(word), 1.0 / _USUAL)
    return {"blur": seconds} if kind == "blur" else {"readout": seconds}


def _cost(film: dict[str, Any]) -> float:
    """s, about."""
    width, height = film.get("size", (640, 480))
    return 2.5 + 2.0 * width * height / (640 * 480)


# ---- films ----


def at_rates(seed: int, seconds: float, rates: list[int]) -> Result:
    """One film at 240 frames per second, and what it is when only each second, third, ... frame is taken."""
    assert all(_FASTEST % rate == 0 for rate in rates), "a rate must divide that of the film"
    film = filmed({"fps": float(_FASTEST)}, seed, seconds)
    seen = sights.look_at(film, kit.settings_of(["tracker=ekf2"]))
    found: Result = {}
    for rate in rates:
        every = _FASTEST // rate
        fewer = replace(seen, stamps=seen.stamps[::every], detections=seen.detections[::every])
        found[str(rate)] = followed(thinned(film, every), fewer, {KNOWN: film.rig}, published=True)
    return {"points": found}


def with_film(seed: int, seconds: float, film: dict[str, Any]) -> Result:
    """One film by all trackers. Where the targets are not found the true pose is taken, and that is said."""
    shot = filmed(film, seed, seconds)
    settings, said = kit.settings_of(["tracker=ekf2"]), None
    try:
        seen = sights.look_at(shot, settings)
    except PoseError as e:
        said = str(e)
        shot = replace(shot, rig=replace(shot.rig, pose=shot.truth.pose))
        seen = sights.look_at(shot, settings)
    rigs = {KNOWN: shot.rig}
    if shot.rig.readout_s > 0.0:
        none = replace(shot.rig, readout_s=0.0)
        rigs |= {ESTIMATED: replace(none, readout_sigma_s=UNKNOWN_READOUT), IGNORED: none}
    return {**followed(shot, seen, rigs), "pose": said}


def filmed(film: dict[str, Any], seed: int, seconds: float) -> kit.Film:
    """A film with the options `film` of the ball on a tour, with places of the discs of its own."""
    plain = {"noise": _NOISE, "fps": float(_USUAL), "seed": seed, "seconds": seconds}
    simulation = prepare(kit.options_of({**plain, **film}))
    return kit.made(replace(simulation, profile=tour(seed, seconds)), f"tour {seed}")


def tour(seed: int, seconds: float) -> Gestures:
    """Turns from rest to rest about axes that leave no direction out, each as hasty as the others."""
    rng = np.random.default_rng([seed, len(_AXES)])
    length = (seconds - _REST) / len(_AXES)
    gestures = []
    for k, i in enumerate(rng.permutation(len(_AXES))):
        x, y, z = np.array(_AXES[i]) / np.linalg.norm(_AXES[i])
        angle = _HASTE * length**2 * rng.choice([-1.0, 1.0])
        gestures.append(Gesture(_REST + k * length, length, (float(x), float(y), float(z)), float(angle)))
    return Gestures(tuple(gestures), seconds)


def thinned(film: kit.Film, every: int) -> kit.Film:
    """Each `every`-th frame of it, from the first."""
    truth, motion, discs = film.truth, film.truth.motion, film.truth.discs
    assert motion is not None, "a film made here knows its motion"
    assert discs is not None, "and where its discs are"
    fewer = Truth(motion.stamp[::every], motion.attitude[::every], motion.rate[::every])
    kept = discs.frame % every == 0
    columns = {name: getattr(discs, name)[kept] for name in DiscTruth.__slots__}
    left = DiscTruth(**{**columns, "frame": columns["frame"] // every})
    frames = tuple(replace(f, sequence=i) for i, f in enumerate(film.frames[::every]))
    return replace(film, frames=frames, truth=replace(truth, motion=fewer, discs=left))


def followed(film: kit.Film, seen: sights.Sights, rigs: dict[str, Rig], published: bool = False) -> Result:
    """A film by the classic filters, which saw it as `seen`, and by `so3` with each of the rigs; and the bound.

    The classic filters are told the true acceleration; `published`: `ekf2` once more with that of the thesis.
    """
    assert film.truth.motion is not None, "a film made here knows its motion"
    rows: Result = {}
    classic = {name: kit.settings_of([f"tracker={name}", suited(film.truth.motion)]) for name in CLASSIC}
    if published:
        classic[PUBLISHED] = kit.settings_of(["tracker=ekf2"])
    for name, settings in classic.items():
        run = sights.filtered(seen, settings, film)
        rows[name] = brief(sights.errors(run, film.truth, film.rig.ball.radius))
    limit = None
    for name, rig in rigs.items():
        tracked = kit.tracked(film, kit.settings_of(), rig=replace(rig, pose=seen.pose))
        rows[name] = brief(tracked.report)
        if name == KNOWN:
            limit = kit.bound(film, tracked)
    return {"rows": rows, "bound": least(limit), "moved": moved(film.truth.motion)}


def suited(motion: Truth) -> str:
    """The setting by which a classic filter knows how a ball is moved: its acceleration, RMS per axis, as sigma_w."""
    return f"euler.acceleration_sigma={max(acceleration(motion), _AT_REST)}"


def acceleration(motion: Truth) -> float:
    """rad/s², RMS per axis."""
    return float(np.sqrt(np.mean((np.diff(motion.rate, axis=0) / np.diff(motion.stamp)[:, None]) ** 2)))


def moved(motion: Truth) -> dict[str, float]:
    """How lively a motion is: °/s, RMS and at most; rad/s²."""
    speed = np.degrees(np.linalg.norm(motion.rate, axis=1))
    return {
        "rms": float(np.sqrt(np.mean(speed**2))),
        "peak": float(speed.max()),
        "acceleration": acceleration(motion),
    }


def brief(report: Result) -> Result:
    """What is compared of a run: combined errors, times lost."""
    return {
        "attitude": report["attitude_rmse_deg"]["combined"],
        "rate": report["rate_rmse_deg_s"]["combined"],
        "lost": report["lost_episodes"],
        "tracked": report["tracked"],
        "frames": report["frames"],
    }


def least(limit: Result | None) -> Result | None:
    """The bound's part of the same."""
    if limit is None or limit["attitude_deg"] is None or limit["rate_deg_s"] is None:
        return None
    return {"attitude": limit["attitude_deg"]["combined"], "rate": limit["rate_deg_s"]["combined"]}


def is_lost(row: Result) -> bool:
    """The tracker said so, or tracked too few frames, or its attitude is no longer the ball's."""
    if row["attitude"] is None or row["tracked"] < FOLLOWED * row["frames"]:
        return True
    return bool(row["lost"] or row["attitude"] > FAR_OFF)


# ---- for a reader ----


# ---- figures ----
