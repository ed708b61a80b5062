"""Overlay of the tracker's view on the frame, for pictures and videos.

Detected contours are white and targets green. Predicted discs of the map are red, with the last epochs fading (Wittich
2017, fig. 27). Masked look-alikes are blue, the ball's outline is thin. A strip below has the numbers.
"""

from collections import deque

import numpy as np

from spheremouse.ball.state import Epoch, Tracker, TrackState, current
from spheremouse.geometry.rotation import Array
from spheremouse.session.overlay.marks import Mark, detected, masked, predicted, still_marks, used_points
from spheremouse.session.overlay.pen import EPOCHS, WHITE, Image, Pen, canvas_of

_UNUSED = 0.45  # weight of a detection that the filter did not use


class Overlay:
    """Draws epochs, and remembers the last few for their traces."""

    def __init__(self, tracker: Tracker, targets: tuple[Mark, ...] = (), scale: int = 1) -> None:
        """`scale` enlarges the frame before anything is drawn on it."""
        self._tracker, self._scale = tracker, scale
        self._still = still_marks(tracker)._replace(targets=targets)
        self._trace: deque[Array] = deque(maxlen=EPOCHS)  # (m, 2) px each, the newest last

    def remember(self, state: TrackState) -> None:
        """The predicted discs of an epoch, for the traces; `draw` does not."""
        tracker = current(state, self._tracker)
        if tracker is not self._tracker:  # the camera was moved
            self._tracker, self._still = tracker, still_marks(tracker)
            self._trace.clear()
        self._trace.append(predicted(state, tracker).centre)

    def draw(self, epoch: Epoch, counts: tuple[int, int, int]) -> Image:
        """The epoch that was remembered last, with the sum of counts so far."""
        state = epoch.state
        canvas = canvas_of(epoch.frame.image, self._scale)
        pen = Pen(canvas, self._scale)
        pen.outline(self._still.outline)
        pen.trace(list(self._trace))
        _draw_detections(pen, state, self._tracker)
        for mark in self._still.targets:
            pen.target(mark)
        for centre in masked(state):
            pen.cross(centre)
        pen.caption(_cells(epoch, counts))
        return canvas


def _draw_detections(pen: "Pen", state: TrackState, tracker: Tracker) -> None:
    """Draw contours as detected. If the detector has none, draw the ellipses of the discs seen there."""
    if state.detections.contours:
        for index, used in zip(state.points.index, used_points(state), strict=True):
            pen.contour(state.detections.contours[index], 1.0 if used else _UNUSED)
        return
    for centre, shape, used in zip(*detected(state, tracker), strict=True):
        pen.ellipse(centre, shape, WHITE, 1.0 if used else _UNUSED)


def _cells(epoch: Epoch, counts: tuple[int, int, int]) -> tuple[tuple[str, float], ...]:
    estimate, n = epoch.estimate, epoch.estimate.statistics
    rate = "  ".join(f"{name} {v:+.1f}" for name, v in zip("XYZ", np.degrees(estimate.rate[:3]), strict=True))
    return (
        (f"{estimate.stamp:.2f} s  {estimate.status}", 0.012),
        (f"{rate} deg/s", 0.2),
        (f"counts {counts[0]:+d} {counts[1]:+d} {counts[2]:+d}", 0.55),
        (f"discs {n['discs_used']} of {n['discs_known']}", 0.86),
    )
