"""The six axes of hand-held balls as text: one line per ball and frame, after two lines that begin with `#`.

The first names the columns and nothing else, as `numpy.genfromtxt(names=True)` wants it; the second has their units.
`t x y z yaw pitch roll sx sy sz syaw spitch sroll dx dy dz ball state`: s, m and degrees (`wand.axes`), standard
deviations of the six, counts of the pointer (those of the ball that moves it, 0 of others), number of the ball from 1,
and searching, tracking, hidden (predicted, not seen) or lost. What is not known is nan. Files as in `output.text`.
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
_WAITING = 512  # frames whose report never came, at most: those of an output that failed


class AxesOutput:
    """Where the axes go: told of each frame's poses before its report is sent, by whoever sends reports."""

    def __init__(self, argument: str) -> None:
        """`argument` as of an output `text:`."""
        self._argument = argument
        self._poses: OrderedDict[float, tuple[int, tuple[WandPose, ...]]] = OrderedDict()  # by the frame's stamp

    def expect(self, stamp: float, poses: tuple[WandPose, ...], points: int = 0) -> None:
        """The poses of the frame whose report comes next, and the index of the ball it moves by; from any thread."""
        self._poses[stamp] = points, poses
        while len(self._poses) > _WAITING:
            self._poses.popitem(last=False)

    def open(self) -> "AxesText":
        """The output; opened anew where it has failed."""
        return AxesText(*text.begin(self._argument, NAMES), self)

    def lines(self, report: Report) -> list[str]:
        """What there is to be written of a frame."""
        stamp = report.motion.stamp
        points, poses = self._poses.pop(stamp, (0, ()))
        return [line(stamp, pose, report.counts if k == points else (0, 0, 0), k + 1) for k, pose in enumerate(poses)]


class AxesText(Text):
    """Writes a line per ball with each report."""

    def __init__(self, file: TextIO, name: str, axes: AxesOutput) -> None:
        super().__init__(file, name, HEADER)
        self._axes = axes

    def send(self, report: Report) -> None:
        """Write the frame's lines."""
        for made in self._axes.lines(report):
            self._write(made)

    def describe(self, report: Report) -> str:
        """The lines are of poses, which a report alone does not have."""
        return ""


def line(stamp: float, pose: WandPose, counts: tuple[int, int, int], number: int) -> str:
    """A ball in a frame as a line: positions to a micrometre, angles to 0.0001 degrees."""
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
