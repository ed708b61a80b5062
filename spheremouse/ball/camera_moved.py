"""Detection of a moved camera from discs and targets, and search for its new pose."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spheremouse.ball import camera_watch as watching
from spheremouse.ball.build import build
from spheremouse.ball.camera_watch import CameraMonitor
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.points import directions_at
from spheremouse.ball.pose import find_pose, predict_targets
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, align, log, tangent_basis
from spheremouse.tracker import Frame, Status

_MIN_BUMP_LEVEL = 64.0  # level of the player from which a bumped camera explains as much
# the same of a ball that hardly turns, and a camera that shakes by a few tenths of a pixel
_MIN_BUMP_LEVEL_AT_REST = 8.0
_MAX_REST_RATE_RAD_S = 0.2  # rad/s, below which a ball hardly turns: a pixel per frame
_MAX_UNNOTICED_TURN_RAD = 0.02  # rad, by which a camera may seem to turn the ball without a suspected bump
_COLOUR_EVERY = 0.5  # s between two searches of the whole picture for the targets: they take long


class MovedTracker(NamedTuple):
    """A tracker at another pose of its camera."""

    tracker: Tracker
    added_covariance: Array | None = None  # (6, 6), added to that of the old pose; None: the pose is a new one


Seek = Callable[[Frame, Tracker], MovedTracker | None]


class CameraCheck(NamedTuple):
    """Result of a check of all targets."""

    watch: CameraMonitor
    moving: bool = False  # the camera has no pose yet
    moved: MovedTracker | None = None  # it has a new one


def seek_by_colour(frame: Frame, tracker: Tracker) -> MovedTracker | None:
    """Return the tracker at the pose from the whole image; None without one, or at the same pose."""
    rig, settings = tracker.rig, tracker.settings
    if frame.image.ndim != 3:
        return None
    try:
        seen = detect_targets(frame.image, rig.targets.radii, settings.rings)
        pose = find_pose([seen], rig, frame.image).pose
        shift = predict_targets(pose, rig) - predict_targets(tracker.pose, rig)
        moved = watching.most_have_moved(shift, 3.0 * watching.MATCH_SIGMA_PX)
        return MovedTracker(build(rig, pose, settings)) if moved else None
    except PoseError:
        return None


def shows_targets(frame: Frame, tracker: Tracker, pose: Pose) -> bool:
    """Return whether a frame shows three targets in their places at a pose that was found for an earlier frame."""
    watch = watching.begin(tracker.rig, pose)
    if watch is None:
        return True  # too near the edge of the picture to be watched
    shown = watching.remember_targets(watch, frame.image, range(len(watch)), tracker.rig, tracker.settings.rings)
    return bool(np.count_nonzero(shown.seen) >= 3)


def hidden(watch: CameraMonitor | None) -> bool:
    """Return whether the targets that were in view are hidden now."""
    if watch is None or sum(patch is not None for patch in watch.patches) < 3:
        return False
    return int(np.count_nonzero(watch.seen)) < 3


def apparent_turn(shift: Array, tracker: Tracker) -> Array:
    """Return the turn of the ball, (3,) rad, as which an unnoticed motion of the camera appears.

    `shift` (n, 2) px is that of the targets; nan if hidden. The turn is at most one without a suspected bump.
    """
    towards, radius = tracker.filter.station.towards, 0.5
    across = radius * tangent_basis(towards[None])[0].T
    directions = towards + np.concatenate([across, -across])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    uv = seen_at(directions, tracker.rig, tracker.pose) + np.nanmedian(shift, axis=0)
    seen, which = directions_at(uv, tracker.rig, tracker.pose)
    if len(which) < 2:
        return np.zeros(3)
    turn = log(align(directions[which], seen))
    return turn * min(1.0, _MAX_UNNOTICED_TURN_RAD / max(float(np.linalg.norm(turn)), _MAX_UNNOTICED_TURN_RAD))


def bump_suspected(state: TrackState[So3State]) -> bool:
    """Return whether the discs of the last frame fit so badly that the camera may have moved; always True in LOST."""
    if state.status is not Status.TRACKING:
        return state.status is Status.LOST
    f, freedom = state.filter, 2 * len(state.filter.used)
    level = _MIN_BUMP_LEVEL_AT_REST if f.speed < _MAX_REST_RATE_RAD_S else _MIN_BUMP_LEVEL
    return not state.confirmed or f.manoeuvre_level >= level or f.nis > freedom + 5.0 * (2 * freedom) ** 0.5


def with_references(watch: CameraMonitor, frame: Frame, tracker: Tracker) -> CameraMonitor:
    """Learn the appearance of targets: of all at the first frame, then of one after the other."""
    if frame.stamp < watch.due:
        return watch
    following = range(len(watch)) if watch.due == -np.inf else [(watch.last_target + 1) % len(watch)]
    which = [k for k in following if watch.patches[k] is None]
    return watching.remember_targets(watch, frame.image, which, tracker.rig, tracker.settings.rings) if which else watch


def out_of_sight(state: TrackState, stamp: float) -> bool:
    """Return whether to search the whole image for the targets: no disc confirms, and the targets are not in place."""
    watch = state.watch
    if watch is None or state.confirmed or state.status is Status.SEARCHING:
        return False
    moved = watch.shaken > -np.inf
    astray = moved and int(np.count_nonzero(watch.seen)) < 3  # the last pose found shows too few
    return (astray or hidden(watch)) and not watch.tried <= stamp < watch.tried + _COLOUR_EVERY


def check_targets(
    before: CameraMonitor, after: TrackState | None, frame: Frame, tracker: Tracker, seek: Seek
) -> CameraCheck:
    """Check all targets: the camera is still at its pose, is moving, or has a new pose.

    `after` is the state after the frame under the assumption of an unmoved camera; None if not computed.
    """
    watch, shift = watching.target_shifts(before, frame.image)
    on_rings = watching.on_rings(watch, frame.image, shift, tracker.rig, tracker.settings.rings)
    displaced_on_rings = watching.most_have_moved(on_rings, watching.DISPLACED_PX)
    if displaced_on_rings is None:
        displaced_on_rings = watching.most_have_moved(shift, 3.0 * watching.MATCH_SIGMA_PX)
    if displaced_on_rings:
        camera_still = watching.is_still(before.shift, shift)
        found = (_pose_by_shifts(on_rings, shift, tracker) or seek(frame, tracker)) if camera_still else None
        return CameraCheck(replace(watch, shift=shift), moving=True, moved=found)
    watch = replace(watch, shift=np.zeros((0, 2)), moving_since=None)
    if frame.image.ndim != 3 and not watch.colour_frame_requested:  # colours show more than a correlation
        return CameraCheck(replace(watch, colour_frame_requested=True))
    watch = replace(watch, colour_frame_requested=False)
    if displaced_on_rings is None and after is not None and out_of_sight(after._replace(watch=watch), frame.stamp):
        watch = replace(watch, tried=frame.stamp)
        found = seek(frame, tracker)
        if found is not None:
            return CameraCheck(watch, moved=found)
    if displaced_on_rings is False:  # then a target out of its place was moved by itself, or is in another light
        displaced = np.flatnonzero(np.hypot(*np.nan_to_num(shift).T) > watching.DISPLACED_PX)
        watch = watching.remember_targets(watch, frame.image, displaced.tolist(), tracker.rig, tracker.settings.rings)
    return CameraCheck(watch)


def _pose_by_shifts(on_rings: Array, shift: Array, tracker: Tracker) -> MovedTracker | None:
    """Return the tracker at the pose from the targets' shifts, (n, 2) px; None if no pose fits them.

    The shifts come from the rings, or else from the correlation. Also returns the addition to the pose's covariance,
    (6, 6).
    """
    rig, settings = tracker.rig, tracker.settings
    for measured, sigma in ((on_rings, watching.RING_SIGMA_PX), (shift, watching.MATCH_SIGMA_PX)):
        found = watching.moved_pose(measured, rig, tracker.pose, sigma)
        if found is not None:
            try:
                return MovedTracker(build(rig, found[0], settings), found[1])
            except PoseError:
                continue
    return None
