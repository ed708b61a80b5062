"""When a frame was taken: the driver's stamp, checked, becomes mid-exposure of the middle row on time.monotonic().

A rolling shutter begins to expose row v of h at b + readout v/h and reads it `exposure` later. Mid-exposure of the
middle row is therefore b + (exposure + readout)/2, and the last row has been read at b + exposure + readout. What
moment a stamp tells is said by the driver (V4L2, "Buffer Flags", V4L2_BUF_FLAG_TSTAMP_SRC_MASK):

    exposure begins (SRC_SOE)           stamp + (exposure + readout)/2
    first packet (uvcvideo, see below)  stamp + (readout - exposure)/2
    end of frame (SRC_EOF)              stamp - (exposure + readout)/2

uvcvideo says SRC_SOE. With its module parameter hwtimestamps the camera's own clock tells that moment; without, which
is the default, the stamp is the kernel's clock at the frame's first packet, and that cannot come before the first row
was read. An exposure that is not known lies between nothing and the frame interval; half the interval is taken, and the
stamp is wrong by a quarter of it at most, always by the same: rates do not suffer, latency is off by that.

Stamps are not trusted: some drivers give none, or those of another clock, or lie ahead of it. No clock is read here.
"""

import enum
import math
from dataclasses import dataclass, replace

_LATE = 1.0  # s that a frame may be older than its arrival, where it was waited for
_QUEUED = 60.0  # s, where it was not: it may have lain in the queue
_AHEAD = 0.25  # s ahead of the clock from which on it is another clock
_WINDOW = 5.0  # s; how far ahead the driver is, is remembered for one to two of these
_LEARN = 1.0 / 16.0  # weight of a new frame in the learnt delay
_LEAST = 0.1  # of the frame interval, between two stamps


class Moment(enum.Enum):
    """Moments of a frame that a driver's stamp may tell."""

    EXPOSURE_BEGINS = "start of exposure"
    FIRST_PACKET = "first packet"
    END_OF_FRAME = "end of frame"


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of a frame's course, as far as they are known."""

    moment: Moment
    interval: float  # s between frames
    exposure: float | None = None  # s; None: not known
    readout: float = 0.0  # s, of all rows
    shift: float = 0.0  # s, added to every stamp

    @property
    def likely_exposure(self) -> float:
        """s; half the interval where nothing is known."""
        return 0.5 * self.interval if self.exposure is None else self.exposure

    @property
    def bound(self) -> float:
        """s by which mid-exposure may be wrong because the exposure is not known."""
        return 0.25 * self.interval if self.exposure is None else 0.0

    @property
    def to_middle(self) -> float:
        """s from the driver's stamp to mid-exposure of the middle row, and the shift asked for."""
        e, r = self.likely_exposure, self.readout
        match self.moment:
            case Moment.EXPOSURE_BEGINS:
                return 0.5 * (e + r) + self.shift
            case Moment.FIRST_PACKET:
                return 0.5 * (r - e) + self.shift
            case Moment.END_OF_FRAME:
                return -0.5 * (e + r) + self.shift

    @property
    def least_delay(self) -> float:
        """s from mid-exposure of the middle row until the whole frame can be there."""
        return 0.5 * ((self.exposure or 0.0) + self.readout)


@dataclass(frozen=True, slots=True)
class Arrival:
    """Times at which a frame came to us."""

    clock: float  # s, time.monotonic()
    realtime: float  # s, time.time() at the same moment
    waited: bool  # for this frame: it has not lain in the queue


@dataclass(frozen=True, slots=True)
class Stamps:
    """State learnt from the frames so far; `stamped` makes the next."""

    last: float = -math.inf  # s, the stamp given last
    raw: float = math.nan  # s, the driver's
    window: float = -math.inf  # s, when the present window began
    leads: tuple[float, float] = (
        0.0,
        0.0,
    )  # s, how far the driver was ahead at most: in the window before, in this one
    delay: float | None = None  # s, arrival less mid-exposure, where stamps were good
    said: frozenset[str] = frozenset()  # kinds of trouble that have been told


