"""Limits of tracking: rate, acceleration, size of a cover, and time to recover.

Most of it without pictures: `World` says which discs a camera would see, and where. What a detector adds, smeared discs
and discs that a cover cuts, is filmed. A trial goes on from the state of the tracker at its start, so that each begins
alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.covers import (
    COUNTS,
    COVERS,
    FILMED,
    Eye,
    View,
    covered,
    found_again,
    shown,
)
from experiments.kit.film import TRACKERS
from experiments.kit.job import Job, Request, Result
from experiments.kit.world import (
    DISCS,
    HOLD,
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
from spheremouse.simulate.ball.profile import Profile

ACCELERATIONS = (4.0, 16.0, 64.0, 256.0)  # rad/s²
PUSH = 3.0  # rad/s, to which the ball is sped up where the acceleration is sought
FASTEST = 25.0  # rad/s, the highest that is tried
SLOWEST, FINE = 0.1, 1.07  # rad/s, the lowest; where bisection ends
HARDEST = 2000.0  # rad/s², the highest acceleration that is tried

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
        return _bisected(holds, SLOWEST, high)

    def hardest(self, rate: float) -> float:
        """The highest even acceleration, rad/s², to `rate` rad/s at which it is followed until HOLD later; 0: none."""

        def holds(acceleration: float) -> bool:
            t = self.times(rate / acceleration + HOLD)
            return len(self.course(course_begun(self.start), SpedUp(self.axis, acceleration, rate), t)) == len(t)

        return _bisected(holds, 1.0, HARDEST)


def _bisected(holds: Callable[[float], bool], low: float, high: float) -> float:
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
    kinds = list(FILMED if quick else COVERS)
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
    found += [
        Job(f"cover-{n}-{k}", covered, {"discs": n, "layout": k, "pictures": False, "kinds": kinds}, cost=4.0)
        for n in ((DISCS,) if quick else COUNTS)
        for k in range(films)
    ]
    found += [
        Job(f"again-{fps:g}-{seed}", found_again, {"fps": fps, "seed": seed, "pictures": False}, cost=1.0 + 0.024 * fps)
        for fps in rates
        for seed in range(seeds)
    ]
    if not quick:
        found.append(
            Job(
                f"cover-{DISCS}-0-filmed",
                covered,
                {"discs": DISCS, "layout": 0, "pictures": True, "kinds": list(FILMED)},
                cost=20.0,
            )
        )
        found.append(Job("again-30-0-filmed", found_again, {"fps": 30.0, "seed": 0, "pictures": True}, cost=12.0))
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


# ---- pictures or none ----


# ---- covers ----


# ---- found again ----


def in_degrees(rate: float) -> float:
    return float(np.degrees(rate))


# ---- figures of this kind ----
