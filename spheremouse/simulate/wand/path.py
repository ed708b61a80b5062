"""Motion of a wand: the robot's drive of Grzonka 2005, chapter 4, and a ball on a stick in a hand.

A path gives poses of the ball in `cam` at any times. World here is the level frame at the camera: x right, y down, z
forward. The drive stops, turns and moves at constant speeds. The hand's motion is a sum of slow sinusoids, scaled to
the requested maximum speed and turning rate.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from spheremouse.geometry.rotation import Array, exp, log

PITCH = np.radians(10.0)  # rad, the camera looks down
CAMERA_HEIGHT = 0.95  # m above the floor (Grzonka 2005, chapter 4)
BALL_HEIGHT = 0.152  # m above the floor, on the robot
DRIVE_SPEED, TURN_RATE = 0.035, np.radians(50.0)  # m/s, rad/s (Grzonka 2005, chapter 4)
REST_BEFORE, REST_AFTER = 28.0, 20.0  # s: 23 and 16 frames at 0.8 Hz
HAND_SPEED, HAND_RATE = 0.4, np.radians(180.0)  # m/s, rad/s

# ball axes on a robot that drives towards the camera: x towards it, y to the right, z up (scene.json of wand_drive)
TOWARDS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])

# Way points of fig. 9: across, away, and back, in halves of the field's width and in lanes; nan: somewhere between
_WAY = ((-1, 0), (1, 0), (1, 1), (np.nan, 1), (np.nan, 2), (1, 2), (1, 1), (-1, 1), (-1, 2))
_HALF_WIDTH, _LANES = 0.63, (3.72, 4.0, 4.28)  # m, world x and z


class WandPath(Protocol):
    """Pose of the ball at any time."""

    @property
    def seconds(self) -> float:
        """Length, s."""
        ...

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Centre, (n, 3) m in cam, and R_cam_ball, (n, 3, 3), at times (n,) s."""
        ...


def world_to_cam() -> Array:
    """R_cam_world, (3, 3)."""
    return exp(np.array([PITCH, 0.0, 0.0]))


@dataclass(frozen=True, slots=True)
class Drive:
    """Path of a robot along straight lines. At each way point it stops and turns on the spot."""

    points: Array  # (k, 2) m, world x and z
    wobble: float  # rad, standard deviation of pitch and of roll over a bumpy floor
    bumps: Array  # (2, m, 3) of pitch and roll: rad/m along the way, phase, share
    speed: float = 1.0  # factor on both speeds
    _start: Array = field(init=False, repr=False)  # (s,) s, of stretches that turn or drive by turns
    _yaw: Array = field(init=False, repr=False)  # (s + 1,) rad
    _place: Array = field(init=False, repr=False)  # (s + 1, 2) m
    _way: Array = field(init=False, repr=False)  # (s + 1,) m driven

    def __post_init__(self) -> None:
        legs = np.diff(self.points, axis=0)
        headings = np.unwrap(np.arctan2(legs[:, 0], -legs[:, 1]))  # 0 is towards the camera, 90 degrees to the right
        time, yaw, place, way = [REST_BEFORE], [headings[0]], [self.points[0]], [0.0]
        for leg, heading, end in zip(legs, headings, self.points[1:], strict=True):
            time.append(time[-1] + abs(heading - yaw[-1]) / (self.speed * TURN_RATE))
            yaw.append(heading)
            place.append(place[-1])
            way.append(way[-1])
            length = float(np.linalg.norm(leg))
            time.append(time[-1] + length / (self.speed * DRIVE_SPEED))
            yaw.append(heading)
            place.append(end)
            way.append(way[-1] + length)
        for name, values in (("_start", time), ("_yaw", yaw), ("_place", place), ("_way", way)):
            object.__setattr__(self, name, np.array(values))

    @property
    def seconds(self) -> float:
        """Length with the rests before and after, s."""
        return float(self._start[-1]) + REST_AFTER

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Return centres (n, 3) m in cam, and R_cam_ball (n, 3, 3), at times (n,) s."""
        yaw, way = np.interp(t, self._start, self._yaw), np.interp(t, self._start, self._way)
        x, z = (np.interp(t, self._start, self._place[:, k]) for k in (0, 1))
        world = np.stack([x, np.full_like(x, CAMERA_HEIGHT - BALL_HEIGHT), z], axis=-1)
        rate, phase, share = np.moveaxis(self.bumps, -1, 0)  # (2, m)
        tilt = self.wobble * np.sum(share * np.sin(rate * way[:, None, None] + phase), axis=-1)
        zero = np.zeros_like(yaw)
        turn = exp(np.stack([zero, zero, yaw], axis=-1)) @ exp(np.stack([tilt[:, 1], tilt[:, 0], zero], axis=-1))
        R = world_to_cam()
        return world @ R.T, R @ TOWARDS @ turn


def drive(rng: np.random.Generator, *, speed: float = 1.0, wobble: float = 0.005, part: int = 0, of: int = 1) -> Drive:
    """The path of fig. 9, its way points some centimetres off, from the left or the right; 0.3 degrees of wobble.

    `part` of `of` robots: each has its own strip of the field.
    """
    way = np.array(_WAY, dtype=float)
    way[np.isnan(way)] = rng.uniform(-0.3, 0.3)
    width = 2.0 * _HALF_WIDTH / of
    half = 0.5 * width if of == 1 else 0.5 * width - 0.12  # robots keep clear of each other
    points = np.stack([half * way[:, 0], np.array(_LANES)[way[:, 1].astype(int)]], axis=-1)
    points[:, 0] *= rng.choice([-1.0, 1.0])
    points += rng.uniform(-0.025, 0.025, points.shape)
    points[:, 0] += (part + 0.5) * width - _HALF_WIDTH
    m = 6
    share = np.sqrt(2.0 / m) * np.ones((2, m))
    bumps = np.stack([rng.uniform(10.0, 120.0, (2, m)), rng.uniform(0.0, 2.0 * np.pi, (2, m)), share], axis=-1)
    return Drive(points, wobble, bumps, speed)


@dataclass(frozen=True, slots=True)
class Hand:
    """Path of a ball held before the camera. It moves to and fro, nods, and turns about its stick."""

    middle: Array  # (3,) m, cam
    sway: Array  # (3, m, 3) of x, y, z: m, rad/s, phase
    turn: Array  # (3, m, 3) of rotation about the ball's x, y and about its pole: rad, rad/s, phase
    facing: Array  # (3, 3) R_cam_ball in the middle
    length: float  # s

    @property
    def seconds(self) -> float:
        """Length, s."""
        return self.length

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Return centres (n, 3) m in cam, and R_cam_ball (n, 3, 3), at times (n,) s."""
        place, angle = _sum(self.sway, t), _sum(self.turn, t)
        zero = np.zeros(len(angle))
        nod = exp(np.stack([angle[:, 0], angle[:, 1], zero], axis=-1))
        about = exp(np.stack([zero, zero, angle[:, 2]], axis=-1))
        return self.middle + place, self.facing @ nod @ about


