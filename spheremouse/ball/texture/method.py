"""The method of tracking a ball by its texture: the filter `so3` takes the anchors of the picture as discs."""

import numpy as np

from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.events import AxisUnseen, Found, NewMap, PatternRepeats, Recognised, Turned
from spheremouse.ball.filters.so3 import So3Filter, relocate
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.follow import confirms
from spheremouse.ball.phases.method import at_new_pose
from spheremouse.ball.state import (
    Events,
    Learning,
    Lost,
    Method,
    Recognising,
    Tracker,
    Tracking,
    TrackState,
    clear_matches,
    start_tracking,
)
from spheremouse.ball.texture.centre import follow_in_bearings
from spheremouse.ball.texture.detect import MAX_ANCHOR_SIGMA
from spheremouse.ball.texture.picture import STATIC_ODDS, Alignment, shows_all_axes, tilt_sigma
from spheremouse.ball.texture.picture_map import recall, to_map
from spheremouse.ball.texture.search import FRAMES_PER_SEARCH, TextureDetector, TextureState
from spheremouse.geometry.rotation import Array, rotation_between
from spheremouse.tracker import Status

_UNKNOWN_ANGLE_SIGMA = float(np.pi / 3.0**0.5)  # rad, standard deviation of an angle of which nothing is known
_AXIS_UNSEEN, _AXIS_SEEN = 0.75, 0.25  # share of recent frames that show no rotation about some axis
_OTHER_BALL_S = 5.0  # of details that fit at no attitude: it is another ball, or was painted


