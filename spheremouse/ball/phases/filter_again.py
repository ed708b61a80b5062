"""Filter the kept frames again, from the first one on, once they have shown look-alikes, rig or ball better."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.camera_state import facing
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.lookalikes import MOVED_PX, STILL_PX
from spheremouse.ball.filters.so3_camera import with_seen_centre
from spheremouse.ball.points import SpherePoints, intersect
from spheremouse.ball.state import BufferedFrame, F, OtherView, Tracker, TrackState
from spheremouse.geometry.camera import project
from spheremouse.geometry.matching import distances
from spheremouse.geometry.rotation import Array, rotation_between

# radii, or relative for the focal length: a shift that places a disc at the limb to a tenth of a pixel, to first order
_MAX_LINEAR_SHIFT = 0.005
_SAME_RIG = 1e-6  # relative, and m: with so small a difference, intersections are the same
_ITERATIONS = 3  # each leaves a tenth of the error
_AGREES = 16.3  # chi-square of a difference of attitudes: 3 degrees of freedom, 99.9 %


def filtered_with_its_rig(
    state: TrackState[F], still: Array, views: tuple[BufferedFrame, ...], tracker: Tracker
) -> TrackState[F]:
    """Return the state after filtering all views again with the rig that they showed, if it is another than assumed.

    The first views placed discs about a centre that was off. There the effect of a shift is not linear. So this is
    the Gauss-Newton iteration of a smoother over the views (Bell 1994). If a round turns the attitude by more than the
    shift explains, it has dropped views, and its result does not count.
    """
    assumed = views[0].points.rig_error
    for _ in range(_ITERATIONS):
        shown = state.filter.rig_error
        shift = relative_shift(shown - assumed, tracker)
        if shift < _MAX_LINEAR_SHIFT or state.filter.centre_noise > 0.0:
            break
        again = filtered_again(state, still, views, tracker)
        if np.linalg.norm(rotation_between(state.filter.attitude, again.filter.attitude)) > shift:
            break
        state, assumed = again, shown
    return state


def relative_shift(rig_error: Array, tracker: Tracker) -> float:
    """Return the length of a `rig_error`, (4,), in relative focal lengths and radii: about rad in the picture."""
    return float(np.linalg.norm(rig_error / np.array([1.0, *[tracker.rig.ball.radius] * 3])))


def filtered_with_others(
    state: TrackState[F],
    still: Array,
    views: tuple[BufferedFrame, ...],
    others: tuple[OtherView, ...],
    tracker: Tracker,
) -> TrackState[F]:
    """Return the state after filtering all views again with those of `others`, if they agree.

    The first attitude is the reference of all later ones. The more discs stand beside it, the smaller is the error that
    they have in common. The other views agree if they do not move the attitude by more than the covariance of this
    camera alone explains.
    """
    if not others:
        return state
    turn, together = state.filter.attitude @ views[0].attitude.T, state
    for camera in sorted({other.view.camera for other in others}):
        own = [other for other in others if other.view.camera == camera]
        (first, _), (last, their_tracker) = own[0], own[-1]
        stayed = distances(last.centre, first.centre).min(axis=1, initial=np.inf) < STILL_PX
        stayed &= would_move(last.points, turn, their_tracker, MOVED_PX)
        together = facing(together, camera)
        masked = static.mask(together.lookalikes, last.centre[stayed], last.stamp)
        together = together._replace(lookalikes=masked)
    together = filtered_again(facing(together, state.camera), still, views, tracker, others)
    off = rotation_between(state.filter.attitude, together.filter.attitude)
    agrees = off @ np.linalg.solve(state.filter.covariance[:3, :3], off) < _AGREES
    return together if together.confirmed and agrees else state


def filtered_again(
    state: TrackState[F],
    still: Array,
    views: tuple[BufferedFrame, ...],
    tracker: Tracker,
    others: tuple[OtherView, ...] = (),
) -> TrackState[F]:
    """Return the state after filtering all views again, without the look-alikes at `still`, (k, 2) px.

    `others` are views of other cameras; those that came before the first of `views` or with the last do not count.
    """
    stamp, camera = views[-1].stamp, state.camera
    state = state._replace(lookalikes=static.mask(state.lookalikes, still, stamp), alternatives=())
    start = tracker.filter.initial(views[0].stamp, views[0].attitude)
    filtered, assumed = start.with_reference_of(state.filter), {camera: state.filter.rig_error}
    if filtered.centre_noise == 0.0 and (assumed[camera] != start.rig_error).any():
        # the views showed this error, so as a prior it would count twice: it is only the point of linearisation
        filtered = filtered._replace(rig_error=start.rig_error)
    if state.centre.wrong_rig:
        filtered = tracker.filter.with_rig_uncertainty(filtered, state.outline.size_sigma)
    counted = [other for other in others if views[0].stamp <= other.view.stamp < stamp]
    ordered = sorted([*(OtherView(view, tracker) for view in views), *counted], key=lambda seen: seen.view.stamp)
    state = state._replace(filter=filtered)
    for k, (view, its_tracker) in enumerate(ordered):
        state = facing(state, view.camera)
        filtered = state.filter
        free, _ = static.unmasked(state.lookalikes, view.centre, view.stamp)
        points = view.points.take(free)
        known = assumed.setdefault(view.camera, filtered.rig_error)
        held = filtered.rig_error if filtered.centre_noise > 0.0 else known
        if np.abs(held - points.rig_error).max() > _SAME_RIG:
            points = intersect(view.detections, its_tracker.rig, its_tracker.pose, held, points.index)
        state = state._replace(points=points, detections=view.detections)
        predicted = its_tracker.filter.predict(filtered, view.stamp)
        if predicted.centre_noise > 0.0 and view.ball_centre is not None:
            seen = view.ball_centre
            predicted = with_seen_centre(predicted, seen.place, seen.axes, seen.covariance)
        state = its_tracker.method.update_all(state, view.stamp, its_tracker, predicted, views[:k])
        confirmed_at = view.stamp if state.confirmed else state.confirmed_at
        state = state._replace(confirmed_at=confirmed_at, shown_at=view.stamp)
    return state._replace(confirmed=not state.alternatives and len(state.filter.used) > 1)


def would_move(points: SpherePoints, rotation: Array, tracker: Tracker, least: float) -> NDArray[np.bool_]:
    """Return a mask, (n,), of the points that `rotation`, (3, 3), would have moved by `least` px or more."""
    radius, centre = tracker.rig.ball.radius, tracker.rig.ball.centre
    uv = [
        project(tracker.pose.to_cam(centre + radius * d), tracker.rig.camera)[0]
        for d in (points.direction, points.direction @ rotation)
    ]
    return np.linalg.norm(uv[0] - uv[1], axis=1) > least
