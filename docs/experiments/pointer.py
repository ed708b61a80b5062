"""Delay, roughness and error of the resampled pointer, by frame rate and settings.

`so3` follows a ball in play, and one that is stopped from 400 °/s; its counts and rates go through the daemon's own
resampling (`spheremouse.output.pointer`) with the frames' stamps and times of arrival. Nothing here reads a clock. A
frame is assumed to arrive 10 ms and 1.2 frame intervals after its stamp. *To the next frame* is a horizon of that and
one interval more, *one frame* an interval alone. A lag search gives the delay between the visible pointer and the ball.
Roughness is the RMS of second differences of the pointer's place every 4 ms.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from experiments.kit.film import settings_of
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Plot, Table, by, tidy, where
from experiments.kit.world import DISCS, RATES, World, known_ball, world
from spheremouse.ball.build import begin, build
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import advance
from spheremouse.geometry.rotation import Array
from spheremouse.output.counts import Counter, MotionSettings
from spheremouse.output.pointer import PointerSettings, Resampler, due, take
from spheremouse.simulate.ball.profile import Gestures, Profile, play, stroke
from spheremouse.tracker import Estimate

NONE, ZERO, ONE, DEFAULT, NEXT = "without", "horizon 0", "one frame", "default", "to the next frame"
TITLE = "The pointer between frames: delay, distance, smoothness, overshoot"
WAYS = (NONE, ZERO, ONE, DEFAULT, NEXT)
FIXED, FRAMES = 0.01, 1.2  # s, and frames: from a frame's stamp to its arrival; 50 ms at 30 Hz, 30 ms at 60 Hz
SHOWN = 0.004  # s, between two looks at the pointer
SPEED, STOPPED, HELD = float(np.radians(400.0)), (0.05, 0.2), 0.25  # rad/s; s, in which it is stopped, and before
OVERSHOOT = "overshoot, counts"
_BEGIN = 1.2  # s: the ball begins to move after one second, and frames arrive later
_INTEGRATION_STEP_S, _SAME = 1e-3, 1e-9  # s: of the integration; rounding of times
_LAG_STEP = 0.002  # s
_LAGS = np.arange(-0.05, 0.4, _LAG_STEP)  # s, that are tried


def latency(fps: float) -> float:
    """From stamp to arrival, s: exposure, the wire, decoding, a step. Assumed, as in docs/pointer.md."""
    return FIXED + FRAMES / fps


def settings(way: str, fps: float) -> PointerSettings:
    horizon = {ZERO: 0.0, ONE: 1.0 / fps, DEFAULT: PointerSettings().horizon, NEXT: latency(fps) + 1.0 / fps}[way]
    return PointerSettings(horizon=horizon)


# ---- what frames say ----


@dataclass(frozen=True, slots=True)
class Told:
    """Counts and rates of the frames of a motion."""

    stamp: Array  # (n,) s
    counts: Array  # (n, 3)
    rate: Array  # (n, 3) counts/s
    tracking: Array  # (n,) bool: discs hold the attitude, as the daemon tells its reporter


def _seen(tracker: Tracker, start: TrackState, there: World, motion: Profile, stamps: Array, seed: int) -> Told:
    """By `so3` without pictures, from `start` on; stamps are those of the motion."""
    rng, state, motions = np.random.default_rng([seed, 5]), start, []
    for t, R in zip(stamps, motion.attitude(stamps), strict=True):
        state, moved, _ = advance(state, start.filter.stamp + float(t), there.see(R, rng), tracker)
        motions.append(moved)
    return _as_told(tracker, motions, stamps)


def _as_told(tracker: Tracker, motions: list[Estimate], stamps: Array) -> Told:
    counter = Counter(_matrix(tracker))
    made = [counter.counts(m) for m in motions]
    counts, rate = np.array([c for c, _ in made]), np.array([rate or (0.0, 0.0, 0.0) for _, rate in made])
    return Told(stamps, counts, rate, np.array([m.confirmed for m in motions]))


def _matrix(tracker: Tracker) -> Array:
    return MotionSettings().matrix(tracker.rig.radius_m)


# ---- what the pointer makes of it ----


@dataclass(frozen=True, slots=True)
class Path:
    """Path of a pointer or of the ball, in intervals of SHOWN."""

    t: Array  # (n,) s
    place: Array  # (n, 3) counts


def ball(motion: Profile, end: float, matrix: Array) -> Path:
    """The true path, not rounded."""
    fine = np.arange(0.0, end + 0.5 * _INTEGRATION_STEP_S, _INTEGRATION_STEP_S)
    speed = motion.rate(fine) @ matrix.T
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (speed[1:] + speed[:-1]) * _INTEGRATION_STEP_S, axis=0)])
    every = round(SHOWN / _INTEGRATION_STEP_S)
    return Path(fine[::every], place[::every])


def pointer(told: Told, fps: float, way: PointerSettings | None, t: Array) -> Array:
    """Return the place at times t, (n, 3) counts; without resampling (None), counts are sent with each frame."""
    late = latency(fps)
    arrivals = told.stamp + late
    if way is None:
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(told.counts, axis=0)])
        return sums[np.searchsorted(arrivals, t + _SAME, side="right")]
    times: list[float] = [-np.inf]
    places: list[tuple[int, int, int]] = [(0, 0, 0)]
    resampler, sent = Resampler(), (0, 0, 0)
    ends = [*arrivals[1:].tolist(), arrivals[-1] + 1.0]
    frames = zip(told.counts.tolist(), told.rate.tolist(), told.stamp.tolist(), arrivals.tolist(), ends, strict=True)
    for k, (counts, rate, stamp, now, end) in enumerate(frames):
        known = tuple(rate) if told.tracking[k] else None
        resampler = take(resampler, sent, tuple(counts), known, stamp, now, way)
        for n in range(int((end - now) * way.rate + 1.0 - 1e-6)):
            report = now + n / way.rate
            sent = due(resampler, report)
            times.append(report)
            places.append(sent)
            if report > resampler.until:
                break  # nothing more is due until there is a new frame
    return np.array(places, dtype=float)[np.searchsorted(times, t + _SAME, side="right") - 1]


def measured(shown: Array, true: Path, begin: float) -> Result:
    """Distance (RMS, counts), roughness (RMS of second differences, counts) and delay (ms) from `begin` on.

    The delay is that with which the pointer follows the ball best (as Wittich 2017, section 4.1.1).
    """
    late = true.t >= begin
    off, bends = (shown - true.place)[late], np.diff(shown[late], 2, axis=0)
    return {
        "off": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        "rough": float(np.sqrt(np.mean(bends**2))),
        "delay": delay(shown[late], Path(true.t[late], true.place[late])),
    }


def delay(shown: Array, true: Path) -> float | None:
    """ms, by which the ball's path has to be shifted to come nearest; None for a pointer that does not move."""
    if not np.any(np.diff(shown, axis=0)):
        return None
    away = []
    for lag in _LAGS:
        past = true.t - lag
        inside = (past >= true.t[0]) & (past <= true.t[-1])
        ball_ = np.stack([np.interp(past[inside], true.t, true.place[:, k]) for k in range(3)], axis=1)
        away.append(np.mean((shown[inside] - ball_) ** 2))
    k = int(np.clip(np.argmin(away), 1, len(_LAGS) - 2))
    left, middle, right = away[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    return 1e3 * float(_LAGS[k] + (0.5 * (left - right) / bend * _LAG_STEP if bend > 0.0 else 0.0))


# ---- jobs ----


def jobs(request: Request) -> list[Job]:
    quick = request.quick
    rates, seeds, seconds, phases = ((15.0, 30.0), 1, 8.0, 2) if quick else (RATES, 2, 20.0, 6)
    return [
        *(
            Job(
                f"play-{fps:g}-{seed}", played, {"fps": fps, "seed": seed, "seconds": seconds},
                cost=2.0 + 0.002 * seconds * fps
            )
            for fps in rates
            for seed in range(seeds)
        ),
        *(
            Job(f"stop-{fps:g}", stopped, {"fps": fps, "phases": phases}, cost=2.0 + 0.01 * phases * fps)
            for fps in rates
        )
    ]  # fmt: skip


def played(fps: float, seed: int, seconds: float) -> Result:
    there = world(DISCS, seed)
    tracker = build(there.rig, there.scene.pose, settings_of())
    motion = play(seconds, np.random.default_rng([seed, 2]))
    stamps = np.arange(1.0, seconds * fps) / fps
    told = _seen(tracker, begin(tracker, 0.0), there, motion, stamps, seed)
    true = ball(motion, float(stamps[-1]), _matrix(tracker))
    paths = {way: pointer(told, fps, None if way == NONE else settings(way, fps), true.t) for way in WAYS}
    found: Result = {way: measured(path, true, _BEGIN) for way, path in paths.items()}
    return {**found, "tracked": float(np.mean(told.tracking))}


def stopped(fps: float, phases: int) -> Result:
    """A ball at SPEED is stopped by hand: how far the pointer goes beyond, counts; by way and time of the stop."""
    there = world(DISCS, 0)
    tracker = build(there.rig, there.scene.pose, settings_of())
    start = known_ball(tracker, there)
    found: Result = {way: {f"{down:g}": [] for down in STOPPED} for way in WAYS}
    for down in STOPPED:
        for k in range(phases):
            axis = (1.0, 0.0, 0.0) if k % 2 else (0.0, 0.0, 1.0)
            push = stroke(0.3 + k / phases / fps, axis, SPEED, up=0.12, hold=HELD, down=down)
            end = push.start + push.length
            motion = Gestures((push,), end + 0.5)
            stamps = np.arange(1.0, motion.seconds * fps) / fps
            told = _seen(tracker, start, there, motion, stamps, k)
            true = ball(motion, motion.seconds, _matrix(tracker))
            moved = int(np.argmax(np.abs(true.place[-1])))
            way_ = np.sign(true.place[-1, moved])
            for way in WAYS:
                path = pointer(told, fps, None if way == NONE else settings(way, fps), true.t)
                beyond = way_ * (path[:, moved] - true.place[-1, moved])
                found[way][f"{down:g}"].append(float(max(beyond.max(), 0.0)))
    return found


# ---- section ----


def section(results: Results) -> list[Part]:
    plays, stops = _plays(results), _stops(results)
    medians = {"delay, ms": "median", "distance RMS, counts": "median", "roughness, counts": "median"}
    shown = where(plays, pointer=[NONE, ONE, DEFAULT, NEXT])
    overshoot = by(
        stops.assign(most=stops[OVERSHOOT]), ["Hz", "pointer", "stopped in, ms"], {OVERSHOOT: "median", "most": "max"}
    )
    return [
        Table("Somebody plays (medians over motions)", by(shown, ["Hz", "pointer"], medians), ["Hz"]),
        Plot("pointer", "The pointer while somebody plays.", shown, "Hz", list(medians), "pointer", log="x"),
        Table("Overshoot of a ball stopped by hand (median and most)", overshoot, ["Hz", "pointer"]),
    ]


def _plays(results: Results) -> pd.DataFrame:
    """A row for each motion and way of moving the pointer."""
    records = []
    for key, result in results.items():
        name, *numbers = key.split("-")
        if name == "play":
            records += [{"Hz": float(numbers[0]), "pointer": way, **result[way]} for way in WAYS]
    names = {"delay": "delay, ms", "off": "distance RMS, counts", "rough": "roughness, counts"}
    return tidy(records, {"Hz": "Hz", "pointer": "pointer", **names}).sort_values("Hz", kind="stable")


def _stops(results: Results) -> pd.DataFrame:
    records = [
        {"Hz": float(key.removeprefix("stop-")), "pointer": way, "stopped in, ms": 1e3 * down, OVERSHOOT: beyond}
        for key, result in results.items()
        if key.startswith("stop-")
        for way in (NONE, ONE, DEFAULT, NEXT)
        for down in STOPPED
        for beyond in result[way][f"{down:g}"]
    ]
    return tidy(records, ["Hz", "pointer", "stopped in, ms", OVERSHOOT]).sort_values("Hz", kind="stable")
