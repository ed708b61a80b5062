"""The first turn of the ball, from which discs are told from look-alikes."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import common_rotation
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.lookalikes import StaticSettings
from spheremouse.ball.events import Found, Turned
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.candidates import confirms
from spheremouse.ball.phases.first_turn import follow_points, still_while_two_turned, would_move
from spheremouse.ball.phases.hypotheses import is_covered, updated_hypotheses, without_effect
from spheremouse.ball.state import Events, F, Learning, Tracker, Tracking, TrackState, View
from spheremouse.geometry.rotation import Array, log, rotation_between

_CERTAIN = 9.0  # nats: odds of 8000 to 1 that it is the ball that moves
_FRAME = 1.0 / 30.0  # s, in which a turn about the line of sight is noticed
_MODEL_ERROR = 0.1  # px, of where a disc is seen, by errors of pose and ball
_REPLAY = 30  # frames kept while nothing has moved yet, to be filtered again without the look-alikes


def learn(
    state: TrackState[F], phase: Learning, stamp: float, tracker: Tracker, predicted: F
) -> tuple[TrackState[F], Events]:
    """Nothing has turned yet: every candidate may be a disc or a look-alike. Take all, until some turn alike.

    Then those that stayed are masked, and the frames since are filtered again without them, as if they had been known.
    A candidate that appears once discs are established may be anything: it founds a disc when it has turned.
    """
    if not phase.views and len(state.filter.discs) == 0:  # where two are first seen, it is known as well as ever
        predicted = tracker.filter.initial(stamp, state.filter.attitude).with_reference_of(state.filter)
        if len(state.points) < 2:
            return found(replace(state, filter=predicted), phase, stamp)
    naive = _with_all(state, stamp, tracker, predicted, phase.views)
    if is_covered(naive.filter, predicted):
        return found(without_effect(state, tracker, predicted), phase, stamp)
    centre = state.detections.centre[state.points.index]
    track, next_track = follow_points(phase.views, centre, phase.next_track)
    views = (*phase.views, View(stamp, state.detections, state.points, predicted, track))
    if len(views) > _REPLAY:
        views = (views[0], *views[2:])  # the first frame is the anchor: slow motion shows against it
    still = _still_since(views[0], views[-1], tracker)
    if still is None:
        still = still_while_two_turned(views, tracker)
    if still is None:
        if len(views) == _REPLAY and _changed(views[0], views[1:], tracker.settings.static):
            views = views[-1:]
        return found(naive, phase._replace(views=views, next_track=next_track), stamp)
    state = _without(state, still, views, tracker) if len(still) else naive
    state, events = found(state, phase, stamp)
    return replace(state, phase=Tracking()), (Turned(len(still)), *events)


def _with_all(
    state: TrackState[F], stamp: float, tracker: Tracker, predicted: F, views: tuple[View, ...]
) -> TrackState[F]:
    """The frame filtered, with every point taken for a disc that may be one."""
    if isinstance(predicted, So3State):
        with_map: Any = state  # of an So3State, as `predicted`
        updated: Any = updated_hypotheses(
            with_map, stamp, tracker, predicted, proven=_founders(with_map, predicted, views, tracker)
        )
        return updated
    filtered = tracker.filter.update(predicted, state.points)
    return replace(state, filter=filtered, confirmed=confirms(filtered, len(state.points), predicted, tracker))


def _without(state: TrackState[F], still: Array, views: tuple[View, ...], tracker: Tracker) -> TrackState[F]:
    """The frames of all views filtered again, without the look-alikes at `still`, (k, 2) px."""
    stamp = views[-1].stamp
    state = replace(state, lookalikes=static.mask(state.lookalikes, still, stamp), alternatives=())
    filtered = tracker.filter.initial(views[0].stamp, views[0].attitude).with_reference_of(state.filter)
    for k, view in enumerate(views):
        free, _ = static.unmasked(state.lookalikes, view.centre, view.stamp, tracker.settings.static)
        state = replace(state, filter=filtered, points=view.points.take(free), detections=view.detections)
        predicted = tracker.filter.predict(filtered, view.stamp)
        state = _with_all(state, view.stamp, tracker, predicted, views[:k])
        filtered = state.filter
        state = replace(state, confirmed_at=view.stamp if state.confirmed else state.confirmed_at)
    return replace(state, confirmed=not state.alternatives and len(state.filter.used) > 1)


def _founders(state: TrackState, predicted: So3State, views: tuple[View, ...], tracker: Tracker) -> NDArray[np.bool_]:
    """Which points may found a disc, (n,).

    All may while fewer than two discs are established, and once those have turned by a disc's width: new discs come
    into view then. While the ball stands, what appears is not on it, or was hidden.
    """
    few = np.count_nonzero(predicted.hits >= tracker.settings.so3.trial) < 2
    turned = rotation_between(views[0].attitude, predicted.attitude) if views else np.zeros(3)
    has_turned = np.linalg.norm(turned) > 2.0 * tracker.rig.disc_radius / tracker.rig.ball.radius
    follows = state.confirmed_at == state.filter.stamp and state.filter.known_missed == 0
    return np.full(len(state.points), few or (has_turned and follows))


def found(state: TrackState[F], phase: Learning, stamp: float) -> tuple[TrackState[F], Events]:
    """The ball is tracked from where two discs are seen."""
    if phase.found:
        return replace(state, phase=phase), ()
    state = replace(state, confirmed_at=stamp)
    if len(state.filter.discs) < 2:
        return replace(state, phase=phase), ()
    return replace(state, phase=phase._replace(found=True)), (Found(len(state.points)),)


def _still_since(anchor: View, now: View, tracker: Tracker) -> Array | None:
    """Places, (k, 2) px, that stayed while most of the others turned alike, as on a ball; None while that is uncertain.

    What is flat, and passes, moves otherwise.
    """
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
    pairs = np.stack([np.flatnonzero(left)[pairs[:, 0]], np.flatnonzero(~stayed)[pairs[:, 1]]], axis=1)
    path = np.linalg.norm(anchor.centre[pairs[:, 0]] - now.centre[pairs[:, 1]], axis=1)
    if np.median(path) < s.moved or 2 * len(pairs) <= np.count_nonzero(~stayed):
        return None
    if _flat(anchor, now, pairs, rotation, tracker):
        return None
    return now.centre[stayed & would_move(now.points, rotation, tracker, s.moved)]


def _flat(anchor: View, now: View, pairs: NDArray[np.intp], rotation: Array, tracker: Tracker) -> bool:
    """Is a flat thing that shifts, turns and grows in the picture nearly as good an explanation as the ball?

    `pairs` (k, 2) index the points of `anchor` and `now`. A turn about the line of sight looks flat, but a flat thing
    hardly ever turns about the ball's middle.
    """
    rig, pose, (before, after) = tracker.rig, tracker.pose, pairs.T
    towards = pose.position - rig.ball.centre
    towards = towards / np.linalg.norm(towards)
    middle = seen_at(np.stack([towards, rotation @ towards]), rig, pose)
    at_once = np.linalg.norm(log(rotation)) < tracker.settings.loss.fastest * _FRAME  # rows of spots match far turns
    if at_once and np.linalg.norm(middle[1] - middle[0]) < 0.5 * tracker.settings.static.moved:
        return False
    off = now.centre[after] - seen_at(anchor.points.direction[before] @ rotation.T, rig, pose)
    weight = 1.0 / (_variance(anchor, before) + _variance(now, after) + _MODEL_ERROR**2)
    a, b = anchor.centre[before] @ (1.0, 1.0j), now.centre[after] @ (1.0, 1.0j)
    A = np.sqrt(weight)[:, None] * np.stack([a, np.ones_like(a)], axis=1)
    similarity = np.linalg.lstsq(A, np.sqrt(weight) * b)[0]
    chi2_flat = float(np.sum(np.abs(np.sqrt(weight) * b - A @ similarity) ** 2))
    return chi2_flat - float(weight @ np.sum(off * off, axis=1)) < 2.0 * _CERTAIN


def _variance(view: View, which: NDArray[np.intp]) -> Array:
    """Variance per axis, (k,) px², of the centres of some points."""
    return 0.5 * np.trace(view.detections.covariance[view.points.index[which]], axis1=1, axis2=2)


def _changed(anchor: View, since: tuple[View, ...], settings: StaticSettings) -> bool:
    """Is most of the anchor's picture missing from all later views, without a common rotation?"""
    later = np.concatenate([view.centre for view in since])
    if len(anchor.points) == 0 or len(later) == 0:
        return len(later) > 0
    gone = np.linalg.norm(anchor.centre[:, None] - later[None], axis=2).min(axis=1) >= settings.still
    return bool(np.count_nonzero(gone) > 0.5 * len(anchor.points))
