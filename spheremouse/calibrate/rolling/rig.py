"""The rig that a rolled ball makes: how large all is, where targets and camera are, the discs, the readout."""

from typing import NamedTuple

import numpy as np

from spheremouse.ball.compare_maps import turned
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.calibrate.rolling.axes import Axes
from spheremouse.calibrate.rolling.axes_choice import AxesFrom
from spheremouse.calibrate.rolling.calibrate import Solution
from spheremouse.calibrate.rolling.lengths import TAPE, check_radius
from spheremouse.calibrate.rolling.placed import (
    known_with_ball,
    placed,
    placed_targets,
    rescaled_targets,
    with_rolled,
)
from spheremouse.calibrate.rolling.problem import Rolled
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array

_READOUT_KNOWN = 1e-3  # s, standard deviation from which a readout is told


class Calibrated(NamedTuple):
    """Everything that a rolled ball tells."""

    rig: Rig
    disc_map: DiscMap
    axes: Axes
    source: str  # of the axes: targets, device or gestures


class _Scaled(NamedTuple):
    """What has a length."""

    pose: Pose
    ball: Ball
    targets: Targets
    cross: Array | None  # (3n, 4) m², of targets with the ball
    free: bool  # of no unit


def calibrated(solution: Solution, axes: AxesFrom, radius: float | None, exposure_s: float) -> Calibrated:
    """The device, with the axes that were found; `radius` of the ball, m, where a person measured it."""
    rolled = solution.rolled
    found, source = axes.find(rolled, solution.views)
    found = with_rolled(found, rolled)
    scaled = _scaled(rolled, found, source, axes, radius)
    at_first = found.rotation @ rolled.rolling.attitude[0]
    seen = np.bincount(rolled.sightings.disc, minlength=len(rolled.rolling.discs))
    disc_map = turned(DiscMap(rolled.rolling.discs, rolled.disc_covariance, seen), at_first)
    readout, sigma = rolled.rolling.readout, rolled.readout_sigma
    told = sigma < _READOUT_KNOWN and readout > -2.0 * sigma
    rig = Rig(
        camera=axes.camera,
        ball=scaled.ball,
        targets=scaled.targets,
        disc_radius=solution.disc_angle * scaled.ball.radius,
        readout_s=(readout if readout > 2.0 * sigma else 0.0) if told else 0.0,
        readout_sigma_s=0.0 if told else UNKNOWN_READOUT,
        exposure_s=exposure_s,
        pose=scaled.pose,
        disc_directions=disc_map.directions,
        cross_covariance=scaled.cross,
        scale_free=scaled.free,
    )
    return Calibrated(rig, disc_map, found, source)


def _scaled(rolled: Rolled, found: Axes, source: str, axes: AxesFrom, given: float | None) -> _Scaled:
    """By the length that was `given`, else by that which the targets tell, else in radii of the ball."""
    radius, sigma = (1.0, 0.0) if given is None else (given, TAPE * given)
    if source == "targets":
        assert axes.rig is not None
        targets = axes.rig.targets
        pose, ball = placed(rolled, found)
        if given is None:
            return _Scaled(pose, ball, targets, known_with_ball(found, ball.radius), axes.rig.scale_free)
        told = ball
        pose, ball = placed(rolled, found, radius, sigma)
        if axes.rig.scale_free:
            return _Scaled(pose, ball, *rescaled_targets(targets, told, ball), False)
        check_radius(given, told)
        return _Scaled(pose, ball, targets, None, False)
    pose, ball = placed(rolled, found, radius, sigma)
    if source == "device" and given is not None:
        assert axes.device is not None
        return _Scaled(pose, ball, *placed_targets(found, axes.device, rolled, radius, sigma), False)
    none = Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3))
    return _Scaled(pose, ball, none, None, given is None)
