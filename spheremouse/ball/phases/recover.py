"""Loss of the ball, lifted off its bearings or after a gap, and its recovery from the map of discs."""

import numpy as np

from spheremouse.ball.events import BallLost, NewMap, Recognised, Why
from spheremouse.ball.filters.so3 import So3Filter, relocate
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.bearing import back_on_bearings
from spheremouse.ball.phases.follow import IDENTIFY_SIGMA, RISK, recognise_attitude, updated_hypotheses
from spheremouse.ball.phases.learn import found, learn
from spheremouse.ball.phases.seen_centre import RESTS
from spheremouse.ball.state import (
    BufferedFrame,
    Events,
    F,
    Learning,
    Lost,
    OutlineCheck,
    Recognising,
    Tracker,
    Tracking,
    TrackState,
    Trial,
    clear_matches,
    forget,
    lost,
    start_tracking,
)
from spheremouse.tracker import Status

_MIN_DISCS_AGAINST_MAP = 4  # in view
_NEW_CENTRE_AFTER_S = 5.0  # a ball off its centre for so long stays there: a new map begins about the new centre


def lost_in_a_gap(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[TrackState[F], Events]:
    """Return the ball as lost if no frame came for more than `loss.lost_after` s.

    After such a gap the prediction is unreliable, so only the map can give the attitude.
    """
    gap = stamp - state.filter.stamp
    if not isinstance(state.phase, Tracking) or gap <= tracker.settings.loss.lost_after:
        return state, ()
    return lost(state), (BallLost(Why.GAP, gap),)


def lost_in_time(state: TrackState, stamp: float, tracker: Tracker) -> tuple[TrackState, Events]:
    """Return the ball as lost if no frame confirmed it for `loss.lost_after` s."""
    after = tracker.settings.loss.lost_after
    known_at = max(state.confirmed_at, state.supported_at)
    if state.status is not Status.TRACKING or state.confirmed or stamp - known_at <= after:
        return state, ()
    return lost(state), (BallLost(Why.UNSEEN, after, len(state.points)),)


def seen_since(phase: Lost, points: int, stamp: float) -> Lost:
    """Return the phase with the time (s) since which a camera shows at least two discs, or None with fewer."""
    if points < 2:
        return phase._replace(in_view_since=None)
    since = stamp if phase.in_view_since is None else min(phase.in_view_since, stamp)  # the clock may start again
    return phase._replace(in_view_since=since)


def recover(
    state: TrackState[So3State], phase: Lost, stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the state and events after a frame in which the ball is lost.

    The map can give the attitude again: at rest, by recognition, or by a search near the prediction. Otherwise the
    tracker tries a new map once discs have been in view for `loss.reset_after` s. In no case does it report motion
    that the discs do not show. `stamp` is in s, and `predicted` is the filter's state predicted for this frame.
    """
    phase = seen_since(phase, state.most_in_view(stamp), stamp)
    state = state._replace(phase=phase, filter=clear_matches(state.filter))
    resting = None if phase.in_view_since is None else _where_it_was(state, stamp, tracker)
    recognised = resting or recognise_attitude(state, stamp, tracker)
    if recognised is None and state.older is not None:
        state, recognised = _on_older_map(state, stamp, tracker)
    if recognised is not None and back_on_bearings(state, phase, recognised[0], tracker):
        filtered, pairs = recognised
        last, reported = phase.last, state.reported_attitude
        if resting is None:
            filtered, reported = filtered.clone_attitude(), filtered.attitude
            if isinstance(last, Learning):
                last = Learning(found=True, views=(_buffer(state, stamp, filtered),))
        state = state._replace(lookalikes=forget(state.lookalikes))
        return start_tracking(state, last, filtered, reported, stamp), (Recognised(pairs),)
    if recognised is None and phase.lifted_at is None:
        state, events = _track_or_lose(state, phase, stamp, tracker, predicted)
        if events:
            return state, events
    waits = phase.lifted_at is not None and 0.0 <= stamp - phase.lifted_at < _NEW_CENTRE_AFTER_S
    if (
        waits
        or phase.in_view_since is None
        or stamp - max(phase.in_view_since, state.supported_at) < tracker.settings.loss.reset_after
    ):
        return state, ()
    if np.count_nonzero(state.filter.hits >= ESTABLISHED_HITS) < 2:  # too few for recognition
        return start_new_map(state, stamp, tracker)
    return try_new_map(state, phase, stamp, tracker)


def _where_it_was(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[So3State, int] | None:
    """Return the filter's state at rest at the last reported attitude, and the number of discs that confirm it.

    Most balls that are hidden for a while do not turn meanwhile. Then two discs in their places are enough, if chance
    does not explain them. The small attitude difference counts as motion. Otherwise errors of the camera's pose would
    add up. Returns None if the discs do not confirm the attitude.
    """
    filter_ = tracker.filter
    placed = relocate(
        state.filter, state.reported_attitude, IDENTIFY_SIGMA**2 * np.eye(3), tracker.settings.so3, stamp, np.zeros(3)
    )
    placed.joint[3:6, 3:6] = RESTS**2 * np.eye(3)
    filtered = filter_.update(placed, state.points, np.zeros(len(state.points), dtype=bool))
    seen = filtered.known_seen
    if seen < 2 or filtered.known_missed > seen or not filter_.is_significant(placed, seen, len(state.points)):
        return None
    return filtered, seen


def try_new_map(
    state: TrackState[So3State], phase: Lost, stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Return the state and events after a frame of a new map's trial, beside the old map.

    The new map replaces the old one once its points have turned like a ball. An object that passes in front of a ball
    at rest hardly ever turns so. Meanwhile the tracker sends no motion, and it recognises the old map when the object
    is gone. It keeps the old map in case the ball is lost again.
    """
    if phase.trial is None:
        filtered, view = _new_map(state, stamp, tracker)
        trial = Trial(filtered, Learning(found=True, views=(view,), beside_map=True))
        return state._replace(phase=phase._replace(trial=trial)), ()
    trial = phase.trial
    predicted = tracker.filter.predict(trial.filter, stamp)
    tried, events = learn(state._replace(filter=trial.filter), trial.phase, stamp, tracker, predicted)
    if isinstance(tried.phase, Learning):
        return state._replace(phase=phase._replace(trial=Trial(tried.filter, tried.phase))), ()
    filtered = tried.filter.clone_attitude()
    maps = [state.filter] if state.older is None else [state.filter, state.older]
    older = max(maps, key=lambda filter_state: int(np.sum(filter_state.hits)))
    tried = start_tracking(tried, Tracking(), filtered, filtered.attitude, stamp)
    tried = tried._replace(older=older, older_searches=state.older_searches if older is state.older else 0)
    return tried, (NewMap(), *events)


def _track_or_lose(
    state: TrackState[So3State], phase: Lost, stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the ball as tracked if discs near their predicted places confirm its attitude, or else as lost.

    More than half of the points in view must be discs of the map. Each must lie within reach of the ball's motion since
    the loss, and only one attitude may explain them.
    """
    updated = updated_hypotheses(state, stamp, tracker, predicted, extend_map=False)
    pairs = len(updated.filter.used)
    if pairs < 2 or 2 * pairs <= len(state.points) or not updated.confirmed:
        return state, ()
    updated = updated._replace(lookalikes=forget(state.lookalikes))
    filtered = updated.filter.clone_attitude()
    return start_tracking(updated, phase.last, filtered, filtered.attitude, stamp), (Recognised(pairs),)


def start_new_map(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[TrackState[F], Events]:
    """Return a lost ball as tracked from its last attitude, with a new map."""
    attitude = state.filter.attitude
    filtered, view = _new_map(state, stamp, tracker)
    state = state._replace(lookalikes=forget(state.lookalikes))
    return start_tracking(state, Learning(found=True, views=(view,)), filtered, attitude, stamp), (NewMap(),)


def recognise(
    state: TrackState[So3State], phase: Recognising, stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Return the state and events after a frame in which the attitude on a saved map is unknown.

    If recognition is certain, the attitude becomes absolute, and motion counts from it. If it fails for
    `loss.reset_after` s with enough discs in view, the map may belong to another ball, and a new map begins. The saved
    map stays as the older one, since other discs may come into view.
    """
    recognised = recognise_attitude(state, stamp, tracker)
    if recognised is not None:
        filtered, pairs = recognised
        state = start_tracking(state, Tracking(), filtered.clone_attitude(), filtered.attitude, stamp)
        return _in_other_axes(state)._replace(absolute=True), (Recognised(pairs, saved=True),)
    before = phase.in_view_since
    in_view = state.most_in_view(stamp)
    too_few = in_view < _MIN_DISCS_AGAINST_MAP
    since = stamp if before is None or too_few else min(before, stamp)
    state = state._replace(confirmed_at=stamp)  # no uncertainty accumulates before the first attitude
    if too_few or stamp - since < tracker.settings.loss.reset_after:
        return state._replace(phase=Recognising(since)), ()
    filtered, view = _new_map(state, stamp, tracker)
    state = state._replace(filter=filtered, older=state.filter, older_searches=1)
    state, events = found(state, Learning(views=(view,)), stamp)
    return state, (NewMap(saved=True), *events)


def recognise_older_map(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Return the state, and an event if the discs in view have their places on the map before the last new one.

    A ball that was lost, or that began, with too few discs in view for recognition gets a new map, and shows the others
    later. The older map gives back the attitude from before the loss, or that of an earlier session. It is no motion.
    """
    # confirmed now, since the attitude reported before is that of the other map, and so shows no rate
    saved = state.older_searches > 0
    state, recognised = _on_older_map(state._replace(confirmed_at=stamp), stamp, tracker)
    if recognised is None:
        return state, ()
    filtered, pairs = recognised
    state = state._replace(lookalikes=forget(state.lookalikes))
    state = start_tracking(state, Tracking(), filtered.clone_attitude(), filtered.attitude, stamp)
    return _in_other_axes(state), (Recognised(pairs, saved=saved, older=True),)


def _in_other_axes(state: TrackState[So3State]) -> TrackState[So3State]:
    """Return the state that measures outlines again. Before, the attitude was in the axes of another map."""
    others = tuple(other._replace(outline=OutlineCheck()) for other in state.others)
    return state._replace(outline=OutlineCheck(), others=others)


def _on_older_map(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], tuple[So3State, int] | None]:
    """Return the state, and the result of `recognise_attitude` for the older map, which then is older no more.

    A saved map may be of another ball. It is searched for long, so all its searches share the risk of one.
    """
    searches = state.older_searches
    risk = RISK / (searches * (searches + 1)) if searches else RISK  # these sum to RISK
    recognised = recognise_attitude(state._replace(filter=state.older), stamp, tracker, risk)
    if recognised is None:
        return state._replace(older_searches=searches + (searches > 0)), None
    return state._replace(older=None, older_searches=0, absolute=state.absolute or searches > 0), recognised


def _new_map(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[F, BufferedFrame]:
    """Return a new map at the last attitude from this frame's points, and the view. It may include look-alikes."""
    start = tracker.filter.initial(stamp, state.filter.attitude).with_cameras_of(state.filter)
    filtered = tracker.filter.update(start, state.points)
    return filtered, _buffer(state, stamp, start)


def _buffer(state: TrackState[F], stamp: float, filter_state: F) -> BufferedFrame:
    return BufferedFrame(stamp, state.detections, state.points, filter_state, camera=state.camera)
