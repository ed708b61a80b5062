"""The ball's centre in its bearings, as its pattern shows it.

Across the line of sight, a shift of the centre looks like a turn in the middle of the ball, but not near its outline.
In a good bearing one frame of four shows that it stays. Once it has moved, each frame is resampled for the centre that
it shows, and the filter lets the centre move. The chart moves with it, but the masks of what stands still do not.
"""

import numpy as np

from spheremouse.ball.events import OutOfRound
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_camera import with_seen_centre
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.outline import SeenCentre
from spheremouse.ball.phases.bearing import (
    MAX_DRIFT,
    PROOF_ROTATION,
    Follow,
    interval,
    with_doubtful_map,
    with_evidence,
    with_learnt_noise,
    with_usual_place,
)
from spheremouse.ball.phases.seen_centre import with_doubtful_turn
from spheremouse.ball.state import CentreCheck, Events, Tracker, TrackState
from spheremouse.ball.texture.chart import IN_PLACE
from spheremouse.ball.texture.picture import Alignment, measure_shift
from spheremouse.ball.texture.search import TextureState
from spheremouse.ball.texture.view import TextureView
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array

_FRAMES = 4  # of which one is measured, beside those with unusual residuals
_TURN = 1  # number of that frame: the others have other tasks
_UNUSUAL_SCALE = 1.1  # times the usual residuals: a shift of the centre leaves some, and a hand does
# Mean squared Mahalanobis distance of the centre from its place. Most of the covariance is that of shading, which
# frames share. So films in good bearings have 0.1, and single frames of them at most 0.4.
_MAX_EVIDENCE = 1.0
_SIGNIFICANT_SIGMAS = 3.0  # of a displacement
_MIN_SHIFT_PX = 0.05  # of the ball's image: less shifts no detail


def image_shift(tracker: Tracker[So3Filter], centre: Array) -> Array:
    """Return the shift, (2,) px, of the image of a ball with its centre off its place by `centre`, (3,) m in obj.

    It is 0 if it is below a twentieth of a pixel.
    """
    if not centre.any():
        return IN_PLACE
    rig, pose = tracker.rig, tracker.pose
    at = np.stack([rig.ball.centre, rig.ball.centre + centre])
    place, moved = project(pose.to_cam(at), rig.camera)[0]
    return moved - place if float(np.abs(moved - place).max()) > _MIN_SHIFT_PX else IN_PLACE


def is_measured(now: TextureState, alignment: Alignment) -> bool:
    """Return whether the centre is measured in a frame: in one of four, and if the residuals are larger than usual."""
    return _is_regular(now) or alignment.scale > _UNUSUAL_SCALE * now.usual_scale


def _is_regular(now: TextureState) -> bool:
    return now.frame_index % _FRAMES == _TURN


def measure_centre(
    view: TextureView, now: TextureState, alignment: Alignment, predicted: So3State
) -> SeenCentre | None:
    """Return the ball's centre by a frame, relative to its place in the rig; None if too few pixels show it."""
    seen = measure_shift(view, now.fine.seen, now.fine.picture, alignment.attitude, now.noise)
    if not np.trace(seen.scatter) < view.rig.ball.radius**2:
        return None
    return seen._replace(place=seen.place + seen.axes.T @ predicted.centre)


def is_lifted(seen: SeenCentre, state: TrackState[So3State], tracker: Tracker[So3Filter]) -> bool:
    """Return whether the ball is significantly off its usual place, by more than half of the way of a lifted ball."""
    f = state.filter
    path = seen.place - seen.axes.T @ (state.centre.home + f.attitude @ f.eccentricity)
    far = float(path @ path) > (0.5 * tracker.settings.loss.lifted * tracker.rig.ball.radius) ** 2
    return far and _squared_mahalanobis(path, seen.covariance) > _SIGNIFICANT_SIGMAS**2


def update_check(
    check: CentreCheck, seen: SeenCentre, now: TextureState, predicted: So3State, dt: float
) -> CentreCheck:
    """Return the check of the bearing after a measured frame, `dt` s after the frame before.

    `predicted` is the filter's state predicted for the frame, with its own estimate of the centre.
    """
    path, covariance = _displacement(seen, predicted)
    dt = _FRAMES * dt if _is_regular(now) else dt
    check = check._replace(turned=check.turned + predicted.speed * dt)
    return with_evidence(check, _squared_mahalanobis(path, covariance), dt)


def has_moved(check: CentreCheck) -> bool:
    """Return whether the centre has left its place, as the frames of the last third of a second show."""
    return check.evidence > _MAX_EVIDENCE


def follow_in_bearings(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State, follow: Follow
) -> tuple[TrackState[So3State], Events]:
    """Filter a frame by `follow`. If the pattern shows that the centre has moved, correct the centre first.

    `stamp` is in s, and `predicted` is the filter's state predicted for it. Returns the state and its events: the
    centre has moved for the first time, or the ball is lost since it is lifted.
    """
    now, events = state.search, ()
    seen = now.shift
    if seen is None or now.searched:
        return follow(state, stamp, tracker, predicted), ()
    check, dt, moves = now.check, interval(state, stamp), predicted.centre_noise > 0.0
    if not moves:
        if not has_moved(check):
            return follow(state._replace(centre=check), stamp, tracker, predicted), ()
        events = () if check.moved else (OutOfRound(),)
        if check.turned < PROOF_ROTATION:
            predicted = with_doubtful_map(predicted, MAX_DRIFT)
    path, covariance = _displacement(seen, predicted)
    if not moves:
        check = CentreCheck(
            moved=True, turned=PROOF_ROTATION, home=check.home
        )  # the picture shows the ball in its place
        predicted = with_doubtful_turn(predicted, seen.axes @ path, tracker)
    jumps = not moves or _squared_mahalanobis(path, covariance) > _SIGNIFICANT_SIGMAS**2
    if jumps:
        predicted = tracker.filter.let_centre_move(predicted, seen.axes @ path)
    before, predicted = state, with_seen_centre(predicted, seen.place, seen.axes, seen.covariance)
    state = follow(state, stamp, tracker, predicted)
    if not jumps:
        state = with_learnt_noise(before, state, dt, tracker)
    state, more = with_usual_place(state._replace(centre=check), stamp, dt, tracker, predicted)
    return state, (*events, *more)


def _displacement(seen: SeenCentre, predicted: So3State) -> tuple[Array, Array]:
    """Return the way, (2,) m along the axes, from the predicted to the measured centre, and its covariance, (2, 2)."""
    covariance = seen.covariance + seen.axes.T @ predicted.centre_covariance @ seen.axes
    return seen.place - seen.axes.T @ predicted.centre, covariance


def _squared_mahalanobis(path: Array, covariance: Array) -> float:
    return float(path @ np.linalg.solve(covariance, path))
