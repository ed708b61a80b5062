"""The known discs followed from one frame to the next, and new ones taken in."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.filters import FilterState
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State, augment
from spheremouse.ball.phases.recognise import recognised_attitude
from spheremouse.ball.points import SpherePoints
from spheremouse.ball.state import (
    Tracker,
    Tracking,
    TrackState,
)
from spheremouse.tracker import Frame

_POINT_SIGMA = 2e-3  # rad, of a seen direction: a tenth of a pixel on a ball 200 px across


def look(state: TrackState, frame: Frame, tracker: Tracker, predicted: FilterState) -> tuple[Detections, SearchState]:
    """The disc candidates of a frame, and the state of the search.

    While the attitude is confirmed, each disc of the map in a window of its own where it is predicted, and a part of
    the rest of the ball; the whole picture when that does not show enough of what was seen before.
    """
    detector = tracker.detector
    if not (
        isinstance(detector, DiscDetector)
        and isinstance(predicted, So3State)
        and isinstance(tracker.filter, So3Filter)
        and isinstance(state.phase, Tracking)
        and state.confirmed_at == state.filter.stamp
    ):
        return detector.detect(frame.image), state.search
    which = tracker.filter.visible(predicted)
    known = np.concatenate([predicted.discs[which], state.lookalikes.anchor_ball])  # discs, and what may be one
    readout = tracker.rig.readout_s + predicted.readout
    found, search = detector.follow(frame.image, known @ predicted.attitude.T, predicted.rate, readout, state.search)
    seen_before = np.count_nonzero(predicted.missed[which] == 0)
    if 2 * len(found) < min(seen_before, len(state.filter.used)):
        return detector.detect(frame.image), search
    near = np.concatenate([found.centre, state.lookalikes.masks])
    other, search = detector.find_new_discs(frame.image, search, near)
    return found.joined(other), search


def follow(state: TrackState, stamp: float, tracker: Tracker, predicted: FilterState) -> TrackState:
    """Filter the points; candidates that have moved with the ball may found discs."""
    points, centre = state.points, state.detections.centre[state.points.index]
    rig, pose, settings = tracker.rig, tracker.pose, tracker.settings.static
    proven = static.known_before_to_turn(state.lookalikes, centre, predicted.attitude, rig, pose, settings)
    posterior = tracker.filter.update(predicted, points, proven)
    confirmed = confirms(posterior, len(points), predicted, tracker)
    if confirmed and len(posterior.used) == len(points) and not len(state.lookalikes.place):
        return replace(state, filter=posterior, confirmed=True)
    state = replace(state, filter=posterior)
    other = np.ones(len(points), dtype=bool)
    if not confirmed:
        found = recognised_attitude(state, stamp, tracker)
        if found is not None:
            return replace(state, filter=found[0], confirmed=True)
        posterior = tracker.filter.update(predicted, points, np.zeros(len(points), dtype=bool))
        if not _known_well(posterior, tracker):  # no point has a place on the ball, and none founds a disc
            return replace(state, filter=posterior, confirmed=False)
    other[posterior.used] = False  # what belongs to a known disc needs no judgement
    turning, _, lookalikes = static.classify_candidates(
        state.lookalikes, centre[other], points.direction[other], posterior.attitude, stamp, rig, pose, settings
    )
    if not confirmed:  # a hand may have stopped the ball: what stands still says nothing, what goes on turning does
        lookalikes = replace(lookalikes, masks=state.lookalikes.masks, mask_seen=state.lookalikes.mask_seen)
    posterior = _with_discs(posterior, points, np.flatnonzero(other)[turning], tracker)
    if len(posterior.discs) > len(predicted.discs):
        lookalikes = static.without_landmarks(lookalikes, posterior.discs, rig.disc_radius / rig.ball.radius)
    return replace(state, filter=posterior, lookalikes=lookalikes, confirmed=confirmed)


def _known_well(filter_state: FilterState, tracker: Tracker) -> bool:
    """Is the attitude known so well that one disc tells the rest?"""
    worst = np.linalg.eigvalsh(filter_state.covariance[:3, :3])[-1]
    return bool(worst < tracker.settings.loss.known_sigma**2)


def _with_discs(
    filter_state: FilterState, points: SpherePoints, which: NDArray[np.intp], tracker: Tracker
) -> FilterState:
    """With those points that have just shown to turn with the ball as discs: the next frame may show no other."""
    if not isinstance(filter_state, So3State) or not isinstance(tracker.filter, So3Filter):
        return filter_state  # the published filters take a disc up when they see it again
    f = tracker.filter
    apart = np.cos(2.0 * f.disc_angle)  # two discs do not overlap: nearer to a known one it is that one, badly seen
    for k in which:
        known = filter_state.discs @ (points.direction[k] @ filter_state.attitude)
        if np.max(known, initial=-1.0) < apart and len(filter_state.discs) < f.settings.most_discs:
            filter_state = augment(filter_state, points, np.array([k]), f.radius)
    return filter_state


def confirms(posterior: FilterState, points: int, predicted: FilterState, tracker: Tracker) -> bool:
    """Does the last frame, with so many points, confirm the attitude?

    Two discs do, or one while it adds to what is known well; but only if chance does not explain them, since of many
    false candidates a few always fit; and only at a rate that a hand can give.
    """
    settings, used, rate = tracker.settings.loss, len(posterior.used), posterior.rate
    if used == 0 or float(rate @ rate) > settings.fastest**2:
        return False
    if 2 * used < points and not _significant(used, points, predicted, tracker):
        return False
    return used > 1 or _known_well(posterior, tracker)


def _significant(used: int, points: int, predicted: FilterState, tracker: Tracker) -> bool:
    """Would so many of the points meet a predicted disc by chance in less than one frame of a thousand?

    Each point lies in each disc's gate by chance with that gate's share of what the camera sees of the ball.
    """
    if not isinstance(predicted, So3State) or not isinstance(tracker.filter, So3Filter):
        return False  # the published filters gate by a length: half of the points must fit
    f = tracker.filter
    which = f.visible(predicted)
    areas = f.settings.gate * np.pi * (f.place_sigma(predicted, which) ** 2 + _POINT_SIGMA**2)
    chance = points * float(np.sum(areas)) / (2.0 * np.pi * (1.0 - f.horizon))  # pairs to be expected
    return bool(pdtrc(used - 1, chance) < 1e-3)
