"""Predict the pointer between frames, without losing counts and without sending them twice.

The input is one record a frame: whole counts, and the filter's rate in counts per second. The output is the sum of
counts that is due at any later time. Sums are whole numbers; only the prediction is a real number. Frame stamps and
report times are on the same clock. docs/pointer.md shows the effect.

For each axis the sum is `truth + direction * (overshoot + u)`. `truth` is the sum over all frames, `direction` the sign
of the last counts. When a frame comes, u starts at the pointer's position and goes in a straight line to the prediction
for a time before the next frame. Then it follows the prediction, `speed * age + acceleration * age² / 2`, until
`horizon` or until the ball would stop. u never decreases. If a frame shows that the pointer went too far, the excess
stays in `ahead` until the ball has caught up. If the ball reverses instead, the excess stays in `overshoot` until the
ball comes back.
"""

from dataclasses import dataclass, replace
from math import floor, inf, isfinite

from spheremouse.output import Counts, Rate
from spheremouse.settings import param

_NO_RATE: Rate = (0.0, 0.0, 0.0)
_ROUNDING_TOLERANCE = 1e-6  # counts
_MAX_SPEED_RATIO = 2.0  # final to mean speed; 2 is that of constant acceleration from rest


@dataclass(frozen=True, slots=True)
class PointerSettings:
    """Settings of the steps from frames to reports."""

    rate: float = param(
        250.0,
        "Hz",
        "reports while the pointer moves: more than a screen shows, and four a frame at 60 Hz",
        ge=125,
        le=1000,
    )
    horizon: float = param(
        0.1,
        "s",
        "length of the prediction after a frame's stamp: an interval at 30 Hz and the latency of a slow camera; 0 "
        "sends the counts of each frame at once, exactly",
        ge=0,
        le=0.25,
    )
    smooth: float = param(
        0.5,
        "-",
        "duration of a correction as a fraction of the frame interval: 0 corrects at once; values above 0.5 add delay "
        "and hardly any smoothness",
        ge=0,
        le=1,
    )


@dataclass(frozen=True, slots=True)
class AxisTrajectory:
    """One axis from one frame to the next. Offsets are counts along `direction`, from `truth` with `overshoot`."""

    truth: int = 0  # counts, sum over all frames
    direction: int = 0  # -1 or 1, sign of the last counts; 0: no counts yet
    overshoot: int = 0  # counts, 0 or negative: excess from before the last reversal
    ahead: int = 0  # counts, offset that the ball has to catch up with
    start: int = 0  # counts, offset at `start_time`
    goal: float = 0.0  # counts, offset at `goal_time`
    start_time: float = 0.0  # s
    goal_time: float = 0.0  # s
    speed: float = 0.0  # counts/s, 0 or positive
    acceleration: float = 0.0  # counts/s²
    stamp: float = 0.0  # s, of the frame
    prediction_end: float = 0.0  # s; the speed stays positive until then

    def at(self, now: float) -> int:
        """Return the sum of counts that is due at `now` (s), which is not before the frame came."""
        if now < self.goal_time:
            duration = self.goal_time - self.start_time
            u = self.start + (self.goal - self.start) * (now - self.start_time) / duration
        else:
            u = max(self.ahead, self.predicted(now))
        return self.truth + self.direction * (self.overshoot + floor(u + _ROUNDING_TOLERANCE))

    def predicted(self, now: float) -> float:
        """Return the counts that the ball is predicted to make between its frame and `now` (s)."""
        age = min(now, self.prediction_end) - self.stamp
        return age * (self.speed + 0.5 * self.acceleration * age)

    @property
    def until(self) -> float:
        """Time (s) after which nothing is due."""
        if self.speed > 0.0:
            return max(self.goal_time, self.prediction_end)
        return self.goal_time if self.start < self.goal else self.start_time


@dataclass(frozen=True, slots=True)
class Resampler:
    """All axes from one frame to the next."""

    trajectories: tuple[AxisTrajectory, AxisTrajectory, AxisTrajectory] = (
        AxisTrajectory(),
        AxisTrajectory(),
        AxisTrajectory(),
    )
    stamp: float | None = None  # s, of the last frame
    rate: Rate | None = None  # of the last frame; None: it was not tracked
    interval: float = 0.0  # s between the last two frames; 0: unknown
    until: float = 0.0  # s; nothing is due later, until the next frame

    @property
    def truth(self) -> Counts:
        """Sum of the counts of all frames."""
        x, y, z = self.trajectories
        return x.truth, y.truth, z.truth


