"""Motion of a wand: the robot's drive of Grzonka 2005, chapter 4, and a ball on a stick in a hand.

A path gives poses of the ball in `cam` at any times. World here is the level frame at the camera: x right, y down, z
forward. The drive stops, turns and moves at constant speeds. The hand's motion is a sum of slow sinusoids, scaled to
the requested maximum speed and turning rate.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array, exp, log

R_CAM_WORLD = exp(np.radians([10.0, 0.0, 0.0]))  # the camera looks down
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
_WOBBLE_SIGMA_RAD = 0.005  # rad, standard deviation of a robot's pitch and of its roll over a bumpy floor
_BUMPS = 6  # sinusoids of each
_SINUSOIDS_PER_COORDINATE = 4  # sinusoids of each coordinate of a hand


@dataclass(frozen=True, slots=True)
class Drive:
    """Path of a robot along straight lines. At each way point it stops and turns on the spot."""

    seconds: float  # with the rests before and after
    knots: Array  # (s, 5) s, rad of yaw, m of world x and z, m driven, between which all but the time is linear
    bumps: Array  # (2, m, 2) of pitch and roll: rad/m along the way, phase

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Return centres (n, 3) m in cam, and R_cam_ball (n, 3, 3), at times (n,) s."""
        yaw, x, z, way = (np.interp(t, self.knots[:, 0], column) for column in self.knots.T[1:])
        world = np.stack([x, np.full_like(x, CAMERA_HEIGHT - BALL_HEIGHT), z], axis=-1)
        rate, phase = np.moveaxis(self.bumps, -1, 0)  # (2, m)
        tilt = _WOBBLE_SIGMA_RAD * np.sum(np.sqrt(2.0 / _BUMPS) * np.sin(rate * way[:, None, None] + phase), axis=-1)
        turn = exp(yaw[:, None] * (0.0, 0.0, 1.0)) @ exp(np.column_stack([tilt[:, ::-1], np.zeros_like(yaw)]))
        return world @ R_CAM_WORLD.T, R_CAM_WORLD @ TOWARDS @ turn


def drive(rng: np.random.Generator, *, speed: float = 1.0, part: int = 0, of: int = 1) -> Drive:
    """The path of fig. 9, its way points some centimetres off, from the left or the right.

    `speed` is a factor on both speeds. `part` of `of` robots: each has its own strip of the field.
    """
    way = np.array(_WAY, dtype=float)
    way[np.isnan(way)] = rng.uniform(-0.3, 0.3)
    width = 2.0 * _HALF_WIDTH / of
    half = 0.5 * width if of == 1 else 0.5 * width - 0.12  # robots keep clear of each other
    points = np.stack([half * way[:, 0], np.array(_LANES)[way[:, 1].astype(int)]], axis=-1)
    points[:, 0] *= rng.choice([-1.0, 1.0])
    points += rng.uniform(-0.025, 0.025, points.shape)
    points[:, 0] += (part + 0.5) * width - _HALF_WIDTH
    bumps = np.stack([rng.uniform(10.0, 120.0, (2, _BUMPS)), rng.uniform(0.0, 2.0 * np.pi, (2, _BUMPS))], axis=-1)
    legs = np.diff(points, axis=0)
    headings = np.unwrap(np.arctan2(legs[:, 0], -legs[:, 1]))  # 0 is towards the camera, 90 degrees to the right
    knots = [np.array([REST_BEFORE, headings[0], *points[0], 0.0])]
    for leg, heading, end in zip(legs, headings, points[1:], strict=True):
        time, yaw, *place, driven = knots[-1]
        time += abs(heading - yaw) / (speed * TURN_RATE)
        knots.append(np.array([time, heading, *place, driven]))
        length = float(np.linalg.norm(leg))
        knots.append(np.array([time + length / (speed * DRIVE_SPEED), heading, *end, driven + length]))
    return Drive(float(knots[-1][0]) + REST_AFTER, np.array(knots), bumps)


