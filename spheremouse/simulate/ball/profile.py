"""Motion of a simulated ball: exact attitude and angular velocity at any time.

A profile takes times, (n,) s, and gives R_obj_ball, (n, 3, 3), and w_obj, (n, 3) rad/s, which agree:
dR/dt = hat(w) R. At time 0 the ball is at rest and `ball` equals `obj`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import ClassVar, Protocol

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from spheremouse.geometry.rotation import Array, exp
from spheremouse.simulate.ball.options import SimulationOptions
from spheremouse.simulate.light import smoothstep

TURN_SECONDS = 3.0  # s, of a turn of `roll`


class Profile(Protocol):
    """A motion of the ball."""

    @property
    def seconds(self) -> float:
        """s, how long it takes; afterwards it rests or repeats."""
        ...

    def attitude(self, t: Array) -> Array:
        """R_obj_ball at times (n,) s, (n, 3, 3)."""
        ...

    def rate(self, t: Array) -> Array:
        """w_obj at times (n,) s, (n, 3) rad/s."""
        ...


# ---- gestures ----


@dataclass(frozen=True, slots=True)
class Gesture:
    """A turn about an axis fixed in `obj`, from rest to rest."""

    start: float  # s
    length: float  # s
    axis: tuple[float, float, float]  # unit vector, obj
    angle: float  # rad
    ramp: float = 0.5  # share of the length spent speeding up, and slowing down at the end
    coast: float = 0.0  # 0: as slow to stop as to start; towards 1: quickly started, slowly spent; -1: the reverse

    @property
    def end(self) -> float:
        """s."""
        return self.start + self.length

    def turned(self, t: Array) -> tuple[Array, Array]:
        """Angle turned so far, rad, and its derivative, rad/s, at times (n,) s.

        The rate rises and falls along x²(3 - 2x), so that the angular acceleration has no jump either.
        """
        up, down = self.ramp * (1.0 - self.coast), self.ramp * (1.0 + self.coast)
        x = np.clip((np.asarray(t, dtype=float) - self.start) / self.length, 0.0, 1.0)
        peak = 1.0 / (1.0 - 0.5 * (up + down))
        rise, fall = np.clip(x / up, 0.0, 1.0), np.clip((1.0 - x) / down, 0.0, 1.0)
        risen, fallen = (v**3 - 0.5 * v**4 for v in (rise, fall))  # integrals of the smooth step
        middle = np.clip(x, up, 1.0 - down) - up
        share = peak * (up * risen + middle + down * (0.5 - fallen))
        return self.angle * share, self.angle / self.length * peak * smoothstep(np.minimum(rise, fall))


@dataclass(frozen=True, slots=True)
class Swing:
    """A turn about an axis fixed in `obj` by an angle that repeats."""

    axis: tuple[float, float, float]  # unit vector, obj
    angle_at: CubicHermiteSpline  # rad
    start: ClassVar[float] = -inf
    end: ClassVar[float] = inf
    angle: ClassVar[float] = 0.0

    def turned(self, t: Array) -> tuple[Array, Array]:
        """Angle, rad, and its derivative, rad/s, at times (n,) s."""
        return self.angle_at(t), self.angle_at(t, 1)


@dataclass(frozen=True, slots=True)
class Gestures:
    """Gestures one after the other, overlapping or not: R = R_last ... R_2 R_1, each turn about its axis in `obj`."""

    gestures: tuple[Gesture | Swing, ...]  # by start time
    seconds: float  # s
    turn: Array | None = None  # (3, 3) from `obj` to the axes of another camera, which sees this motion; None: obj
    _before: Array = field(init=False, repr=False)  # (n + 1, 3, 3) product of the first k gestures, all finished

    def __post_init__(self) -> None:
        before = [np.eye(3)]
        for g in self.gestures:
            before.append(exp(np.array(g.axis) * g.angle) @ before[-1])
        object.__setattr__(self, "_before", np.array(before))

    def attitude(self, t: Array) -> Array:
        return self._both(t)[0]

    def rate(self, t: Array) -> Array:
        return self._both(t)[1]

    def _both(self, t: Array) -> tuple[Array, Array]:
        """Return attitude, (n, 3, 3), and rate, (n, 3) rad/s, at times `t`."""
        t = np.asarray(t, dtype=float)
        first, last = np.min(t, initial=inf), np.max(t, initial=-inf)
        done = next((k for k, g in enumerate(self.gestures) if g.end > first), len(self.gestures))
        R = np.broadcast_to(self._before[done], (len(t), 3, 3))
        w = np.zeros((len(t), 3))
        for g in self.gestures[done:]:
            if g.start >= last:
                break
            angle, speed = g.turned(t)
            turn = exp(angle[:, None] * np.array(g.axis))
            R = turn @ R
            w = (turn @ w[..., None])[..., 0] + speed[:, None] * np.array(g.axis)
        return (R, w) if self.turn is None else (self.turn @ R, w @ self.turn.T)


def _parabolas(times: tuple[float, ...], degrees: tuple[float, ...]) -> CubicHermiteSpline:
    """Return an angle, rad, at rest at its knots: with these slopes half way, cubic pieces are parabolas."""
    t, angle = np.array(times), np.radians(degrees)
    knots = np.sort([*t, *(0.5 * (t[1:] + t[:-1]))])
    slope = np.zeros(len(knots))
    slope[1::2] = 2.0 * np.diff(angle) / np.diff(t)
    return CubicHermiteSpline(knots, np.interp(knots, t, angle), slope, extrapolate="periodic")


def thesis() -> Gestures:
    """Return the motion of the synthetic sets of Wittich 2017 (figure 30), to its description.

    Euler angles move from rest to rest between knots, with constant acceleration and then deceleration, for half of the
    time each. Angles and angular rates have no jumps. 10 s, then again from the start; mean angular acceleration
    16.4 deg/s², peak rate 28 deg/s.
    """
    kappa = Swing((0.0, 0.0, 1.0), _parabolas((0.0, 3.6, 7.9, 10.0), (0.0, 46.0, -3.0, 0.0)))
    phi = Swing((0.0, 1.0, 0.0), _parabolas((0.0, 2.8, 6.7, 10.0), (0.0, -24.0, 10.0, 0.0)))
    omega = Swing((1.0, 0.0, 0.0), _parabolas((0.0, 5.4, 10.0), (0.0, 61.0, 0.0)))
    return Gestures((kappa, phi, omega), 10.0)


def still(seconds: float = 10.0) -> Gestures:
    """A ball at rest for `seconds` s."""
    return Gestures((), seconds)


def roll(turns: float, seconds: float | None = None) -> Gestures:
    """Return a roll about a horizontal axis and back about another one, `turns` turns in all (3 s each).

    About (1, 0, 1) the ball has phi = +90 deg in the middle of every turn, about (1, 0, -1) phi = -90 deg. Euler angles
    are singular there.
    """
    total = TURN_SECONDS * turns if seconds is None else seconds
    forth = min(turns, float(np.ceil(turns / 2.0)))
    gestures, start = [], 0.0
    for share, axis in ((forth, (1.0, 0.0, 1.0)), (turns - forth, (1.0, 0.0, -1.0))):
        if share > 0.0:
            length = total * share / turns
            gestures.append(Gesture(start, length, _unit(axis), 2.0 * np.pi * share, min(0.4, 1.0 / length)))
            start += length
    return Gestures(tuple(gestures), total)


def rest(seconds: float = 60.0) -> Gestures:
    """The ball is shown from all sides for 8 s, then lies still for `seconds`."""
    shown = _initial_turns()
    return Gestures(tuple(shown), shown[-1].end + seconds)


def creep() -> Gestures:
    """The ball is shown for 8 s and rests for 2 s. Then it turns at 0.05 deg/s for a minute, by 3 deg in all."""
    shown = _initial_turns()
    slow = stroke(shown[-1].end + 2.0, (1.0, 0.0, 1.0), np.radians(0.05), up=1.0, hold=59.0, down=1.0)
    return Gestures((*shown, slow), slow.end + 2.0)


def flick() -> Gestures:
    """The ball is shown for 8 s, then flicked at 400 deg/s about four axes, stopped within 50 ms, and back."""
    gestures = _initial_turns()
    t = gestures[-1].end + 0.5
    for axis in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.3, -1.0)):
        for sign in (1.0, -1.0):
            gestures.append(stroke(t, axis, sign * np.radians(400.0), up=0.12, hold=0.25, down=0.05))
            t = gestures[-1].end
        t += 1.0
    return Gestures(tuple(gestures), t)


def stroke(
    start: float, axis: tuple[float, float, float], rate: float, *, up: float, hold: float, down: float
) -> Gesture:
    """A turn that reaches `rate` (rad/s) within `up` s, holds it for `hold` s and stops within `down` s."""
    length = up + hold + down
    ramp, coast = 0.5 * (up + down) / length, (down - up) / (up + down)
    return Gesture(start, length, _unit(axis), rate * (hold + 0.5 * (up + down)), ramp, coast)


def _unit(axis: Sequence[float] | Array) -> tuple[float, float, float]:
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    return float(x), float(y), float(z)


def _initial_turns() -> list[Gesture]:
    """After a rest of 1 s the ball makes a turn about X and one about Y: every disc has been seen, and has moved."""
    return [Gesture(1.0, 3.5, (1.0, 0.0, 0.0), 2.0 * np.pi, 0.3), Gesture(4.5, 3.5, (0.0, 1.0, 0.0), 2.0 * np.pi, 0.3)]


def shown_to_axes() -> Gestures:
    """Gestures for `spheremouse axes` from the far side: 60° to the right, away, and counter-clockwise from above."""
    ways = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    return Gestures(tuple(Gesture(1.5 + 3.0 * k, 1.5, way, np.pi / 3.0) for k, way in enumerate(ways)), 10.5)


def play(seconds: float, rng: np.random.Generator) -> Gestures:
    """Play: rolls that run into each other, spins, flicks that coast, rests. It starts with a rest of 1 s."""
    gestures: list[Gesture] = []
    t = 1.0
    while t < seconds - 0.5:
        kind = rng.choice(["roll", "spin", "flick", "rest"], p=[0.5, 0.15, 0.2, 0.15])
        heading = rng.uniform(0.0, 2.0 * np.pi)
        sign = rng.choice([-1.0, 1.0])
        axis = np.array([np.cos(heading), 0.3 * rng.standard_normal(), np.sin(heading)])
        if kind == "rest":
            t += rng.uniform(0.4, 1.5)
            continue
        if kind == "roll":
            length, angle, coast = rng.uniform(0.8, 2.5), rng.uniform(0.3, 2.0), 0.0
        elif kind == "spin":
            axis = np.array([0.15 * rng.standard_normal(), 1.0, 0.15 * rng.standard_normal()])
            length, angle, coast = rng.uniform(0.8, 2.0), sign * rng.uniform(0.3, 1.5), 0.0
        else:
            length, angle, coast = rng.uniform(0.8, 1.4), rng.uniform(1.0, 2.0), 0.7
        length = min(float(length), seconds - t)
        gestures.append(Gesture(float(t), length, _unit(axis), float(angle), 0.5, coast))
        t += length * rng.uniform(0.6, 1.05)  # often the next begins before this one has ended
    return Gestures(tuple(sorted(gestures, key=lambda g: g.start)), seconds)


def profile_of(options: SimulationOptions) -> Gestures:
    """Return the motion that the options select."""
    if options.motion == "roll":
        return roll(options.turns, options.seconds)
    if options.motion == "play":
        return play(20.0 if options.seconds is None else options.seconds, np.random.default_rng([options.seed, 2]))
    motions = {"thesis": thesis, "still": still, "rest": rest, "creep": creep, "flick": flick, "axes": shown_to_axes}
    return motions[options.motion]()
