"""Learning phase: the first turn of the ball separates discs from look-alikes.

Most of the points turn together like a ball, or two do while the others stay. An image that only shifts is no turn.
"""

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import common_rotation
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.lookalikes import MOVED_PX, STILL_PX
from spheremouse.ball.events import Found, Turned
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.filter_again import (
    filtered_again,
    filtered_with_its_rig,
    filtered_with_others,
    would_move,
)
from spheremouse.ball.phases.follow import not_used, updated_hypotheses, without_effect
from spheremouse.ball.points import SpherePoints
from spheremouse.ball.state import BufferedFrame, Events, F, Learning, OtherView, Tracker, Tracking, TrackState
from spheremouse.geometry.matching import distances, mutual_nearest
from spheremouse.geometry.rotation import Array, align, log, rotation_between

_MIN_LOG_ODDS = 9.0  # nats: odds of 8000 to 1 for a motion of the ball
_SPIN_INTERVAL_S = 1.0 / 30.0  # s, frame interval within which a turn about the line of sight is detected
_MAX_PREDICTION_ERROR_PX = 6.0  # from the predicted to the seen place of a point
_MAX_EXTRAPOLATION_S = 0.1  # interval between views over which a step predicts the next one
_MODEL_ERROR = 0.1  # px, error of a disc's predicted centre from errors of pose and ball
_MAX_KEPT_VIEWS = 30  # frames kept until the ball moves, for filtering again without the look-alikes
_MIN_PATH = 5.0  # times MOVED_PX: over so long a path, a turn and a shift of the picture differ by many deviations
_MAX_CHI2 = 10.83  # chi-square with one degree of freedom, 99.9 %
# squared deviations by which a turn must fit better than a shift of the picture: odds of 3e6
_MIN_CHI2_DIFFERENCE = 30.0
_CENTRE_SIGMA = 0.1  # px, floor of the standard deviation of a path's length: unevenness of light


def learn(
    state: TrackState[F], phase: Learning, stamp: float, tracker: Tracker, predicted: F
) -> tuple[TrackState[F], Events]:
    """Return the state and events after a frame in which the ball may not have turned yet.

    Before the first turn, every candidate may be a disc or a look-alike, so the filter uses all of them. When most of
    them turn together, the tracker masks the static ones and filters the kept frames again without them. Once discs are
    established, a new candidate adds a disc to the map only after the ball has turned.

    Only frames of one camera count, since the others may show the same look-alikes elsewhere. Another camera takes its
    part if it shows none for `loss.lost_after` s. Once the ball has turned, the frames that the others showed meanwhile
    count, too.

    `stamp` is in s, and `predicted` is the filter's state predicted for this frame.
    """
    if phase.views and phase.views[-1].camera != state.camera:
        if abs(stamp - phase.views[-1].stamp) <= tracker.settings.loss.lost_after:
            return not_used(state)._replace(phase=_with_other_view(phase, state, stamp, tracker, predicted)), ()
        phase = phase._replace(views=(), others=())
    if not phase.views and len(state.filter.discs) == 0:  # no uncertainty accumulates before the first two discs
        predicted = tracker.filter.initial(stamp, state.filter.attitude).with_reference_of(state.filter)
        if len(state.points) < 2:
            return found(state._replace(filter=predicted), phase, stamp)
    naive = tracker.method.update_all(state, stamp, tracker, predicted, phase.views)
    if tracker.method.is_covered(naive, predicted, tracker):
        return found(without_effect(state, tracker, predicted), phase, stamp)
    centre = state.detections.centre[state.points.index]
    track, next_track = follow_points(phase.views, centre, phase.next_track)
    views = (
        *phase.views,
        BufferedFrame(stamp, state.detections, state.points, predicted, track, state.camera, state.outline.seen),
    )
    if len(views) > _MAX_KEPT_VIEWS:
        views = (views[0], *views[2:])  # the first frame stays as the anchor, so that slow motion adds up against it
    still = _still_since(views[0], views[-1], tracker)
    if still is None and not phase.beside_map:
        still = still_while_two_turned(views, tracker)
    if still is None:
        if len(views) == _MAX_KEPT_VIEWS and _most_are_gone(views[0], views[1:]):
            views, phase = views[-1:], phase._replace(others=())
        return found(naive, phase._replace(views=views, next_track=next_track), stamp)
    state = filtered_again(state, still, views, tracker) if len(still) else naive
    state = filtered_with_its_rig(state, still, views, tracker)
    state = filtered_with_others(state, still, views, phase.others, tracker)
    state, events = found(state, phase, stamp)
    return state._replace(phase=Tracking()), (Turned(len(still)), *events)


