"""The tracker of the published filters, `ekf1` and `ekf2`: what becomes of the ball with each frame.

Look-alikes are told from discs as for any filter. But these keep no map, for a disc that is not seen is forgotten
(`filters/euler.py`): a ball that was lost is begun anew where it was last, and nothing says that it was lifted, that
the camera was pushed, or how long a shutter takes.
"""

from dataclasses import replace

import numpy as np

from spheremouse.ball.filters.euler import EulerState
from spheremouse.ball.phases.candidates import all_are_discs, classify_unmatched, updated
from spheremouse.ball.phases.learn import learn
from spheremouse.ball.phases.recover import begin_anew, seen_since
from spheremouse.ball.state import Events, Learning, Lost, Recognising, Tracker, Tracking, TrackState

State = TrackState[EulerState]


def next_phase(state: State, stamp: float, tracker: Tracker, predicted: EulerState) -> tuple[State, Events]:
    """The state after the points of a frame, and what has changed."""
    match state.phase:
        case Learning():
            return learn(state, state.phase, stamp, tracker, predicted)
        case Tracking():
            return _followed(state, stamp, tracker, predicted), ()
        case Lost():
            phase = seen_since(state.phase, len(state.points), stamp)
            state = replace(state, phase=phase)
            return (state, ()) if phase.in_view_since is None else begin_anew(state, stamp, tracker)
        case Recognising():
            raise AssertionError("no map, nothing to recognise")


def _followed(state: State, stamp: float, tracker: Tracker, predicted: EulerState) -> State:
    """Filter the points; candidates that have moved with the ball found discs when they are seen again."""
    state = updated(state, tracker, predicted)
    if all_are_discs(state):
        return state
    if not state.confirmed:  # then no point starts a landmark
        none = np.zeros(len(state.points), dtype=bool)
        state = replace(state, filter=tracker.filter.update(predicted, state.points, none))
    return classify_unmatched(state, stamp, tracker, predicted, lambda posterior, *_: posterior)
