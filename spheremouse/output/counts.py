"""Convert rotations of the ball to mouse counts, without rounding loss.

After Wittich 2017, section 3.9.4, with two changes. The touching point travels along the surface, by
log(R_k R_{k-1}^T) x C. Its chord (eq. 172-174) loses 1 % at 30 Hz and 5 % at 5 Hz. Y points down, as a mouse counts.
"""

from dataclasses import dataclass
from math import hypot
from typing import Literal

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output import Counts, Rate, Report
from spheremouse.output.response import COUNTS_RESPONSE, Response
from spheremouse.settings import FACTOR, PER_RADIAN, param
from spheremouse.tracker import Estimate

_WHOLE_COUNT = 1.0 - 1e-9  # counts; less than one by rounding errors
_RELEASE_RATE = 2.0  # rad/s: a hand rolls a ball at 1 to 3 rad/s in ordinary play
_MAX_INTERVAL_RATIO = 2.5  # a longer interval misses frames; one dropped frame doubles the interval
_DEFAULT_RADIUS = 0.6  # m, for the scale per millimetre of a ball of unknown size
_REVERSED_HINT = (
    "to reverse it: invert_{}; if both axes of the pointer are wrong, set motion.player or wand.pointing.facing"
)

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
class AxisSettings:
    """Factor and sign of each axis of the counts."""

    scale_x: float = param(
        1.0, "-", "factor on the pointer's X, right and left", refused=_REVERSED_HINT.format("x"), **FACTOR
    )
    scale_y: float = param(
        1.0, "-", "factor on the pointer's Y, up and down", refused=_REVERSED_HINT.format("y"), **FACTOR
    )
    scale_z: float = param(
        1.0, "-", "factor on the third axis, the ball's spin", refused=_REVERSED_HINT.format("z"), **FACTOR
    )
    invert_x: bool = param(False, "-", "reverse X, for a program that expects it")
    invert_y: bool = param(False, "-", "reverse Y, for a program that expects it")
    invert_z: bool = param(
        False, "-", "reverse the third axis, which is positive counter-clockwise from above, or clockwise for a wand"
    )

    def factors(self) -> Array:
        """Return the factors with their signs, (3,)."""
        sign = np.where([self.invert_x, self.invert_y, self.invert_z], -1.0, 1.0)
        return np.asarray(sign * (self.scale_x, self.scale_y, self.scale_z))


@dataclass(frozen=True, slots=True)
class MotionSettings(AxisSettings):
    """Scale and direction of the counts."""

    player: Player = param(
        "far-side",
        "-",
        "place of the player, as the camera sees the ball: a push of the ball's top to the player's right moves the "
        "pointer right, and a push away moves it up; at far-side the player does not hide the ball from the camera",
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
        "scale per radian in place of counts_per_mm; null uses counts_per_mm, with a radius of 0.6 m if it is unknown",
        **PER_RADIAN,
    )

    def scale(self, radius: float | None) -> float:
        """Return counts per radian for the ball's radius (m); None: the radius is unknown."""
        if self.counts_per_radian is not None:
            return self.counts_per_radian
        return 1000.0 * (_DEFAULT_RADIUS if radius is None else radius) * self.counts_per_mm

    def directions(self) -> Array:
        """Return the rotation axes in `obj`, (3, 3), of rolling right, rolling towards the player, and spinning.

        A hand on the ball's top defines right and towards; the spin is counter-clockwise from above. A rotation rho
        moves the top (0, c, 0) by rho x (0, c, 0), which is c rho . (up x r) along a horizontal direction r.
        """
        right = np.array(_RIGHT[self.player])
        return np.array([np.cross(_UP, right), right, _UP])

    def matrix(self, radius: float | None) -> Array:
        """Return counts (x, y, third axis) per radian of a rotation vector in `obj`, (3, 3); `radius` as in `scale`."""
        return self.directions() * (self.factors() * self.scale(radius))[:, None]


NO_REMAINDER = (0.0, 0.0, 0.0)


