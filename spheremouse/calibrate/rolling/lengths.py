"""Lengths that a person measured: how large the discs are over the ball by them, and whether targets contradict."""

from typing import NamedTuple

from spheremouse.ball.rig import Ball
from spheremouse.calibrate.rolling.axes_choice import AxesFrom
from spheremouse.calibrate.rolling.calibrate import Views
from spheremouse.calibrate.rolling.placed import placed, with_rolled
from spheremouse.calibrate.rolling.problem import Rolled
from spheremouse.errors import CalibrationError

TAPE = 0.002  # part by which a length that a person measured on a ball is off: tape, and balls are not rounder
_DOUBT = 5.0  # standard deviations from which a radius contradicts what the targets tell
_FIRST = 0.1  # part by which the first look's radius may be off: its discs' size was only seen


class Lengths(NamedTuple):
    """What was measured, m."""

    radius: float | None  # of the ball
    disc_radius: float | None


def disc_angle(lengths: Lengths, axes: AxesFrom, rolled: Rolled, views: Views) -> float | None:
    """Radius of a disc over the ball's, where lengths or targets tell it."""
    radius = lengths.radius
    if axes.rig is not None and axes.device is None and axes.gestures is None:
        ball = placed(rolled, with_rolled(axes.find(rolled, views)[0], rolled))[1]
        if radius is not None and not axes.rig.scale_free:
            check_radius(radius, ball, _FIRST)
        if radius is None or (axes.rig.scale_free and lengths.disc_radius is None):
            radius = ball.radius
    disc = lengths.disc_radius or axes.disc_radius
    return None if disc is None or radius is None else disc / radius


def check_radius(radius: float, ball: Ball, rough: float = 0.0) -> None:
    """CalibrationError where a length that was given contradicts the ball that the targets tell, beyond `rough`."""
    sigma = float(ball.covariance[3, 3]) ** 0.5
    if abs(radius - ball.radius) <= max(rough * ball.radius, _DOUBT * ((TAPE * radius) ** 2 + sigma**2) ** 0.5):
        return
    why = "measure again, or leave the length out: the targets tell it"
    for factor, what in ((2.0, "the diameter was given for the radius"), (0.5, "half the radius was given")):
        if abs(radius / ball.radius / factor - 1.0) < _FIRST:
            why = f"it seems that {what}; leave the length out, or correct it"
    raise CalibrationError(
        f"the ball's radius is given as {radius:.4g} m, but the targets of the rig put it at {ball.radius:.4g} m: {why}"
    )
