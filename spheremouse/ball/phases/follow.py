"""Tracking of the known discs from frame to frame, and addition of new ones to the map.

A frame's points update the filter under every attitude that the discs leave possible. The map alone gives the attitude
if no prediction does. Points without a disc are discs if they turn with the ball, and look-alikes if they do not move.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import identify
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.filters import FilterState
from spheremouse.ball.filters.so3 import CandidatePoints, So3Filter, relocate
from spheremouse.ball.filters.so3_map import keep_candidates
from spheremouse.ball.filters.so3_mixture import Hypothesis, update_hypotheses
from spheremouse.ball.filters.so3_settings import DWELL_S
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import F, Tracker, TrackState, clear_matches, no_points
from spheremouse.geometry.matching import are_among
from spheremouse.geometry.rotation import rotation_between
from spheremouse.tracker import Status

_REST_RATE = 0.05  # rad/s, below which a ball brings no disc into view or out of it
SECURE = 3  # discs in use of which one may vanish: with fewer, all of the picture is searched for more
_JUMP_LEVEL = 16.0  # level of the player from which points pair by chance
_HIDDEN_BY_CHANCE = 2.0  # discs: struts hide so many, a cover on the ball hides more
_TURNING_RATE = 0.15  # rad/s, from which a disc may come into view with any frame
# log probability from which the most probable attitude counts as the only one
_CERTAIN_LOG_PROBABILITY = math.log(0.999)
_MAX_NEW_DISC_SIGMA_PX = static.TURNED_PART * static.MOVED_PX  # standard deviation of a point that may be a new disc
# probability that a ball turns about the one disc in view: the disc that stays is near the axis
_UNSEEN_TURN_PROBABILITY = 0.1
_MAX_KNOWN_SIGMA = 0.02  # rad per axis, up to which one disc alone holds the attitude: half a disc's width
IDENTIFY_SIGMA = 0.003  # rad, of a direction when the map is searched; at a tenth any disc may be any other
RISK = 1e-3  # probability of error up to which the map gives the attitude
_MIN_DIRECTION_SIGMA = 2e-4  # rad, least error of a direction: 0.1 mm on a ball of 1 m, the accuracy of its discs


def follow(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> TrackState[So3State]:
    """Filter the points; candidates that have moved with the ball become discs at once."""
    before, state = state, updated_hypotheses(state, stamp, tracker, predicted)
    if state.filter.stamp != stamp:
        return _beside_another(state, stamp, tracker, predicted)
    if state.filter.known_seen < SECURE and is_covered(state, predicted, tracker):
        return without_effect(before, tracker, predicted)
    if all_are_discs(state):
        return state
    if not state.confirmed:
        found = recognise_attitude(state._replace(filter=predicted), stamp, tracker)  # without its new landmarks
        if found is not None:
            return state._replace(filter=found[0], alternatives=(), confirmed=True, supported_at=stamp)
    if state.alternatives:  # the attitude by which candidates would be judged is in doubt
        return state
    lookalikes = static.with_places(state.lookalikes, state.filter.candidates, state.filter.places_of_candidates)
    state, seen = classify_unmatched(state._replace(lookalikes=lookalikes), stamp, tracker)
    # a point that has just shown to turn with the ball is a disc at once: the next frame may show no other
    return _with_candidates(state, seen, tracker)


def _beside_another(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> TrackState[So3State]:
    """Return the state after a frame that shows no disc of the map, while another camera confirms the attitude.

    Its points that turn with the ball become discs, so a camera takes part before the ball has turned the discs of the
    other into its view.
    """
    if not _known_well(predicted, tracker):
        return state
    at_frame = without_effect(state, tracker, predicted)
    lookalikes = static.with_places(state.lookalikes, predicted.candidates, predicted.places_of_candidates)
    at_frame, seen = classify_unmatched(at_frame._replace(lookalikes=lookalikes), stamp, tracker)
    return _with_candidates(at_frame, seen, tracker)


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
    Nothing joins unless the map may be extended, `extend_map`. A frame without certain pairs is not used if another
    camera has just confirmed the attitude, since a hand before one camera shows spots of its own.
    """
    points, centre, f = state.points, state.detections.centre[state.points.index], tracker.filter
    if proven is None:
        proven = static.known_before_to_turn(state.lookalikes, centre, predicted.attitude, tracker.rig, tracker.pose)
        if np.count_nonzero(proven):
            proven &= _is_clear(state)
    if not extend_map:
        proven = np.zeros_like(proven)
    turned_unseen = _turned_unseen(state, stamp, tracker, predicted)
    in_doubt = bool(state.alternatives) or turned_unseen is not None
    certain = None if in_doubt else f.update_if_certain(predicted, points, proven)
    if certain is not None:
        filtered, alternatives = certain, ()
    elif state.is_confirmed_by_another(stamp):
        return not_used(state)
    else:
        less = 0.0 if turned_unseen is None else math.log1p(-_UNSEEN_TURN_PROBABILITY)
        rest = [Hypothesis(f.predict(h.state, stamp), h.log_probability + less) for h in state.alternatives]
        if turned_unseen is not None:
            rest.append(Hypothesis(turned_unseen, math.log(_UNSEEN_TURN_PROBABILITY)))
        best = math.log1p(-sum(math.exp(h.log_probability) for h in rest))
        turned = rotation_between(state.reported_attitude, predicted.attitude)  # new discs come into view by that alone
        turns = predicted.speed > _TURNING_RATE
        has_turned = turns or float(turned @ turned) > (2.0 * f.disc_angle) ** 2
        needed = has_turned and extend_map
        hypotheses = update_hypotheses(f, (Hypothesis(predicted, best), *rest), points, proven, needed)
        filtered = hypotheses[0].state
        alternatives = () if hypotheses[0].log_probability > _CERTAIN_LOG_PROBABILITY else hypotheses[1:]
    confirmed = not alternatives and confirms(filtered, len(points), predicted, tracker)
    supported = confirmed or _supports(state, filtered, predicted, tracker)
    before = state.supported_at if state.supported_at < stamp else -np.inf  # a clock that starts again
    return state._replace(
        filter=filtered,
        alternatives=alternatives,
        supported_at=stamp if supported else before,
        paired_at=stamp if len(filtered.used) > 1 else state.paired_at,
        confirmed=confirmed,
    )


