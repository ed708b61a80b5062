"""Convert a driver's stamp to mid-exposure of the middle row on the clock of time.monotonic().

A rolling shutter begins to expose row v of h at b + readout v/h and reads it `exposure` later. So mid-exposure of the
middle row is b + (exposure + readout)/2, and the last row is read at b + exposure + readout. The driver declares the
moment of its stamps (V4L2, "Buffer Flags", V4L2_BUF_FLAG_TSTAMP_SRC_MASK):

    exposure begins (SRC_SOE)           stamp + (exposure + readout)/2
    first packet (uvcvideo, see below)  stamp + (readout - exposure)/2
    end of frame (SRC_EOF)              stamp - (exposure + readout)/2

uvcvideo declares SRC_SOE. With its module parameter hwtimestamps the stamp is that moment on the camera's clock. By
default it is the kernel's time at the frame's first packet, which comes after the first row was read. An unknown
exposure counts as half the frame interval. Then the stamp has a constant error of a quarter of the interval at most,
which changes latencies but no rates.

Some drivers give no stamps, or stamps of another clock, or stamps in the future. This module corrects them. It reads no
clock itself.
"""

import enum
import math
from dataclasses import dataclass, replace

_MAX_AGE = 1.0  # s of a frame at its arrival, if the program waited for it
_MAX_QUEUED_AGE = 60.0  # s, if it may have waited in the queue
_MAX_LEAD = 0.25  # s ahead of the clock; a stamp beyond it belongs to another clock
_LEAD_WINDOW = 5.0  # s; the driver's lead is kept for one or two windows
_DELAY_GAIN = 1.0 / 16.0  # weight of a new frame in the mean delay
_MIN_STEP = 0.1  # of the frame interval, between two stamps


class Moment(enum.Enum):
    """Moments of a frame that a driver's stamp may mean."""

    EXPOSURE_BEGINS = "start of exposure"
    FIRST_PACKET = "first packet"
    END_OF_FRAME = "end of frame"


@dataclass(frozen=True, slots=True)
class Timing:
    """Known times of a frame's exposure and readout."""

    moment: Moment
    interval: float  # s between frames
    exposure: float | None = None  # s; None: not known
    readout: float = 0.0  # s, of all rows
    shift: float = 0.0  # s, added to every stamp

    @property
    def likely_exposure(self) -> float:
        """Exposure in s; half the interval if it is unknown."""
        return 0.5 * self.interval if self.exposure is None else self.exposure

    @property
    def max_error(self) -> float:
        """Largest error (s) of mid-exposure due to an unknown exposure."""
        return 0.25 * self.interval if self.exposure is None else 0.0

    @property
    def to_middle(self) -> float:
        """Time (s) from the driver's stamp to mid-exposure of the middle row, with the requested shift."""
        e, r = self.likely_exposure, self.readout
        match self.moment:
            case Moment.EXPOSURE_BEGINS:
                return 0.5 * (e + r) + self.shift
            case Moment.FIRST_PACKET:
                return 0.5 * (r - e) + self.shift
            case Moment.END_OF_FRAME:
                return -0.5 * (e + r) + self.shift

    @property
    def min_delay(self) -> float:
        """Least time (s) from mid-exposure of the middle row to the arrival of the whole frame."""
        return 0.5 * ((self.exposure or 0.0) + self.readout)


@dataclass(frozen=True, slots=True)
class Arrival:
    """Times of a frame's arrival."""

    clock: float  # s, time.monotonic()
    realtime: float  # s, time.time() at the same moment
    waited: bool  # the program waited for this frame, so it was not queued before


@dataclass(frozen=True, slots=True)
class Stamps:
    """State of the correction between two frames."""

    last: float = -math.inf  # s, the last corrected stamp
    raw: float = math.nan  # s, the driver's last stamp
    window: float = -math.inf  # s, start of the current window
    leads: tuple[float, float] = (0.0, 0.0)  # s, largest lead of the driver in the last and the current window
    delay: float | None = None  # s, mean time from mid-exposure to arrival; None: no valid stamp yet
    noted: frozenset[str] = frozenset()  # kinds of problems that have a note


