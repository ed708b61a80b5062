"""Poses of a hand-held ball -> motion of a mouse, in counts, with nothing lost to rounding and no jitter at rest.

As with the ball in its frame, what counts is the rotation vector between two frames (or the shift), in axes that stand
still: it has no singular attitude, however the ball is held. Between the pose and the pointer there is some play, as
wide as the filter says that the pose may be off: within it a hand is taken to rest.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from spheremouse.geometry.rotation import Array, exp, left_jacobian, log
from spheremouse.output import Report, no_report
from spheremouse.output.counts import Remainder, to_counts
from spheremouse.settings import FACTOR, HAND, HAND_TURN, PER_RADIAN, param
from spheremouse.tracker import Motion, Status
from spheremouse.wand.course import Course, between
from spheremouse.wand.state import WandEpoch, WandPose

_TURN_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])  # what a pose has last, a motion has first
_NOISE = 3.0  # standard deviations by which a pose may be off, besides what a hand does


@dataclass(frozen=True, slots=True)
class PointingSettings:
    """From the ball's motion to counts."""

    by: Literal["turn", "shift"] = param(
        "turn",
        "-",
        "the pointer follows how the ball turns (right and left: x; up and down: y; clockwise: third), or how it is "
        "shifted (right and left: x; up and down: y; ahead: third)",
    )
    facing: bool = param(
        True, "-", "who holds the ball faces the camera, as one on the screen; false: looks the way the camera does"
    )
    counts_per_radian: float = param(
        1800.0,
        "counts/rad",
        "scale of turns: 60 degrees, which a wrist does at ease, cross a screen of 1920 px",
        **PER_RADIAN,
    )
    counts_per_metre: float = param(
        4800.0,
        "counts/m",
        "scale of shifts: 0.4 m, which a forearm does at ease, cross a screen of 1920 px",
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
        "play either way, in standard deviations of the pose as the filter reports them: 95 % of its errors lie "
        "within two; 0 passes all of its jitter on",
        ge=0,
        le=10,
    )
    fastest: float = param(
        3.0, "m/s", "no hand moves faster: what says so is a pose put right, or another ball, and moves nothing", **HAND
    )
    fastest_turn: float = param(20.0, "rad/s", "the same of turns (1150 degrees/s)", **HAND_TURN)

    def directions(self) -> Array:
        """Axes in `cam`, (3, 3), about which or along which the ball goes to the right, down, and the third way.

        Whoever holds the ball has right, down and ahead along cam's axes, or turned about y by half a turn. Pointing
        further to the right is a turn about down, pointing down one about left, and clockwise one about ahead.
        """
        side = -1.0 if self.facing else 1.0
        if self.by == "turn":
            return np.array([[0.0, 1.0, 0.0], [-side, 0.0, 0.0], [0.0, 0.0, side]])
        return np.diag([side, 1.0, side])

    def matrix(self) -> Array:
        """(3, 3): counts x, y, third per rad of rotation vector, or per m of shift, in cam."""
        scale = self.counts_per_radian if self.by == "turn" else self.counts_per_metre
        sign = np.where([self.invert_x, self.invert_y, self.invert_z], -1.0, 1.0)
        return self.directions() * (sign * (self.scale_x, self.scale_y, self.scale_z) * scale)[:, None]


@dataclass(frozen=True, slots=True)
class ReferencePose:
    """The pose that motion is counted from."""

    stamp: float  # s
    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad

    @property
    def variance(self) -> Array:
        """(6,) m², rad²."""
        return np.diag(self.covariance).clip(0.0)


@dataclass(frozen=True, slots=True)
class Pointing:
    """State of the mapping from frame to frame."""

    reference: ReferencePose | None = None  # None: the ball has not been seen, or was lost since
    slack: Array = field(default_factory=lambda: np.zeros(3))  # rad or m, cam: motion taken up by the play
    remainder: Remainder = field(default_factory=Remainder)  # counts