def hand(
    rng: np.random.Generator,
    *,
    distance: float = 1.0,
    reach: float = 0.15,
    speed: float = HAND_SPEED,
    rate: float = HAND_RATE,
    seconds: float = 20.0,
    aside: float = 0.0,
) -> Hand:
    """Return the path of a hand about `distance` m away. Its maxima are `speed` (m/s) and `rate` (rad/s).

    `reach` is the amplitude to either side, m. `aside` is the offset of the middle to the right, m. The pole with its
    discs leans towards the camera by 15 to 35 degrees and nods by some 20 more. About the pole it makes full turns.
    """
    m = 4
    # slow and wide or fast and short, as a player's hand moves, 0.2 to 1.2 Hz
    omega = 2.0 * np.pi * rng.uniform(0.2, 1.0, (3, m))
    sway = np.stack([np.array([[1.0], [0.7], [0.8]]) / omega, omega, _phases(rng, m)], axis=-1)
    omega = 2.0 * np.pi * rng.uniform([[0.2], [0.2], [0.1]], [[1.2], [1.2], [0.6]], (3, m))
    turn = np.stack([np.array([[0.25], [0.25], [1.0]]) / omega, omega, _phases(rng, m)], axis=-1)
    lean = np.radians(rng.uniform(15.0, 35.0))
    # the pole up and towards the camera, azimuth 0 anywhere
    facing = exp(np.array([lean, 0.0, 0.0])) @ TOWARDS @ exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    path = Hand(np.array([aside, 0.0, distance]), sway, turn, facing, seconds)
    return _scaled(path, reach, speed, rate)


def _scaled(path: Hand, reach: float, speed: float, rate: float) -> Hand:
    """Scale the path to the requested maximum speeds. If it would exceed `reach`, make swings faster and shorter."""
    t = np.arange(0.0, path.seconds, 0.01)
    sway, turn = path.sway.copy(), path.turn.copy()
    place = _sum(sway, t)
    widest, fastest = np.max(np.abs(place)), float(np.max(_pace(place, 0.01)))
    sway[..., 1] *= max(speed / fastest / (reach / widest), 1.0)  # too wide at that speed: faster and shorter
    sway[..., 0] *= speed / float(np.max(_pace(_sum(sway, t), 0.01)))
    for _ in range(20):  # rotations do not add up: by and by
        turned = Hand(path.middle, sway, turn, path.facing, path.length).pose(t)[1]
        turn[..., 0] *= rate / float(np.max(turning_rates(turned, 0.01)))
    return Hand(path.middle, sway, turn, path.facing, path.length)


def turning_rates(R: Array, step: float) -> Array:
    """Angular speeds, (n - 1,) rad/s, between rotations (n, 3, 3) `step` s apart."""
    return np.linalg.norm(log(R[1:] @ R[:-1].transpose(0, 2, 1)), axis=-1) / step


def _pace(place: Array, step: float) -> Array:
    return np.linalg.norm(np.diff(place, axis=0), axis=-1) / step


def _phases(rng: np.random.Generator, m: int) -> Array:
    return rng.uniform(0.0, 2.0 * np.pi, (3, m))


def _sum(waves: Array, t: Array) -> Array:
    """(n, 3) of (3, m, 3) amplitudes, rates and phases."""
    amplitude, omega, phase = np.moveaxis(waves, -1, 0)
    return np.sum(amplitude * np.sin(omega * np.asarray(t)[:, None, None] + phase), axis=-1)
