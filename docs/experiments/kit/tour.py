"""A tour that leaves no axis out, filmed in any way, and what filters make of it."""

from dataclasses import replace
from typing import Any

import numpy as np

from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit.job import Result
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.profile import Gesture, Gestures

CLASSIC = ("ekf1", "ekf2")
PUBLISHED = "ekf2, as published"  # with the thesis' sigma_w, of a slower motion
KNOWN, ESTIMATED, IGNORED = "so3", "so3, estimated", "so3, ignored"  # the readout
NEAR = 0.1  # °, a good attitude: a millimetre of a ball of 0.6 m radius, one count
SHARE = 0.05  # of the ball's own rate (RMS), a good rate
FAR_OFF = 1.0  # °, an attitude that is lost
FOLLOWED = 0.9  # share of the frames, less of which is a ball that is lost
NOISE = 3.0  # grey values
USUAL = 30  # frames per second
_AT_REST = 1e-3  # rad/s²: a filter takes no sigma of zero, and a hundredth of the usual one is as still
_REST, _HASTE = 0.2, np.radians(72.0)  # s before the first turn; rad/s², mean rate of a turn over its length
AXES = ((1, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 1), (1, 0, -1), (1, 1, 1))  # of the turns, obj


def filmed(film: dict[str, Any], seed: int, seconds: float) -> kit.Film:
    """A film with the options `film` of the ball on a tour, with places of the discs of its own."""
    plain = {"noise": NOISE, "fps": float(USUAL), "seed": seed, "seconds": seconds}
    simulation = prepare(kit.options_of({**plain, **film}))
    return kit.film_of(replace(simulation, profile=tour(seed, seconds)), f"tour {seed}")


def tour(seed: int, seconds: float) -> Gestures:
    """Turns from rest to rest about axes that leave no direction out, each as hasty as the others."""
    rng = np.random.default_rng([seed, len(AXES)])
    length = (seconds - _REST) / len(AXES)
    gestures = []
    for k, i in enumerate(rng.permutation(len(AXES))):
        x, y, z = np.array(AXES[i]) / np.linalg.norm(AXES[i])
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


def followed(film: kit.Film, seen: detections.Sights, rigs: dict[str, Rig], published: bool = False) -> Result:
    """A film by the classic filters, which saw it as `seen`, and by `so3` with each of the rigs; and the bound.

    The published filters get the true acceleration; `published`: `ekf2` once more with that of the thesis.
    """
    assert film.truth.motion is not None, "a film made here knows its motion"
    rows: Result = {}
    classic = {name: kit.settings_of([f"tracker={name}", suited(film.truth.motion)]) for name in CLASSIC}
    if published:
        classic[PUBLISHED] = kit.settings_of(["tracker=ekf2"])
    for name, settings in classic.items():
        run = detections.filtered(seen, settings, film)
        rows[name] = brief(detections.errors(run, film.truth, film.rig.ball.radius))
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
    """Return RMS and maximum of the rate, °/s, and of the acceleration, rad/s²."""
    speed = np.degrees(np.linalg.norm(motion.rate, axis=1))
    return {"rms": float(np.sqrt(np.mean(speed**2))), "peak": float(speed.max()), "acceleration": acceleration(motion)}


def brief(report: Result) -> Result:
    """Return the combined errors of a run and how often it lost the ball."""
    return {
        "attitude": report["attitude_rmse_deg"]["combined"], "rate": report["rate_rmse_deg_s"]["combined"],
        "lost": report["lost_episodes"], "tracked": report["tracked"], "frames": report["frames"]
    }  # fmt: skip


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
