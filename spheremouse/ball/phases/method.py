"""The default method of tracking: the filter `so3` with its map of the discs."""

from dataclasses import replace

from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import KINEMATIC_DIM, So3State, consider
from spheremouse.ball.phases.follow import detect_discs, follow
from spheremouse.ball.phases.learn import learn
from spheremouse.ball.phases.lifted import check_bearings
from spheremouse.ball.phases.recover import recognise, recover
from spheremouse.ball.state import Events, Learning, Lost, Method, Recognising, Tracker, Tracking, TrackState
from spheremouse.geometry.rotation import Array


def _next_phase(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the state after the points of a frame, and the events."""
    match state.phase:
        case Recognising():
            return recognise(state, state.phase, stamp, tracker)
        case Learning():
            return learn(state, state.phase, stamp, tracker, predicted)
        case Tracking():
            return check_bearings(follow(state, stamp, tracker, predicted), stamp, tracker, predicted)
        case Lost():
            return recover(state, state.phase, stamp, tracker, predicted)


def _at_new_pose(state: TrackState[So3State], tracker: Tracker[So3Filter], added: Array | None) -> So3State:
    """Return the filter's state at a new pose of the camera.

    If the pose comes from the one before, its covariance grows by `added`, (6, 6), and the map keeps its correlation
    with it. Otherwise (None) the errors of pose and map are independent.
    """
    joint = state.filter.joint.copy()
    if added is None:
        consider(joint, tracker.filter.considered)
    else:
        joint[KINEMATIC_DIM : KINEMATIC_DIM + 6, KINEMATIC_DIM : KINEMATIC_DIM + 6] += added
    return replace(state.filter, joint=joint)


SO3 = Method(keeps_map=True, detect=detect_discs, next_phase=_next_phase, at_new_pose=_at_new_pose)
