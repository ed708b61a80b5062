"""Several cameras of one ball: one filter of the ball, and a state of each camera.

A camera has its rig, pose and detector (`Tracker`), its look-alikes, colours and targets. Attitude, map and phase are
of the ball. A frame updates the ball by its own stamp with the points of its camera. The axes are `obj` for all.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.build import begin
from spheremouse.ball.detect.lookalikes import StaticDistractors
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import CameraState, Lost, Tracker, TrackState
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.rotation import Array

_NUMBERS = 1 << 40  # of look-alikes of one camera: more than in a thousand years


def begin_all(
    trackers: Sequence[Tracker[Any]], stamp: float, attitude: Array | None = None, known: BallMap | None = None
) -> TrackState[Any]:
    """Return the state before the first frame of one or more cameras, as `build.begin` does for one."""
    state = begin(trackers[0], stamp, attitude, known)
    for k in range(1, len(trackers)):
        state = with_camera(state, trackers[k], trackers[:k])
    return state


def with_camera(
    state: TrackState[So3State], tracker: Tracker[So3Filter], present: Sequence[Tracker[So3Filter]]
) -> TrackState[So3State]:
    """Return the state with one more camera, `tracker`; `present` are those that it has, in the order of their numbers.

    Call it before the first frame. Errors of the ball are the same for cameras whose rigs have the same ball. Raises
    ConfigurationError for trackers that follow no discs by the default filter.
    """
    for each in (*present, tracker):
        if not (each.method.keeps_map and each.detector.is_exact):
            raise ConfigurationError(
                "two cameras: only the tracker so3 with the default detector takes more than one camera",
                "give one camera, or leave tracker and detector at their defaults",
            )
    assert state.camera == 0, "add cameras before the first frame"
    number = len(present)
    other = CameraState.of(begin(tracker, state.filter.stamp))._replace(
        camera=number, lookalikes=StaticDistractors(next_number=number * _NUMBERS)
    )
    shared = [
        one.filter.shared_covariance(tracker.filter) if _same_ball(one.rig, tracker.rig) else np.zeros((7, 7))
        for one in present
    ]
    filtered = state.filter.with_camera(tracker.filter.camera_covariance(), np.concatenate(shared))
    return state._replace(filter=filtered, others=(*state.others, other))


def _same_ball(one: Rig, other: Rig) -> bool:
    """Return whether two rigs have the ball of one calibration, so that its errors are the same."""
    return one.ball.radius == other.ball.radius and np.array_equal(one.ball.covariance, other.ball.covariance)


def facing(state: TrackState[Any], camera: int) -> TrackState[Any]:
    """Return the state for a frame of a camera."""
    if camera == state.camera:
        return state
    which = [other.camera for other in state.others].index(camera)
    others = list(state.others)
    others[which] = CameraState.of(state)
    state = state._replace(**state.others[which]._asdict(), others=tuple(others))
    phase = state.phase
    if isinstance(phase, Lost) and phase.trial is not None:
        phase = phase._replace(trial=phase.trial._replace(filter=phase.trial.filter.facing(which)))
    return state._replace(
        phase=phase,
        filter=state.filter.facing(which),
        alternatives=tuple(h._replace(state=h.state.facing(which)) for h in state.alternatives),
        older=None if state.older is None else state.older.facing(which),
    )
