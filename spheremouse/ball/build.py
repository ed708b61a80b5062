"""Construction of a tracker from a device, a pose and settings, and of its state before the first frame."""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from spheremouse.ball import camera_watch as watching
from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.detections import no_detections
from spheremouse.ball.detect.projection import GREY
from spheremouse.ball.detector import Detector
from spheremouse.ball.filters import Filter
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_rig import Station
from spheremouse.ball.phases.discs import Discs
from spheremouse.ball.phases.method import SO3
from spheremouse.ball.rig import Rig, considered_covariance
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import (
    Colours,
    Learning,
    Method,
    Tracker,
    TrackState,
    no_points,
)
from spheremouse.errors import ConfigurationError, PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array


class Choice(NamedTuple):
    """A detector with the steps of tracking for the filter `so3`."""

    detector: Detector
    method: Method


@cache
def _discs() -> Choice:
    return Choice(Discs(), SO3)


@cache
def _blobs() -> Choice:
    from spheremouse.ball.published.method import Blobs

    return Choice(Blobs(), SO3)


@cache
def _texture() -> Choice:
    from spheremouse.ball.texture.detector import Texture
    from spheremouse.ball.texture.method import TEXTURE

    return Choice(Texture(), TEXTURE)


@cache
def _both() -> Choice:
    from spheremouse.ball.texture.both import BOTH, Both

    return Choice(Both(), BOTH)


# Functions, since a run imports its own detector alone
DETECTORS = {"default": _discs, "blobs": _blobs, "texture": _texture, "both": _both}


def detector_name(rig: Rig, settings: Settings) -> str:
    """Return the name of the detector in use. The default one sees discs, or the texture of a ball without discs."""
    of_pattern = rig.disc_radius is None and settings.detector == "default" and settings.tracker == "so3"
    return "texture" if of_pattern else settings.detector


def detector_of(rig: Rig, settings: Settings) -> Detector:
    """Return the detector in use."""
    return DETECTORS[detector_name(rig, settings)]().detector


def map_kind(rig: Rig, settings: Settings) -> str:
    """Return the kind of the map that the tracker learns, as `BallMap.kind`."""
    return detector_of(rig, settings).map_type.kind


def check_discs(rig: Rig, settings: Settings) -> None:
    """Raise ConfigurationError if the ball has no discs, and these settings need them."""
    if rig.disc_radius is None and detector_of(rig, settings).sees_discs:
        needs = f"tracker {settings.tracker}" if settings.tracker != "so3" else f"detector {settings.detector}"
        raise ConfigurationError(
            f"rig: disc_radius: missing; the {needs} follows discs, and this ball has none",
            "leave detector and tracker at their defaults, which follow the pattern of such a ball",
        )


def check_view(rig: Rig, pose: Pose) -> None:
    """Raise PoseError if the camera cannot see the ball, as `build` does."""
    distance = float(np.linalg.norm(pose.position - rig.ball.centre))
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


def build(rig: Rig, pose: Pose, settings: Settings, before: Tracker | None = None) -> Tracker:
    """Build the tracker for a device and one camera pose.

    If the detector of `before` is of the same device, pose and settings, it is used again. So is the size of the ball
    that an outline has shown to a tracker of the same device.
    Raises ConfigurationError if the ball has no discs, or larger ones than the image shows. Raises PoseError if the
    camera cannot see the ball: it is inside the ball, the ball is not in front of it, or the ball is outside the image.
    """
    check_discs(rig, settings)
    check_view(rig, pose)
    detector, method = DETECTORS[detector_name(rig, settings)]()
    towards = pose.position - rig.ball.centre
    distance = float(np.linalg.norm(towards))
    stage: Filter[Any]
    if settings.tracker == "so3":
        station = Station(
            towards / distance,
            rig.ball.radius / distance,
            rig.ball.radius,
            considered_covariance(pose, rig.ball) + detector.shared_errors(rig, pose),
            rig.readout_sigma_s,
            rig.camera.focal_sigma,
            pose.by_focal,
            pose.along_axis(rig.ball.centre),
        )
        if before is not None and before.rig is rig and isinstance(before.filter, So3Filter):
            station = replace(station, size_error=before.filter.station.size_error)
        stage = So3Filter(settings.so3, station, detector.landmark_angle(rig))
    else:
        from spheremouse.ball.published.euler import ConstantDiscsFilter, StateDiscsFilter
        from spheremouse.ball.published.method import PUBLISHED

        method = PUBLISHED
        stage = (StateDiscsFilter if settings.tracker == "ekf2" else ConstantDiscsFilter)(settings.euler)
    if (
        before is not None
        and before.rig is rig
        and before.pose is pose
        and _detection(before.settings) == _detection(settings)
    ):
        data = before.detector_data
    else:
        data = detector.prepare(rig, pose, settings, None if before is None else before.detector_data)
    return Tracker(settings, rig, pose, detector, data, stage, method)


def _detection(settings: Settings) -> tuple[Any, ...]:
    return settings.detector, settings.discs, settings.blobs


def colours_of(rig: Rig, settings: Settings, before: Colours) -> Colours:
    """Return the colour projection under new settings: the fixed one, or else the one found `before`."""
    fixed = settings.discs.projection
    if not detector_of(rig, settings).uses_colours:
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
        shown_at=stamp,
    )
    return state if known is None else tracker.method.recall(state, known)
