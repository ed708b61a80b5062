"""Write the six axes of hand-held balls as text: one line a ball and frame, after two header lines that begin with `#`.

The first header line has the column names alone, as `numpy.genfromtxt(names=True)` requires. The second has the units.
`t x y z yaw pitch roll sx sy sz syaw spitch sroll dx dy dz ball state`: time, position and angles in s, m and degrees
(`wand.axes`), the six standard deviations, the counts of the pointer, the number of the ball from 1, and its state. The
counts are 0 for a ball that does not move the pointer. The states are searching, tracking, hidden (predicted, not seen)
and lost. Unknown values are nan. Files open as in `output.text`.
"""

from typing import TextIO

import numpy as np

from spheremouse.output import Report, text
from spheremouse.output.text import Text
from spheremouse.tracker import Estimate, Status
from spheremouse.wand.axes import estimated_axes

NAMES = "# t x y z yaw pitch roll sx sy sz syaw spitch sroll dx dy dz ball state"
UNITS = "# s; m and degrees before the camera; their standard deviations; counts; number; a word"
HEADER = f"{NAMES}\n{UNITS}"


class AxesText(Text):
    """Writes one line a ball with each report."""

    def __init__(self, file: TextIO, name: str) -> None:
        super().__init__(file, name, HEADER)

    def send(self, report: Report) -> None:
        """Write the lines of the balls."""
        for text_line in lines(report):
            self._write(text_line)

    def describe(self, report: Report) -> str:
        """Return the lines as one."""
        return " | ".join(lines(report))


def open(argument: str) -> AxesText:
    """Open standard output (`-` or nothing) or a file."""
    return AxesText(*text.open_log(argument, NAMES))


def lines(report: Report) -> list[str]:
    """Return a line for each ball. The counts are those of the ball that moves the pointer."""
    return [
        line(ball, report.counts if ball is report.estimate else (0, 0, 0), k + 1)
        for k, ball in enumerate(report.balls)
    ]


def line(estimate: Estimate, counts: tuple[int, int, int], number: int) -> str:
    """Return a ball in a frame as a line: positions to a micrometre, angles to 0.0001 degrees."""
    position = angles = position_sigma = angles_sigma = np.full(3, np.nan)
    if estimate.status is Status.TRACKING:
        axes = estimated_axes(estimate)
        position, position_sigma = axes.position, axes.position_sigma
        angles, angles_sigma = np.degrees(axes.angles), np.degrees(axes.angles_sigma)
    hidden = estimate.status is Status.TRACKING and not estimate.confirmed
    numbers = [
        repr(float(estimate.stamp)),
        *(f"{v:.6f}" for v in position),
        *(f"{v:.4f}" for v in angles),
        *(f"{v:.6f}" for v in position_sigma),
        *(f"{v:.4f}" for v in angles_sigma),
        *map(str, counts),
    ]
    return f"{' '.join(numbers)} {number} {'hidden' if hidden else estimate.status}"
