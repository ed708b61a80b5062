"""Rotation of the ball between two epochs -> motion of a mouse, in counts, with nothing lost to rounding.

Wittich 2017, section 3.9.4, with the travel of the touching point along the surface, log(R_k R_{k-1}^T) x C, in place
of its chord (eq. 172-174), which loses 1 % at 30 Hz and 5 % at 5 Hz; and with Y downwards, as a mouse counts.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output import Report
from spheremouse.settings import FACTOR, PER_RADIAN, param
from spheremouse.tracker import Motion

_DUE = 1.0 - 1e-9  # counts; less than one by rounding alone
_RELEASE_RATE = 2.0  # rad/s: a hand rolls a ball at 1 to 3 rad/s in ordinary play
_GAP = 2.5  # intervals without a frame: frames are missing; where one was dropped, the next comes after two
_USUAL_RADIUS = 0.6  # m: a millimetre of a ball of unknown size is what it is on a ball of 1.2 m
_REVERSED = "where it goes the wrong way, say where the player stands (motion.player), or reverse one axis (invert_{})"

Player = Literal["far-side", "camera-side", "left", "right"]

# The player's right, in obj; the camera is at +Z.
_RIGHT: dict[Player, tuple[float, float, float]] = {
    "far-side": (-1.0, 0.0, 0.0),
    "camera-side": (1.0, 0.0, 0.0),
    "left": (0.0, 0.0, 1.0),
    "right": (0.0, 0.0, -1.0),
}
_UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """From rotation to counts."""

    GONE: ClassVar[dict[str, str]] = {"swap_xy": "a seat turned by 90 degrees is `player: left` or `right`"}

    player: Player = param(
        "far-side",
        "-",
        "where the player stands, as the camera sees the ball: the pointer goes right where a hand pushes the top of "
        "the ball to the player's right, and up where it pushes it away; far-side, since who stands there does not "
        "stand in the camera's view",
    )
    counts_per_mm: float = param(
        1.0,
        "counts/mm",
        "scale of all axes, per millimetre of the ball's surface: about a 25 dpi trackball; mice have up to 1000",
        **FACTOR,
    )
    counts_per_radian: float | None = param(
        None,
        "counts/rad",
        "scale per radian instead; null where the rig's scale is free: that of a ball of 0.6 m radius",
        **PER_RADIAN,
    )
    scale_x: float = param(
        1.0,
        "-",
        "factor on the pointer's X (ball rolling left and right)",
        refused=_REVERSED.format("x"),
        **FACTOR,
    )
    scale_y: float = param(
        1.0,
        "-",
        "factor on the pointer's Y (ball rolling towards and away)",
        refused=_REVERSED.format("y"),
        **FACTOR,
    )
    scale_z: float = param(
        1.0,
        "-",
        "factor on the third axis (ball spinning about the vertical)",
        refused="to reverse it: invert_z",
        **FACTOR,
    )
    invert_x: bool = param(False, "-", "reverse X, for a program that wants it so")
    invert_y: bool = param(False, "-", "reverse Y, for a program that wants it so")
    invert_z: bool = param(False, "-", "reverse the third axis, which is positive counter-clockwise seen from above")

    def scale(self, radius: float | None) -> float:
        """Counts per radian; `radius` of the ball in m, None where it is not known in metres."""
        if self.counts_per_radian is not None:
            return self.counts_per_radian
        return 1000.0 * (_USUAL_RADIUS if radius is None else radius) * self.counts_per_mm

    def directions(self) -> Array:
        """Axes in `obj`, (3, 3), about which the ball rolls to the player's right, rolls towards them, and spins.

        As a hand on its top sees it, and counter-clockwise from above. The top (0, c, 0) goes by rho x (0, c, 0); along
        a direction r of the floor that is c rho . (up x r).
        """
        right = np.array(_RIGHT[self.player])
        return np.array([np.cross(_UP, right), right, _UP])

    def matrix(self, radius: float | None) -> Array:
        """Counts per radian of rotation vector in `obj`, (3, 3): rows x, y, third axis; `radius` as in `scale`."""
        sign = np.where([self.invert_x, self.invert_y, self.invert_z], -1.0, 1.0)
        return self.directions() * (sign * (self.scale_x, self.scale_y, self.scale_z) * self.scale(radius))[:, None]


@dataclass(frozen=True, slots=True)
class Remainder:
    """Fractions of counts not sent yet, each in (-1, 1), and in [-1/2, 1/2] after a report on that axis."""

    value: tuple[float, float, float] = (0.0, 0.0, 0.0)


def to_counts(rotation: Array, matrix: Array, remainder: Remainder) -> tuple[tuple[int, int, int], Remainder]:
    """Whole counts of a rotation vector (3,) rad, and what is left of them.

    The sum of all counts stays within one of the integral of the motion. An axis is silent until a whole count is due,
    and then sends the nearest number: half a count of play, so that noise about a boundary does not make a ball at rest
    send counts back and forth.
    """
    counts, left = [0, 0, 0], [0.0, 0.0, 0.0]
    for axis, value in enumerate((matrix @ rotation).tolist()):
        exact = value + remainder.value[axis]
        counts[axis] = round(exact) if abs(exact) >= _DUE else 0
        left[axis] = exact - counts[axis]
    return (counts[0], counts[1], counts[2]), Remainder((left[0], left[1], left[2]))


@dataclass(frozen=True, slots=True)
class Pace:
    """Motion of frames that were missing or not confirmed, released no faster than a hand rolls a ball."""

    stamp: float | None = None  # s, of the last frame
    interval: float = np.inf  # s between the last two frames
    confirmed: float = np.inf  # s, stamp of the last confirmed frame, or of the first one
    pending: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad, withheld and not released yet

    def take(self, motion: Motion) -> tuple[Array, "Pace"]:
        """The rotation vector (3,) rad to report with a frame, and what is left.

        A frame's own motion is its share, by time, of the motion since the last confirmed one: all of it, unless frames
        between were missing or not confirmed. The rest is added at `_RELEASE_RATE`.
        """
        interval = np.inf if self.stamp is None else motion.stamp - self.stamp
        confirmed = min(self.confirmed, motion.stamp)  # a clock that starts again
        if not motion.confirmed:
            return np.zeros(3), Pace(motion.stamp, interval, confirmed, self.pending)
        since = motion.stamp - confirmed
        length = self.interval if interval > _GAP * self.interval > 0.0 else interval
        own = 1.0 if not 0.0 < length < since else length / since
        left = np.array(self.pending) + (1.0 - own) * motion.rotation
        size, bound = float(np.sqrt(left @ left)), max(_RELEASE_RATE * length, 0.0)
        released = left if size <= bound else left * (bound / size)
        x, y, z = (left - released).tolist()
        return own * motion.rotation + released, Pace(motion.stamp, interval, motion.stamp, (x, y, z))


class Counter:
    """The reports of a ball's motions, one after the other: what is left of a count goes into the next one."""

    def __init__(self, matrix: Array) -> None:
        """`matrix` (3, 3), counts per radian, as of `MotionSettings`."""
        self.matrix, self._remainder, self._pace = matrix, Remainder(), Pace()

    @property
    def withheld(self) -> Array:
        """Rotation vector, (3,) rad, that was confirmed and is not released yet."""
        return np.array(self._pace.pending)

    def report(self, motion: Motion) -> Report:
        """The next one; a motion that is not confirmed gives no counts: the next ones that are make up for it.

        They do so at a hand's pace (`Pace`), and the sum of all counts stays within one of the integral of the motion.
        """
        rotation, self._pace = self._pace.take(motion)
        if not motion.confirmed:
            return Report((0, 0, 0), (0.0, 0.0, 0.0), motion)
        counts, self._remainder = to_counts(rotation, self.matrix, self._remainder)
        x, y, z = (self.matrix @ motion.rate[:3]).tolist()
        return Report(counts, (x, y, z), motion)
