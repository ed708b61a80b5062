"""The estimate of a hand-held ball: its pose and velocity, and its motion since the last measured pose."""

import numpy as np

from spheremouse.geometry.rotation import Array, exp, left_jacobian, log
from spheremouse.tracker import Estimate, Status, unknown
from spheremouse.wand.pose_velocity import MAX_HAND_VELOCITY, pose_difference
from spheremouse.wand.state import MeasuredPose, Track, WandPose

_ROTATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])  # a pose has it last, an estimate first
_MAX_NOISE_SIGMAS = 3.0  # error of a pose beside the fastest motion of a hand


def measured_pose(before: MeasuredPose | None, pose: WandPose, stamp: float) -> MeasuredPose | None:
    """Return the last measured pose after a frame, from which the next increment counts; None for a lost ball.

    A frame that does not show the ball keeps the pose `before`.
    """
    if pose.phase is not Status.TRACKING or pose.position is None or pose.rotation is None or pose.covariance is None:
        return None
    return MeasuredPose(stamp, pose.position, pose.rotation, pose.covariance) if pose.seen else before


def estimate(before: MeasuredPose | None, track: Track, pose: WandPose, stamp: float, sequence: int) -> Estimate:
    """Return the estimate of a frame; `before` is the last measured pose before it.

    A change faster than any hand is a corrected pose or another ball. As after a loss, its increment is zero. The
    errors of poses and rate are assumed to be independent. If the images have equal errors, the increment is better
    than its covariance.
    """
    if pose.position is None or pose.rotation is None or pose.covariance is None:
        return unknown(stamp, sequence, pose.phase)
    increment, increment_covariance = np.zeros(6), np.zeros((6, 6))
    covariance, rate = np.zeros((12, 12)), np.zeros(6)
    covariance[:6, :6] = pose.covariance[_ROTATION_FIRST]
    if track.pose_velocity is not None:
        rate = np.roll(track.pose_velocity.velocity, 3)
        covariance[6:, 6:] = track.pose_velocity.covariance[6:, 6:][_ROTATION_FIRST]
    if pose.seen and before is not None:
        now = MeasuredPose(stamp, pose.position, pose.rotation, pose.covariance)
        if _is_plausible(before, now):
            increment, increment_covariance = _increment(before, now)
    return Estimate(
        stamp,
        sequence,
        pose.phase,
        pose.rotation,
        pose.position,
        rate,
        covariance,
        increment,
        increment_covariance,
        pose.seen,
        {"match": pose.match, "effective_particles": pose.effective},
    )


def _increment(before: MeasuredPose, now: MeasuredPose) -> tuple[Array, Array]:
    """Return rotation vector and shift between two poses, (6,), and their covariance, (6, 6)."""
    turn = log(now.rotation @ before.rotation.T)
    A, J = np.eye(6), np.eye(6)
    A[3:, 3:], J[:3, :3] = exp(turn), np.linalg.inv(left_jacobian(turn))
    covariance = J @ (now.covariance + A @ before.covariance @ A.T)[_ROTATION_FIRST] @ J.T
    return np.concatenate([turn, now.position - before.position]), covariance


def _is_plausible(before: MeasuredPose, now: MeasuredPose) -> bool:
    """Return False if the change exceeds the fastest motion of a hand and the error of both poses."""
    dt = now.stamp - before.stamp
    change = pose_difference(before.position, before.rotation, now.position, now.rotation)
    variance = (np.diag(before.covariance) + np.diag(now.covariance)).clip(0.0)
    return bool(dt > 0.0 and (np.abs(change) <= MAX_HAND_VELOCITY * dt + _MAX_NOISE_SIGMAS * np.sqrt(variance)).all())
