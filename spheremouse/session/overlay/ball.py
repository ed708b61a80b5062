"""Overlay of the tracker's view on the frame, for pictures and videos.

Detected contours are white and targets green. Predicted discs of the map are red, with the last epochs fading (Wittich
2017, fig. 27). Masked look-alikes are blue, the ball's outline is thin. A strip below has the numbers.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance, ball_outline
from spheremouse.ball.detect.lookalikes import MASK_RADIUS_PX
from spheremouse.ball.points import directions_at
from spheremouse.ball.pose import Resection, predict_targets
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Epoch, Tracker, TrackState, current
from spheremouse.geometry.camera import Pose, ellipse_to_pixel, project_circle
from spheremouse.geometry.rotation import Array
from spheremouse.session.overlay.pen import EPOCHS, WHITE, Image, Mark, Pen, canvas_of
from spheremouse.tracker import Status


def target_marks(rig: Rig, pose: Pose, seen: Resection | None) -> tuple[Mark, ...]:
    """Return marks of the targets of a resection at their measured places; without it, of all at predicted places."""
    if len(rig.targets.codes) == 0:
        return ()
    codes, centres = (rig.targets.codes, predict_targets(pose, rig)) if seen is None else (seen.codes, seen.centre)
    points = pose.to_cam(rig.targets.position[[rig.targets.codes.index(c) for c in codes]])
    normal = np.broadcast_to(pose.rotation[2], points.shape)  # obj's Z axis in cam
    _, shape = ellipse_to_pixel(*project_circle(points, normal, float(rig.targets.radii[-1])), rig.camera)
    return tuple(Mark(c, p, s) for c, p, s in zip(codes, centres, shape, strict=True) if np.all(np.isfinite(p)))


class Overlay:
    """Draws epochs, and remembers the last few for their traces."""

    def __init__(self, tracker: Tracker, targets: tuple[Mark, ...] = (), scale: int = 1) -> None:
        """`scale` enlarges the frame before anything is drawn on it."""
        self._tracker, self._targets, self._scale = tracker, targets, scale
        self._outline = ball_outline(tracker.rig, tracker.pose)
        self._trace: deque[Array] = deque(maxlen=EPOCHS)  # (m, 2) px each, the newest last

    def remember(self, state: TrackState) -> None:
        """The predicted discs of an epoch, for the traces; `draw` does not."""
        tracker = current(state, self._tracker)
        if tracker is not self._tracker:  # the camera was moved: what is drawn from its pose moves along
            self._tracker, self._outline = tracker, ball_outline(tracker.rig, tracker.pose)
            self._targets = target_marks(tracker.rig, tracker.pose, None)
            self._trace.clear()
        seen = _predicted(state, self._tracker)
        self._trace.append(seen if state.status is not Status.LOST else seen[:0])

    def draw(self, epoch: Epoch, counts: tuple[int, int, int]) -> Image:
        """The epoch that was remembered last, with the sum of counts so far."""
        state = epoch.state
        canvas = canvas_of(epoch.frame.image, self._scale)
        pen = Pen(canvas, self._scale)
        pen.outline(self._outline)
        pen.trace(list(self._trace))
        used = np.zeros(len(state.points), dtype=bool)
        used[epoch.state.filter.used] = True
        _draw_detections(pen, state, self._tracker, used)
        for mark in self._targets:
            pen.target(mark)
        for centre in _masked(state, self._tracker):
            pen.cross(centre)
        pen.caption(_cells(epoch, counts))
        return canvas


def _predicted(state: TrackState, tracker: Tracker) -> Array:
    """Return the visible discs of the map, (m, 2) px."""
    discs = np.asarray(state.filter.discs, dtype=float).reshape(-1, 3)
    seen = appearance(discs @ state.filter.attitude.T, tracker.rig, tracker.pose)
    return seen.centre[seen.whole]


def _masked(state: TrackState, tracker: Tracker) -> Array:
    """Detections set aside as look-alikes, (k, 2) px."""
    offset = state.detections.centre[:, None] - state.lookalikes.masks[None]
    near = np.linalg.norm(offset, axis=2) < MASK_RADIUS_PX
    near[state.points.index] = False
    return state.detections.centre[near.any(axis=1)]


def _draw_detections(pen: "Pen", state: TrackState, tracker: Tracker, used: NDArray[np.bool_]) -> None:
    """Contours as detected; where the detector fits ellipses and has none, the ellipse of the disc seen there."""
    weights = np.where(used, 1.0, 0.45)
    if state.detections.contours:
        for index, weight in zip(state.points.index, weights, strict=True):
            pen.contour(state.detections.contours[index], float(weight))
        return
    centre = state.detections.centre[state.points.index]
    directions, which = directions_at(centre, tracker.rig, tracker.pose)
    seen = appearance(directions, tracker.rig, tracker.pose)
    for k in np.flatnonzero(seen.whole):
        pen.ellipse(centre[which[k]], seen.shape[k], WHITE, float(weights[which[k]]))


def _cells(epoch: Epoch, counts: tuple[int, int, int]) -> tuple[tuple[str, float], ...]:
    """Time, phase, rate, counts, discs."""
    estimate, n = epoch.estimate, epoch.estimate.statistics
    rate = "  ".join(f"{name} {v:+.1f}" for name, v in zip("XYZ", np.degrees(estimate.rate[:3]), strict=True))
    return (
        (f"{estimate.stamp:.2f} s  {estimate.status}", 0.012),
        (f"{rate} deg/s", 0.2),
        (f"counts {counts[0]:+d} {counts[1]:+d} {counts[2]:+d}", 0.55),
        (f"discs {n['discs_used']} of {n['discs_known']}", 0.86),
    )