def _with_other_view(phase: Learning, state: TrackState[F], stamp: float, tracker: Tracker, predicted: F) -> Learning:
    """Return the phase after a frame of a camera that does not decide whether the ball has turned."""
    view = BufferedFrame(stamp, state.detections, state.points, predicted, camera=state.camera)
    others = (*phase.others, OtherView(view, tracker))
    own = [k for k, other in enumerate(others) if other.view.camera == state.camera]
    if len(own) > _MAX_KEPT_VIEWS:
        others = others[: own[1]] + others[own[1] + 1 :]
    return phase._replace(others=others)


def update_all(
    state: TrackState[So3State],
    stamp: float,
    tracker: Tracker[So3Filter],
    predicted: So3State,
    views: tuple[BufferedFrame, ...],
) -> TrackState[So3State]:
    """Return the state after filtering a frame with every point as a possible disc.

    All points may add a disc to the map if fewer than two discs are established. All may if the ball has turned by a
    disc's width and the last frame confirmed its attitude, because new discs come into view then. If the ball is at
    rest, a new point is not on the ball, or is a disc that was hidden.
    """
    few = np.count_nonzero(predicted.hits >= ESTABLISHED_HITS) < 2
    turned = rotation_between(views[0].attitude, predicted.attitude) if views else np.zeros(3)
    has_turned = np.linalg.norm(turned) > 2.0 * tracker.detector.landmark_angle(tracker.rig)
    follows = state.follows and state.filter.known_missed < 0.5
    proven = np.full(len(state.points), few or (has_turned and follows))
    return updated_hypotheses(state, stamp, tracker, predicted, proven=proven)


def found(state: TrackState[F], phase: Learning, stamp: float) -> tuple[TrackState[F], Events]:
    """Return the state in `phase`, with a `Found` event when the map first has two discs."""
    if phase.found:
        return state._replace(phase=phase), ()
    state = state._replace(confirmed_at=stamp)
    if len(state.filter.discs) < 2:
        return state._replace(phase=phase), ()
    return state._replace(phase=phase._replace(found=True)), (Found(len(state.points)),)


def _still_since(anchor: BufferedFrame, now: BufferedFrame, tracker: Tracker) -> Array | None:
    """Return the places, (k, 2) px, of points that stayed while most others turned together like a ball.

    Returns None while that is uncertain, and if the motion also fits a flat object that passes.
    """
    if len(anchor.points) < 3 or len(now.points) < 3:
        return None
    distance = distances(now.centre, anchor.centre)
    stayed = distance.min(axis=1) < STILL_PX
    left = distance.min(axis=0) >= STILL_PX
    spread = np.sqrt(np.trace(now.points.image_covariance, axis1=1, axis2=2) / 2.0) / tracker.rig.ball.radius
    sigma = max(float(np.median(spread)), 1e-3)
    shared = common_rotation(anchor.points.direction[left], now.points.direction[~stayed], sigma)
    if shared is None:
        return None
    rotation, pairs = shared
    pairs = np.stack([np.flatnonzero(left)[pairs[:, 0]], np.flatnonzero(~stayed)[pairs[:, 1]]], axis=1)
    path = np.linalg.norm(anchor.centre[pairs[:, 0]] - now.centre[pairs[:, 1]], axis=1)
    if np.median(path) < MOVED_PX or 2 * len(pairs) <= np.count_nonzero(~stayed):
        return None
    if _flat(anchor, now, pairs, rotation, tracker):
        return None
    return now.centre[stayed & would_move(now.points, rotation, tracker, MOVED_PX)]


def _flat(
    anchor: BufferedFrame, now: BufferedFrame, pairs: NDArray[np.intp], rotation: Array, tracker: Tracker
) -> bool:
    """Return True if a flat object that shifts, turns and grows in the picture fits nearly as well as the ball.

    `pairs` (k, 2) index the points of `anchor` and `now`, and `rotation`, (3, 3), takes one to the other. A turn about
    the line of sight also fits a flat object. But such an object hardly ever turns about the centre of the ball's
    picture, so the function then returns False.
    """
    rig, pose, (before, after) = tracker.rig, tracker.pose, pairs.T
    towards = pose.position - rig.ball.centre
    towards = towards / np.linalg.norm(towards)
    middle = seen_at(np.stack([towards, rotation @ towards]), rig, pose)
    # large turns match rows of spots
    at_once = np.linalg.norm(log(rotation)) < tracker.settings.loss.fastest * _SPIN_INTERVAL_S
    if at_once and np.linalg.norm(middle[1] - middle[0]) < 0.5 * MOVED_PX:
        return False
    off = now.centre[after] - seen_at(anchor.points.direction[before] @ rotation.T, rig, pose)
    weight = 1.0 / (_variance(anchor, before) + _variance(now, after) + _MODEL_ERROR**2)
    a, b = anchor.centre[before] @ (1.0, 1.0j), now.centre[after] @ (1.0, 1.0j)
    A = np.sqrt(weight)[:, None] * np.stack([a, np.ones_like(a)], axis=1)
    similarity = np.linalg.lstsq(A, np.sqrt(weight) * b)[0]
    chi2_flat = float(np.sum(np.abs(np.sqrt(weight) * b - A @ similarity) ** 2))
    return chi2_flat - float(weight @ np.sum(off * off, axis=1)) < 2.0 * _MIN_LOG_ODDS


