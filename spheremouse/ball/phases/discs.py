"""Detection of discs: in windows at their predicted places while the attitude is confirmed, else everywhere."""

from typing import Any

import numpy as np

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.windows import Motion
from spheremouse.ball.filters import FilterState
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.follow import SECURE
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.tracker import Frame, Status


def detect_everywhere(
    state: TrackState, frame: Frame, tracker: Tracker, predicted: FilterState
) -> tuple[Detections, SearchState]:
    """Return the disc candidates of the whole image, and the search as it was."""
    return tracker.detector.with_projection(state.colours.projection).detect(frame.image), state.search


def detect_discs(
    state: TrackState[So3State], frame: Frame, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[Detections, SearchState]:
    """Return the disc candidates of a frame, and the state of the search.

    While the attitude is confirmed, the detector measures each disc of the map in a window at its predicted place, and
    searches a part of the rest of the ball. Until the ball turns, or if the detector sees too few of the discs of the
    frame before, it searches all of the ball.
    """
    detector: Any = tracker.detector.with_projection(
        state.colours.projection
    )  # a DiscDetector, as `build` chose this method
    tracking, before = state.status is Status.TRACKING, state.search
    if not (tracking and state.known_to_turn):  # bolts, or another ball
        before = before._replace(size=0.0, contrast=0.0)
    if not tracking or state.confirmed_at != state.filter.stamp:
        return detector.detect(frame.image, before.contrast), before
    which = tracker.filter.visible(predicted)
    known = np.concatenate(
        [predicted.discs[which], state.lookalikes.candidates.anchor_ball]
    )  # discs, and what may be one
    seen_before = np.count_nonzero(predicted.missed[which] == 0)
    seen_enough = max(SECURE, (min(seen_before, len(state.filter.used)) + 1) // 2)
    least = seen_enough if state.known_to_turn else len(known) + 1
    motion = Motion(predicted.rate, tracker.rig.readout_s + predicted.readout)
    found, search = detector.follow(
        frame.image, before, known @ predicted.attitude.T, motion, state.lookalikes.masks, least
    )
    if len(found) < least:
        found = found.joined_apart(detector.detect(frame.image, search.contrast), 0.5 * detector.model.diameter)
    return found, search