def to_counts(
    rotation: Array, matrix: Array, remainder: tuple[float, float, float]
) -> tuple[Counts, tuple[float, float, float]]:
    """Return the whole counts (x, y, third axis) to send for a rotation vector (3,) rad, and the fractions left over.

    `matrix` (3, 3) has counts per radian, in the frame of the rotation. `remainder` has the fractions of the last call:
    in (-1, 1), and in [-1/2, 1/2] after a count on that axis. On each axis, the sum of all counts stays within one
    count of the exact sum. An axis sends nothing until a whole count is due, and then the nearest whole number.
    Afterwards the ball must turn back by half a count or more until a count back is due, so noise at rest sends no
    counts back and forth.
    """
    counts, left = [0, 0, 0], [0.0, 0.0, 0.0]
    for axis, value in enumerate((matrix @ rotation).tolist()):
        exact = value + remainder[axis]
        counts[axis] = round(exact) if abs(exact) >= _WHOLE_COUNT else 0
        left[axis] = exact - counts[axis]
    return (counts[0], counts[1], counts[2]), (left[0], left[1], left[2])


class Counter:
    """Mapping of a ball in its frame. Fractions of a count carry over to the next call.

    Motion of missing or unconfirmed frames is released no faster than a hand rolls a ball.
    """

    def __init__(self, matrix: Array) -> None:
        """Take the counts per radian, (3, 3), as `MotionSettings.matrix` returns them."""
        self.matrix = matrix
        self.fraction: Rate = NO_REMAINDER
        self._stamp: float | None = None  # s, of the last frame
        self._interval = np.inf  # s between the last two frames
        self._confirmed = np.inf  # s, stamp of the last confirmed frame, or of the first one
        self._pending = np.zeros(3)  # rad, withheld and not released yet

    def counts(self, estimate: Estimate) -> tuple[Counts, Rate | None]:
        """Return counts and counts/s of an estimate.

        If it is not confirmed, the counts are 0 and the rate is None. The next estimates have its counts. The sum of
        all counts stays within one of the integral of the motion.
        """
        rotation = self._due(estimate)
        if rotation is None:
            return (0, 0, 0), None
        counts, self.fraction = to_counts(rotation, self.matrix, self.fraction)
        x, y, z = (self.matrix @ estimate.rate[:3]).tolist()
        return counts, (x, y, z)

    def interrupted(self) -> None:
        """Change nothing: the increment after a break is known, or zero."""

    def _due(self, estimate: Estimate) -> Array | None:
        """Return the rotation vector (3,) rad to count with a frame; None if the frame is not confirmed.

        A frame's own motion is its share, by time, of the motion since the last confirmed frame. This is all of it,
        unless frames in between were missing or not confirmed. The rest follows at `_RELEASE_RATE`.
        """
        before, interval = self._interval, np.inf if self._stamp is None else estimate.stamp - self._stamp
        self._stamp, self._interval = estimate.stamp, interval
        self._confirmed = min(self._confirmed, estimate.stamp)  # the clock may start again
        if not estimate.confirmed:
            return None
        since, self._confirmed = estimate.stamp - self._confirmed, estimate.stamp
        length = before if interval > _MAX_INTERVAL_RATIO * before > 0.0 else interval
        own = 1.0 if not 0.0 < length < since else length / since
        left = self._pending + (1.0 - own) * estimate.increment[:3]
        size, bound = float(np.sqrt(left @ left)), max(_RELEASE_RATE * length, 0.0)
        released = left if size <= bound else left * (bound / size)
        self._pending = left - released
        return own * estimate.increment[:3] + released


class OutputCounter:
    """Counts of one output, by its response. Call `apply` with the report of each frame of a run, in their order."""

    def __init__(self, response: Response) -> None:
        self._response, self._changes = response, response != COUNTS_RESPONSE
        self._fraction, self._remainder = np.zeros(3), NO_REMAINDER

    def apply(self, report: Report) -> Report:
        """Return the report with the counts of this output, and their rate.

        Without a dead zone and a curve, the sum of all counts stays within one of the gain times the integral of the
        motion, because the fractions that the run has not reported yet are scaled as well.
        """
        if not self._changes:
            return report
        sample, fraction = report.pointing_sample, np.array(report.fraction)
        factor = self._response.factor(0.0 if sample is None else hypot(*sample.rate.tolist()))
        motion, self._fraction = report.counts + fraction - self._fraction, fraction
        turn = report.to_camera if self._response.in_camera else np.eye(3)
        mapped = np.array(self._response.to_axes((turn @ motion).tolist()))
        counts, self._remainder = to_counts(mapped, factor * np.eye(3), self._remainder)
        x, y, z = (0.0, 0.0, 0.0) if report.rate is None else self._response.to_axes((turn @ report.rate).tolist())
        rate = None if report.rate is None else (factor * x, factor * y, factor * z)
        return report._replace(counts=counts, rate=rate, fraction=self._remainder)