def point(
    pointing: Pointing, pose: WandPose, course: Course | None, stamp: float, settings: PointingSettings
) -> tuple[Pointing, Report]:
    """The report of one frame, with the motion since the last pose, in cam; `course` has the velocity.

    Only poses that were seen move anything: a ball that is hidden for a moment is where it is when it shows again, one
    that was lost begins anew from there.
    """
    still = no_report(stamp)
    if pose.phase is not Status.TRACKING or pose.position is None or pose.rotation is None:
        return begun_anew(pointing), still
    if not pose.seen or pose.covariance is None:
        return pointing, still
    now = ReferencePose(stamp, pose.position, pose.rotation, pose.covariance)
    velocity = np.zeros(6) if course is None else course.velocity
    rate = pointing_rate(velocity, settings)
    if pointing.reference is None or _is_leap(pointing.reference, now, settings):
        return replace(begun_anew(pointing), reference=now), Report((0, 0, 0), rate, _motion(now, now, course))
    motion = _motion(pointing.reference, now, course)
    if settings.by == "turn":
        way, variance = motion.rotation, now.variance[3:]
    else:
        way, variance = motion.shift, now.variance[:3]
    slack, passed = taken_up(pointing.slack, way, settings.play * np.sqrt(variance))
    counts, remainder = to_counts(passed, settings.matrix(), pointing.remainder)
    return Pointing(now, slack, remainder), Report(counts, rate, motion)


def _motion(before: ReferencePose, now: ReferencePose, course: Course | None) -> Motion:
    """The motion from one pose to another, and the rate at its end.

    The errors of the two are taken as independent, and as those of the rate: where pictures err alike, the motion is
    better than its covariance says.
    """
    turn, covariance, rate = log(now.rotation @ before.rotation.T), np.zeros((12, 12)), np.zeros(6)
    if before is not now:  # else a motion begins to count
        A, J = np.eye(6), np.eye(6)
        A[3:, 3:], J[:3, :3] = exp(turn), np.linalg.inv(left_jacobian(turn))
        covariance[:6, :6] = J @ (now.covariance + A @ before.covariance @ A.T)[_TURN_FIRST] @ J.T
    if course is not None:
        rate, covariance[6:, 6:] = np.roll(course.velocity, 3), course.covariance[6:, 6:][_TURN_FIRST]
    return Motion(now.stamp, turn, now.position - before.position, rate, covariance, confirmed=True)


def begun_anew(pointing: Pointing) -> Pointing:
    """Wherever the ball is next seen, nothing moves to there."""
    return Pointing(remainder=pointing.remainder)


def pointing_rate(velocity: Array, settings: PointingSettings) -> tuple[float, float, float]:
    """Counts/s of the three axes at a velocity, (6,) m/s and rad/s in cam."""
    part = velocity[3:] if settings.by == "turn" else velocity[:3]
    x, y, z = (settings.matrix() @ part).tolist()
    return x, y, z


def taken_up(slack: Array, way: Array, play: Array) -> tuple[Array, Array]:
    """Slack after a way, and what of the way is passed on, all (3,), axis by axis.

    As between two gears: the way goes into the slack until that is as wide as the play, the rest is passed on. No more
    is passed on than the way itself, also where the play becomes narrower: what rests does not move.
    """
    slack = slack + way
    beyond = np.minimum(np.abs(slack) - play, np.abs(way))
    passed = np.where((beyond > 0.0) & (slack * way > 0.0), np.sign(way) * beyond, 0.0)
    return slack - passed, passed


def _is_leap(before: ReferencePose, after: ReferencePose, settings: PointingSettings) -> bool:
    """Is it further than a hand gets in that time, and the filter may be off?"""
    dt = after.stamp - before.stamp
    way = between(before.position, before.rotation, after.position, after.rotation)
    reach = np.repeat([settings.fastest * dt, settings.fastest_turn * dt], 3)
    return bool(dt <= 0.0 or (np.abs(way) > reach + _NOISE * np.sqrt(before.variance + after.variance)).any())


class HandMapping:
    """Reports of the pointer from the epochs of a run, as they come."""

    def __init__(self, settings: PointingSettings, points: int = 0) -> None:
        """`points` is the index of the ball that moves the pointer."""
        self._settings, self._points = settings, points
        self._pointing = Pointing()

    def report(self, epoch: WandEpoch) -> Report:
        """The next one."""
        pose, course = epoch.poses[self._points], epoch.state.tracks[self._points].course
        self._pointing, report = point(self._pointing, pose, course, epoch.frame.stamp, self._settings)
        return report

    def interrupted(self) -> None:
        """No frames came for a while: nothing moves to where the ball is next seen."""
        self._pointing = begun_anew(self._pointing)