def _variance(view: BufferedFrame, which: NDArray[np.intp]) -> Array:
    """Return the variance per axis, (k,) px², of the centres of the points `which`, (k,)."""
    return 0.5 * np.trace(view.detections.covariance[view.points.index[which]], axis1=1, axis2=2)


def _most_are_gone(anchor: BufferedFrame, since: tuple[BufferedFrame, ...]) -> bool:
    """Return True if more than half of the anchor's points are missing from all later views."""
    later = np.concatenate([view.centre for view in since])
    if len(anchor.points) == 0 or len(later) == 0:
        return len(later) > 0
    gone = distances(anchor.centre, later).min(axis=1) >= STILL_PX
    return bool(np.count_nonzero(gone) > 0.5 * len(anchor.points))


def follow_points(views: tuple[BufferedFrame, ...], centre: Array, next_track: int) -> tuple[NDArray[np.intp], int]:
    """Assign track numbers to the points of a frame, at `centre` (n, 2) px.

    A point takes the number of the point whose predicted place is nearest, within `_MAX_PREDICTION_ERROR_PX`. The
    prediction repeats a point's last step. If the last views are more than `_MAX_EXTRAPOLATION_S` apart, it is the last
    place.
    Returns the numbers, (n,), and the next free number.
    """
    track = np.full(len(centre), -1, dtype=np.intp)
    if views and len(centre) and len(views[-1].track):
        last = views[-1]
        expected = last.centre.copy()
        if len(views) > 1:
            _, before, now = np.intersect1d(views[-2].track, last.track, return_indices=True)
            step = last.centre[now] - views[-2].centre[before]
            expected[now] += step * (views[-1].stamp - views[-2].stamp < _MAX_EXTRAPOLATION_S)
        distance = distances(centre, expected)
        nearest = mutual_nearest(np.where(distance < _MAX_PREDICTION_ERROR_PX, distance, np.inf))
        same = nearest >= 0
        track[same] = last.track[nearest[same]]
    new = np.flatnonzero(track < 0)
    track[new] = next_track + np.arange(len(new))
    return track, next_track + len(new)


def still_while_two_turned(views: tuple[BufferedFrame, ...], tracker: Tracker) -> Array | None:
    """Places, (k, 2) px, of points that stayed while two others moved as the ball makes them move.

    None while there is no such pair. Two points on a ball that turns keep their angle; two that are carried past it
    keep their offset in the picture. Over a long path only one of the two holds.
    """
    now = views[-1]
    for view in views[:-1]:
        _, first, last = np.intersect1d(view.track, now.track, return_indices=True)
        path = np.linalg.norm(now.centre[last] - view.centre[first], axis=1)
        moved, still = path > _MIN_PATH * MOVED_PX, path < STILL_PX
        if np.count_nonzero(moved) != 2 or np.count_nonzero(still) > (view is views[0]):
            continue  # both kinds must be in view from the first frame: a later one passed by
        pair = view.points.take(first[moved]), now.points.take(last[moved])
        rotation = align(pair[0].direction, pair[1].direction)
        turned = pair[0].direction @ rotation.T - pair[1].direction
        variance = sum(_direction_variance(points, tracker.rig.ball.radius) for points in pair)
        as_turn = float(np.sum(np.sum(turned**2, axis=1) / variance))
        step = now.centre[last[moved]] - view.centre[first[moved]]
        as_shift = float(np.sum((step - step.mean(axis=0)) ** 2) / (2.0 * _CENTRE_SIGMA**2))
        if as_turn < _MAX_CHI2 and as_shift > as_turn + _MIN_CHI2_DIFFERENCE:
            index = last[still]
            return now.centre[index][would_move(now.points.take(index), rotation, tracker, MOVED_PX)]
    return None


def _direction_variance(points: SpherePoints, radius: float) -> Array:
    """Variance, (n,) rad², of a direction along one axis."""
    return np.trace(points.image_covariance, axis1=1, axis2=2) / (2.0 * radius**2)
