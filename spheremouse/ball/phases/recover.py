"""A ball found by its map: one that was lost, or one whose map was made earlier."""

from dataclasses import replace

import numpy as np

from spheremouse.ball.events import BallLost, NewMap, Recognised, Why
from spheremouse.ball.filters.so3 import So3Filter, relocate
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.hypotheses import updated_hypotheses
from spheremouse.ball.phases.learn import found, learn
from spheremouse.ball.phases.lifted import back_on_bearings
from spheremouse.ball.phases.recognise import recognised_attitude
from spheremouse.ball.state import (
    Events,
    F,
    Learning,
    Lost,
    Recognising,
    Tracker,
    Tracking,
    TrackState,
    Trial,
    View,
    forget,
    lost,
    tracked,
    unused,
)

_RESTS = 0.05  # rad/s, standard deviation of the rate of a ball that is where it was
_SPEAKS = 4  # discs in view: fewer say nothing against a map


def lost_in_a_gap(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[TrackState[F], Events]:
    """No frame came for so long that the prediction is a guess: the map says where the ball is, or nothing does."""
    gap = stamp - state.filter.stamp
    if not isinstance(state.phase, Tracking) or gap <= tracker.settings.loss.lost_after:
        return state, ()
    return lost(state), (BallLost(Why.GAP, gap),)


def seen_since(phase: Lost, points: int, stamp: float) -> Lost:
    """Lost, and since when discs are in view again."""
    if points < 2:
        return phase._replace(in_view_since=None)
    since = stamp if phase.in_view_since is None else min(phase.in_view_since, stamp)  # a clock that starts again
    return phase._replace(in_view_since=since)


def recover(
    state: TrackState[So3State], phase: Lost, stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Lost: find the attitude again by the map, or begin anew at the last one. Either way nothing is invented."""
    phase = seen_since(phase, len(state.points), stamp)
    state = replace(state, phase=phase, filter=unused(state.filter))
    resting = None if phase.in_view_since is None else _where_it_was(state, stamp, tracker)
    recognised = resting or recognised_attitude(state, stamp, tracker)
    if recognised is not None and back_on_bearings(state, phase, recognised[0], tracker):
        filtered, pairs = recognised
        last, reported = phase.last, state.reported_attitude
        if resting is None:
            filtered, reported = filtered.with_reference(), filtered.attitude
            if isinstance(last, Learning):
                last = Learning(found=True, views=(View(stamp, state.detections, state.points, filtered),))
        state = replace(state, lookalikes=forget(state.lookalikes))
        return tracked(state, last, filtered, reported, stamp), (Recognised(pairs),)
    if recognised is None and phase.lifted_at is None:
        state, events = _followed(state, phase, stamp, tracker, predicted)
        if events:
            return state, events
    waits = phase.lifted_at is not None and 0.0 <= stamp - phase.lifted_at < tracker.settings.bearing.patience
    if (
        waits
        or phase.in_view_since is None
        or stamp - max(phase.in_view_since, state.supported_at) < tracker.settings.loss.reset_after
    ):
        return state, ()
    return try_new_map(state, phase, stamp, tracker)


def _where_it_was(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[So3State, int] | None:
    """The filter at rest where the ball was last, and by how many discs; None where they do not show it.

    Most balls that are hidden for a while are. Two discs in their places are enough then, if chance does not put them
    there. What little the attitude differs counts as motion: else errors of the camera's pose would add up.
    """
    filter_, s = tracker.filter, tracker.settings.loss
    placed = relocate(state.filter, state.reported_attitude, s.identify_sigma, tracker.settings.so3, stamp, np.zeros(3))
    placed.joint[3:6, 3:6] = _RESTS**2 * np.eye(3)
    filtered = filter_.update(placed, state.points, np.zeros(len(state.points), dtype=bool))
    seen = filtered.known_seen
    if seen < 2 or filtered.known_missed > seen or not filter_.beyond_chance(placed, seen, len(state.points)):
        return None
    return filtered, seen


def try_new_map(
    state: TrackState[So3State], phase: Lost, stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """What is in view on trial as a new map, beside the old one, until it has turned as only a ball turns.

    What passes before a ball that stands does not: nothing is sent, and the old map is recognised when it is gone.
    """
    if phase.trial is None:
        filtered, view = _new_map(state, stamp, tracker)
        trial = Trial(filtered, Learning(found=True, views=(view,)))
        return replace(state, phase=phase._replace(trial=trial)), ()
    trial = phase.trial
    predicted = tracker.filter.predict(trial.filter, stamp)
    tried, events = learn(replace(state, filter=trial.filter), trial.phase, stamp, tracker, predicted)
    if isinstance(tried.phase, Learning):
        return replace(state, phase=phase._replace(trial=Trial(tried.filter, tried.phase))), ()
    filtered = tried.filter.with_reference()
    return tracked(tried, Tracking(), filtered, filtered.attitude, stamp), (NewMap(), *events)


def _followed(
    state: TrackState[So3State], phase: Lost, stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Lost, or found by the discs that are where the ball may have turned since.

    Most of what is in view must be discs of the map, each in a place that the time since allows, and only one attitude
    may explain it.
    """
    updated = updated_hypotheses(state, stamp, tracker, predicted, extend_map=False)
    pairs = len(updated.filter.used)
    if pairs < 2 or 2 * pairs <= len(state.points) or not updated.confirmed:
        return state, ()
    updated = replace(updated, lookalikes=forget(state.lookalikes))
    filtered = updated.filter.with_reference()
    return tracked(updated, phase.last, filtered, filtered.attitude, stamp), (Recognised(pairs),)


def begin_anew(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[TrackState[F], Events]:
    """A lost ball tracked from its last attitude on, with a new map."""
    attitude = state.filter.attitude
    filtered, view = _new_map(state, stamp, tracker)
    state = replace(state, lookalikes=forget(state.lookalikes))
    return tracked(state, Learning(found=True, views=(view,)), filtered, attitude, stamp), (NewMap(),)


def recognise(
    state: TrackState[So3State], phase: Recognising, stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """The ball is where the saved map says, once that is certain; never recognised, it is another ball's map."""
    recognised = recognised_attitude(state, stamp, tracker)
    if recognised is not None:
        filtered, pairs = recognised
        state = tracked(state, Tracking(), filtered.with_reference(), filtered.attitude, stamp)
        return replace(state, absolute=True), (Recognised(pairs, saved=True),)
    before = phase.in_view_since
    since = stamp if before is None or len(state.points) < _SPEAKS else min(before, stamp)
    state = replace(state, confirmed_at=stamp)
    if stamp - since < tracker.settings.loss.reset_after:
        return replace(state, phase=Recognising(since)), ()
    filtered, view = _new_map(state, stamp, tracker)
    state, events = found(replace(state, filter=filtered), Learning(views=(view,)), stamp)
    return state, (NewMap(saved=True), *events)


def _new_map(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[F, View]:
    """A new map, begun at the last attitude by this frame's points: any of them may be a look-alike."""
    start = tracker.filter.initial(stamp, state.filter.attitude)
    filtered = tracker.filter.update(start, state.points)
    return filtered, View(stamp, state.detections, state.points, start)
