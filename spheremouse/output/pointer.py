"""Counts per frame -> the pointer's course between frames, predicted forward, without loss or double counting.

Takes what each frame brings, whole counts and the filter's rate in counts per second; says for any later time the sum
of counts that should have been sent by then. Sums are whole numbers, only the prediction is a real one. All times are
of one clock, on which frames are stamped and reports are made. docs/pointer.md shows what comes out.

Per axis, in the direction `way` of the last counts: the sum is K + way (kept + u) with K the sum over all frames. From
where the pointer is when a frame comes, u goes in a straight line to where the prediction will be some time before the
next frame, and then along the prediction, speed x age + acceleration x age² / 2, up to `horizon` or until the ball
would stand still. It never runs back. What a frame shows to be too far stays, `ahead`, until the ball has caught up;
when the ball turns round instead, it stays as `kept` until the ball comes back.
"""

from dataclasses import dataclass, replace
from math import floor, inf, isfinite

from spheremouse.settings import param

Counts = tuple[int, int, int]  # x, y and third axis

_DUE = 1e-6  # counts; as much is missing by rounding alone
_FULL = 2.0  # from rest at constant acceleration the end is twice as fast as the mean


@dataclass(frozen=True, slots=True)
class PointerSettings:
    """From frames to reports."""

    rate: float = param(
        250.0,
        "Hz",
        "reports while the pointer moves: more than screens show; four per frame at 60 Hz",
        ge=125,
        le=1000,
    )
    horizon: float = param(
        0.1,
        "s",
        "motion is carried on so far beyond a frame's stamp: an interval at 30 Hz and what a slow camera takes; "
        "0 sends each frame's counts at once, exactly",
        ge=0,
        le=0.25,
    )
    smooth: float = param(
        0.5,
        "-",
        "share of the interval between frames in which the pointer gets to where a frame says: more comes later and is "
        "hardly smoother; 0 is at once",
        ge=0,
        le=1,
    )
    text: bool = param(False, "-", "outputs text and null get a line per report as well, not one per frame")


@dataclass(frozen=True, slots=True)
class Course:
    """One axis from one frame to the next. Offsets are counts beyond `truth` + `way` x `kept`, along `way`."""

    truth: int = 0  # counts, sum over all frames
    way: int = 0  # -1 or 1, direction of the last counts; 0: there were none
    kept: int = 0  # counts, never above 0: overshoot of the other direction
    ahead: int = 0  # counts, offset that the ball has to catch up with
    start: int = 0  # counts, offset at `began`
    goal: float = 0.0  # counts, offset at `ends`
    began: float = 0.0  # s
    ends: float = 0.0  # s
    speed: float = 0.0  # counts/s, never below 0
    acceleration: float = 0.0  # counts/s²
    stamp: float = 0.0  # s, of the frame
    last: float = 0.0  # s, end of the prediction, before which the speed does not fall below 0

    def at(self, now: float) -> int:
        """Sum of counts that should have been sent by `now`, which is not before the frame came."""
        if now < self.ends:
            u = self.start + (self.goal - self.start) * (now - self.began) / (self.ends - self.began)
        else:
            u = max(self.ahead, self.predicted(now))
        return self.truth + self.way * (self.kept + floor(u + _DUE))

    def predicted(self, now: float) -> float:
        """Counts that the ball goes on from its frame to `now`."""
        age = min(now, self.last) - self.stamp
        return age * (self.speed + 0.5 * self.acceleration * age)

    @property
    def until(self) -> float:
        """s; nothing is due later."""
        if self.speed > 0.0:
            return max(self.ends, self.last)
        return self.ends if self.start < self.goal else self.began