def _turned_unseen(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> So3State | None:
    """Return the prediction for a ball that has turned about the one disc in view, where no disc shows it; else None.

    A disc does not move if the ball turns about it, and the others leave the view. The next points can be discs that
    the ball has turned into view unseen. While nothing else is in view, there is nothing to choose.
    """
    if len(state.filter.used) != 1 or len(state.points) < 2:
        return None
    pairs = tracker.filter.nearest_pairs(predicted, state.points)
    if len(pairs.rows) != 1:
        return None
    duration = min(max(stamp - state.paired_at, 0.0), DWELL_S)
    return tracker.filter.with_unseen_turn(predicted, state.points.direction[pairs.rows[0]], duration)


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
    went_on = state.shown_at <= state.supported_at <= state.filter.stamp and before <= _HIDDEN_BY_CHANCE
    return went_on and filtered.is_roughly_known and missing <= _HIDDEN_BY_CHANCE


def is_covered(state: TrackState[So3State], predicted: So3State, tracker: Tracker[So3Filter]) -> bool:
    """Return whether something covers most of the established discs of a ball at rest, at a well-known attitude.

    The discs of a ball that begins to turn do not vanish, but those of a ball that turns leave the view. A jump that
    half of the discs contradict counts as a cover, too. If discs in their places are significant, the ball is not
    covered.
    """
    if not (predicted.is_placed and predicted.speed < _REST_RATE):
        return False
    filtered = state.filter
    jumped = filtered.manoeuvre_level >= _JUMP_LEVEL
    missing = filtered.known_missed
    most_missing = missing > 0.5 and missing + jumped > filtered.known_seen
    used = len(filtered.used)
    in_place = used > 0 and not jumped and tracker.filter.is_significant(predicted, used, len(state.points))
    return most_missing and not in_place


def not_used(state: TrackState[F]) -> TrackState[F]:
    """Return the state after a frame that the filter does not use. It stays at the time of the frame before."""
    return state._replace(filter=clear_matches(state.filter), confirmed=False)


def without_effect(state: TrackState[F], tracker: Tracker, predicted: Any) -> TrackState[F]:
    """Return the state without the points of a frame that `is_covered`, since they may lie on the cover."""
    filtered = tracker.filter.update(predicted, no_points(tracker))._replace(hidden=predicted.hidden)
    return state._replace(filter=filtered, alternatives=(), confirmed=False)


def recognise_attitude(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], risk: float = RISK
) -> tuple[So3State, int] | None:
    """Return the filter updated at the attitude that the map alone gives, and the number of discs that give it.

    Return None if the probability of an error exceeds `risk`. `identify` weighs all points, also those without a disc,
    so no further rule on their number is needed. `stamp` is in s.
    After a short gap the rate follows from the last confirmed attitude. After a long gap it is unknown.
    """
    points = state.points
    map_sigma = state.filter.map_sigma()
    placed = map_sigma < IDENTIFY_SIGMA  # the place of another disc is too uncertain to give the attitude
    if len(points) < 3 or np.count_nonzero(placed) < 3:
        return None
    noise = np.trace(points.image_covariance, axis1=1, axis2=2) / (2.0 * tracker.rig.ball.radius**2)
    least = math.sqrt(float(np.median(noise) + np.median(map_sigma[placed] ** 2)))  # errors of pose and ball add to it
    known = identify(
        points.direction,
        state.filter.discs[placed],
        sigma=IDENTIFY_SIGMA,
        view_axis=tracker.filter.station.towards,
        horizon=tracker.filter.station.horizon,
        risk=risk,
        min_sigma=min(max(least, _MIN_DIRECTION_SIGMA), IDENTIFY_SIGMA),
    )
    if known is None:
        return None
    gap = stamp - state.confirmed_at
    rate = None
    if state.status is Status.TRACKING and 0.0 < gap <= tracker.settings.loss.lost_after:
        rate = rotation_between(state.reported_attitude, known.rotation) / gap
    located = relocate(state.filter, known.rotation, IDENTIFY_SIGMA**2 * np.eye(3), tracker.settings.so3, stamp, rate)
    return tracker.filter.update(located, points, np.zeros(len(points), dtype=bool)), len(known.pairs)


