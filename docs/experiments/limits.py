"""Limits of tracking: the highest rate and acceleration, without motion blur and with it.

A ball of 50 discs before the far camera speeds up evenly from rest about a random axis. A filter follows it if it is
not lost and if the rotation of the last 0.4 s is right to 3°. Bisection finds the limits. A limit is the first failure;
beyond it some rates may work again. `so3` has either seen the ball from all sides, or it is new. The published filters
remember no disc that is out of view.

Rates and accelerations are simulated without pictures: `World` says which discs a camera would see, and where. With
motion blur the detector is the limit, so these runs are filmed, at rates a factor of √2 apart about an axis across the
view. A trial goes on from the state of the tracker at its start, so that each begins alike.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from experiments.covers import Eye, View, shown
from experiments.kit.film import TRACKERS
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Claim, Part, Plot, Table, by, tidy, where
from experiments.kit.world import (
    DISCS,
    HOLD,
    NEW,
    RATES,
    WHO,
    Course,
    SpedUp,
    World,
    after_rest,
    course_begun,
    random_axis,
    tracker_for,
    world,
)
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.film import default_scene
from spheremouse.simulate.ball.profile import Profile

TITLE = "Limits of rate and acceleration"
ACCELERATIONS = (4.0, 16.0, 64.0, 256.0)  # rad/s²
PUSH = 3.0  # rad/s, to which the ball is sped up where the acceleration is sought
FASTEST = 25.0  # rad/s, the highest that is tried
SLOWEST, FINE = 0.1, 1.07  # rad/s, the lowest; where bisection ends
HARDEST = 2000.0  # rad/s², the highest acceleration that is tried
FLICK, FLICKED = 400.0, 64.0  # °/s, about the fastest that hands turn the ball; rad/s², about a stop by hand
PUSHED = f"acceleration to {np.degrees(PUSH):.0f} °/s, rad/s²"

EXPOSURE = 0.004  # s: as long as a camera of 240 Hz can
EXPOSURES = (0.0, 0.002, EXPOSURE, 0.008, 0.016)  # s
WHOLE = 8.0  # rad/s, up to which all of the way is filmed
LADDER = tuple(float(2.0 ** (0.5 * k)) for k in range(10))  # rad/s, that are filmed
FILMED_SECONDS, _BLIND = 0.1, 0.05  # s of a filmed trial; at its end discs must have held the attitude as late as that


@dataclass(frozen=True, slots=True)
class Trial:
    """A tracker before a ball that lies still at first, and is looked at `fps` times per second."""

    tracker: Tracker
    world: World
    start: TrackState
    axis: Array  # (3,) unit vector, obj
    fps: float
    seed: int

    def course(self, before: Course, motion: Profile, t: Array) -> list[Course]:
        """Track `before` on at times t (n,) s after the start; end early if the ball is lost."""
        rng, attitudes = np.random.default_rng([self.seed, len(t)]), motion.attitude(t)
        made: list[Course] = []
        for s, R in zip(t, attitudes, strict=True):
            state = shown(before.state, self.start.filter.stamp + float(s), self.world.see(R, rng), self.tracker)
            after = before.then(state, R)
            if after is None:
                break
            made.append(after)
            before = after
        return made

    def times(self, end: float) -> Array:
        """Frames up to `end`, s after the ball begins to move, which is not when a frame is taken."""
        phase = 0.1 + 0.8 * np.random.default_rng(self.seed).random()
        count = int(np.floor(end * self.fps - phase)) + 1
        return (np.arange(count, dtype=float) + phase) / self.fps

    def sped_up(self, acceleration: float, most: float) -> list[Course]:
        """The start and all frames in which a ball that is sped up evenly to `most` rad/s is followed."""
        begun = course_begun(self.start)
        return [begun, *self.course(begun, SpedUp(self.axis, acceleration, most), self.times(most / acceleration))]

    def fastest(self, acceleration: float) -> float:
        """The highest rate, rad/s, at which a ball sped up evenly to it is followed for HOLD; 0: none."""
        courses = self.sped_up(acceleration, FASTEST)

        def holds(rate: float) -> bool:
            end = rate / acceleration
            done = len(self.times(end))
            t = self.times(end + HOLD)[done:]
            motion = SpedUp(self.axis, acceleration, rate)
            return done < len(courses) and len(self.course(courses[done], motion, t)) == len(t)

        ramp = self.times(FASTEST / acceleration)
        high = FASTEST if len(courses) > len(ramp) else acceleration * float(ramp[len(courses) - 1])
        return bisected(holds, SLOWEST, high)

    def hardest(self, rate: float) -> float:
        """The highest even acceleration, rad/s², to `rate` rad/s at which it is followed until HOLD later; 0: none."""

        def holds(acceleration: float) -> bool:
            t = self.times(rate / acceleration + HOLD)
            return len(self.course(course_begun(self.start), SpedUp(self.axis, acceleration, rate), t)) == len(t)

        return bisected(holds, 1.0, HARDEST)


def bisected(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Bisect for the value up to which a condition holds; `high` if it always holds, 0 if never."""
    if holds(high):
        return high
    if high <= low or not holds(low):
        return 0.0
    while high > FINE * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def jobs(request: Request) -> list[Job]:
    """A camera's rate, an exposure, a ball, at a time."""
    quick = request.quick
    rates, seeds, films = ((15.0, 30.0), 1, 1) if quick else (RATES, 3, 2)
    found = [
        Job(f"speed-{fps:g}-{seed}", speeds, {"fps": fps, "seed": seed}, cost=2.0 + 0.07 * fps)
        for fps in rates
        for seed in range(seeds)
    ]
    filmed_at = [(30.0, EXPOSURE)] if quick else [(60.0, e) for e in EXPOSURES] + [(30.0, EXPOSURE), (120.0, EXPOSURE)]
    found += [
        Job(
            f"film-{fps:g}-{1e3 * e:g}-{seed}",
            filmed,
            {"fps": fps, "exposure": e, "seed": seed},
            cost=4.0 + fps * (0.05 + 15.0 * e),
        )
        for fps, e in filmed_at
        for seed in range(films if fps == 60.0 and e < EXPOSURES[-1] else 1)
    ]
    return found


