"""Known discs updated by a frame of a ball that turns, and what it shows besides them told from look-alikes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.filters import FilterState
from spheremouse.ball.points import SpherePoints
from spheremouse.ball.state import F, Tracker, TrackState

_KNOWN_SIGMA = 0.02  # rad per axis, up to which one disc alone holds the attitude: half a disc's width

AddLandmarks = Callable[[F, SpherePoints, NDArray[np.intp], Tracker], F]  # the filter with some of the points as discs


def confirms(posterior: FilterState, points: int, predicted: FilterState, tracker: Tracker) -> bool:
    """Return whether the last frame, with so many points, confirms the attitude.

    Two discs do, or one while it adds to what is known well; but only if chance does not explain them, since of many
    false candidates a few always fit; and only at a rate that a hand can give.
    """
    settings, used, rate = tracker.settings.loss, len(posterior.used), posterior.rate
    if used == 0 or float(rate @ rate) > settings.fastest**2:
        return False
    if 2 * used < points and not tracker.filter.is_significant(predicted, used, points):
        return False
    return used > 1 or _known_well(posterior, tracker)


def updated(state: TrackState[F], tracker: Tracker, predicted: F) -> TrackState[F]:
    """Filter the points; candidates that were seen to move with the ball may found discs."""
    points, centre = state.points, state.detections.centre[state.points.index]
    proven = static.known_before_to_turn(state.lookalikes, centre, predicted.attitude, tracker.rig, tracker.pose)
    posterior = tracker.filter.update(predicted, points, proven)
    return replace(state, filter=posterior, confirmed=confirms(posterior, len(points), predicted, tracker))


def all_are_discs(state: TrackState) -> bool:
    """Return whether the frame confirms the attitude with every point, and no candidate is followed."""
    return state.confirmed and len(state.filter.used) == len(state.points) and not len(state.lookalikes.place)


def classify_unmatched(
    state: TrackState[F], stamp: float, tracker: Tracker, predicted: F, take_up: AddLandmarks[F]
) -> TrackState[F]:
    """Classify the points without a disc: they turn with the ball, stand still, or do neither yet."""
    points, centre, confirmed = state.points, state.detections.centre[state.points.index], state.confirmed
    rig, posterior = tracker.rig, state.filter
    if not confirmed and not _known_well(posterior, tracker):  # no point has a place on the ball
        return state
    other = np.ones(len(points), dtype=bool)
    other[posterior.used] = False  # what belongs to a known disc needs no judgement
    turning, _, lookalikes = static.classify_candidates(
        state.lookalikes,
        centre[other],
        points.direction[other],
        posterior.attitude,
        stamp,
        rig,
        tracker.pose,
    )
    if not confirmed:  # a hand may have stopped the ball, so only moving candidates count
        lookalikes = replace(lookalikes, masks=state.lookalikes.masks, mask_seen=state.lookalikes.mask_seen)
    posterior = take_up(posterior, points, np.flatnonzero(other)[turning], tracker)
    if len(posterior.discs) > len(predicted.discs):
        lookalikes = static.without_landmarks(lookalikes, posterior.discs, rig.disc_radius / rig.ball.radius)
    return replace(state, filter=posterior, lookalikes=lookalikes)


def _known_well(filter_state: FilterState, tracker: Tracker) -> bool:
    """Return whether the attitude is known so well that one disc gives the rest."""
    worst = np.linalg.eigvalsh(filter_state.covariance[:3, :3])[-1]
    return bool(worst < _KNOWN_SIGMA**2)
