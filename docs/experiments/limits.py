"""Limits of tracking: the highest rate and acceleration, without motion blur.

A ball of 50 discs before the far camera speeds up evenly from rest about a random axis. A filter follows it if it is
not lost and if the rotation of the last 0.4 s is right to 3°. Bisection finds the limits. A limit is the first failure;
beyond it some rates may work again. `so3` has either seen the ball from all sides, or it is new. The published filters
remember no disc that is out of view.

There are no pictures: `World` says which discs a camera would see, and where. A trial goes on from the state of the
tracker at its start, so that each begins alike.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from experiments.kit import world as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Plot, Table, by, tidy, where
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import advance
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.profile import Profile

TITLE = "Limits of rate and acceleration"
ACCELERATIONS = (4.0, 16.0, 64.0, 256.0)  # rad/s²
PUSH = 3.0  # rad/s, to which the ball is sped up where the acceleration is sought
FASTEST = 25.0  # rad/s, the highest that is tried
SLOWEST, FINE = 0.1, 1.07  # rad/s, the lowest; where bisection ends
HARDEST = 2000.0  # rad/s², the highest acceleration that is tried
FLICK = 400.0  # °/s, about the fastest that hands turn the ball
PUSHED = f"acceleration to {np.degrees(PUSH):.0f} °/s, rad/s²"


@dataclass(frozen=True, slots=True)
class Trial:
    """A tracker before a ball that lies still at first, and is looked at `fps` times per second."""

    tracker: Tracker
    world: kit.World
    start: TrackState
    axis: Array  # (3,) unit vector, obj
    fps: float
    seed: int

    def course(self, before: kit.Course, motion: Profile, t: Array) -> list[kit.Course]:
        """Track `before` on at times t (n,) s after the start; end early if the ball is lost."""
        rng, attitudes = np.random.default_rng([self.seed, len(t)]), motion.attitude(t)
        made: list[kit.Course] = []
        for s, R in zip(t, attitudes, strict=True):
            seen = self.world.see(R, rng)
            state = advance(before.state, self.start.filter.stamp + float(s), seen, self.tracker).state
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

    def sped_up(self, acceleration: float, most: float) -> list[kit.Course]:
        """The start and all frames in which a ball that is sped up evenly to `most` rad/s is followed."""
        begun = kit.course_begun(self.start)
        return [begun, *self.course(begun, kit.SpedUp(self.axis, acceleration, most), self.times(most / acceleration))]

    def fastest(self, acceleration: float) -> float:
        """The highest rate, rad/s, at which a ball sped up evenly to it is followed for HOLD; 0: none."""
        courses = self.sped_up(acceleration, FASTEST)

        def holds(rate: float) -> bool:
            end = rate / acceleration
            done = len(self.times(end))
            t = self.times(end + kit.HOLD)[done:]
            motion = kit.SpedUp(self.axis, acceleration, rate)
            return done < len(courses) and len(self.course(courses[done], motion, t)) == len(t)

        ramp = self.times(FASTEST / acceleration)
        high = FASTEST if len(courses) > len(ramp) else acceleration * float(ramp[len(courses) - 1])
        return bisected(holds, SLOWEST, high)

    def hardest(self, rate: float) -> float:
        """The highest even acceleration, rad/s², to `rate` rad/s at which it is followed until HOLD later; 0: none."""

        def holds(acceleration: float) -> bool:
            t = self.times(rate / acceleration + kit.HOLD)
            return len(self.course(kit.course_begun(self.start), kit.SpedUp(self.axis, acceleration, rate), t)) == len(
                t
            )

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
    rates, seeds = ((15.0, 30.0), 1) if request.quick else (kit.RATES, 3)
    return [
        Job(f"speed-{fps:g}-{seed}", speeds, {"fps": fps, "seed": seed}, cost=2.0 + 0.07 * fps)
        for fps in rates
        for seed in range(seeds)
    ]


# ---- how fast, how suddenly ----


def speeds(fps: float, seed: int) -> Result:
    """Highest rates by acceleration (rad/s) and the highest acceleration to PUSH (rad/s²), of every tracker."""
    there = kit.world(kit.DISCS, seed)
    found: Result = {}
    for who in kit.WHO:
        tracker = kit.tracker_for(who, there)
        trial = Trial(tracker, there, kit.after_rest(who, tracker, there), kit.random_axis(seed), fps, seed)
        found[who] = {"rate": [trial.fastest(a) for a in ACCELERATIONS], "acceleration": trial.hardest(PUSH)}
    return found


# ---- section ----


def section(results: Results) -> list[Part]:
    rows = tidy(
        {
            "Hz": float(key.split("-")[1]), "filter": who, "acceleration, rad/s²": acceleration,
            "rate, °/s": np.degrees(rate), PUSHED: found["acceleration"]
        }
        for key, result in results.items()
        for who, found in result.items()
        for acceleration, rate in zip(ACCELERATIONS, found["rate"], strict=True)
    )  # fmt: skip
    gentle = where(rows, **{"acceleration, rad/s²": ACCELERATIONS[0]})
    medians = by(gentle, ["Hz", "filter"], {"rate, °/s": "median", PUSHED: "median"})
    between = medians.assign(**{"between two frames from, rad/s²": PUSH * medians["Hz"]})
    return [
        Table(
            f"Highest rate at {ACCELERATIONS[0]:g} rad/s² and highest acceleration that are followed (medians; "
            f"tried: up to {np.degrees(FASTEST):.0f} °/s and {HARDEST:.0f} rad/s²)",
            between,
            ["Hz"],
        ),
        Plot(
            "limits",
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
