"""Convert the motion of a hand-held ball to mouse counts, without rounding loss and without jitter at rest.

The counts follow the increment of an estimate, its rotation vector or its shift, in axes of the camera. So no attitude
of the ball is singular. A backlash between pose and pointer is as wide as the filter's standard deviations, times
`play`. Within it the hand counts as resting.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output import Counts, Rate
from spheremouse.output.counts import NO_REMAINDER, AxisSettings, to_counts
from spheremouse.settings import PER_RADIAN, param
from spheremouse.tracker import Estimate, Status


@dataclass(frozen=True, slots=True)
class PointingSettings(AxisSettings):
    """Scale and direction of the counts of a hand-held ball."""

    by: Literal["turn", "shift"] = param(
        "turn",
        "-",
        "turn: the pointer follows the ball's rotation (right and left: x; up and down: y; clockwise: third); shift: "
        "its position (right and left: x; up and down: y; ahead: third)",
    )
    facing: bool = param(
        True, "-", "true: the player faces the camera, which is at the screen; false: looks the way the camera does"
    )
    counts_per_radian: float = param(
        1800.0,
        "counts/rad",
        "scale of rotations: 60 degrees, an easy motion of a wrist, cross a screen of 1920 px",
        **PER_RADIAN,
    )
    counts_per_metre: float = param(
        4800.0,
        "counts/m",
        "scale of shifts: 0.4 m, an easy motion of a forearm, cross a screen of 1920 px",
        **PER_RADIAN,
    )
    play: float = param(
        2.0,
        "-",
        "half width of the backlash, in standard deviations of the pose: 95 % of the errors lie within two; 0 passes "
        "all jitter to the pointer",
        ge=0,
        le=10,
    )

    def directions(self) -> Array:
        """Return the axes in `cam`, (3, 3), about or along which the ball moves right, down, and the third way.

        The player's right, down and ahead are cam's axes, rotated about y by half a turn if the player faces it.
        Pointing right is a rotation about down, pointing down one about left, and clockwise one about ahead.
        """
        side = -1.0 if self.facing else 1.0
        if self.by == "turn":
            return np.array([[0.0, 1.0, 0.0], [-side, 0.0, 0.0], [0.0, 0.0, side]])
        return np.diag([side, 1.0, side])

    def matrix(self) -> Array:
        """Return counts x, y, third per rad of rotation vector, or per m of shift, in cam, (3, 3)."""
        scale = self.counts_per_radian if self.by == "turn" else self.counts_per_metre
        return self.directions() * (self.factors() * scale)[:, None]


def apply_backlash(slack: Array, displacement: Array, half_width: Array) -> tuple[Array, Array]:
    """Return the slack after a displacement, and the part that passes, all (3,), axis by axis.

    As between two gears, a displacement first takes up the slack and then passes. No more passes than the displacement
    itself, also if the backlash became narrower: a ball at rest does not move the pointer.
    """
    slack = slack + displacement
    excess = np.minimum(np.abs(slack) - half_width, np.abs(displacement))
    passed = np.where((excess > 0.0) & (slack * displacement > 0.0), np.sign(displacement) * excess, 0.0)
    return slack - passed, passed


class WandMapping:
    """Mapping of a hand-held ball. Fractions of a count and the slack carry over to the next call."""

    matrix: None = None  # its motion is in `cam`

    def __init__(self, settings: PointingSettings) -> None:
        self._settings = settings
        self.fraction: Rate = NO_REMAINDER
        self.slack = np.zeros(3)  # (3,) rad or m, cam: motion within the backlash
        self._counting = (
            False  # False: the ball was never seen, or it was lost; the motion to its next pose is not sent
        )

    def counts(self, estimate: Estimate) -> tuple[Counts, Rate | None]:
        """Return counts and counts/s of the motion since the last confirmed estimate.

        A ball that was hidden for a moment moves the pointer when it is seen again. A ball that was lost does not. The
        rate is None unless the estimate is confirmed in Status.TRACKING.
        """
        if estimate.status is not Status.TRACKING:
            self.interrupted()
        if estimate.status is not Status.TRACKING or not estimate.confirmed:
            return (0, 0, 0), None
        settings, matrix = self._settings, self._settings.matrix()
        part = slice(0, 3) if settings.by == "turn" else slice(3, 6)
        x, y, z = (matrix @ estimate.rate[part]).tolist()
        if not self._counting or not estimate.increment_covariance.any():  # found again: no motion without an error
            self.interrupted()
            self._counting = True
            return (0, 0, 0), (x, y, z)
        sigma = np.sqrt(np.diag(estimate.covariance)[part].clip(0.0))
        self.slack, passed = apply_backlash(self.slack, estimate.increment[part], settings.play * sigma)
        counts, self.fraction = to_counts(passed, matrix, self.fraction)
        return counts, (x, y, z)

    def interrupted(self) -> None:
        """Count no motion across a break in the frames, to the next pose. Fractions stay."""
        self._counting, self.slack = False, np.zeros(3)
