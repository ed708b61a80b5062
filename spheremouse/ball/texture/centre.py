"""The ball's centre in its bearings, as its pattern shows it.

Across the line of sight, a shift of the centre looks like a turn in the middle of the ball, but not near its outline.
In a good bearing one frame of four shows that it stays. Once it has moved, each frame is resampled for the centre that
it shows, and the filter lets the centre move.
"""

import numpy as np

from spheremouse.ball.events import OutOfRound
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State, with_seen_centre
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
from spheremouse.ball.texture.picture import Alignment, TextureView, seen_shift
from spheremouse.ball.texture.search import TextureState
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array

_FRAMES = 4  # of which one shows whether the centre stays
_UNUSUAL_SCALE = 1.1  # times the usual residuals: a shift of the centre leaves some, and a hand does
# mean squared Mahalanobis distance of the centre from its place; in it, frames do not share errors and show a quarter
_MAX_EVIDENCE = 1.0
_SHIFTED_SIGMAS = 3.0  # of a shift, from which it is no error
_MIN_SHIFT_PX = 0.05  # of the ball's image in its bearings: less shifts no detail


def image_shift(tracker: Tracker[So3Filter], centre: Array) -> Array:
    """Return by how much, (2,) px, the image of a ball is off its place that is off by `centre`, (3,) m in obj."""
    if not centre.any():
        return IN_PLACE
    rig, pose = tracker.rig, tracker.pose
    at = np.stack([rig.ball.centre, rig.ball.centre + centre])
    place, moved = project(pose.to_cam(at), rig.camera)[0]
    return moved - place if float(np.abs(moved - place).max()) > _MIN_SHIFT_PX else IN_PLACE


def is_due(now: TextureState, alignment: Alignment) -> bool:
    """Return whether a frame is to show the centre: its residuals are larger than usual, or its turn has come."""
    return now.frame_index % _FRAMES == 1 or alignment.scale > _UNUSUAL_SCALE * now.usual_scale


def centre_in_frame(view: TextureView, now: TextureState, alignment: Alignment, predicted: So3State) -> SeenCentre:
    """Return the ball's centre by a frame, relative to its place in the rig."""
    seen = seen_shift(view, now.fine.seen, now.fine.picture, alignment.attitude, now.noise)
    return seen._replace(place=seen.place + seen.axes.T @ predicted.centre)


def is_lifted(centre: SeenCentre, tracker: Tracker[So3Filter]) -> bool:
    """Return whether the ball is significantly off its bearings."""
    far = float(centre.place @ centre.place) > (0.5 * tracker.settings.loss.lifted * tracker.rig.ball.radius) ** 2
    return far and centre.squared_mahalanobis > _SHIFTED_SIGMAS**2


def with_centre_seen(state: TrackState[So3State], seen: SeenCentre, stamp: float) -> CentreCheck:
    """Return the check of the bearing after a frame that shows the centre, as one in `_FRAMES` does."""
    return with_evidence(state.centre, seen.squared_mahalanobis, _FRAMES * interval(state, stamp))


def has_moved(check: CentreCheck) -> bool:
    """Return whether the centre has left its place, as frames of late show."""
    return check.evidence > _MAX_EVIDENCE


def follow_in_bearings(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State, follow: Follow
) -> tuple[TrackState[So3State], Events]:
    """Return the state and the events after an update, by `follow`, and with the centre that the pattern shows.

    In a good bearing the centre stays in its place, and the filter does not take it from the frame.
    """
    seen, check, events = state.search.shift, state.centre, ()
    if seen is None or state.search.searched:
        return follow(state, stamp, tracker, predicted), ()
    dt = interval(state, stamp)
    path = seen.place - seen.axes.T @ predicted.centre
    if predicted.centre_noise == 0.0:
        check = with_centre_seen(state, seen, stamp)
        if not has_moved(check):
            rate = float(np.linalg.norm(state.filter.rate))
            check = check._replace(turned=check.turned + _FRAMES * dt * rate)
            return follow(state._replace(centre=check), stamp, tracker, predicted), ()
        events = () if check.moved else (OutOfRound(),)
        if check.turned < PROOF_ROTATION:
            predicted = with_doubtful_map(predicted, MAX_DRIFT)
        check = CentreCheck(moved=True, turned=PROOF_ROTATION, home=check.home)
        predicted = with_doubtful_turn(predicted, seen.axes @ path, tracker)
    far = float(path @ np.linalg.solve(seen.covariance, path)) > _SHIFTED_SIGMAS**2
    if far or predicted.centre_noise == 0.0:
        predicted = tracker.filter.let_centre_move(predicted, seen.axes @ path)
    before, predicted = state, with_seen_centre(predicted, seen.place, seen.axes, seen.covariance)
    state = follow(state, stamp, tracker, predicted)
    state = with_learnt_noise(before, state, dt, tracker)
    state, more = with_usual_place(state._replace(centre=check), stamp, dt, tracker, predicted)
    return state, (*events, *more)
