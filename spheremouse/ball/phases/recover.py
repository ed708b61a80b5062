"""A ball that was lost, found again."""

from dataclasses import replace

from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.lifted import back_on_bearings
from spheremouse.ball.phases.recognise import recognised_attitude
from spheremouse.ball.state import (
    Phase,
    Sight,
    Tracker,
    TrackState,
    forget,
    tracking,
    unused,
)


def lost_in_a_gap(state: TrackState, stamp: float, tracker: Tracker) -> TrackState:
    """No frame came for so long that the prediction is a guess: the map says where the ball is, or nothing does."""
    gap = stamp - state.filter.stamp
    if state.phase is not Phase.TRACKING or not state.moved or gap <= tracker.settings.loss.lost_after:
        return state
    return replace(
        state,
        phase=Phase.LOST,
        found=None,
        off=0,
        filter=unused(state.filter),
        event=f"lost: no frame for {gap:.1f} s",
    )


def recovered(state: TrackState, stamp: float, tracker: Tracker) -> TrackState:
    """Lost: find the attitude again by the map, or begin anew at the last one. Either way nothing is invented."""
    points, s = state.points, tracker.settings.loss
    if len(points) < 2:
        return replace(state, found=None)
    found = stamp if state.found is None else min(state.found, stamp)  # a clock that starts again
    state = replace(state, found=found)
    if isinstance(state.filter, So3State):
        recognised = recognised_attitude(state, stamp, tracker)
        if recognised is not None and back_on_bearings(state, recognised[0], tracker):
            filtered, pairs = recognised
            return replace(
                tracking(state, filtered, filtered.attitude, stamp),
                lifted=None,
                off=0,
                recent=() if state.moved else (Sight(stamp, state.detections, points, filtered.attitude),),
                lookalikes=forget(state.lookalikes),
                event=f"tracking again: attitude kept, recognised by {pairs} discs",
            )
        if stamp - found < s.reset_after:
            return state
        if state.lifted is not None and 0.0 <= stamp - state.lifted < tracker.settings.bearing.patience:
            return state
    attitude = state.filter.attitude
    anew = _anew(state, stamp, tracker)
    return replace(
        tracking(anew, anew.filter, attitude, stamp),
        moved=False,
        lifted=None,
        misfit=0.0,
        out_of_round=False,
        fitted=0.0,
        lookalikes=forget(state.lookalikes),
        event="tracking again: attitude reset to the last one known, a new map begun; unseen motion not counted",
    )


def _anew(state: TrackState, stamp: float, tracker: Tracker) -> TrackState:
    """With a new map, begun at the last attitude by this frame's points: any of them may be a look-alike."""
    attitude = state.filter.attitude
    filtered = tracker.filter.update(tracker.filter.initial(stamp, attitude), state.points)
    return replace(state, filter=filtered, found=None, recent=(Sight(stamp, state.detections, state.points, attitude),))


def recognise_saved(state: TrackState, stamp: float, tracker: Tracker) -> TrackState:
    """The ball is where the saved map says, once that is certain; never recognised, it is another ball's map."""
    points = state.points
    recognised = recognised_attitude(state, stamp, tracker)
    if recognised is not None:
        filtered, pairs = recognised
        return replace(
            tracking(state, filtered, filtered.attitude, stamp),
            moved=True,
            saved=False,
            absolute=True,
            event=f"tracking: recognised by {pairs} discs of the saved map",
        )
    enough = len(points) >= 4  # fewer say nothing against the map
    found = stamp if state.found is None or not enough else min(state.found, stamp)
    if stamp - found < tracker.settings.loss.reset_after:
        return replace(state, found=found)
    return replace(
        _anew(state, stamp, tracker),
        saved=False,
        event="the saved map does not fit: another ball, or its discs were moved; a new map is begun",
    )