def confirms(posterior: FilterState, points: int, predicted: FilterState, tracker: Tracker) -> bool:
    """Return whether the last frame, with so many points, confirms the attitude.

    Two discs confirm it, or one disc if the attitude is already well known. Chance must not explain these discs, since
    a few of many false candidates always fit. The rate must be one that a hand can produce.
    """
    used = len(posterior.used)
    if used == 0 or math.hypot(*posterior.rate.tolist()) > tracker.settings.loss.fastest:
        return False
    if 2 * used < points and not tracker.filter.is_significant(predicted, used, points):
        return False
    return used > 1 or _known_well(posterior, tracker)


def update_filter(state: TrackState[F], tracker: Tracker, predicted: F) -> TrackState[F]:
    """Return the state after the filter's update of `predicted` with the points, and whether they confirm it.

    Only candidates that earlier frames have proven to turn with the ball may start discs.
    """
    points, centre = state.points, state.detections.centre[state.points.index]
    proven = static.known_before_to_turn(state.lookalikes, centre, predicted.attitude, tracker.rig, tracker.pose)
    posterior = tracker.filter.update(predicted, points, proven)
    return state._replace(filter=posterior, confirmed=confirms(posterior, len(points), predicted, tracker))


def all_are_discs(state: TrackState) -> bool:
    """Return whether the frame confirms the attitude with every point, and no candidate is followed."""
    return (
        state.confirmed and len(state.filter.used) == len(state.points) and not len(state.lookalikes.candidates.place)
    )


def classify_unmatched(state: TrackState[F], stamp: float, tracker: Tracker) -> tuple[TrackState[F], CandidatePoints]:
    """Classify the points without a disc: turning with the ball, static, or undecided. Return those that may be discs.

    If the attitude is neither confirmed nor known well, no point has a place on the ball, and none is classified.
    """
    points, centre, confirmed = state.points, state.detections.centre[state.points.index], state.confirmed
    if not confirmed and not _known_well(state.filter, tracker):
        none = np.zeros(0, dtype=np.intp)
        return state, CandidatePoints(none, none, np.zeros(0, dtype=np.bool_))
    other = np.ones(len(points), dtype=bool)
    other[state.filter.used] = False  # points of known discs need no classification
    turning, still, number, lookalikes = static.classify_candidates(
        state.lookalikes,
        centre[other],
        points.direction[other],
        state.filter.attitude,
        stamp,
        tracker.rig,
        tracker.pose,
    )
    if not confirmed:  # a hand may have stopped the ball, so only moving candidates count
        lookalikes = replace(lookalikes, masks=state.lookalikes.masks, mask_seen=state.lookalikes.mask_seen)
    new = ~still & _is_clear(state)[other]
    seen = CandidatePoints(np.flatnonzero(other)[new], number[new], turning[new])
    return state._replace(lookalikes=lookalikes), seen


def _is_clear(state: TrackState) -> NDArray[np.bool_]:
    """Return a mask, (n,), of the points that are known well enough for a place on the map.

    The limb, or a cover beside a disc, shifts its centre in the same way in each frame. So further sightings neither
    reveal nor reduce such an error. If it may be larger than the path that proves a candidate allows, it proves none.
    """
    covariance = state.detections.covariance[state.points.index]
    return covariance[:, 0, 0] + covariance[:, 1, 1] < 2.0 * _MAX_NEW_DISC_SIGMA_PX**2


def _with_candidates(
    state: TrackState[So3State], seen: CandidatePoints, tracker: Tracker[So3Filter]
) -> TrackState[So3State]:
    """Return the state with a frame's candidates: those that turn with the ball are discs."""
    filtered, lookalikes = tracker.filter.follow_candidates(state.filter, state.points, seen), state.lookalikes
    refused = seen.numbers[seen.turning & are_among(seen.numbers, filtered.candidates)]  # they turned elsewhere
    if len(filtered.discs) > len(state.filter.discs):
        lookalikes = static.without_landmarks(lookalikes, filtered.discs, tracker.filter.disc_angle)
    lookalikes = static.without_candidates(lookalikes, refused)
    others = [static.recent(other.lookalikes, state.filter.stamp) for other in state.others]
    filtered = keep_candidates(filtered, np.concatenate([lookalikes.candidates.number, *others]))
    return state._replace(filter=filtered, lookalikes=lookalikes)


def _known_well(filter_state: FilterState, tracker: Tracker) -> bool:
    """Return whether the attitude is known so well that one disc suffices to confirm it."""
    worst = np.linalg.eigvalsh(filter_state.covariance[:3, :3])[-1]
    return bool(worst < _MAX_KNOWN_SIGMA**2)
