"""Overlay of a frame's annotations on its picture, for pictures and videos.

Detected discs are white, or grey if the filter did not use them, and targets green. The predicted discs of the last
frames are red dots that fade (Wittich 2017, fig. 27). Masked look-alikes are blue, outlines of balls thin. A strip
below has the numbers of the ball that points.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output import Counts
from spheremouse.output.sample import Sample
from spheremouse.session.overlay.pen import EPOCHS, WHITE, Image, Pen, canvas_of, masked
from spheremouse.session.tracker_adapter import FrameResult
from spheremouse.tracker import Status
from spheremouse.wand.axes import estimated_axes

Marks = dict[str, Any]  # of `TrackerAdapter.annotations`

_UNUSED_WEIGHT = 0.45  # weight of a detection that the filter did not use
_PICTURE_WIDTH = 1280  # px


class Overlay:
    """Draws frames, and remembers the predictions of the last few for their traces."""

    def __init__(self, scale: int = 1) -> None:
        """`scale` enlarges the frame before anything is drawn on it."""
        self._scale = scale
        self._trace: deque[Array] = deque(maxlen=EPOCHS)  # (m, 2) px each, the newest last

    def remember(self, marks: Marks) -> None:
        """Add the predicted discs of a frame to the traces; `draw` does not."""
        self._trace.append(np.array([_place(disc) for disc in marks["predicted"]]).reshape(-1, 2))

    def draw(self, image: Image, marks: Marks, sample: Sample, counts: Counts) -> Image:
        """Return the picture of the frame that was remembered last, with the sum of counts so far."""
        canvas = canvas_of(image, self._scale)
        pen = Pen(canvas, self._scale)
        for outline in (marks["outline"], *marks.get("others", ())):
            pen.outline(np.reshape(outline, (-1, 2)))
        pen.trace(list(self._trace))
        for disc in marks["detected"]:
            pen.ellipse(_place(disc), _shape(disc), WHITE, 1.0 if disc["used"] else _UNUSED_WEIGHT)
        for target in marks["targets"]:
            pen.target(target["code"], _place(target), _shape(target))
        for place in marks["masked"]:
            pen.cross(np.array(place))
        pen.caption(*_caption(sample, counts))
        return canvas


def picture_of(
    result: FrameResult, marks: Marks, counts: Counts, keep: Callable[[], Image] | None
) -> Callable[[], Image]:
    """Return a function that draws a frame with its marks, black where `keep()`, (h, w), is 0. The image is copied."""
    image, sample = result.frame.image.copy(), result.samples[result.pointing]

    def draw() -> Image:
        overlay = Overlay(max(1, round(_PICTURE_WIDTH / image.shape[1])))
        overlay.remember(marks)
        return overlay.draw(image if keep is None else masked(image, keep()), marks, sample, counts)

    return draw


def _place(mark: Marks) -> Array:
    return np.array([mark["x"], mark["y"]])


def _shape(mark: Marks) -> Array:
    xx, xy, yy = mark["shape"]
    return np.array([[xx, xy], [xy, yy]])


def _caption(sample: Sample, counts: Counts) -> tuple[list[tuple[str, float]], int]:
    """Return the cells of the strip, and the height of its letters."""
    hidden = sample.coordinates == "cam" and sample.status is Status.TRACKING and not sample.confirmed
    cells = [(f"{sample.stamp:.2f} s  {'hidden' if hidden else sample.status}", 0.012)]
    sums = "counts {:+d} {:+d} {:+d}".format(*counts)
    if sample.coordinates == "obj":
        rate, n = np.degrees(sample.rate), sample.statistics
        cells.append(("X {:+.1f}  Y {:+.1f}  Z {:+.1f} deg/s".format(*rate), 0.2))
        return [*cells, (sums, 0.55), (f"points {n['discs_used']:.0f} of {n['discs_known']:.0f}", 0.86)], 11
    if sample.status is Status.TRACKING:
        axes = estimated_axes(sample.estimate)
        cells.append(("x {:+.3f}  y {:+.3f}  z {:.3f} m".format(*axes.position), 0.17))
        cells.append(("yaw {:+.1f}  pitch {:+.1f}  roll {:+.1f} deg".format(*np.degrees(axes.angles)), 0.42))
    return [*cells, (sums, 0.755)], 9