def stamped(state: Stamps, raw: float, arrival: Arrival, timing: Timing) -> tuple[Stamps, float, str | None]:
    """The state after a frame, its stamp in s, and what was wrong with the driver's, said once a kind.

    `raw` is the driver's stamp in s. The stamp given is later than the one before, and not later than the arrival.
    Stamps ahead of the clock are all taken back by the same, so that they keep their regular steps.
    """
    good, trouble = _of_our_clock(raw, arrival, max(_AHEAD, timing.interval))
    middle = None
    if good is not None:
        lead = good + timing.to_middle - (arrival.clock - timing.least_delay)
        state = _leading(state, lead, arrival.clock)
        if lead > timing.bound and trouble is None:
            trouble = "ahead"
        middle = good + timing.to_middle - max(state.leads)
        if middle <= state.last:
            middle, trouble = None, trouble or ("same" if raw == state.raw else "back")
    if middle is None:
        middle = arrival.clock - _delay(state, timing)
    elif arrival.waited:
        new = arrival.clock - middle
        old = new if state.delay is None else state.delay
        state = replace(state, delay=old + _LEARN * (new - old))
    stamp = min(max(middle, state.last + _LEAST * timing.interval), arrival.clock)
    stamp = max(stamp, math.nextafter(state.last, math.inf))
    said = None
    if trouble is not None and trouble not in state.said:
        said = _words(trouble, state, timing)
        state = replace(state, said=state.said | {trouble})
    return replace(state, last=stamp, raw=raw), stamp, said


def _leading(state: Stamps, lead: float, now: float) -> Stamps:
    """The state with one more frame that came `lead` s sooner than it can have."""
    before, here = state.leads
    if now - state.window > _WINDOW:
        return replace(state, window=now, leads=(here, max(0.0, lead)))
    return replace(state, leads=(before, max(here, lead)))


def _of_our_clock(raw: float, arrival: Arrival, ahead: float) -> tuple[float | None, str | None]:
    """The driver's stamp on the monotonic clock, in s, or None; and the kind of trouble, if any."""
    if not raw > 0.0 or not math.isfinite(raw):
        return None, "none"
    late = _LATE if arrival.waited else _QUEUED
    if -late <= raw - arrival.clock <= ahead:
        return raw, None
    if -late <= raw - arrival.realtime <= ahead:
        return raw - arrival.realtime + arrival.clock, "realtime"
    return None, "foreign"


def _delay(state: Stamps, timing: Timing) -> float:
    """s from mid-exposure to arrival, as learnt, or the least that can be."""
    return 0.5 * (timing.likely_exposure + timing.readout) - timing.shift if state.delay is None else state.delay


def _words(trouble: str, state: Stamps, timing: Timing) -> str:
    instead = f"the time of arrival less {1e3 * _delay(state, timing):.1f} ms is taken"
    if state.delay is None:
        instead += ", which leaves out the transfer"
    lead = f"{1e3 * max(state.leads):.1f} ms"
    return {
        "none": f"the driver gives no stamps; {instead}",
        "foreign": f"the driver's stamps are of a clock that is not known; {instead}",
        "realtime": "the driver's stamps are of the realtime clock; they are carried to the monotonic one",
        "ahead": f"the driver's stamps lie ahead of the clock, by {lead} so far; they are taken back by that",
        "back": f"a stamp of the driver jumped back; {instead}",
        "same": f"the driver gave two frames the same stamp; {instead}",
    }[trouble]


@dataclass(frozen=True, slots=True)
class Count:
    """Frames that the camera produced, from a 32-bit counter that may wrap, stick or begin anew."""

    given: int = -1  # the number given last
    raw: int | None = None  # the driver's


def counted(state: Count, raw: int) -> tuple[Count, int]:
    """The state after a frame and its number: 0, 1, ...; a gap is as wide as the driver's.

    A counter that stands still (some drivers never count) or goes back (the stream began anew) goes on by one.
    """
    step = 1 if state.raw is None else (raw - state.raw) % 2**32
    if not 0 < step < 2**31:
        step = 1
    return Count(state.given + step, raw), state.given + step
