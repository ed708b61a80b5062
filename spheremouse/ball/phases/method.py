"""The default method of tracking: the filter `so3` with its map of the discs."""

from dataclasses import replace

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.projection import GREY
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_camera import add_common, forget_common
from spheremouse.ball.filters.so3_map import to_map, with_map, without_candidates
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.bearing import check_bearings, check_learning, with_eccentricity
from spheremouse.ball.phases.follow import follow, is_covered
from spheremouse.ball.phases.learn import learn, update_all
from spheremouse.ball.phases.recover import recognise, recognise_older_map, recover
from spheremouse.ball.state import (
    SURE,
    Colours,
    Events,
    Learning,
    Lost,
    Method,
    Recognising,
    Tracker,
    Tracking,
    TrackState,
)
from spheremouse.geometry.rotation import Array


def _next_phase(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the state after the points of a frame, and the events."""
    match state.phase:
        case Recognising():
            return recognise(state, state.phase, stamp, tracker)
        case Learning() as phase:
            # a still scene adds no evidence, so only another number of points is a reason to search again
            if state.older is not None and phase.views and len(phase.views[-1].points) != len(state.points):
                state, events = recognise_older_map(state, stamp, tracker)
                if events:
                    return state, events
            before, (state, events) = state, learn(state, phase, stamp, tracker, predicted)
            if tracker.detector.is_exact:
                state, more = check_learning(before, state, stamp, tracker)
                events = (*events, *more)
            return state, events
        case Tracking():
            before, known, state = state, len(state.filter.discs), follow(state, stamp, tracker, predicted)
            if state.older is not None and state.confirmed and len(state.filter.discs) > known:
                state, events = recognise_older_map(state, stamp, tracker)
                if events:
                    return state, events
            exact = tracker.detector.is_exact and state.filter.stamp == stamp  # else the frame is not used
            if not exact:
                return state, ()
            state, events = check_bearings(before, state, stamp, tracker, predicted)
            return with_eccentricity(before, state, stamp, tracker), events
        case Lost():
            return recover(state, state.phase, stamp, tracker, predicted)


def at_new_pose(state: TrackState[So3State], tracker: Tracker[So3Filter], added: Array | None) -> So3State:
    """Return the filter's state at a new pose of the camera.

    If the pose comes from the one before, its covariance grows by `added`, (6, 6), and the map keeps its correlation
    with it. Otherwise (None) the errors of pose and map are independent.
    """
    filtered = without_candidates(state.filter)
    joint = filtered.joint.copy()
    if added is None:
        forget_common(joint)
        add_common(joint, tracker.filter.station.covariance()[:-1, :-1])
    else:
        A = tracker.filter.station.common_by_pose_and_ball()[:, :6]
        add_common(joint, A @ added @ A.T)
    return filtered._replace(joint=joint)


def _to_map(state: TrackState[So3State]) -> DiscMap | None:
    """Return the map of discs to save; None with fewer than four certain ones."""
    found = None if isinstance(state.phase, Recognising) else to_map(state.filter, SURE)
    return None if found is None else replace(found, projection=state.colours.projection)


def _recall(state: TrackState[So3State], known: BallMap) -> TrackState[So3State]:
    """Return the state in which the discs of a saved map are recognised first."""
    if not isinstance(known, DiscMap) or len(known) < 3:
        return state
    learnt = Colours(known.projection, refined=known.projection != GREY)
    colours = state.colours if state.colours.fixed else learnt
    return state._replace(phase=Recognising(), filter=with_map(state.filter, known), colours=colours)


SO3 = Method(
    keeps_map=True,
    to_map=_to_map,
    recall=_recall,
    next_phase=_next_phase,
    at_new_pose=at_new_pose,
    update_all=update_all,
    is_covered=is_covered,
)
