"""Convert the motion of a hand-held ball to mouse counts, without rounding loss and without jitter at rest.

The counts follow the increment of an estimate, its rotation vector or its shift, in axes of the camera. So no attitude
of the ball is singular. A backlash between pose and pointer is as wide as the filter's standard deviations, times
`play`. Within it the hand counts as resting.
"""

from dataclasses import dataclass, field, replace
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


@dataclass(frozen=True, slots=True)
class PointingState:
    """State of the mapping between two frames."""

    counting: bool = False  # False: the ball was never seen, or it was lost; the motion to its next pose moves nothing
    slack: Array = field(default_factory=lambda: np.zeros(3))  # (3,) rad or m, cam: motion within the backlash
    remainder: tuple[float, float, float] = NO_REMAINDER  # counts

    def reset(self) -> "PointingState":
        """Return the state of a ball that was lost."""
        return PointingState(remainder=self.remainder)


def point(
    state: PointingState, estimate: Estimate, settings: PointingSettings
) -> tuple[PointingState, Counts, Rate | None]:
    """Return the next state, and counts and counts/s of the motion since the last confirmed estimate.

    A ball that was hidden for a moment moves the pointer when it is seen again. A ball that was lost does not. The
    rate is None unless the estimate is confirmed in Status.TRACKING.
    """
    if estimate.status is not Status.TRACKING:
        return state.reset(), (0, 0, 0), None
    if not estimate.confirmed:
        return state, (0, 0, 0), None
    rate = pointing_rate(estimate.rate, settings)
    if not state.counting or not estimate.increment_covariance.any():  # found again: no motion without an error
        return replace(state.reset(), counting=True), (0, 0, 0), rate
    part = slice(0, 3) if settings.by == "turn" else slice(3, 6)
    sigma = np.sqrt(np.diag(estimate.covariance)[part].clip(0.0))
    slack, passed = apply_backlash(state.slack, estimate.increment[part], settings.play * sigma)
    counts, remainder = to_counts(passed, settings.matrix(), state.remainder)
    return PointingState(counting=True, slack=slack, remainder=remainder), counts, rate


def pointing_rate(rate: Array, settings: PointingSettings) -> tuple[float, float, float]:
    """Return counts/s of the three axes at a rate (6,), rad/s and m/s in cam."""
    x, y, z = (settings.matrix() @ (rate[:3] if settings.by == "turn" else rate[3:])).tolist()
    return x, y, z


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
    """Mapping of a hand-held ball."""

    matrix: None = None  # its motion is in `cam`

    def __init__(self, settings: PointingSettings) -> None:
        self._settings, self._state = settings, PointingState()

    @property
    def fraction(self) -> Rate:
        return self._state.remainder

    def counts(self, estimate: Estimate) -> tuple[Counts, Rate | None]:
        self._state, counts, rate = point(self._state, estimate, self._settings)
        return counts, rate

    def interrupted(self) -> None:
        """Reset after a break in the frames: the motion to the next pose moves nothing."""
        self._state = self._state.reset()