def correct_stamp(state: Stamps, raw: float, arrival: Arrival, timing: Timing) -> tuple[Stamps, float, str | None]:
    """Return the next state, a frame's stamp (s), and a note on a new kind of problem, or None.

    `raw` is the driver's stamp (s). The returned stamp is later than the last one and not later than the arrival.
    Stamps in the future are all shifted by the same time, so they keep their regular steps.
    """
    good, trouble = _on_monotonic_clock(raw, arrival, max(_MAX_LEAD, timing.interval))
    middle = None
    if good is not None:
        lead = good + timing.to_middle - (arrival.clock - timing.min_delay)
        state = _with_lead(state, lead, arrival.clock)
        if lead > timing.max_error and trouble is None:
            trouble = "ahead"
        middle = good + timing.to_middle - max(state.leads)
        if middle <= state.last:
            middle, trouble = None, trouble or ("same" if raw == state.raw else "back")
    if middle is None:
        middle = arrival.clock - _delay(state, timing)
    elif arrival.waited:
        new = arrival.clock - middle
        old = new if state.delay is None else state.delay
        state = replace(state, delay=old + _DELAY_GAIN * (new - old))
    stamp = min(max(middle, state.last + _MIN_STEP * timing.interval), arrival.clock)
    stamp = max(stamp, math.nextafter(state.last, math.inf))
    note = None
    if trouble is not None and trouble not in state.noted:
        note = _note(trouble, state, timing)
        state = replace(state, noted=state.noted | {trouble})
    return replace(state, last=stamp, raw=raw), stamp, note


def _with_lead(state: Stamps, lead: float, now: float) -> Stamps:
    """Return the state after a frame with a stamp that is `lead` (s) later than possible."""
    last, current = state.leads
    if now - state.window > _LEAD_WINDOW:
        return replace(state, window=now, leads=(current, max(0.0, lead)))
    return replace(state, leads=(last, max(current, lead)))


def _on_monotonic_clock(raw: float, arrival: Arrival, ahead: float) -> tuple[float | None, str | None]:
    """Return the driver's stamp (s) on the monotonic clock, at most `ahead` s later, or None; and a kind of problem."""
    if not raw > 0.0 or not math.isfinite(raw):
        return None, "none"
    max_age = _MAX_AGE if arrival.waited else _MAX_QUEUED_AGE
    if -max_age <= raw - arrival.clock <= ahead:
        return raw, None
    if -max_age <= raw - arrival.realtime <= ahead:
        return raw - arrival.realtime + arrival.clock, "realtime"
    return None, "foreign"


def _delay(state: Stamps, timing: Timing) -> float:
    """Return the mean time (s) from mid-exposure to arrival, or the least possible one."""
    return 0.5 * (timing.likely_exposure + timing.readout) - timing.shift if state.delay is None else state.delay


def _note(trouble: str, state: Stamps, timing: Timing) -> str:
    """Return the log line about a trouble with the driver's stamps, and the substitute."""
    substitute = f"the time of arrival less {1e3 * _delay(state, timing):.1f} ms is taken"
    if state.delay is None:
        substitute += ", which leaves out the transfer"
    lead = f"{1e3 * max(state.leads):.1f} ms"
    return {
        "none": f"the driver gives no stamps; {substitute}",
        "foreign": f"the driver's stamps are of a clock that is not known; {substitute}",
        "realtime": "the driver's stamps are of the realtime clock; they are carried to the monotonic one",
        "ahead": f"the driver's stamps lie ahead of the clock, by {lead} so far; they are taken back by that",
        "back": f"a stamp of the driver jumped back; {substitute}",
        "same": f"the driver gave two frames the same stamp; {substitute}",
    }[trouble]


@dataclass(frozen=True, slots=True)
class Count:
    """Number of frames that the camera produced, from a 32-bit counter that may wrap, stop or restart."""

    number: int = -1  # of the last frame
    raw: int | None = None  # by the driver


def unwrap_count(state: Count, raw: int) -> tuple[Count, int]:
    """Return the next state and a frame's number from 0, with the driver's gaps.

    If the counter stops (some drivers never count) or goes back (the stream restarted), the number increases by one.
    """
    step = 1 if state.raw is None else (raw - state.raw) % 2**32
    if not 0 < step < 2**31:
        step = 1
    return Count(state.number + step, raw), state.number + step
