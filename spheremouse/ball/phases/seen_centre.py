"""The ball's centre by its outline: when it is measured, whether it has moved, and how the filter uses it.

The outline is measured in the first frame, while the ball first turns, if discs cause a doubt or are few, and while the
centre moves. Shading shifts the outline by about the same in each frame. So its first place counts as that of the rig's
centre, unless the centre moved before it proved its place.
"""

from dataclasses import replace

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.events import WrongSize
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_camera import with_seen_centre, with_uncertain_turn
from spheremouse.ball.filters.so3_state import ECCENTRICITY, So3State
from spheremouse.ball.outline import seen_ball, seen_centre
from spheremouse.ball.state import Events, OutlineCheck, Tracker, TrackState
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status

LARGE_NIS = 3.0  # for each disc, of two expected: more may be a shift
RESTS = 0.05  # rad/s, below which a ball rests and shows nothing new
_CERTAIN_SIGMAS = 3.0  # of the outline's radius
_FEW_DISCS = 5  # in use: with fewer, a shift looks like a turn
_INTERVAL_S = 0.05  # between outlines with few discs: a ball that sinks within 0.2 s has not gone half of its way
_WATCHED = 1.0  # rad, first turn with an outline in each frame: it shows whether the bearings are worn
_DOUBTFUL = 1.0  # standard deviations², mean by the discs, from which the outline is measured
_MOVED_SIGMAS = 5.0  # of the way of an outline


def with_first_outline(
    state: TrackState[So3State], image: Image, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Return the state before the first frame at a pose, `image`, with the place that the ball's outline shows.

    The first frame of each camera also shows the radius. If that differs from the rig's by more than three standard
    deviations, one of them is wrong: the outline may be that of an opening before the ball. So the filter takes the
    outline's radius, with a standard deviation as large as the difference. Then the outline does not show how near the
    ball is. A lost ball has no first frame.
    """
    if state.status is Status.LOST:
        return state, ()
    ball = seen_ball(image, tracker.rig, tracker.pose)
    if ball is None:
        return state._replace(outline=OutlineCheck(begun=True)), ()
    confirms = abs(ball.size_error) < _CERTAIN_SIGMAS * ball.sigma
    size_sigma = max(ball.sigma, abs(ball.size_error)) if confirms else np.inf
    seen = ball.centre if confirms else ball.centre.across
    first = seen if state.filter.centre_noise == 0.0 else None
    check = OutlineCheck(begun=True, seen=seen, first=first, trust=ball.trust, size_sigma=size_sigma)
    state = state._replace(outline=check._replace(attitude=state.filter.attitude))
    if confirms or state.rebuilt is not None:
        return state, ()
    stage = replace(tracker.filter, station=replace(tracker.filter.station, size_error=ball.size_error))
    state = state._replace(filter=stage.with_station(state.filter), rebuilt=replace(tracker, filter=stage))
    return state, (WrongSize(ball.size_error),)


def with_outline(
    state: TrackState[So3State], predicted: So3State, image: Image, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], So3State]:
    """Return state and prediction after the outline of a frame, if this one is to be measured.

    While the centre moves, the outline corrects the prediction. Otherwise it is only compared with the first one.
    """
    check, moves = state.outline, predicted.centre_noise > 0.0
    if not (moves or _is_due(state, predicted.stamp)):
        return (state if check.seen is None else state._replace(outline=check._replace(seen=None))), predicted
    seen = seen_centre(image, tracker.rig, tracker.pose, tracker.rig.ball.centre + predicted.centre, check.trust)
    if seen is not None and check.size_sigma == np.inf:
        seen = seen.across
    turned = state.filter.speed * max(predicted.stamp - state.filter.stamp, 0.0)
    check = check._replace(seen=seen, measured=predicted.stamp, watched=check.watched + turned)
    if moves:
        return state._replace(outline=check), correct_by_outline(predicted, check)
    return state._replace(outline=_compared_with_first(check, predicted)), predicted


def _is_due(state: TrackState[So3State], stamp: float) -> bool:
    """Return whether the outline must be measured while the centre is in its place."""
    check, used = state.outline, len(state.filter.used)
    if state.status is Status.LOST:
        return False
    if check.away > 0 or state.centre.evidence > _DOUBTFUL or state.filter.nis > LARGE_NIS * used:
        return True
    again = not 0.0 <= stamp - check.measured < _INTERVAL_S
    return state.filter.speed > RESTS and (check.watched < _WATCHED or (again and used < _FEW_DISCS))


def correct_by_outline(predicted: So3State, check: OutlineCheck) -> So3State:
    """Return the state corrected by the centre of the outline in the last frame, if it was measured."""
    seen, first = check.seen, check.first
    if seen is None:
        return predicted
    if first is None:
        return with_seen_centre(predicted, seen.place, seen.axes, seen.covariance)
    covariance = seen.scatter + first.scatter
    return with_seen_centre(predicted, seen.place - first.place, seen.axes, covariance, check.attitude)


def with_doubtful_turn(state: So3State, shift: Array, tracker: Tracker[So3Filter]) -> So3State:
    """Return the state with the turn as uncertain that a `shift` of the centre, (3,) m in obj, looked like."""
    return with_uncertain_turn(state, np.cross(tracker.filter.station.towards, shift / tracker.rig.ball.radius))


def _compared_with_first(check: OutlineCheck, predicted: So3State) -> OutlineCheck:
    """Return the check with `away` and `drift` by the way of the outline from its place in the first frame.

    The way that an eccentric ball makes as it turns does not count. Nor does the way along the line of sight, since a
    lens that focuses makes the ball look nearer.
    """
    if check.seen is None or check.first is None:
        return check
    seen, first = check.seen.across, check.first.across
    turned = seen.axes.T @ (predicted.attitude - check.attitude)
    step = seen.place - first.place - turned @ predicted.eccentricity
    covariance = seen.covariance + first.scatter + turned @ predicted.joint[ECCENTRICITY, ECCENTRICITY] @ turned.T
    if float(step @ np.linalg.solve(covariance, step)) > _MOVED_SIGMAS**2:
        return check._replace(away=check.away + 1)
    return check._replace(away=0, drift=max(check.drift, float(np.linalg.norm(step))))
