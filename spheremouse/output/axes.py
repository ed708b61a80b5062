"""Write the six axes of hand-held balls as text: one line a ball and frame, after two header lines that begin with `#`.

The first header line has the column names alone, as `numpy.genfromtxt(names=True)` requires. The second has the units.
`t x y z yaw pitch roll sx sy sz syaw spitch sroll dx dy dz ball state`: time, position and angles in s, m and degrees
(`wand.axes`), the six standard deviations, the counts of the pointer, the number of the ball from 1, and its state. The
counts are 0 for a ball that does not move the pointer. The states are searching, tracking, hidden (predicted, not seen)
and lost. Unknown values are nan. Files open as in `output.text`.
"""

from collections import OrderedDict
from typing import TextIO

import numpy as np

from spheremouse.output import Report, text
from spheremouse.output.text import Text
from spheremouse.tracker import Status
from spheremouse.wand.axes import axes_of
from spheremouse.wand.state import WandPose

NAMES = "# t x y z yaw pitch roll sx sy sz syaw spitch sroll dx dy dz ball state"
UNITS = "# s; m and degrees before the camera; their standard deviations; counts; number; a word"
HEADER = f"{NAMES}\n{UNITS}"
_MAX_FRAMES = 512  # without a report: while an output fails, its reports do not come


class PoseLog:
    """Poses of the frames whose reports have not been sent. Push the poses of a frame before you send its report."""

    def __init__(self, argument: str) -> None:
        """Take `argument` as the output `text:` does."""
        self._argument = argument
        self._poses: OrderedDict[float, tuple[int, tuple[WandPose, ...]]] = OrderedDict()  # by the frame's stamp

    def push(self, stamp: float, poses: tuple[WandPose, ...], points: int = 0) -> None:
        """Add the poses of a frame and the index of the ball that moves the pointer, from any thread."""
        self._poses[stamp] = points, poses
        while len(self._poses) > _MAX_FRAMES:
            self._poses.popitem(last=False)

    def open(self) -> "AxesText":
        """Open the output, which writes these poses."""
        return AxesText(*text.open_log(self._argument, NAMES), self)

    def lines(self, report: Report) -> list[str]:
        """Return the lines of the frame of a report, and forget its poses."""
        stamp = report.estimate.stamp
        points, poses = self._poses.pop(stamp, (0, ()))
        return [line(stamp, pose, report.counts if k == points else (0, 0, 0), k + 1) for k, pose in enumerate(poses)]


class AxesText(Text):
    """Writes one line a ball with each report."""

    def __init__(self, file: TextIO, name: str, poses: PoseLog) -> None:
        super().__init__(file, name, HEADER)
        self._poses = poses

    def send(self, report: Report) -> None:
        """Write the frame's lines."""
        for text_line in self._poses.lines(report):
            self._write(text_line)

    def describe(self, report: Report) -> str:
        """Return nothing, because a report has no poses."""
        return ""


def line(stamp: float, pose: WandPose, counts: tuple[int, int, int], number: int) -> str:
    """Return a ball in a frame as a line: positions to a micrometre, angles to 0.0001 degrees."""
    position = angles = position_sigma = angles_sigma = np.full(3, np.nan)
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = axes_of(pose.position, pose.rotation, pose.covariance)
        position, position_sigma = axes.position, axes.position_sigma
        angles, angles_sigma = np.degrees(axes.angles), np.degrees(axes.angles_sigma)
    state = "hidden" if pose.phase is Status.TRACKING and not pose.seen else str(pose.phase)
    numbers = [
        repr(float(stamp)),
        *(f"{v:.6f}" for v in position),
        *(f"{v:.4f}" for v in angles),
        *(f"{v:.6f}" for v in position_sigma),
        *(f"{v:.4f}" for v in angles_sigma),
        *map(str, counts),
    ]
    return f"{' '.join(numbers)} {number} {state}"