# ---- how fast, how suddenly ----


def speeds(fps: float, seed: int) -> Result:
    """Highest rates by acceleration (rad/s) and the highest acceleration to PUSH (rad/s²), of every tracker."""
    there = world(DISCS, seed)
    found: Result = {}
    for who in WHO:
        tracker = tracker_for(who, there)
        trial = Trial(tracker, there, after_rest(who, tracker, there), random_axis(seed), fps, seed)
        found[who] = {
            "rate": [trial.fastest(a) for a in ACCELERATIONS],
            "acceleration": trial.hardest(PUSH),
        }
    return found


def filmed(fps: float, exposure: float, seed: int) -> Result:
    """The highest rate of LADDER, rad/s, that is followed in pictures exposed for `exposure` s; 0: none.

    The ball is brought there gently without pictures, about an axis across the view; then all see the same ones. With
    sharp pictures also the rate at which each is lost when all of the way there is filmed, and without pictures.
    """
    there, axis = world(DISCS, seed, exposure), random_axis(seed, across=True)
    trials = {}
    for who in TRACKERS:
        tracker = tracker_for(who, there)
        trials[who] = Trial(tracker, there, after_rest(who, tracker, there), axis, fps, seed)
    courses = {who: trial.sped_up(ACCELERATIONS[0], LADDER[-1]) for who, trial in trials.items()}
    found: Result = _climbed(trials, courses, Eye(there, True, seed))
    if exposure == 0.0:
        both = [_lost_at(trials, Eye(there, pictures, seed)) for pictures in (True, False)]
        found["sharp"] = {who: [rates[who] for rates in both] for who in trials}
    return found


def _lost_at(trials: dict[str, Trial], eye: "Eye") -> dict[str, float]:
    """The rate, rad/s, up to which each follows a ball that is sped up gently from rest, to WHOLE at most."""
    one = next(iter(trials.values()))
    motion = SpedUp(one.axis, ACCELERATIONS[0], WHOLE)
    going, found = {who: course_begun(trial.start) for who, trial in trials.items()}, dict.fromkeys(trials, 0.0)
    for s in one.times(WHOLE / ACCELERATIONS[0]):
        view, R = eye.at(motion, float(s)), motion.attitude(np.array([s]))[0]
        for who, course in list(going.items()):
            trial = trials[who]
            after = course.then(shown(course.state, trial.start.filter.stamp + float(s), view(None), trial.tracker), R)
            if after is None:
                del going[who]
            else:
                going[who], found[who] = after, float(ACCELERATIONS[0] * s)
    return found


def _climbed(trials: dict[str, Trial], courses: dict[str, list[Course]], eye: "Eye") -> Result:
    """The highest rate of LADDER, rad/s, that each follows for a while; `courses` lead there."""
    found, going, gentle, one = dict.fromkeys(trials, 0.0), list(trials), ACCELERATIONS[0], next(iter(trials.values()))
    for rate in LADDER:
        motion, end = SpedUp(one.axis, gentle, rate), rate / gentle
        done = len(one.times(end))
        t = one.times(end + max(FILMED_SECONDS, 5.0 / one.fps))[done:]
        going = [who for who in going if done < len(courses[who])]
        if not going:
            break
        views, attitudes = [eye.at(motion, float(s)) for s in t], motion.attitude(t)
        going = [who for who in going if _follows(trials[who], courses[who][done], t, attitudes, views)]
        found.update(dict.fromkeys(going, rate))
    return found


def _follows(trial: Trial, course: Course, t: Array, attitudes: Array, pictures: "Sequence[View]") -> bool:
    """Right to the end, and not because it is blind and the ball goes on as it did."""
    now: Course | None = course
    for s, R, view in zip(t, attitudes, pictures, strict=True):
        assert now is not None, "the loop ends where it is lost"
        now = now.then(shown(now.state, trial.start.filter.stamp + float(s), view(None), trial.tracker), R)
        if now is None:
            return False
    return now is not None and now.state.filter.stamp - now.state.confirmed_at <= max(_BLIND, 1.0 / trial.fps)


