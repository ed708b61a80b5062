"""The known discs followed from one frame to the next, and new ones taken in."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State, augment
from spheremouse.ball.phases.candidates import all_are_discs, classify_unmatched
from spheremouse.ball.phases.colours import seen_in
from spheremouse.ball.phases.hypotheses import is_covered, updated_hypotheses, without_effect
from spheremouse.ball.phases.recognise import recognised_attitude
from spheremouse.ball.points import SpherePoints
from spheremouse.ball.state import Tracker, Tracking, TrackState
from spheremouse.tracker import Frame

_AT_REST = 0.05  # rad/s, below which a ball brings no disc into view or out of it
_SECURE = 3  # discs in use of which one may vanish: with fewer, all of the picture is searched for more


def detect_discs(
    state: TrackState[So3State], frame: Frame, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[Detections, SearchState]:
    """The disc candidates of a frame, and the state of the search.

    While the attitude is confirmed, each disc of the map in a window of its own where it is predicted, and a part of
    the rest of the ball; the whole picture when that does not show enough of what was seen before.
    """
    detector = seen_in(tracker.detector, state.colours)
    if not (
        isinstance(detector, DiscDetector)
        and isinstance(state.phase, Tracking)
        and state.confirmed_at == state.filter.stamp
    ):
        return detector.detect(frame.image), state.search
    which = tracker.filter.visible(predicted)
    known = np.concatenate([predicted.discs[which], state.lookalikes.anchor_ball])  # discs, and what may be one
    readout = tracker.rig.readout_s + predicted.readout
    found, search = detector.follow(frame.image, known @ predicted.attitude.T, predicted.rate, readout, state.search)
    seen_before = np.count_nonzero(predicted.missed[which] == 0)
    if len(found) < _SECURE or 2 * len(found) < min(seen_before, len(state.filter.used)):
        return detector.detect(frame.image), search
    near = np.concatenate([found.centre, state.lookalikes.masks])
    other, search = detector.find_new_discs(frame.image, search, near)
    return found.joined(other), search


def follow(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter], predicted: So3State
) -> TrackState[So3State]:
    """Filter the points; candidates that have moved with the ball become discs at once."""
    before, state = state, updated_hypotheses(state, stamp, tracker, predicted)
    rests = np.linalg.norm(predicted.rate) < _AT_REST
    if rests and state.filter.known_seen < _SECURE and is_covered(state, predicted, tracker):
        return without_effect(before, tracker, predicted)  # the discs of a ball that begins to turn do not vanish
    if all_are_discs(state):
        return state
    if not state.confirmed:
        found = recognised_attitude(replace(state, filter=predicted), stamp, tracker)  # without its new landmarks
        if found is not None:
            return replace(state, filter=found[0], alternatives=(), confirmed=True, supported_at=stamp)
    if state.alternatives:  # the attitude by which candidates would be judged is in doubt
        return state
    return classify_unmatched(state, stamp, tracker, predicted, _with_discs)


def _with_discs(
    filter_state: So3State, points: SpherePoints, which: NDArray[np.intp], tracker: Tracker[So3Filter]
) -> So3State:
    """With those points that have just shown to turn with the ball as discs: the next frame may show no other."""
    f = tracker.filter
    apart = np.cos(2.0 * f.disc_angle)  # two discs do not overlap: nearer to a known one it is that one, badly seen
    for k in which:
        known = filter_state.discs @ (points.direction[k] @ filter_state.attitude)
        if np.max(known, initial=-1.0) < apart and len(filter_state.discs) < f.settings.most_discs:
            filter_state = augment(filter_state, points, np.array([k]), f.radius)
    return filter_state
