"""The detector of a ball's pattern: the anchors of its picture are points."""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.appearance import clear_mask
from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.diagnosis import Absence, Cause, why_no_pattern
from spheremouse.ball.detect.support import dilate, with_noise_lines
from spheremouse.ball.detector import Words
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.texture.detect import TURNING, detect_texture
from spheremouse.ball.texture.picture import SHADING_PX, contrast_noise, contrast_of_samples, grain_of, plain_share
from spheremouse.ball.texture.picture_map import PictureMap
from spheremouse.ball.texture.search import TextureDetector, TextureState, texture_chart, texture_detector
from spheremouse.ball.texture.view import texture_pixel
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame

_ANCHOR_ANGLE = 0.1  # rad, of an anchor: they are six times as far apart
_MARK = 0.03  # radii
_BESIDE = 1  # px beside the ball, that interpolation may read with a weight too small to leave them out


_WORDS = Words(
    "part of the pattern",
    "parts of the pattern",
    "pattern",
    "what stands still is masked",
    PictureMap.alteration,
    "the ball is not followed",
)


@dataclass(frozen=True, slots=True)
class Texture:
    """Parts of a pattern, by the alignment of a frame with the picture of the ball."""

    words: Words = _WORDS
    map_type: type[BallMap] = PictureMap
    sees_discs: bool = False
    is_exact: bool = False
    uses_colours: bool = False
    keeps_state: bool = True

    def landmark_angle(self, rig: Rig) -> float:
        return _ANCHOR_ANGLE

    def mark_radius(self, rig: Rig) -> float:
        return _MARK * rig.ball.radius

    def shared_errors(self, rig: Rig, pose: Pose) -> Array:
        """Return the covariance, (10, 10) of pose and ball, that shading adds.

        Light that stands still shifts the contours of the pattern by about the same in each frame, as an error of the
        camera's rotation does.
        """
        towards = pose.position - rig.ball.centre
        towards = towards / np.linalg.norm(towards)
        along_sight = np.outer(towards, towards)
        focal, radius_px = max(rig.camera.intrinsic[:2]), 1.0 / texture_pixel(rig, pose)
        covariance = np.zeros((10, 10))
        covariance[3:6, 3:6] = SHADING_PX**2 * ((np.eye(3) - along_sight) / focal**2 + along_sight / radius_px**2)
        return covariance

    def prepare(self, rig: Rig, pose: Pose, settings: Settings, before: object = None) -> TextureDetector:
        return texture_detector(rig, pose, settings.discs.masks)

    def detect(
        self, state: TrackState[So3State], frame: Frame, tracker: Tracker[So3Filter], predicted: So3State
    ) -> tuple[Detections, TextureState]:
        return detect_texture(state, frame, tracker, predicted)

    def clear_points(self, points: int) -> int:
        return 0  # until the ball turns, they may be of what stands before it

    def why_absent(self, image: Image, rig: Rig, pose: Pose, settings: Settings, known: bool) -> Absence:
        absence = why_no_pattern(image, rig, pose, known)
        if absence.cause is not Cause.UNTURNED:
            return absence
        detector = self.prepare(rig, pose, settings)
        shown, light = detector.light(image)
        noise = contrast_noise(grain_of(detector.resampling, image), light)
        plain = plain_share(detector.fine, contrast_of_samples(detector.fine, shown[0]), noise)
        return replace(absence, cause=Cause.UNPATTERNED, plain=plain) if plain > 1.0 - TURNING else absence

    def support_mask(self, rig: Rig, pose: Pose, settings: Settings) -> Image:
        window = texture_chart(rig, pose)[1].window
        return with_noise_lines(dilate(clear_mask(rig, pose), _BESIDE), *window)
