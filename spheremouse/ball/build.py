"""Construction of a tracker from a device, a pose and settings, and of its state before the first frame."""

from typing import Any

import numpy as np

from spheremouse.ball import camera_watch as watching
from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.detections import no_detections
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.detect.projection import GREY
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters import Filter
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.phases.method import SO3, SO3_WITH_BLOBS
from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.published.euler import ConstantDiscsFilter, StateDiscsFilter
from spheremouse.ball.published.method import PUBLISHED
from spheremouse.ball.rig import Rig, considered_covariance
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import (
    Colours,
    Detector,
    Learning,
    Tracker,
    TrackState,
    no_points,
)
from spheremouse.ball.texture.method import TEXTURE, shading_covariance
from spheremouse.ball.texture.picture_map import PictureMap
from spheremouse.ball.texture.search import texture_detector
from spheremouse.errors import ConfigurationError, PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array

_ANCHOR_ANGLE = 0.1  # rad, of a texture's anchors: they are six times as far apart


def check_discs(rig: Rig, settings: Settings) -> None:
    """Raise ConfigurationError if the ball has no discs, and these settings need them."""
    if rig.disc_radius is None and not follows_pattern(rig, settings):
        needs = f"tracker {settings.tracker}" if settings.tracker != "so3" else f"detector {settings.detector}"
        raise ConfigurationError(
            f"rig: disc_radius: missing; the {needs} follows discs, and this ball has none",
            "leave detector and tracker at their defaults, which follow the pattern of such a ball",
        )


def follows_pattern(rig: Rig, settings: Settings) -> bool:
    """Return whether the tracker follows the ball's pattern in place of discs."""
    return detector_of(rig, settings) == "texture"


def map_kind(rig: Rig, settings: Settings) -> str:
    """Return the kind of the map that the tracker learns, as `BallMap.kind`."""
    return PictureMap.kind if follows_pattern(rig, settings) else DiscMap.kind


def detector_of(rig: Rig, settings: Settings) -> str:
    """Return the detector in use. The default one sees discs, or the texture of a ball without discs."""
    of_pattern = rig.disc_radius is None and settings.detector == "default" and settings.tracker == "so3"
    return "texture" if of_pattern else settings.detector


def build(rig: Rig, pose: Pose, settings: Settings, before: Tracker | None = None) -> Tracker:
    """Build the tracker for a device and one camera pose.

    If the detector of `before` is of the same device, pose and settings, it is used again.
    Raises ConfigurationError if the ball has no discs, and PoseError if the camera cannot see the ball: it is inside
    the ball, the ball is not in front of it, or the ball is outside the image.
    """
    check_discs(rig, settings)
    seen_by = detector_of(rig, settings)
    towards = pose.position - rig.ball.centre
    distance = float(np.linalg.norm(towards))
    if (
        distance <= rig.ball.radius
        or pose.to_cam(rig.ball.centre)[2] <= rig.ball.radius
        or not ball_mask(rig, pose).any()
    ):
        unit = "" if rig.scale_free else " m"
        raise PoseError(
            f"from the camera, {distance:.2f}{unit} from the ball's centre, the ball (radius {rig.ball.radius:g}{unit})"
            " is not in the picture: turn the camera towards it, or check the rig's positions and lengths"
        )
    stage: Filter[Any]
    method = PUBLISHED
    texture = follows_pattern(rig, settings)
    if settings.tracker == "so3":
        stage = So3Filter(
            settings.so3,
            towards / distance,
            rig.ball.radius / distance,
            _ANCHOR_ANGLE if texture else rig.disc_angle,
            rig.ball.radius,
            considered_covariance(pose, rig.ball) + (shading_covariance(rig, pose) if texture else 0.0),
            rig.readout_sigma_s,
        )
        method = {"default": SO3, "blobs": SO3_WITH_BLOBS, "texture": TEXTURE}[seen_by]
    elif settings.tracker == "ekf2":
        stage = StateDiscsFilter(settings.euler)
    else:
        stage = ConstantDiscsFilter(settings.euler)
    detector: Detector
    if (
        before is not None
        and before.rig is rig
        and before.pose is pose
        and _detection(before.settings) == _detection(settings)
    ):
        detector = before.detector
    elif seen_by == "default":
        detector = disc_detector(settings.discs, rig, pose, None if before is None else before.detector)
    elif texture:
        detector = texture_detector(rig, pose, settings.discs.masks)
    else:
        detector = BlobDetector(settings.blobs)
    return Tracker(settings, rig, pose, detector, stage, method)


def _detection(settings: Settings) -> tuple[Any, ...]:
    return settings.detector, settings.discs, settings.blobs


def colours_of(rig: Rig, settings: Settings, before: Colours) -> Colours:
    """Return the colour projection under new settings: the fixed one, or else the one found `before`."""
    fixed = settings.discs.projection
    if detector_of(rig, settings) != "default":
        fixed = GREY
    return before._replace(fixed=False) if fixed is None else Colours(fixed, fixed=True)


def begin(tracker: Tracker, stamp: float, attitude: Array | None = None, known: BallMap | None = None) -> TrackState:
    """Return the state before the first frame; the ball is at `attitude` (3, 3), by default that of `obj`.

    With the map of an earlier run (`so3` alone can use it) the ball is recognised first, and the attitude is that of
    the map: absolute.
    """
    R = np.eye(3) if attitude is None else attitude
    start: Any = tracker.filter.initial(stamp, R)
    state = TrackState(
        Learning(),
        start,
        R,
        stamp,
        no_detections(),
        no_points(tracker),
        colours=colours_of(tracker.rig, tracker.settings, Colours()),
        watch=watching.begin(tracker.rig, tracker.pose) if tracker.method.keeps_map else None,
        readout_known=not tracker.method.keeps_map,
    )
    return state if known is None else tracker.method.recall(state, known)