# ---- section ----


def section(results: Results) -> list[Part]:
    """Return the highest rates and accelerations, with blur and without."""
    parts = [part(rows) for part, rows in ((_speeds, _speed_rows(results)), (_films, _film_rows(results))) if len(rows)]
    return [each for part in parts for each in part]


def _speed_rows(results: Results) -> pd.DataFrame:
    return tidy(
        {
            "Hz": fps,
            "filter": who,
            "acceleration, rad/s²": acceleration,
            "rate, °/s": np.degrees(rate),
            PUSHED: found["acceleration"],
        }
        for (fps, _), result in trials(results, "speed")
        for who, found in result.items()
        for acceleration, rate in zip(ACCELERATIONS, found["rate"], strict=True)
    )


def _speeds(rows: pd.DataFrame) -> list[Part]:
    """Without pictures; 0 is lost at the least that was tried."""
    gentle = where(rows, **{"acceleration, rad/s²": ACCELERATIONS[0]})
    medians = by(gentle, ["Hz", "filter"], {"rate, °/s": "median", PUSHED: "median"})
    least = where(rows, **{"acceleration, rad/s²": FLICKED}).groupby("filter")["rate, °/s"].min()
    between = medians.assign(**{"between two frames from, rad/s²": PUSH * medians["Hz"]})
    return [
        Table(
            f"Highest rate at {ACCELERATIONS[0]:g} rad/s² and highest acceleration that are followed (medians; "
            f"tried: up to {np.degrees(FASTEST):.0f} °/s and {HARDEST:.0f} rad/s²)",
            between,
            ["Hz"],
        ),
        Claim(
            f"A flick to {FLICK:g} °/s at {FLICKED:g} rad/s² is followed by `so3` on every ball at every frame "
            "rate, whether it knows the ball or not. The published filters lose some ball.",
            least.reindex(["so3", NEW]).min(skipna=False) >= FLICK > least.reindex(list(TRACKERS[:2])).max(),
        ),
        Plot(
            "limits-speed",
            f"Highest rate at {ACCELERATIONS[0]:g} rad/s², and highest acceleration.",
            gentle.replace(0.0, np.nan),
            "Hz",
            ["rate, °/s", PUSHED],
            "filter",
            log="xy",
        ),
        Plot(
            "limits-map",
            "The rate that a ball may be sped up to, by acceleration and frame rate.",
            rows.replace(0.0, np.nan),
            "acceleration, rad/s²",
            ["rate, °/s"],
            "filter",
            "Hz",
            log="xy",
            levels={"a flick by hand": FLICK},
        ),
    ]


def _film_rows(results: Results) -> pd.DataFrame:
    return tidy(
        {
            "Hz": fps,
            "exposure, ms": exposure,
            "ball": ball,
            "filter": who,
            "rate, °/s": np.degrees(result[who]),
            "sharp": np.degrees(sharp[0]),
            "without pictures": np.degrees(sharp[1]),
        }
        for (fps, exposure, ball), result in trials(results, "film")
        for who in TRACKERS
        for sharp in [result.get("sharp", {}).get(who, (np.nan, np.nan))]
    )


def _films(rows: pd.DataFrame) -> list[Part]:
    """In pictures."""
    rows = rows.sort_values(["Hz", "exposure, ms"], kind="stable")
    medians = by(rows, ["Hz", "exposure, ms", "filter"], {"ball": "nunique", "rate, °/s": "median"})
    width = 2.0 * np.degrees(default_scene(1).disc_angle)
    smeared = {"smeared over a disc's width at, °/s": width / (1e-3 * medians["exposure, ms"]).replace(0.0, np.nan)}
    usual = rows[rows["Hz"] == rows["Hz"].mode()[0]]
    ours, sharp = where(usual, filter="so3")["rate, °/s"], rows.dropna()
    return [
        Table(
            f"Highest rate followed in pictures (medians; filmed: up to {np.degrees(LADDER[-1]):.0f} °/s)",
            medians.assign(**smeared),
            ["Hz", "exposure, ms"],
        ),
        Claim(
            f"At an even rate `so3` follows {FLICK:g} °/s on every ball with every exposure tried.", ours.min() >= FLICK
        ),
        Claim(
            "Sharp pictures, taken all the way from rest, limit no more than none do.",
            (sharp["sharp"] >= sharp["without pictures"]).all(),
        ),
        Plot(
            "limits-exposure",
            "Highest rate followed, by exposure.",
            usual.replace(0.0, np.nan),
            "exposure, ms",
            ["rate, °/s"],
            "filter",
            log="y",
        ),
    ]


def trials(results: Results, kind: str) -> Iterator[tuple[list[float], Result]]:
    """Numbers of the keys `kind-1-2`, and results."""
    for key, result in results.items():
        name, *numbers = key.removesuffix("-filmed").split("-")
        if name == kind:
            yield list(map(float, numbers)), result
