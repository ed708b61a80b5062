"""Convert poses of a hand-held ball to mouse counts, without rounding loss and without jitter at rest.

The counts follow the rotation vector between two frames, or the shift, in axes of the camera. So no attitude of the
ball is singular. A backlash between pose and pointer is as wide as the filter's standard deviations, times `play`.
Within it the hand counts as resting.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from spheremouse.geometry.rotation import Array, exp, left_jacobian, log
from spheremouse.output import Report, no_report
from spheremouse.output.counts import Remainder, to_counts
from spheremouse.settings import FACTOR, PER_RADIAN, param
from spheremouse.tracker import Estimate, Status, unknown
from spheremouse.wand.pose_velocity import PoseVelocityState, pose_difference
from spheremouse.wand.state import WandEpoch, WandPose

_ROTATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])  # a pose has it last, an estimate first
_MAX_NOISE_SIGMAS = 3.0  # error of a pose beside the fastest motion of a hand


@dataclass(frozen=True, slots=True)
class PointingSettings:
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
    scale_x: float = param(1.0, "-", "factor on the pointer's X", refused="to reverse it: invert_x", **FACTOR)
    scale_y: float = param(1.0, "-", "factor on the pointer's Y", refused="to reverse it: invert_y", **FACTOR)
    scale_z: float = param(1.0, "-", "factor on the third axis", refused="to reverse it: invert_z", **FACTOR)
    invert_x: bool = param(False, "-", "reverse X")
    invert_y: bool = param(False, "-", "reverse Y")
    invert_z: bool = param(False, "-", "reverse the third axis")
    play: float = param(
        2.0,
        "-",
        "half width of the backlash, in standard deviations of the pose: 95 % of the errors lie within two; 0 passes "
        "all jitter to the pointer",
        ge=0,
        le=10,
    )
    # Not settings: no hand moves faster. A larger change is a corrected pose or another ball, and moves nothing.
    fastest: float = 3.0  # m/s
    fastest_turn: float = 20.0  # rad/s, 1150 °/s

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
        sign = np.where([self.invert_x, self.invert_y, self.invert_z], -1.0, 1.0)
        return self.directions() * (sign * (self.scale_x, self.scale_y, self.scale_z) * scale)[:, None]


@dataclass(frozen=True, slots=True)
class ReferencePose:
    """The last pose from which motion is counted."""

    stamp: float  # s
    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad

    @property
    def variance(self) -> Array:
        """Return the variances, (6,) m², rad²."""
        return np.diag(self.covariance).clip(0.0)


@dataclass(frozen=True, slots=True)
class PointingState:
    """State of the mapping between two frames."""

    reference: ReferencePose | None = None  # None: the ball was never seen, or it was lost
    slack: Array = field(default_factory=lambda: np.zeros(3))  # rad or m, cam: motion within the backlash
    remainder: Remainder = field(default_factory=Remainder)  # counts

    def reset(self) -> "PointingState":
        """Return the state without a reference: the motion to the next pose moves nothing."""
        return PointingState(remainder=self.remainder)


def point(
    state: PointingState,
    pose: WandPose,
    velocity_state: PoseVelocityState | None,
    stamp: float,
    settings: PointingSettings,
) -> tuple[PointingState, Report]:
    """Return the next state, and the report of a frame with the motion since the last pose, in cam.

    `velocity_state` has the velocity. A ball that was hidden for a moment moves the pointer when it is seen again. A
    ball that was lost does not.
    """
    still = no_report(stamp)
    if pose.phase is not Status.TRACKING or pose.position is None or pose.rotation is None:
        return state.reset(), still
    if not pose.seen or pose.covariance is None:
        return state, still
    now = ReferencePose(stamp, pose.position, pose.rotation, pose.covariance)
    velocity = np.zeros(6) if velocity_state is None else velocity_state.velocity
    rate = pointing_rate(velocity, settings)
    if state.reference is None or _is_implausible(state.reference, now, settings):
        return replace(state.reset(), reference=now), Report((0, 0, 0), rate, _estimate(now, now, velocity_state))
    estimate = _estimate(state.reference, now, velocity_state)
    if settings.by == "turn":
        displacement, variance = estimate.increment[:3], now.variance[3:]
    else:
        displacement, variance = estimate.increment[3:], now.variance[:3]
    slack, passed = apply_backlash(state.slack, displacement, settings.play * np.sqrt(variance))
    counts, remainder = to_counts(passed, settings.matrix(), state.remainder)
    return PointingState(now, slack, remainder), Report(counts, rate, estimate)


def _estimate(before: ReferencePose, now: ReferencePose, velocity_state: PoseVelocityState | None) -> Estimate:
    """Return the estimate at a pose, with the increment from the pose before and the rate at its end.

    The errors of poses and rate are assumed to be independent. If the images have equal errors, the increment is better
    than its covariance.
    """
    turn, increment_covariance = log(now.rotation @ before.rotation.T), np.zeros((6, 6))
    covariance, rate = np.zeros((12, 12)), np.zeros(6)
    covariance[:6, :6] = now.covariance[_ROTATION_FIRST]
    if before is not now:
        A, J = np.eye(6), np.eye(6)
        A[3:, 3:], J[:3, :3] = exp(turn), np.linalg.inv(left_jacobian(turn))
        increment_covariance = J @ (now.covariance + A @ before.covariance @ A.T)[_ROTATION_FIRST] @ J.T
    if velocity_state is not None:
        rate = np.roll(velocity_state.velocity, 3)
        covariance[6:, 6:] = velocity_state.covariance[6:, 6:][_ROTATION_FIRST]
    return unknown(now.stamp, status=Status.TRACKING)._replace(
        rotation=now.rotation,
        position=now.position,
        rate=rate,
        covariance=covariance,
        increment=np.concatenate([turn, now.position - before.position]),
        increment_covariance=increment_covariance,
        confirmed=True,
    )


def pointing_rate(velocity: Array, settings: PointingSettings) -> tuple[float, float, float]:
    """Return counts/s of the three axes at a velocity (6,), m/s and rad/s in cam."""
    part = velocity[3:] if settings.by == "turn" else velocity[:3]
    x, y, z = (settings.matrix() @ part).tolist()
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


def _is_implausible(before: ReferencePose, after: ReferencePose, settings: PointingSettings) -> bool:
    """Return True if the change exceeds the fastest motion of a hand and the error of both poses."""
    dt = after.stamp - before.stamp
    change = pose_difference(before.position, before.rotation, after.position, after.rotation)
    reach = np.repeat([settings.fastest * dt, settings.fastest_turn * dt], 3)
    return bool(
        dt <= 0.0 or (np.abs(change) > reach + _MAX_NOISE_SIGMAS * np.sqrt(before.variance + after.variance)).any()
    )


class WandMapping:
    """Makes the pointer's reports from the epochs of a run."""

    def __init__(self, settings: PointingSettings, points: int = 0) -> None:
        """Take the index `points` of the ball that moves the pointer."""
        self._settings, self._points = settings, points
        self._state = PointingState()

    def report(self, epoch: WandEpoch) -> Report:
        """Return the report of an epoch."""
        pose, velocity_state = epoch.poses[self._points], epoch.state.tracks[self._points].pose_velocity
        self._state, report = point(self._state, pose, velocity_state, epoch.frame.stamp, self._settings)
        return report

    def interrupted(self) -> None:
        """Reset after a break in the frames: the motion to the next pose moves nothing."""
        self._state = self._state.reset()
