"""The tracker's marks on a frame, which `overlay.ball` draws and `overlay.annotations` sends."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance, ball_outline
from spheremouse.ball.detect.lookalikes import MASK_RADIUS_PX
from spheremouse.ball.points import directions_at
from spheremouse.ball.pose import Resection, predict_targets
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.camera import Pose, ellipse_to_pixel, project_circle
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status


@dataclass(frozen=True, slots=True)
class Mark:
    """A target."""

    code: str
    centre: Array  # (2,) px
    shape: Array  # (2, 2) px², of the outer ring


class StillMarks(NamedTuple):
    """Marks that stay until the camera is moved."""

    outline: Array  # (n, 2) px, of the ball
    targets: tuple[Mark, ...]


class Detected(NamedTuple):
    """Detected discs, as ellipses of the discs that are whole there."""

    centre: Array  # (k, 2) px
    shape: Array  # (k, 2, 2) px²
    used: NDArray[np.bool_]  # (k,) by the filter


class Predicted(NamedTuple):
    """Whole discs of the map at the estimated attitude; none if the ball is lost."""

    discs: NDArray[np.intp]  # (m,) indices on the map
    centre: Array  # (m, 2) px
    shape: Array  # (m, 2, 2) px²


def target_marks(rig: Rig, pose: Pose, seen: Resection | None) -> tuple[Mark, ...]:
    """Return marks of the targets of a resection at their measured places; without it, of all at predicted places."""
    if len(rig.targets.codes) == 0:
        return ()
    codes, centres = (rig.targets.codes, predict_targets(pose, rig)) if seen is None else (seen.codes, seen.centre)
    points = pose.to_cam(rig.targets.position[[rig.targets.codes.index(c) for c in codes]])
    normal = np.broadcast_to(pose.rotation[2], points.shape)  # obj's Z axis in cam
    _, shape = ellipse_to_pixel(*project_circle(points, normal, float(rig.targets.radii[-1])), rig.camera)
    return tuple(Mark(c, p, s) for c, p, s in zip(codes, centres, shape, strict=True) if np.all(np.isfinite(p)))


def still_marks(tracker: Tracker) -> StillMarks:
    """Return the ball's outline, and the targets at their predicted places."""
    rig, pose = tracker.rig, tracker.pose
    return StillMarks(ball_outline(rig, pose), target_marks(rig, pose, None))


def used_points(state: TrackState) -> NDArray[np.bool_]:
    """Return a mask, (n,), of the points that the filter used."""
    used = np.zeros(len(state.points), dtype=bool)
    used[state.filter.used] = True
    return used


def detected(state: TrackState, tracker: Tracker) -> Detected:
    """Return the detected points."""
    centre = state.detections.centre[state.points.index]
    directions, which = directions_at(centre, tracker.rig, tracker.pose)
    seen = appearance(directions, tracker.rig, tracker.pose)
    which = which[seen.whole]
    return Detected(centre[which], seen.shape[seen.whole], used_points(state)[which])


def predicted(state: TrackState, tracker: Tracker) -> Predicted:
    """Return the discs of the map whose whole rim faces the camera, in px; none if the ball is lost."""
    discs = np.asarray(state.filter.discs, dtype=float).reshape(-1, 3)
    if state.status is Status.LOST:
        discs = discs[:0]
    seen = appearance(discs @ state.filter.attitude.T, tracker.rig, tracker.pose)
    return Predicted(np.flatnonzero(seen.whole), seen.centre[seen.whole], seen.shape[seen.whole])


def masked(state: TrackState) -> Array:
    """Return the detections set aside as look-alikes, (k, 2) px."""
    offset = state.detections.centre[:, None] - state.lookalikes.masks[None]
    near = np.linalg.norm(offset, axis=2) < MASK_RADIUS_PX
    near[state.points.index] = False
    return state.detections.centre[near.any(axis=1)]
