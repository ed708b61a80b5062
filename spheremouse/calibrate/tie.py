"""Tie the rigs of two cameras of one ball: the rotation between their axes, from the ball's motion as each sees it.

Each camera alone tracks the ball in the axes of its own rig, and from an attitude of its own at the first frame. So the
attitudes are R_a = C R_b D, with the rotation C between the axes and D between the axes on the ball. Rotations between
two stamps give a first C (Wahba's problem), and all attitudes then give C, D and the difference of the clocks.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import Rig, in_axes
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, align, exp, hat, log

_STEP_S = 0.3  # s, between the stamps of a first rotation: more than the noise, less than half a turn
_INDEPENDENT = 8.0  # deviations in all: the same discs in view have the same errors of the maps
_MAX_INTERVAL_S = 0.1  # s, between the frames that an attitude is interpolated from
_MIN_SECONDS = 5.0  # s that both cameras must track
_MAX_RMS = np.radians(0.5)  # of the deviations of one ball: tracking is better by far
_MAX_SIGMA = np.radians(0.1)  # of the axes: a ball that turns about one axis leaves more
_HUBER = 3.0  # medians of a deviation, from which it counts less
_ITERATIONS = 10


@dataclass(frozen=True, slots=True)
class AttitudeTrack:
    """Motion of the ball as one camera saw it: n tracked frames, in the order of their stamps."""

    stamp: Array  # (n,) s
    attitude: Array  # (n, 3, 3) R_obj_ball
    rate: Array  # (n, 3) rad/s, w_obj


@dataclass(frozen=True, slots=True)
class Tie:
    """The rotation from the axes of a second camera's rig to those of the first, and how well it fits."""

    rotation: Array  # (3, 3) R_first_second
    covariance: Array  # (3, 3) rad², of an error in the axes of the first
    lag: float  # s, by which the stamps of the second camera are late
    rms: float  # rad, of the deviations
    frames: int


def tie(first: AttitudeTrack, second: AttitudeTrack) -> Tie:
    """Estimate the tie of two cameras. The faster one is interpolated at the stamps of the other.

    Raises CalibrationError if they have too few frames in common, if the ball turned about one axis only, or if the
    tracks are not of one ball by one clock.
    """
    if _interval(first) <= _interval(second):
        return _tie(first, second)
    back = _tie(second, first)
    R = back.rotation.T
    return replace(back, rotation=R, covariance=R @ back.covariance @ R.T, lag=-back.lag)


def _interval(track: AttitudeTrack) -> float:
    """Return the usual time between two frames, s."""
    return float(np.median(np.diff(track.stamp))) if len(track.stamp) > 1 else np.inf


def _tie(first: AttitudeTrack, second: AttitudeTrack) -> Tie:
    """Estimate the tie as `tie`, with the track of the first camera interpolated."""
    R, rate, which = _at(first, second.stamp)
    stamp, S = second.stamp[which], second.attitude[which]
    if len(stamp) < 2 or stamp[-1] - stamp[0] < _MIN_SECONDS or len(stamp) < 10 * _MIN_SECONDS:
        seconds = 0.0 if len(stamp) < 2 else float(stamp[-1] - stamp[0])
        raise CalibrationError(
            f"both cameras track the ball at the same time for {seconds:.1f} s",
            f"roll it in view of both for {_MIN_SECONDS:g} s or more; recordings must be of one run, by one clock",
        )
    C = _first_rotation(stamp, R, S)
    D = align(np.eye(3), np.sum(np.swapaxes(S, 1, 2) @ C.T @ R, axis=0).T)  # the nearest rotation to the sum
    lag, inverse, size = 0.0, np.zeros((7, 7)), np.zeros(len(stamp))
    for _ in range(_ITERATIONS):
        deviation = log(R @ np.swapaxes(C @ S @ D, 1, 2)) - lag * rate
        size = np.linalg.norm(deviation, axis=1)
        weight = np.minimum(1.0, _HUBER * np.median(size) / np.maximum(size, 1e-12))
        J = np.concatenate([np.broadcast_to(np.eye(3), R.shape), C @ S, rate[:, :, None]], axis=2)  # of C, D, lag
        inverse = np.linalg.pinv(np.einsum("n,nij,nik->jk", weight, J, J), hermitian=True)
        step = inverse @ np.einsum("n,nij,ni->j", weight, J, deviation)
        C, D, lag = exp(step[:3]) @ C, exp(step[3:6]) @ D, lag + float(step[6])
    rms = float(np.sqrt(np.mean(size**2)))
    if rms > _MAX_RMS:
        raise CalibrationError(
            f"the two tracks differ by {np.degrees(rms):.2f}° (RMS): they are not of one ball by one clock",
            "record both cameras at the same time, and check each rig",
        )
    covariance = len(stamp) * rms**2 / _INDEPENDENT * inverse[:3, :3]
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    if sigma > _MAX_SIGMA:
        raise CalibrationError(
            f"the axes are known to {np.degrees(sigma):.2f}° only", "roll the ball longer, about different axes"
        )
    return Tie(C, covariance, lag, rms, len(stamp))


def tied(rig: Rig, tie: Tie) -> Rig:
    """Return the rig of the second camera in the axes of the first. Its errors include those of the tie."""
    nowhere = Pose(np.eye(3), np.zeros(3))
    turned, pose = in_axes(rig, rig.pose or nowhere, tie.rotation)
    by_tie = -hat(turned.targets.position).reshape(-1, 3)
    targets = replace(turned.targets, covariance=turned.targets.covariance + by_tie @ tie.covariance @ by_tie.T)
    turned = replace(turned, targets=targets, disc_directions=None)
    if rig.pose is None:
        return turned
    by_tie = np.concatenate([-hat(pose.position), np.eye(3)])
    return replace(turned, pose=replace(pose, covariance=pose.covariance + by_tie @ tie.covariance @ by_tie.T))


def _at(track: AttitudeTrack, stamps: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Interpolate a track at stamps, (n,), by cubic Hermite splines between two frames.

    Returns attitudes, (k, 3, 3), rates, (k, 3), and the indices, (k,), of the stamps that lie between two near frames.
    """
    after = np.searchsorted(track.stamp, stamps)
    inside = (after > 0) & (after < len(track.stamp))
    inside[inside] = np.diff(track.stamp)[after[inside] - 1] < _MAX_INTERVAL_S
    which = np.flatnonzero(inside)
    b = after[which]
    a, dt = b - 1, (track.stamp[b] - track.stamp[b - 1])[:, None]
    s = (stamps[which] - track.stamp[a])[:, None] / dt
    turn = log(track.attitude[b] @ np.swapaxes(track.attitude[a], 1, 2))
    along = s * s * (3.0 - 2.0 * s) * turn
    along += dt * (s * (1.0 - s) ** 2 * track.rate[a] + s * s * (s - 1.0) * track.rate[b])
    return exp(along) @ track.attitude[a], (1.0 - s) * track.rate[a] + s * track.rate[b], which


def _first_rotation(stamp: Array, R: Array, S: Array) -> Array:
    """Return the rotation, (3, 3), between the axes of two tracks, from the turns of both between two stamps."""
    later = np.searchsorted(stamp, stamp + _STEP_S)
    now = np.flatnonzero(later < len(stamp))
    turns = [log(T[later[now]] @ np.swapaxes(T[now], 1, 2)) for T in (S, R)]
    return align(*turns)
