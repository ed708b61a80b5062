"""The method of tracking of the published filters `ekf1` and `ekf2` (Wittich 2017, section 3.5).

The separation of look-alikes from discs is the same as for any filter. These filters keep no map: they delete a disc
that one frame does not show. A lost ball starts at its last attitude. The method does not detect a lifted ball, a moved
camera or a rolling shutter.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.support import disc_support
from spheremouse.ball.phases.discs import Discs, unmasked_detector
from spheremouse.ball.phases.follow import all_are_discs, classify_unmatched, confirms, update_filter
from spheremouse.ball.phases.learn import learn
from spheremouse.ball.phases.recover import seen_since, start_new_map
from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.published.euler import EulerState
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Events, Learning, Lost, Method, Recognising, Tracker, Tracking, TrackState
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame

State = TrackState[EulerState]


@dataclass(frozen=True, slots=True)
class Blobs(Discs):
    """Discs by grey-value masks: their centres are off by more than their covariance (`blobs.py`)."""

    is_exact: bool = False
    uses_colours: bool = False

    def prepare(self, rig: Rig, pose: Pose, settings: Settings, before: object = None) -> Any:
        return BlobDetector(settings.blobs)

    def detect(
        self, state: TrackState, frame: Frame, tracker: Tracker, predicted: Any
    ) -> tuple[Detections, SearchState]:
        return tracker.detector_data.detect(frame.image), state.search

    def support_mask(self, rig: Rig, pose: Pose, settings: Settings) -> Image:
        return disc_support(unmasked_detector(rig, pose, settings), clipped=False)


def _next_phase(state: State, stamp: float, tracker: Tracker, predicted: EulerState) -> tuple[State, Events]:
    """Return the state after the points of a frame, and the events."""
    match state.phase:
        case Learning():
            return learn(state, state.phase, stamp, tracker, predicted)
        case Tracking():
            return _follow(state, stamp, tracker, predicted), ()
        case Lost():
            phase = seen_since(state.phase, len(state.points), stamp)
            state = state._replace(phase=phase)
            return (state, ()) if phase.in_view_since is None else start_new_map(state, stamp, tracker)
        case Recognising():
            raise AssertionError("no map, nothing to recognise")


def _follow(state: State, stamp: float, tracker: Tracker, predicted: EulerState) -> State:
    """Return the state after an update. A candidate that moved with the ball becomes a disc at its next sighting."""
    state = update_filter(state, tracker, predicted)
    if all_are_discs(state):
        return state
    if not state.confirmed:  # then no point starts a landmark
        none = np.zeros(len(state.points), dtype=bool)
        state = state._replace(filter=tracker.filter.update(predicted, state.points, none))
    return classify_unmatched(state, stamp, tracker)[0]


def _at_new_pose(state: State, tracker: Tracker, added: Array | None) -> EulerState:
    """Return the filter's state at a new pose: a new start if only image positions of candidates are known."""
    if state.known_to_turn:
        return state.filter
    return tracker.filter.initial(state.filter.stamp, state.filter.attitude).with_reference_of(state.filter)


def _update_all(state: State, stamp: float, tracker: Tracker, predicted: EulerState, views: object) -> State:
    """Return the state after filtering a frame with every point as a possible disc."""
    filtered = tracker.filter.update(predicted, state.points)
    return state._replace(filter=filtered, confirmed=confirms(filtered, len(state.points), predicted, tracker))


PUBLISHED = Method(
    keeps_map=False,
    to_map=lambda _: None,
    recall=lambda state, _: state,
    next_phase=_next_phase,
    at_new_pose=_at_new_pose,
    update_all=_update_all,
    is_covered=lambda *_: False,
)