@dataclass(frozen=True, slots=True)
class Hand:
    """Path of a ball held before the camera. It moves to and fro, nods, and turns about its stick."""

    middle: Array  # (3,) m, cam
    sway: Array  # (3, m, 3) of x, y, z: m, rad/s, phase
    turn: Array  # (3, m, 3) of rotation about the ball's x, y and about its pole: rad, rad/s, phase
    facing: Array  # (3, 3) R_cam_ball in the middle
    seconds: float

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Return centres (n, 3) m in cam, and R_cam_ball (n, 3, 3), at times (n,) s."""
        place, angle = _sum(self.sway, t), _sum(self.turn, t)
        return self.middle + place, self.facing @ exp(angle * (1.0, 1.0, 0.0)) @ exp(angle * (0.0, 0.0, 1.0))


WandPath = Drive | Hand


def hand(
    rng: np.random.Generator,
    *,
    distance: float = 1.0,
    speed: float = HAND_SPEED,
    rate: float = HAND_RATE,
    seconds: float = 20.0,
    aside: float = 0.0,
) -> Hand:
    """Return the path of a hand about `distance` m away. Its maxima are `speed` (m/s) and `rate` (rad/s).

    `aside` is the offset of the middle to the right, m. The pole with its discs leans towards the camera by 15 to 35
    degrees and nods by some 20 more. About the pole it makes full turns. The hand sways by 0.16 of the distance at
    most: if it would exceed that at its speed, its swings become faster and shorter.
    """
    # slow and wide or fast and short, as a player's hand moves, 0.2 to 1.2 Hz
    sway = _waves(rng, (1.0, 0.7, 0.8), 0.2, 1.0)
    turn = _waves(rng, (0.25, 0.25, 1.0), np.array([[0.2], [0.2], [0.1]]), np.array([[1.2], [1.2], [0.6]]))
    lean = np.radians(rng.uniform(15.0, 35.0))
    # the pole up and towards the camera, azimuth 0 anywhere
    facing = exp(np.array([lean, 0.0, 0.0])) @ TOWARDS @ exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    t, step = np.arange(0.0, seconds, 0.01), 0.01

    def fastest() -> float:
        return float(np.max(np.linalg.norm(np.diff(_sum(sway, t), axis=0), axis=-1) / step))

    sway[..., 1] *= max(speed / fastest() / (0.16 * distance / np.max(np.abs(_sum(sway, t)))), 1.0)
    sway[..., 0] *= speed / fastest()
    path = Hand(np.array([aside, 0.0, distance]), sway, turn, facing, seconds)
    for _ in range(20):  # rotations do not add up: by and by
        turn[..., 0] *= rate / float(np.max(turning_rates(path.pose(t)[1], step)))
    return path


def turning_rates(R: Array, step: float) -> Array:
    """Angular speeds, (n - 1,) rad/s, between rotations (n, 3, 3) `step` s apart."""
    return np.linalg.norm(log(R[1:] @ R[:-1].transpose(0, 2, 1)), axis=-1) / step


def _waves(rng: np.random.Generator, size: tuple[float, ...], low: Array | float, high: Array | float) -> Array:
    """Return sinusoids of three coordinates, (3, m, 3): amplitude, rate from `low` to `high` Hz in rad/s, and phase."""
    omega = 2.0 * np.pi * rng.uniform(low, high, (3, _SINUSOIDS_PER_COORDINATE))
    return np.stack(
        [np.array(size)[:, None] / omega, omega, rng.uniform(0.0, 2.0 * np.pi, (3, _SINUSOIDS_PER_COORDINATE))], axis=-1
    )


def _sum(waves: Array, t: Array) -> Array:
    """(n, 3) of (3, m, 3) amplitudes, rates and phases."""
    amplitude, omega, phase = np.moveaxis(waves, -1, 0)
    return np.sum(amplitude * np.sin(omega * np.asarray(t)[:, None, None] + phase), axis=-1)
