"""Signs that the camera was moved."""

import numpy as np

from spheremouse.ball import camera_watch as watching
from spheremouse.ball.camera_watch import CameraMonitor
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.tracker import Frame, Status

_LIVELY = 64.0  # level of the player from which a bumped camera explains as much
_STIRRED = 8.0  # the same of a ball that hardly turns, and a camera that shakes by a few tenths of a pixel
_RESTS = 0.2  # rad/s, below which a ball hardly turns: a pixel per frame
_COLOUR_EVERY = 0.5  # s between two searches of the whole picture for the targets: they take long


def hidden(watch: CameraMonitor | None) -> bool:
    """Return whether the targets that were in view are hidden now."""
    if watch is None or sum(patch is not None for patch in watch.patches) < 3:
        return False
    return int(np.count_nonzero(watch.seen)) < 3


def surprised(state: TrackState[So3State]) -> bool:
    """Return whether a bumped camera would explain the discs of the last frame."""
    if state.status is not Status.TRACKING:
        return state.status is Status.LOST
    freedom = 2 * len(state.filter.used)
    return (
        not state.confirmed
        or state.filter.manoeuvre_level >= (_STIRRED if np.linalg.norm(state.filter.rate) < _RESTS else _LIVELY)
        or state.filter.nis > freedom + 5.0 * (2 * freedom) ** 0.5
    )


def with_references(watch: CameraMonitor, frame: Frame, tracker: Tracker) -> CameraMonitor:
    """Learn the appearance of targets: of all at the first frame, then of one after the other."""
    which = np.array([k for k, patch in enumerate(watch.patches) if patch is None], dtype=np.intp)
    if len(which) and watch.due > -np.inf:
        which = which[which == (watch.turn + 1) % len(watch)] if frame.stamp >= watch.due else which[:0]
    if len(which) == 0:
        return watch
    return watching.remember_targets(watch, frame.image, which, tracker.rig, tracker.settings.rings)


def out_of_sight(state: TrackState, stamp: float) -> bool:
    """Return whether to search the whole image for the targets: no disc confirms, and the targets are not in place."""
    watch = state.watch
    if watch is None or state.confirmed or state.status is Status.SEARCHING:
        return False
    astray = state.rebuilt is not None and int(np.count_nonzero(watch.seen)) < 3  # the last pose found shows too few
    return (astray or hidden(watch)) and not watch.tried <= stamp < watch.tried + _COLOUR_EVERY
