"""The detector of discs: in windows at their predicted places while the attitude is confirmed, else everywhere."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball import outline
from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.diagnosis import Absence, why_no_disc
from spheremouse.ball.detect.discs import DiscDetector, disc_detector
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.support import disc_support
from spheremouse.ball.detect.windows import Motion
from spheremouse.ball.detector import Words
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.colours import blurred_detector
from spheremouse.ball.phases.follow import SECURE
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame, Status

_WORDS = Words("disc", "discs", "discs", "{n} look-alike{s} masked", DiscMap.alteration, "no disc found on the ball")


@dataclass(frozen=True, slots=True)
class Discs:
    """Discs by their contrast, each with the covariance of its fit (`detect/discs.py`)."""

    words: Words = _WORDS
    map_type: type[BallMap] = DiscMap
    sees_discs: bool = True
    is_exact: bool = True
    uses_colours: bool = True
    keeps_state: bool = False

    def landmark_angle(self, rig: Rig) -> float:
        return rig.disc_angle

    def mark_radius(self, rig: Rig) -> float:
        assert rig.disc_radius is not None
        return rig.disc_radius

    def shared_errors(self, rig: Rig, pose: Pose) -> Array:
        return np.zeros((10, 10))

    def prepare(self, rig: Rig, pose: Pose, settings: Settings, before: object = None) -> Any:
        return disc_detector(settings.discs, rig, pose, before)

    def detect(
        self, state: TrackState, frame: Frame, tracker: Tracker, predicted: Any
    ) -> tuple[Detections, SearchState]:
        if not tracker.method.keeps_map:  # there is no place to look at
            return _detector(state, tracker).detect(frame.image), state.search
        return detect_discs(state, frame, tracker, predicted, tracker.filter.visible(predicted))

    def clear_points(self, points: int) -> int:
        return points

    def why_absent(self, image: Image, rig: Rig, pose: Pose, settings: Settings, known: bool) -> Absence:
        return why_no_disc(image, rig, pose, settings.discs)

    def support_mask(self, rig: Rig, pose: Pose, settings: Settings) -> Image:
        return disc_support(unmasked_detector(rig, pose, settings), clipped=True) | outline.support_mask(rig, pose)


def unmasked_detector(rig: Rig, pose: Pose, settings: Settings) -> DiscDetector:
    """Return the default detector for all of the ball."""
    return disc_detector(replace(settings.discs, masks=()), rig, pose)


def _detector(state: TrackState, tracker: Tracker) -> DiscDetector:
    """Return the detector for the colours and the blur of the camera."""
    return blurred_detector(state, tracker).with_projection(state.colours.projection)


def detect_discs(
    state: TrackState[So3State],
    frame: Frame,
    tracker: Tracker[So3Filter],
    predicted: So3State,
    which: NDArray[np.intp],
) -> tuple[Detections, SearchState]:
    """Return the disc candidates of a frame, and the state of the search. `which`, (k,), of the landmarks are in view.

    While the attitude is confirmed, the detector measures each disc of the map in a window at its predicted place, and
    searches a part of the rest of the ball. Until the ball turns, or if the detector sees too few of the discs of the
    frame before, it searches all of the ball.
    """
    detector = _detector(state, tracker)
    tracking, before = state.status is Status.TRACKING, state.search
    if not (tracking and state.known_to_turn):  # bolts, or another ball
        before = before._replace(size=0.0, contrast=0.0)
    if not tracking or not state.follows:
        return detector.detect(frame.image, before), before
    # Discs of the map, and candidates
    known = np.concatenate([predicted.discs[which], state.lookalikes.candidates.anchor_ball])
    seen_before = np.count_nonzero(predicted.missed[which] == 0)
    seen_enough = max(SECURE, (min(int(seen_before), len(state.filter.used)) + 1) // 2)
    least = seen_enough if state.known_to_turn else len(known) + 1
    motion = Motion(predicted.rate, tracker.rig.readout_s + predicted.readout, predicted.interval)
    found, search = detector.follow(
        frame.image, before, known @ predicted.attitude.T, motion, state.lookalikes.masks, least
    )
    if len(found) < least:
        learnt = search if state.known_to_turn else search._replace(size=0.0)  # bolts have a size, too
        found = found.joined_apart(detector.detect(frame.image, learnt), 0.5 * detector.model.diameter)
    return found, search
