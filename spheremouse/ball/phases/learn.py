"""The first turn of the ball, from which discs are told from look-alikes."""

from dataclasses import replace
from typing import Any

import numpy as np

from spheremouse.ball.associate import common_rotation
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.lookalikes import StaticSettings
from spheremouse.ball.events import Found, Turned
from spheremouse.ball.phases.candidates import confirms
from spheremouse.ball.phases.first_turn import follow_points, still_while_two_turned, would_move
from spheremouse.ball.phases.hypotheses import updated_hypotheses
from spheremouse.ball.state import Events, F, Learning, Tracker, Tracking, TrackState, View
from spheremouse.geometry.rotation import Array

_REPLAY = 30  # frames kept while nothing has moved yet, to be filtered again without the look-alikes


def learn(
    state: TrackState[F], phase: Learning, stamp: float, tracker: Tracker, predicted: F
) -> tuple[TrackState[F], Events]:
    """Nothing has turned yet: every candidate may be a disc or a look-alike. Take all, until some turn alike.

    Then those that stayed are masked, and the frames since are filtered again without them, as if they had been known.
    """
    if not phase.views:  # the ball is where two points are first seen: nothing is known less for having waited
        predicted = tracker.filter.initial(stamp, state.filter.attitude).with_reference_of(state.filter)
        if len(state.points) < 2:
            return found(replace(state, filter=predicted), phase, stamp)
    naive = _with_all(state, stamp, tracker, predicted)
    centre = state.detections.centre[state.points.index]
    track, next_track = follow_points(phase.views, centre, phase.next_track)
    views = (*phase.views, View(stamp, state.detections, state.points, predicted, track))
    if len(views) > _REPLAY:
        views = (views[0], *views[2:])  # the first frame is the anchor: slow motion shows against it
    still = _still_since(views[0], views[-1], tracker)
    if still is None:
        still = still_while_two_turned(views, tracker)
    if still is None:
        if len(views) == _REPLAY and _changed(views[0], views[-1], tracker.settings.static):
            views = views[-1:]
        return found(naive, phase._replace(views=views, next_track=next_track), stamp)
    state = _without(state, still, views, tracker) if len(still) else naive
    state, events = found(state, phase, stamp)
    return replace(state, phase=Tracking()), (Turned(len(still)), *events)


def _with_all(state: TrackState[F], stamp: float, tracker: Tracker, predicted: F) -> TrackState[F]:
    """The frame filtered with every point taken for a disc."""
    if not tracker.classic:
        every = np.ones(len(state.points), dtype=bool)
        known: Any = state, stamp, tracker, predicted
        return updated_hypotheses(*known, proven=every)
    filtered = tracker.filter.update(predicted, state.points)
    return replace(state, filter=filtered, confirmed=confirms(filtered, len(state.points), predicted, tracker))


def _without(state: TrackState[F], still: Array, views: tuple[View, ...], tracker: Tracker) -> TrackState[F]:
    """The frames of all views filtered again, without the look-alikes at `still`, (k, 2) px."""
    stamp = views[-1].stamp
    state = replace(state, lookalikes=static.mask(state.lookalikes, still, stamp), alternatives=())
    filtered = tracker.filter.initial(views[0].stamp, views[0].attitude).with_reference_of(state.filter)
    for view in views:
        free, _ = static.unmasked(state.lookalikes, view.centre, view.stamp, tracker.settings.static)
        state = replace(state, filter=filtered, points=view.points.take(free), detections=view.detections)
        predicted = tracker.filter.predict(filtered, view.stamp)
        state = _with_all(state, view.stamp, tracker, predicted)
        filtered = state.filter
    return replace(state, confirmed=not state.alternatives and len(state.filter.used) > 1)


def found(state: TrackState[F], phase: Learning, stamp: float) -> tuple[TrackState[F], Events]:
    """The ball is tracked from where two discs are seen."""
    if phase.found:
        return replace(state, phase=phase), ()
    state = replace(state, confirmed_at=stamp)
    if len(state.filter.discs) < 2:
        return replace(state, phase=phase), ()
    return replace(state, phase=phase._replace(found=True)), (Found(len(state.points)),)


def _still_since(anchor: View, now: View, tracker: Tracker) -> Array | None:
    """Places, (k, 2) px, that stayed while at least three others turned alike; None while nothing is certain."""
    s = tracker.settings.static
    if len(anchor.points) < 3 or len(now.points) < 3:
        return None
    distance = np.linalg.norm(now.centre[:, None] - anchor.centre[None], axis=2)
    stayed = distance.min(axis=1) < s.still
    left = distance.min(axis=0) >= s.still
    spread = np.sqrt(np.trace(now.points.image_covariance, axis1=1, axis2=2) / 2.0) / tracker.rig.ball.radius
    sigma = max(float(np.median(spread)), 1e-3)
    shared = common_rotation(anchor.points.direction[left], now.points.direction[~stayed], sigma)
    if shared is None:
        return None
    rotation, pairs = shared
    path = np.linalg.norm(anchor.centre[left][pairs[:, 0]] - now.centre[~stayed][pairs[:, 1]], axis=1)
    if np.median(path) < s.moved:
        return None
    return now.centre[stayed & would_move(now.points, rotation, tracker, s.moved)]


def _changed(anchor: View, now: View, settings: StaticSettings) -> bool:
    """The anchor's picture is gone without a common rotation: hands, light, or too few discs in common."""
    if len(anchor.points) == 0 or len(now.points) == 0:
        return len(now.points) > 0
    stayed = np.linalg.norm(anchor.centre[:, None] - now.centre[None], axis=2).min(axis=1) < settings.still
    return bool(np.count_nonzero(~stayed) > 0.5 * len(anchor.points))
