"""The direction of a ball's motion in words, as seen by its player."""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output.counts import MotionSettings
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.session.control.status import MotionStatus
from spheremouse.tracker import Estimate

_MIN_SHARE = 0.1  # of the largest part; less is not worth a word


@dataclass(frozen=True, slots=True)
class Directions:
    """Directions of the pointer's axes x, y and third, before any is reversed."""

    axes: Array  # (3, 3) unit vectors in obj or cam: about which the ball turns, or along which it is shifted
    words: tuple[tuple[str, str], tuple[str, str], tuple[str, str]]  # along each, and against
    part: slice  # of (6,) `Estimate.rate`: rotation, or translation
    unit: str  # of a displayed rate
    factor: float  # from rad/s or m/s to `unit`
    min_rate: float  # in `unit`, below which the ball is at rest

    def motion(self, estimate: Estimate) -> MotionStatus:
        """Return the rate of an estimate for the status. Its words leave out parts below a tenth of the largest."""
        rate = self.factor * self.axes @ estimate.rate[self.part]
        least = max(self.min_rate, _MIN_SHARE * float(np.max(np.abs(rate))))
        digits = 0 if self.min_rate >= 1.0 else 2
        parts = [
            f"{words[value < 0.0]} {abs(value):.{digits}f} {self.unit}"
            for value, words in zip(rate.tolist(), self.words, strict=True)
            if abs(value) >= least
        ]
        return MotionStatus(rate=rate.tolist(), unit=self.unit, words=", ".join(parts) or "at rest")


def of_ball(settings: MotionSettings) -> Directions:
    """Return the directions of a ball in its frame, as the player sees its top move."""
    words = ("right", "left"), ("towards you", "away from you"), ("counter-clockwise", "clockwise")
    return _of_rotation(settings.directions(), words)


def of_hand(settings: PointingSettings) -> Directions:
    """Return the directions of a hand-held ball, as its holder sees it."""
    if settings.by == "turn":
        words = ("right", "left"), ("down", "up"), ("clockwise", "counter-clockwise")
        return _of_rotation(settings.directions(), words)
    words = ("right", "left"), ("down", "up"), ("ahead", "back")
    return Directions(settings.directions(), words, part=slice(3, 6), unit="m/s", factor=1.0, min_rate=0.01)


def _of_rotation(axes: Array, words: tuple[tuple[str, str], tuple[str, str], tuple[str, str]]) -> Directions:
    return Directions(axes, words, part=slice(0, 3), unit="°/s", factor=np.degrees(1.0), min_rate=1.0)
