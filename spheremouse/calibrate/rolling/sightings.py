"""Sightings of discs for the adjustment, from the tracker with a rough rig; its map matches them between frames.

If the tracker lost the ball and began a new map, the constellation of the discs joins the two segments.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import identify
from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import TrackState
from spheremouse.ball.track import step
from spheremouse.calibrate.outline.fit import R_OBJ_CAM
from spheremouse.calibrate.rolling.problem import Rolling, Sightings
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame, Status

_MIN_SEMI_MINOR = 2.0  # px; below, both rims are one blur, with a bias that is the same in every frame
_DIRECTION_SIGMA = 0.003  # rad, when two maps are matched
_MAX_JOIN_RISK = 1e-4  # of a wrong match of two segments
_MAX_JOIN_FRAMES = 50  # of a segment that are tried


@dataclass(frozen=True, slots=True)
class TrackedRolling:
    rolling: Rolling
    sightings: Sightings
    size: float  # of the fitted discs over the expected size
    lost: int  # number of times it lost the ball
    frames: int  # all frames read


@dataclass(slots=True)
class _Segment:
    stamp: list[float] = field(default_factory=list)
    attitude: list[Array] = field(default_factory=list)  # R_obj_ball
    direction: list[Array] = field(default_factory=list)  # (n, 3) obj
    centre: list[Array] = field(default_factory=list)
    covariance: list[Array] = field(default_factory=list)
    discs: Array = field(default_factory=lambda: np.zeros((0, 3)))  # the map in the end


def provisional_pose(direction: Array, ratio: float) -> Pose:
    """Return the camera in `obj` with the axes of the picture, for a ball of radius 1.

    `direction` (3,) is the unit vector in cam to the ball's centre, at `ratio` radii.
    """
    return Pose(R_OBJ_CAM, -ratio * (R_OBJ_CAM @ direction))


def track_rolling(frames: Iterable[Frame], rig: Rig, pose: Pose, settings: Settings) -> TrackedRolling:
    """Run the tracker over all frames; raises CalibrationError if it hardly ever tracks the ball."""
    tracker = build(rig, pose, settings)
    state: TrackState | None = None
    segments = [_Segment()]
    sizes: list[float] = []
    lost, count, status = 0, 0, Status.SEARCHING
    for frame in frames:
        state = state or begin(tracker, frame.stamp)
        state = step(state, frame, tracker).state
        count += 1
        lost += state.status is Status.LOST and status is not Status.LOST
        status = state.status
        f = state.filter
        if state.search.size > 0.0:
            sizes.append(state.search.size)
        if not state.known_to_turn:  # a candidate may be a look-alike, and the next map is another one
            if segments[-1].stamp:
                segments.append(_Segment())
        elif tracker.method.keeps_map and state.confirmed and status is Status.TRACKING:
            into, points = segments[-1], state.points
            into.stamp.append(frame.stamp)
            into.attitude.append(f.attitude)
            into.direction.append(points.direction)
            into.centre.append(state.detections.centre[points.index])
            into.covariance.append(state.detections.covariance[points.index])
            into.discs = f.discs
    best = max(segments, key=lambda s: len(s.stamp))
    if len(best.stamp) < 10:
        raise CalibrationError(
            "hardly any disc is seen to turn with the ball: roll it on in all directions, slowly, for a minute; "
            "a pattern does not serve"
        )
    joined = [s if s is best else _in_frame_of(best, s, rig, pose) for s in segments]
    rolling, sightings = _assign_discs([s for s in joined if s is not None], best.discs, rig, pose)
    return TrackedRolling(rolling, sightings, float(np.median(sizes)) if sizes else 1.0, lost, count)


def _in_frame_of(best: _Segment, other: _Segment, rig: Rig, pose: Pose) -> _Segment | None:
    """The other segment with attitudes in the best one's map; None if its discs are not recognised there."""
    towards = pose.position / np.linalg.norm(pose.position)
    order = np.argsort([-len(d) for d in other.direction], kind="stable")[:_MAX_JOIN_FRAMES]
    for k in order:
        found = identify(
            other.direction[k],
            best.discs,
            sigma=_DIRECTION_SIGMA,
            view_axis=towards,
            horizon=rig.ball.radius / float(np.linalg.norm(pose.position)),
            risk=_MAX_JOIN_RISK,
        )
        if found is not None:
            turn = other.attitude[k].T @ found.rotation
            other.attitude = [R @ turn for R in other.attitude]
            return other
    return None


def _assign_discs(segments: list[_Segment], discs: Array, rig: Rig, pose: Pose) -> tuple[Rolling, Sightings]:
    """All frames in the order of time; each sighting belongs to the nearest disc of the map."""
    stamp = np.concatenate([s.stamp for s in segments])
    attitude = np.concatenate([np.array(s.attitude) for s in segments])
    direction = [d for s in segments for d in s.direction]
    frame = np.repeat(np.arange(len(stamp)), [len(d) for d in direction])
    ball = np.einsum("nji,nj->ni", attitude[frame], np.concatenate(direction))
    cosine = ball @ discs.T
    disc = cosine.argmax(axis=1)
    near = cosine.max(axis=1) > np.cos(2.0 * rig.disc_angle)
    near &= _are_unbiased(np.concatenate(direction), rig, pose)
    to_centre = pose.to_cam(rig.ball.centre)
    ratio = float(np.linalg.norm(to_centre))
    rolling = Rolling(to_centre / ratio, ratio, discs, stamp, pose.rotation.T @ attitude, rig.readout_s)
    centre = np.concatenate([c for s in segments for c in s.centre])
    covariance = np.concatenate([c for s in segments for c in s.covariance])
    return rolling, Sightings(frame, disc, centre, covariance).take(near & _once(frame, disc, cosine.max(axis=1)))


def _are_unbiased(directions: Array, rig: Rig, pose: Pose) -> NDArray[np.bool_]:
    """Return True for discs at `directions`, (n, 3) in obj, if their images are wide enough for an unbiased centre."""
    shape = np.nan_to_num(appearance(directions, rig, pose).shape)
    minor = np.sqrt(np.maximum(np.linalg.eigvalsh(shape)[:, 0], 0.0))
    return minor >= min(_MIN_SEMI_MINOR, 0.5 * float(minor.max(initial=0.0)))


def _once(frame: NDArray[np.intp], disc: NDArray[np.intp], worth: Array) -> NDArray[np.bool_]:
    """Return True for the best of several sightings of one disc in one frame, (n,)."""
    order = np.lexsort((-worth, disc, frame))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(frame[order]) != 0) | (np.diff(disc[order]) != 0)
    keep = np.empty(len(order), dtype=bool)
    keep[order] = first
    return keep
