"""A recording like R1 of Wittich 2017 (section 4.1.1), which is not available: a player rolls a ball with a camera
in front of it and a trackball under it. Film and mouse's log out, and how well a run agrees with the log (eq. 175).

As there: 32 discs, 640x480 at 30 Hz, the lens of table 5. Noise, exposure, hands and the trackball are our guess of
what is usual; the shutter does not roll.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.kit.film import Film, film_of, options_of
from experiments.kit.trackball import Trackball, simulate_log, trackball_matrix
from spheremouse.ball.truth import Truth
from spheremouse.evaluation.metrics import pearson, surface_travel
from spheremouse.evaluation.run import Run
from spheremouse.evaluation.trackball import CountPath
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array, log
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.profile import Profile, play

PACE = 0.5  # of `play`: at its full pace the published filters lose the ball too often for what R1 shows (`filters`)
SECONDS = 30.0  # s
LAG, SCALE = 0.083, 240.0  # s, counts/rad: unknown to the comparison
OPTIONS: dict[str, Any] = {
    "discs": 32, "noise": 4.0, "blur": 0.01, "hands": True, "dist": [-0.49141, 0.29957, -0.00369, -0.00077, -0.11383]
}  # fmt: skip
TRACKBALL = Trackball(
    trackball_matrix(SCALE, SCALE),
    slowest=40.0,  # Hz: reports come unevenly
    lag=LAG,
    drift=2e-4,
    stamp_sigma=0.003,
    grip=30.0,  # rad/s²: it slips when the ball is jerked
    dropouts=0.1,
)

_STEP = 0.005  # s, between the lags that are tried
_MAX_LAG_S = 0.5  # s, to either side


@dataclass(frozen=True, slots=True)
class Slowed:
    profile: Profile
    pace: float  # 0.5: half as fast

    @property
    def seconds(self) -> float:
        return self.profile.seconds / self.pace

    def attitude(self, t: Array) -> Array:
        return self.profile.attitude(self.pace * np.asarray(t, dtype=float))

    def rate(self, t: Array) -> Array:
        return self.pace * self.profile.rate(self.pace * np.asarray(t, dtype=float))


def filmed(seconds: float = SECONDS, pace: float = PACE, seed: int = 0) -> tuple[Film, MouseLog]:
    """The film, in memory, and what the mouse logged meanwhile."""
    motion = Slowed(play(pace * seconds, np.random.default_rng([seed, 2])), pace)
    simulation = prepare(options_of({**OPTIONS, "seconds": seconds, "seed": seed}))
    film = film_of(replace(simulation, profile=motion), "R1-like")
    return film, simulate_log(motion.rate, 0.0, seconds, TRACKBALL, seed)


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of the speeds between frames with a log, at the best lag."""

    r: float  # Pearson's, x and y as one series
    lag: float  # s
    scale: float  # counts/mm, the regression's s
    offset: float  # counts/s, its a


def agreement(begin: Array, end: Array, moved: Array, mouse: MouseLog) -> Agreement | None:
    """Eq. 175 at every lag; None where nothing varies.

    `moved` (n, 2) mm of ball surface from `begin` to `end`, (n,) s. The log's counts in the same times are the
    reference: as speeds, since frames do not all take the same time.
    """
    counts, dt = CountPath.from_log(mouse), (end - begin)[:, None]
    speed = moved / dt
    best: Agreement | None = None
    for lag in np.arange(-_MAX_LAG_S, _MAX_LAG_S + 0.5 * _STEP, _STEP):
        known = (begin + lag >= mouse.stamp[0]) & (end + lag <= mouse.stamp[-1])
        if np.count_nonzero(known) < 0.5 * len(known):
            continue
        true = ((counts.at(end + lag) - counts.at(begin + lag)) / dt)[known].ravel()
        m = speed[known].ravel()
        r = pearson(m, true)
        if r is not None and (best is None or r > best.r):
            s = float(np.cov(m, true)[0, 1] / np.var(m, ddof=1))
            best = Agreement(r, float(lag), s, float(true.mean() - s * m.mean()))
    return best


def of_run(run: Run, mouse: MouseLog, radius: float) -> Agreement | None:
    """Return the agreement of a tracker's motion over pairs of tracked frames; `radius` m."""
    k = run.steps
    if len(k) < 3:
        return None
    return agreement(run.stamp[k - 1], run.stamp[k], surface_travel(run.rotation[k], radius), mouse)


def of_truth(motion: Truth, mouse: MouseLog, radius: float) -> Agreement | None:
    """Return the true motion. A tracker agrees better only by chance."""
    turned = log(motion.attitude[1:] @ motion.attitude[:-1].transpose(0, 2, 1))
    return agreement(motion.stamp[:-1], motion.stamp[1:], surface_travel(turned, radius), mouse)
