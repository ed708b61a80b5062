"""A ball that was lifted off its bearings, and put back."""

from dataclasses import replace

import numpy as np

from spheremouse.ball import centre_offset
from spheremouse.ball.centre_offset import CentreOffset
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.events import BallLost, OutOfRound, Why
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_predict import CLONE_DIM, MAP_OFFSET
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import So3State, delays
from spheremouse.ball.state import CentreCheck, Events, Lost, Tracker, Tracking, TrackState, lost

_PUSHED = 16.0  # level from which the filter may take for a turn what is none
_PROVEN = 0.5  # rad: a quarter of the visible side has changed, so a wrong centre or radius would have shown
_PAIRS = 5  # discs that say something of the centre: with three any shift fits, with four nearly
_RESTS = 0.05  # rad/s, below which a ball brings nothing new
_FRAME = 0.1  # s, the longest that one frame counts for


def check_bearings(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Check the ball's centre in a followed frame. A frame that shows it off its place has no effect.

    A second one in a row is a lifted ball. It is lost until the discs fit a rotation again. A ball out of round causes
    an event and is tracked further. So is one whose discs never were in their places, since then the rig is wrong.
    """
    assert isinstance(state.phase, Tracking)
    before = state.phase.roundness
    speed = float(np.linalg.norm(state.filter.rate))
    settled = before.rotation_since_failure >= _PROVEN or speed < _RESTS
    if before.frames_off_centre == 0 and before.misfit < 1.0 and settled and _all_fit(state):
        return state, ()
    if not isinstance(tracker.detector, DiscDetector):
        return state, ()  # centres of blobs are off by more than they say
    shift = _shift(state, state.filter, tracker)
    s, radius = tracker.settings.bearing, tracker.rig.ball.radius
    if shift is None:
        return replace(state, phase=Tracking(before._replace(frames_off_centre=0))), ()
    off = centre_offset.is_off(shift, radius, s, before.out_of_round)
    if off and before.rotation_since_failure >= _PROVEN:
        blind = tracker.filter.update(predicted, state.points, np.zeros(len(state.points), dtype=bool))
        if before.frames_off_centre == 0:
            phase = Tracking(before._replace(frames_off_centre=1))
            return replace(state, phase=phase, filter=blind, confirmed=False), ()
        state = lost(replace(state, filter=blind), lifted_at=stamp)
        return state, (BallLost(Why.OFF_CENTRE, shift.distance, radii=radius == 1.0),)
    dt = min(stamp - state.confirmed_at, _FRAME)
    misfit = centre_offset.averaged(before.misfit, shift, dt)
    turned = 0.0 if off else before.rotation_since_failure
    if turned < _PROVEN and state.confirmed and shift.pairs >= _PAIRS and centre_offset.fits(shift, radius, s):
        turned += speed * dt * min(1.0, (0.5 * s.lifted * radius / max(shift.sigma, 1e-9)) ** 2)
    if not before.out_of_round and misfit > centre_offset.OUT_OF_ROUND:
        return replace(state, phase=Tracking(CentreCheck(0, misfit, True, 0.0))), (OutOfRound(),)
    still = before.out_of_round and misfit > 0.3 * centre_offset.OUT_OF_ROUND
    return replace(state, phase=Tracking(CentreCheck(0, misfit, still, turned))), ()


def _all_fit(state: TrackState[So3State]) -> bool:
    """Is every point of the last frame a known disc in its place? Then there is nothing to look into."""
    f, used = state.filter, len(state.filter.used)
    return used == len(state.points) and f.nis < 4.0 * used + 10.0 and f.manoeuvre_level < _PUSHED


def _shift(state: TrackState[So3State], filter_state: So3State, tracker: Tracker[So3Filter]) -> CentreOffset | None:
    """Return the offset of the ball's centre by the last frame's discs, with a filter's attitude and map."""
    sure = np.flatnonzero(filter_state.hits >= ESTABLISHED_HITS)
    variance = filter_state.joint.diagonal()[MAP_OFFSET:-CLONE_DIM].reshape(-1, 2).mean(axis=1)[sure]
    return centre_offset.shift_of(
        state.points,
        delays(state.points, filter_state),
        filter_state.discs[sure],
        variance,
        filter_state.attitude,
        filter_state.rate,
        tracker.rig.ball.radius,
        2.0 * tracker.filter.disc_angle,
    )


def back_on_bearings(
    state: TrackState[So3State], phase: Lost, filter_state: So3State, tracker: Tracker[So3Filter]
) -> bool:
    """Return whether a lifted ball turns about its centre again, at the attitude of its map."""
    if phase.lifted_at is None:
        return True
    shift = _shift(state, filter_state, tracker)
    return shift is not None and centre_offset.fits(shift, tracker.rig.ball.radius, tracker.settings.bearing)