def plus(a: Counts, b: Counts) -> Counts:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Counts, b: Counts) -> Counts:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def due(resampler: Resampler, now: float) -> Counts:
    """Return the sum of counts that is due at `now` (s)."""
    x, y, z = resampler.trajectories
    return x.at(now), y.at(now), z.at(now)


def take(
    resampler: Resampler,
    sent: Counts,
    counts: Counts,
    rate: Rate | None,
    stamp: float,
    now: float,
    settings: PointerSettings,
) -> Resampler:
    """Return the trajectories after a frame of time `stamp` (s), with its counts and rate, came at `now`.

    `sent` are the sums sent so far. Without a rate nothing is predicted and all counts are due at once.
    """
    interval = 0.0 if resampler.stamp is None else max(stamp - resampler.stamp, 0.0)
    horizon = settings.horizon if rate is not None and interval > 0.0 else 0.0
    rates = rate or _NO_RATE
    # After a dropped frame the interval is twice as long, but the next frame still comes at the usual time.
    usual = min(interval, resampler.interval) or interval
    goal_time = now + min(settings.smooth * usual, horizon)
    start_time = now - 1.0 / settings.rate  # the first report already has one period's part of the line
    previous = resampler.rate or rates
    taken = min(stamp, now)  # a stamp in the future would make the prediction run back
    a, b, c = (
        _take(axis, s, n, start_time, goal_time, taken, _prediction(n, r0, r, interval, horizon))
        for axis, s, n, r0, r in zip(resampler.trajectories, sent, counts, previous, rates, strict=True)
    )
    until = max(a.until, b.until, c.until)
    return Resampler((a, b, c), stamp, rate, interval, until)


def _prediction(
    counts: int, previous_rate: float, rate: float, interval: float, horizon: float
) -> tuple[float, float, float]:
    """Return speed (counts/s) along the counts, acceleration (counts/s²) and duration (s) of the prediction.

    The acceleration comes from the rates at both ends of the interval. At rest the rates are noise, and a filter that
    diverged may return any rate, also NaN. So the counts limit the prediction: up to the horizon its mean speed is at
    most `_MAX_SPEED_RATIO` times the mean speed of the frame.
    """
    if interval <= 0.0 or horizon <= 0.0:
        return 0.0, 0.0, 0.0
    direction = 1.0 if counts > 0 else -1.0
    limit = _MAX_SPEED_RATIO * abs(counts) / interval
    speed = min(max(0.0, direction * rate), limit)  # max returns 0 for NaN
    acceleration = min(direction * (rate - previous_rate) / interval, 2.0 * (limit - speed) / horizon)
    if speed <= 0.0 or not isfinite(acceleration):
        return speed, 0.0, horizon
    return speed, acceleration, min(horizon, -speed / acceleration if acceleration < 0.0 else inf)


def _take(
    axis: AxisTrajectory,
    sent: int,
    counts: int,
    start_time: float,
    goal_time: float,
    stamp: float,
    prediction: tuple[float, float, float],  # as `_prediction` returns it
) -> AxisTrajectory:
    """Return an axis after a frame: with its counts, its overshoot, and the line to the prediction at `goal_time`."""
    speed, acceleration, duration = prediction
    direction = 1 if counts > 0 else -1 if counts < 0 else axis.direction
    overshoot = axis.overshoot
    if direction != axis.direction:
        lead = max(axis.direction * (sent - axis.truth) - overshoot, 0)
        overshoot = min(-overshoot - lead, 0)
    truth = axis.truth + counts
    start = direction * (sent - truth) - overshoot
    ahead = max(start, 0)
    new = AxisTrajectory(
        truth=truth,
        direction=direction,
        overshoot=overshoot,
        ahead=ahead,
        start=start,
        start_time=start_time,
        goal_time=goal_time,
        speed=speed,
        acceleration=acceleration,
        stamp=stamp,
        prediction_end=stamp + duration,
    )
    return replace(new, goal=max(float(ahead), new.predicted(goal_time)))
