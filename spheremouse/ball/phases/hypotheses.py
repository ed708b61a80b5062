"""Update of the filter by a frame, under every attitude that the discs in view leave possible."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_mixture import Hypothesis, update_hypotheses
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.candidates import confirms
from spheremouse.ball.state import F, Tracker, TrackState, no_points
from spheremouse.geometry.rotation import rotation_between

_JUMP = 16.0  # level of the player from which points pair by chance
_HIDDEN_BY_CHANCE = 2.0  # discs: struts hide so many, something that covers the ball hides more
_TURNS = 0.15  # rad/s, from which a disc may come into view with any frame
_CERTAIN = math.log(0.999)  # log probability from which the most probable attitude is taken for the only one


def updated_hypotheses(
    state: TrackState[So3State],
    stamp: float,
    tracker: Tracker[So3Filter],
    predicted: So3State,
    *,
    proven: NDArray[np.bool_] | None = None,
    extend_map: bool = True,
) -> TrackState[So3State]:
    """Filter the points under every attitude that is possible; `predicted` is the most probable one.

    Points that are `proven` (n,) to turn with the ball may join the map; None: those that earlier frames have proven.
    Nothing joins unless the map may be extended, `extend_map`.
    """
    points, centre, f = state.points, state.detections.centre[state.points.index], tracker.filter
    if proven is None:
        proven = static.known_before_to_turn(state.lookalikes, centre, predicted.attitude, tracker.rig, tracker.pose)
    certain = None if state.alternatives else f.update_if_certain(predicted, points, proven & extend_map)
    if certain is not None:
        filtered, alternatives = certain, ()
    else:
        rest = tuple(Hypothesis(f.predict(h.state, stamp), h.log_probability) for h in state.alternatives)
        best = math.log1p(-sum(math.exp(h.log_probability) for h in rest))
        turned = rotation_between(state.reported_attitude, predicted.attitude)  # new discs come into view by that alone
        turns = float(predicted.rate @ predicted.rate) > _TURNS**2
        has_turned = turns or float(turned @ turned) > (2.0 * f.disc_angle) ** 2
        hypotheses = update_hypotheses(f, (Hypothesis(predicted, best), *rest), points, proven, has_turned, extend_map)
        filtered = hypotheses[0].state
        alternatives = () if hypotheses[0].log_probability > _CERTAIN else hypotheses[1:]
    confirmed = not alternatives and confirms(filtered, len(points), predicted, tracker)
    supported = confirmed or _supports(state, filtered, predicted, tracker)
    before = state.supported_at if state.supported_at < stamp else -np.inf  # a clock that starts again
    return replace(
        state,
        filter=filtered,
        alternatives=alternatives,
        supported_at=stamp if supported else before,
        confirmed=confirmed,
    )


def _supports(
    state: TrackState[So3State], filtered: So3State, predicted: So3State, tracker: Tracker[So3Filter]
) -> bool:
    """Return whether a frame agrees with the places of the discs on the map; `state` has its points.

    A frame that shows discs agrees if it shows as many as it hides. A frame that shows none agrees if at most two are
    expected in view and no more than two were seen before: more do not vanish at once.
    """
    used, before = len(filtered.used), len(state.filter.used)
    missing = filtered.known_missed
    if used > 0:
        points = len(state.points)
        by_chance = 2 * used < points and not tracker.filter.is_significant(predicted, used, points)
        return missing <= max(used, _HIDDEN_BY_CHANCE) and not by_chance
    went_on = state.supported_at == state.filter.stamp and before <= _HIDDEN_BY_CHANCE
    return went_on and filtered.is_roughly_known and missing <= _HIDDEN_BY_CHANCE


def is_covered(state: TrackState[F], predicted: F, tracker: Tracker) -> bool:
    """Return whether something lies before most of the established discs, whose places are well known.

    A jump that half of them contradict is no better. Discs in their places that are not there by chance still count.
    """
    filtered = state.filter
    if not isinstance(filtered, So3State) or not isinstance(predicted, So3State):
        return False
    jumped = filtered.manoeuvre_level >= _JUMP
    missing = filtered.known_missed
    most_missing = missing > 0.5 and missing + jumped > filtered.known_seen
    used = len(filtered.used)
    in_place = used > 0 and not jumped and tracker.filter.is_significant(predicted, used, len(state.points))
    return most_missing and predicted.is_placed and not in_place


def without_effect(state: TrackState[F], tracker: Tracker, predicted: F) -> TrackState[F]:
    """Return the state without the frame: something lies before most discs, and its spots may be in view."""
    filtered = tracker.filter.update(predicted, no_points(tracker))
    if isinstance(filtered, So3State) and isinstance(predicted, So3State):
        filtered = replace(filtered, hidden=predicted.hidden)
    return replace(state, filter=filtered, alternatives=(), confirmed=False)