def _next_phase(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the state and the events after a frame whose anchors are `state.points`.

    `stamp` is in s, and `predicted` is the filter's state predicted for this frame.
    """
    now: TextureState = state.search
    before = state.phase
    if now.alignment is None:
        return _without_alignment(state, stamp, tracker, predicted)
    if now.symmetric and shows_all_axes(now.alignment):  # it is not, so the picture has parts at wrong places
        return _begin_again(state, stamp, tracker)
    match before:
        case Lost() | Recognising():
            placed = _relocate(predicted, now.alignment, stamp, tracker)
            filtered, saved = _update(state, tracker, placed).clone_attitude(), isinstance(before, Recognising)
            phase = before.last if isinstance(before, Lost) else Tracking()
            state = start_tracking(state, phase, filtered, filtered.attitude, stamp)
            return state._replace(absolute=saved or state.absolute), (Recognised(len(state.points), saved=saved),)
        case Learning(found=True) if now.turned:
            masked = int(np.count_nonzero(now.fine.seen.odds < STATIC_ODDS))
            return _follow(state._replace(phase=Tracking()), stamp, tracker, predicted), (Turned(masked),)
        case Learning(found=False) if now.proven:
            filtered = _update(state, tracker, predicted).clone_attitude()
            state = start_tracking(state, Learning(found=True), filtered, filtered.attitude, stamp)
            return state, (Found(len(state.points)),)
        case Learning(found=False):
            filtered = _update(state, tracker, predicted)
            return state._replace(filter=filtered.clone_attitude(), confirmed_at=stamp), ()
    state, events = follow_in_bearings(state, stamp, tracker, predicted, _follow)
    state, more = _with_faults_reported(state)
    return state, (*events, *more)


def _without_alignment(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the state and the events after a frame that fits at no attitude."""
    phase = state.phase
    if isinstance(phase, Recognising):
        return _not_recognised(state, phase, stamp, tracker)
    if isinstance(phase, Lost) and stamp - max(state.confirmed_at, state.search.last_plain_stamp) > _OTHER_BALL_S:
        return _begin_again(state, stamp, tracker)
    if state.status is Status.SEARCHING:  # no uncertainty accumulates before the ball is seen
        new_filter = tracker.filter.initial(stamp, state.filter.attitude).with_reference_of(state.filter)
        return state._replace(filter=new_filter, confirmed_at=stamp), ()
    unobserved = tracker.filter.update(predicted, state.points, np.zeros(len(state.points), dtype=np.bool_))
    return state._replace(filter=clear_matches(unobserved)), ()


def _with_faults_reported(state: TrackState[So3State]) -> tuple[TrackState[So3State], Events]:
    """Return the state and events on faults of the pattern: it shows no rotation about some axis, or repeats itself."""
    now: TextureState = state.search
    lacked, repeated = now.reported
    lacks = now.unseen > (_AXIS_SEEN if lacked else _AXIS_UNSEEN)
    if (lacks, now.repeats) == now.reported:
        return state, ()
    events = (AxisUnseen(ended=not lacks),) if lacks != lacked else ()
    if now.repeats and not repeated:
        events = (*events, PatternRepeats())
    return state._replace(search=now._replace(reported=(lacks, now.repeats))), events


def _not_recognised(
    state: TrackState[So3State], phase: Recognising, stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Return the state after a frame that does not fit a saved picture.

    After `_OTHER_BALL_S` with details in view, and two searches of all attitudes, the ball counts as another one: the
    tracker gives up the saved map and learns a new one. `confirmed_at` follows the frames, since no uncertainty
    accumulates before the ball is recognised.
    """
    texture: TextureState = state.search
    plain = texture.last_plain_stamp == stamp
    in_view_since = stamp if phase.in_view_since is None or plain else min(phase.in_view_since, stamp)
    state = state._replace(confirmed_at=stamp)
    if stamp - in_view_since <= _OTHER_BALL_S or texture.frame_index < 2 * FRAMES_PER_SEARCH:
        return state._replace(phase=Recognising(in_view_since)), ()
    return _begin_again(state, stamp, tracker, saved=True)


def _begin_again(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], *, saved: bool = False
) -> tuple[TrackState[So3State], Events]:
    """Return the state that learns a new map, and the event. It gives up the map, which may be a `saved` one."""
    new_filter = tracker.filter.initial(stamp, state.filter.attitude)
    state = state._replace(phase=Learning(), filter=new_filter, search=SearchState(), confirmed_at=stamp)
    return state, (NewMap(saved=saved),)


def _follow(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> TrackState[So3State]:
    """Return the state after an update with the anchors in view."""
    now = state.search
    if now.searched:  # the motion since the last confirmed frame is no small correction
        turned, gap = rotation_between(state.reported_attitude, now.alignment.attitude), stamp - state.confirmed_at
        rate = now.alignment.known @ turned / gap if 0.0 < gap <= tracker.settings.loss.lost_after else None
        predicted = _relocate(predicted, now.alignment, stamp, tracker, rate)
    filtered = _update(state, tracker, predicted)
    return state._replace(filter=filtered, confirmed=confirms(filtered, len(state.points), predicted, tracker))


def _relocate(
    predicted: So3State, alignment: Alignment, stamp: float, tracker: Tracker[So3Filter], rate: Array | None = None
) -> So3State:
    """Return the state at an attitude that a search has found. About an axis that no pixel shows, it is any."""
    others = np.eye(3) - alignment.known
    tilt = tilt_sigma(alignment, _UNKNOWN_ANGLE_SIGMA**2 * float(np.trace(others)))
    covariance = (MAX_ANCHOR_SIGMA**2 + tilt**2) * alignment.known + _UNKNOWN_ANGLE_SIGMA**2 * others
    return relocate(predicted, alignment.attitude, covariance, tracker.settings.so3, stamp, rate)


def _update(state: TrackState[So3State], tracker: Tracker[So3Filter], predicted: So3State) -> So3State:
    """Return the filter after the anchors of a frame. An anchor that is on the map does not start a disc again."""
    now: TextureState = state.search
    detector: TextureDetector = tracker.detector_data
    anchors = detector.fine.anchors[now.shown[state.points.index]]
    nearest = np.max(anchors @ predicted.discs.T, axis=1, initial=-1.0)
    may_start = nearest < np.cos(2.0 * tracker.filter.disc_angle)
    updated = tracker.filter.update(predicted, state.points, may_start)
    if now.alignment is None or shows_all_axes(now.alignment):
        return updated
    return tracker.filter.without_unseen_axes(updated, predicted, now.alignment.known)


TEXTURE = Method(
    keeps_map=True,
    to_map=to_map,
    recall=recall,
    next_phase=_next_phase,
    at_new_pose=at_new_pose,
    update_all=lambda state, *_: state,
    is_covered=lambda *_: False,
)
