"""Steady stamps: the times at which a camera exposes, from stamps that a computer makes late by chance.

A camera exposes at equal intervals, but a driver may stamp a frame only when the computer handles its packets. uvcvideo
handles up to 32 packets of 125 µs at once (UVC_MAX_PACKETS), so its stamps are up to 4 ms late. At 30 Hz, that makes a
rate wrong by 5 %. A Kalman filter of the exposure's time and the interval averages the delays. The mean delay remains.
This module reads no clock itself.
"""

import math
from dataclasses import dataclass

_USB_DELAY_S = 4.5e-3  # of packets that are handled together; a larger step is one of the camera
_SIGMA_S = 1.2e-3  # standard deviation of a delay between 0 and 4 ms
_MIN_SIGMA_S = 1e-4  # of any computer's stamp
_MAX_SHARE = 0.2  # of the interval: a larger standard deviation is not due to delays
_UNKNOWN_SHARE = 0.25  # of the interval: its standard deviation before the first frame
_MIN_CHANGE = 0.1  # of the interval, to which a camera shortens it at most
_WANDER = 1e-5  # relative change of the interval from frame to frame, ample for a quartz that warms and for NTP
_GAIN = 1.0 / 32.0  # weight of a new frame in the variance of the delays
_GATE = 4.0  # standard deviations


@dataclass(frozen=True, slots=True)
class Rhythm:
    """Estimate after a frame."""

    interval: float  # s, between two exposures
    stamp: float = -math.inf  # s
    raw: float = -math.inf  # s, as the driver gave it
    stamp_variance: float = 0.0  # s²
    covariance: float = 0.0  # s², of stamp and interval
    interval_variance: float = 0.0  # s²
    delay_variance: float = _SIGMA_S**2  # s²
    late: float = 0.0  # s, later than expected
    odd: bool = False  # the frame came late, or after frames that the driver did not count


class SteadyStamps:
    """Stamps of one camera: they increase, and none is later than the arrival of its frame."""

    def __init__(self, interval: float) -> None:
        """`interval` is the nominal time between two frames, s."""
        self._rhythm, self._last = Rhythm(interval), -math.inf

    def next(self, raw: float, arrival: float, n: int = 1) -> float:
        """Return the stamp, s, of the n-th frame after the last one, which the driver stamps `raw`, s."""
        self._rhythm = steady_stamp(self._rhythm, raw, n)
        self._last = max(min(self._rhythm.stamp, arrival), math.nextafter(self._last, math.inf))
        return self._last


def steady_stamp(last: Rhythm, raw: float, n: int = 1) -> Rhythm:
    """Return the estimate after a frame with the stamp `raw`, s, the n-th after the last one by the driver's count.

    A frame that comes too late gets the last expected time before its stamp. If the next one is late, too, or if a
    frame comes too early, the camera has another interval, and a new estimate begins.
    """
    if not -math.inf < last.raw < raw:
        R, P = last.delay_variance, last.interval
        return Rhythm(P, raw, raw, R, 0.0, (_UNKNOWN_SHARE * P) ** 2, R)
    P, R = last.interval, last.delay_variance
    gate = max(_GATE * math.sqrt(last.stamp_variance + n * n * last.interval_variance + R), _USB_DELAY_S)
    late = raw - last.stamp - n * P
    odd, counted, lost = late > gate, n, 0
    if odd:  # frames that the camera lost, or those of another interval
        lost = round(late / P)
        lost = lost if abs(late - lost * P) < gate else math.floor(late / P)
    n, late = n + lost, late - lost * P
    a = last.stamp_variance + n * (2.0 * last.covariance + n * last.interval_variance)
    b = last.covariance + n * last.interval_variance
    c = last.interval_variance + n * (_WANDER * P) ** 2
    scatter = 0.5 * min(abs(late - last.late), gate) ** 2  # of frames in a row: an interval that changes has none
    R = max(min(R + _GAIN * (scatter - R), (_MAX_SHARE * P) ** 2), _MIN_SIGMA_S**2)
    if late < -gate or (odd and last.odd):
        if counted * _MIN_CHANGE * P > raw - last.raw:
            counted = 1  # a counter that jumped
        return Rhythm((raw - last.raw) / counted, raw, raw, R, R / counted, 2.0 * R / counted**2, R)
    K, L = (0.0, 0.0) if late > gate else (a / (a + R), b / (a + R))
    return Rhythm(
        P + L * late, last.stamp + n * P + K * late, raw, a - K * a, b - K * b, c - L * b, R, 0.0 if odd else late, odd
    )
