"""Several cameras of one ball: one filter of the ball, and a state of each camera.

A camera has its rig, pose and detector (`Tracker`), its look-alikes, colours and targets. Attitude, map and phase are
of the ball. A frame updates the ball by its own stamp with the points of its camera. The axes are `obj` for all.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.build import begin, detector_of
from spheremouse.ball.camera_state import with_filters
from spheremouse.ball.detect.lookalikes import StaticDistractors
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_motion import CAMERA_DIM
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import CameraState, Tracker, TrackState
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.rotation import Array

_NUMBERS = 1 << 40  # of look-alikes of one camera: more than in a thousand years


def begin_all(
    trackers: Sequence[Tracker[Any]], stamp: float, attitude: Array | None = None, known: BallMap | None = None
) -> TrackState[Any]:
    """Return the state before the first frame of one or more cameras, as `build.begin` does for one."""
    state = begin(trackers[0], stamp, attitude, known)
    for k in range(1, len(trackers)):
        state = with_camera(state, trackers[k], trackers[:k], k)
    return state


def begin_with(tracker: Tracker[Any], number: int, stamp: float, known: BallMap | None = None) -> TrackState[Any]:
    """Return the state before the first frame of the camera with a `number`, which is the first that shows the ball."""
    state = begin(tracker, stamp, known=known)
    if number == 0:
        return state
    return state._replace(camera=number, lookalikes=StaticDistractors(next_number=number * _NUMBERS))


def with_camera(
    state: TrackState[So3State], tracker: Tracker[So3Filter], present: Sequence[Tracker[So3Filter]], number: int
) -> TrackState[So3State]:
    """Return the state with one more camera, `tracker`, whose frames have the `number`.

    `present` are those that it has: of the last frame's camera, then of `state.others`. Errors of the ball are the same
    for cameras whose rigs have the same ball. Raises ConfigurationError for trackers that follow no discs by the
    default filter.
    """
    trackers = (*present, tracker)
    check_cameras([each.rig for each in trackers], tracker.settings)
    other = CameraState.of(begin_with(tracker, number, state.filter.stamp))
    prior = np.block([[_shared_covariance(one, another) for another in trackers] for one in trackers])
    return with_filters(state._replace(others=(*state.others, other)), lambda f: f.with_camera(prior))


def check_cameras(rigs: Sequence[Rig], settings: Settings) -> None:
    """Raise ConfigurationError if the tracker takes one camera and there are several."""
    if len(rigs) > 1 and not (settings.tracker == "so3" and all(detector_of(rig, settings).is_exact for rig in rigs)):
        raise ConfigurationError(
            "two cameras: only the tracker so3 with the default detector takes more than one camera",
            "give one camera, or leave tracker and detector at their defaults",
        )


def _shared_covariance(one: Tracker[So3Filter], other: Tracker[So3Filter]) -> Array:
    """Return the covariance, (7, 7), of the errors of one camera with those of another, before any frame."""
    if one is other:
        return one.filter.station.covariance()
    same = one.rig.ball.radius == other.rig.ball.radius
    same = same and np.array_equal(one.rig.ball.covariance, other.rig.ball.covariance)  # the ball of one calibration
    return one.filter.station.shared_covariance(other.filter.station) if same else np.zeros((CAMERA_DIM, CAMERA_DIM))
