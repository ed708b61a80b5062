"""Discs and the pattern between them in one update: anchors of the picture are points beside the discs.

The discs own the filter's state and its phases. The picture is learnt while they track the ball. Once it shows the
ball alone, its anchors join the map as landmarks. So errors that the frames share stay correlated.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.windows import DiscModel
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.discs import Discs, detect_discs
from spheremouse.ball.phases.method import SO3
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.texture.detect import detect_texture
from spheremouse.ball.texture.detector import Texture
from spheremouse.ball.texture.search import TextureDetector, TextureState
from spheremouse.ball.texture.view import anchor_directions
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, rotation_between
from spheremouse.tracker import Frame, Status

_TEXTURE = Texture()
_ANCHORS = anchor_directions()
_AT_ANCHOR = 0.02  # rad: a landmark so near to an anchor is that anchor
_SAME_FRAME = 0.02  # rad, between filter and picture, above which the discs have begun another map


class BothData(NamedTuple):
    """Constant data of both detectors."""

    discs: DiscDetector
    texture: TextureDetector

    @property
    def model(self) -> DiscModel:
        """Model of the discs."""
        return self.discs.model

    def with_lens_blur(self, sigma: float | None) -> DiscDetector:
        """Return the detector of discs for a lens that blurs with a standard deviation, px; None: one in focus."""
        return self.discs.with_lens_blur(sigma)

    def lens_blur(self, image: Image) -> float | None:
        """Return the standard deviation, px, of the lens's blur in an image; None without edges."""
        return self.discs.lens_blur(image)


class BothState(NamedTuple):
    """State of both detectors between frames."""

    discs: SearchState = SearchState()
    texture: TextureState | None = None

    @property
    def size(self) -> float:
        """Size of the discs, as `SearchState` has it."""
        return self.discs.size


@dataclass(frozen=True, slots=True)
class Both(Discs):
    """Discs, and parts of the pattern between them."""

    keeps_state: bool = True

    def prepare(self, rig: Rig, pose: Pose, settings: Settings, before: object = None) -> Any:
        of_discs = before.discs if isinstance(before, BothData) else None
        return BothData(Discs.prepare(self, rig, pose, settings, of_discs), _TEXTURE.prepare(rig, pose, settings))

    def detect(
        self, state: TrackState, frame: Frame, tracker: Tracker[So3Filter], predicted: Any
    ) -> tuple[Detections, Any]:
        """Return the discs of a frame and, once the picture shows the ball alone, the anchors; (n, 2) px."""
        data: BothData = tracker.detector_data
        before = state.search if isinstance(state.search, BothState) else BothState()
        which = tracker.filter.visible(predicted)
        which = which[~_is_anchor(predicted.discs[which])]
        of_discs = replace(tracker, detector_data=data.discs)
        found, search = detect_discs(state._replace(search=before.discs), frame, of_discs, predicted, which)
        if state.status is not Status.TRACKING:
            return found, BothState(search, before.texture if state.status is Status.LOST else None)
        of_texture = replace(tracker, detector_data=data.texture)
        texture = _same_frame_or_none(state, before.texture)
        points, after = detect_texture(state._replace(search=texture), frame, of_texture, predicted)
        if after.turned and state.known_to_turn:
            found = found.joined(points)
        return found, BothState(search, after)

    def support_mask(self, rig: Rig, pose: Pose, settings: Settings) -> Image:
        return Discs.support_mask(self, rig, pose, settings) | _TEXTURE.support_mask(rig, pose, settings)


def _is_anchor(directions: Array) -> NDArray[np.bool_]:
    """Return a mask, (n,), of the landmarks at `directions`, (n, 3) in ball, that are anchors."""
    return np.max(directions @ _ANCHORS.T, axis=1, initial=-1.0) > np.cos(_AT_ANCHOR)


def _same_frame_or_none(state: TrackState[So3State], texture: TextureState | None) -> TextureState | None:
    """Return the picture's state; None if its frame is not that of the filter any more."""
    if texture is None or texture.alignment is None or not state.confirmed:
        return texture
    apart = rotation_between(texture.alignment.attitude, state.filter.attitude)
    return texture if np.linalg.norm(apart) < _SAME_FRAME else None


def _to_map(state: TrackState[So3State]) -> DiscMap | None:
    """Return the map of discs to save, without anchors; None with fewer than four discs."""
    found = SO3.to_map(state)
    if not isinstance(found, DiscMap):
        return None
    keep = np.flatnonzero(~_is_anchor(found.directions))
    rows = (2 * keep[:, None] + np.arange(2)).ravel()
    covariance = found.covariance[np.ix_(rows, rows)]
    discs = replace(found, directions=found.directions[keep], covariance=covariance, sightings=found.sightings[keep])
    return discs if len(keep) >= 4 else None


BOTH = SO3._replace(to_map=_to_map)