@dataclass(frozen=True, slots=True)
class Resampler:
    """All axes from one frame to the next."""

    courses: tuple[Course, Course, Course] = (Course(), Course(), Course())
    stamp: float | None = None  # s, of the last frame
    rate: tuple[float, float, float] | None = None  # counts/s, of the last frame; None: it was not tracked
    interval: float = 0.0  # s between the last two frames; 0: not known
    until: float = 0.0  # s; nothing is due later, until there is a new frame

    @property
    def truth(self) -> Counts:
        """Sum of the counts of all frames."""
        x, y, z = self.courses
        return x.truth, y.truth, z.truth


def plus(a: Counts, b: Counts) -> Counts:
    """Sum, axis by axis."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Counts, b: Counts) -> Counts:
    """Difference, axis by axis."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def due(resampler: Resampler, now: float) -> Counts:
    """Sum of counts that should have been sent by `now`."""
    x, y, z = resampler.courses
    return x.at(now), y.at(now), z.at(now)


def take(
    resampler: Resampler,
    sent: Counts,
    counts: Counts,
    rate: tuple[float, float, float],
    stamp: float,
    now: float,
    tracking: bool,
    settings: PointerSettings,
) -> Resampler:
    """A frame of time `stamp` that comes at `now`: its counts, and the rate (counts/s) to carry on with.

    `sent` are the sums sent so far. While not `tracking` nothing is predicted, and counts are due at once.
    """
    interval = 0.0 if resampler.stamp is None else max(stamp - resampler.stamp, 0.0)
    horizon = settings.horizon if tracking and interval > 0.0 else 0.0
    # Where a frame was dropped the interval is twice the one before, yet the next frame comes at the usual time.
    usual = min(interval, resampler.interval) or interval
    ends = now + min(settings.smooth * usual, horizon)
    began = now - 1.0 / settings.rate  # a report stands until the next one: the first has its share of the way
    before = resampler.rate or rate
    taken = min(stamp, now)  # a stamp ahead of the clock would have it run back to the frame
    a, b, c = (
        _take(course, s, n, began, ends, taken, _foresight(n, r0, r, interval, horizon))
        for course, s, n, r0, r in zip(resampler.courses, sent, counts, before, rate, strict=True)
    )
    until = max(a.until, b.until, c.until)
    return Resampler((a, b, c), stamp, rate if tracking else None, interval, until)


def _foresight(counts: int, before: float, rate: float, interval: float, horizon: float) -> tuple[float, float, float]:
    """Speed (counts/s) in the direction of the counts, acceleration (counts/s²), and for how long they hold (s).

    From the rates at either end of the interval. At rest rates are noise, and where a filter has gone astray they may
    be anything, even no numbers: what the counts do not bear out is not believed. The mean speed up to the horizon is
    not above `full`.
    """
    if interval <= 0.0 or horizon <= 0.0:
        return 0.0, 0.0, 0.0
    way = 1.0 if counts > 0 else -1.0
    full = _FULL * abs(counts) / interval
    speed = min(max(0.0, way * rate), full)  # 0 for a rate that is no number
    acceleration = min(way * (rate - before) / interval, 2.0 * (full - speed) / horizon)
    if speed <= 0.0 or not isfinite(acceleration):
        return speed, 0.0, horizon
    return speed, acceleration, min(horizon, -speed / acceleration if acceleration < 0.0 else inf)


def _take(
    course: Course,
    sent: int,
    counts: int,
    began: float,
    ends: float,
    stamp: float,
    foresight: tuple[float, float, float],  # as `_foresight` gives it
) -> Course:
    speed, acceleration, lasts = foresight
    way = 1 if counts > 0 else -1 if counts < 0 else course.way
    kept = course.kept
    if way != course.way:
        lead = max(course.way * (sent - course.truth) - kept, 0)
        kept = min(-kept - lead, 0)
    truth = course.truth + counts
    start = way * (sent - truth) - kept
    ahead = max(start, 0)
    new = Course(truth, way, kept, ahead, start, 0.0, began, ends, speed, acceleration, stamp, stamp + lasts)
    return replace(new, goal=max(float(ahead), new.predicted(ends)))
