"""A ball that was lifted off its bearings, and put back."""

from dataclasses import replace

import numpy as np

from spheremouse.ball import bearings as bearing
from spheremouse.ball.bearings import Shift
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.filters import FilterState
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import FIRST, So3State, delays
from spheremouse.ball.state import (
    Phase,
    Tracker,
    TrackState,
    unused,
)

_PUSHED = 16.0  # level from which the filter may take for a turn what is none
_PROVEN = 0.5  # rad: a quarter of what is seen of a ball has come or gone: a wrong centre or radius would have shown
_PAIRS = 5  # discs that say something of the centre: with three any shift fits, with four nearly
_RESTS = 0.05  # rad/s, below which a ball brings nothing new
_FRAME = 0.1  # s, the longest that one frame counts for


def on_its_bearings(state: TrackState, stamp: float, tracker: Tracker, predicted: FilterState) -> TrackState:
    """What the followed frame says of the ball's centre: a frame that shows it off its place is set aside.

    A second one in a row is a ball that was lifted: lost, and nothing sent, until the discs fit a rotation again. A
    ball out of round is said to be, and tracked as well as it goes; and so is one whose discs never were in their
    places, since the rig is wrong: nothing has been lifted.
    """
    speed = float(np.linalg.norm(state.filter.rate))
    settled = state.fitted >= _PROVEN or speed < _RESTS
    if state.off == 0 and state.misfit < 1.0 and settled and _all_fit(state):
        return state
    if not isinstance(tracker.detector, DiscDetector):
        return state  # centres of blobs are off by more than they say
    found = _shift(state, state.filter, tracker)
    s, radius = tracker.settings.bearing, tracker.rig.ball.radius
    if found is None:
        return replace(state, off=0)
    off = bearing.is_off(found, radius, s, state.out_of_round)
    if off and state.fitted >= _PROVEN:
        blind = tracker.filter.update(predicted, state.points, np.zeros(len(state.points), dtype=bool))
        if state.off == 0:
            return replace(state, filter=blind, holds=False, off=1)
        by = (
            f"by {1e3 * found.distance:.0f} mm" if radius != 1.0 else f"by {100.0 * found.distance:.1f} % of its radius"
        )
        event = f"lost: the ball does not turn about its centre, off {by}: lifted, or out of round"
        return replace(
            state,
            filter=unused(blind),
            phase=Phase.LOST,
            holds=False,
            off=0,
            lifted=stamp,
            found=None,
            event=event,
        )
    dt = min(stamp - state.held, _FRAME)
    misfit = bearing.averaged(state.misfit, found, dt, s)
    fitted = 0.0 if off else state.fitted
    if fitted < _PROVEN and state.holds and found.pairs >= _PAIRS and bearing.fits(found, radius, s):
        fitted += speed * dt * min(1.0, (0.5 * s.lifted * radius / max(found.sigma, 1e-9)) ** 2)  # what it can tell
    state = replace(state, off=0, misfit=misfit, fitted=fitted)
    if not state.out_of_round and misfit > s.out_of_round:
        why = "it is out of round, the camera was moved, or the rig is wrong"
        event = f"the discs do not fit a ball that turns about its centre: {why}"
        return replace(state, out_of_round=True, fitted=0.0, event=f"{state.event}; {event}" if state.event else event)
    return replace(state, out_of_round=state.out_of_round and misfit > 0.3 * s.out_of_round)


def _all_fit(state: TrackState) -> bool:
    """Is every point of the last frame a known disc in its place? Then there is nothing to look into."""
    f, used = state.filter, len(state.filter.used)
    return isinstance(f, So3State) and used == len(state.points) and f.nis < 4.0 * used + 10.0 and f.level < _PUSHED


def _shift(state: TrackState, filter_state: FilterState, tracker: Tracker) -> Shift | None:
    """How far the last frame's discs show the ball's centre off its place, with a filter's attitude and map."""
    if not isinstance(filter_state, So3State) or not isinstance(tracker.filter, So3Filter):
        return None
    sure = np.flatnonzero(filter_state.hits >= tracker.filter.settings.trial)
    variance = filter_state.joint.diagonal()[FIRST:].reshape(-1, 2).mean(axis=1)[sure]
    return bearing.shift_of(
        state.points,
        delays(state.points, filter_state),
        filter_state.discs[sure],
        variance,
        filter_state.attitude,
        filter_state.rate,
        tracker.rig.ball.radius,
        2.0 * tracker.filter.disc_angle,
    )


def back_on_bearings(state: TrackState, filter_state: FilterState, tracker: Tracker) -> bool:
    """Does a ball that was lifted turn about its centre again, at the attitude that its map tells?"""
    if state.lifted is None:
        return True
    found = _shift(state, filter_state, tracker)
    return found is not None and bearing.fits(found, tracker.rig.ball.radius, tracker.settings.bearing)
