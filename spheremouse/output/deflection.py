"""Angular velocity of the ball along the pointer's directions, for outputs that send rates in place of counts.

A stick keeps its deflection, so a pause or a camera that stops would leave it deflected. Such an output therefore has
`CHECK_PERIOD` as its `period`, and releases the stick after `RELEASE_TIME`.
"""

from math import hypot

from spheremouse.output import Report
from spheremouse.output.response import COUNTS_RESPONSE, Response
from spheremouse.tracker import Status

RELEASE_TIME = 0.3  # s without a confirmed frame; a camera at 5 Hz takes 0.2 s
CHECK_PERIOD = 0.05  # s


def pointer_rate(report: Report, response: Response = COUNTS_RESPONSE) -> list[float] | None:
    """Return the ball's angular velocity along the directions of the counts (x, y, third axis), (3,) rad/s.

    Its direction is that of the counts' rate, by the frame of `response`, and its length that of the angular velocity.
    It is zero if the ball is not tracked, and None if no frame confirms it.
    """
    sample = report.pointing_sample
    if sample is not None and sample.status is not Status.TRACKING:
        return [0.0, 0.0, 0.0]
    if sample is None or report.rate is None:
        return None
    rate = (report.to_camera @ report.rate).tolist() if response.in_camera else report.rate
    size, speed = hypot(*rate), hypot(*sample.rate.tolist())
    return [r * speed / size if size > 0.0 else 0.0 for r in rate]
