"""The host's end of docs/protocol.md without port, thread or clock: a ledger of counts, sessions and answers.

Counts and received bytes go in with their time (s, of any monotonic clock). Frames to send come out.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from spheremouse.output.serial import messages

STEP_LIMIT = 1200  # counts: 600 per radian x 20 rad/s x SILENCE
SILENCE = 0.1  # s without a MOTION, after which the device ends the session
FAILURE_DELAY = 0.5  # s; a new session begins after 0.2 s without answers, and by then ten HELLOs were sent

_MAX_SPREAD = STEP_LIMIT // 2  # counts between any two positions that the device may have obeyed
_KEEP_ALIVE_INTERVAL = 0.02  # s between two MOTIONs: five chances before the device times out
_HELLO_INTERVAL = 0.05  # s
_ANSWER_TIMEOUT = 0.2  # s: twice the silence, after which the device has ended the session anyway
_TRACKER_TIMEOUT = 1.0  # s without a report: slower than any camera
_MAX_DELAY = 1.0  # s; later counts would make the pointer jump
_MAX_UNANSWERED = 8  # frames: 13 ms of a line at 115200 baud
_RETRY_BITS = 3 * 19 * 10  # with more unanswered frames, a third of the line's speed
_MAX_IN_FLIGHT = 64  # frames whose send time is kept
_ROUND_TRIPS = 4096  # the last ones are kept


class _Targets:
    """Interval on each axis of all positions (sums of counts) that the device may have reached."""

    def __init__(self, confirmed: Sequence[int]) -> None:
        self._pending: deque[tuple[int, list[int], list[int]]] = deque()  # number, lowest, highest
        self.low, self.high = list(confirmed), list(confirmed)

    def limited(self, total: Sequence[int]) -> list[int]:
        """Return the next target: `total`, limited so that no step of the device is too large, whatever was lost."""
        return [
            min(max(t, high - _MAX_SPREAD), low + _MAX_SPREAD)
            for t, low, high in zip(total, self.low, self.high, strict=True)
        ]

    def add(self, number: int, target: list[int]) -> None:
        self._pending.append((number, target, target))
        self.low, self.high = _hull([self.low, self.high, target])
        if len(self._pending) > _MAX_IN_FLIGHT:  # join the two oldest
            (_, *first), (newer, *second) = self._pending.popleft(), self._pending.popleft()
            self._pending.appendleft((newer, *_hull([*first, *second])))

    def acknowledge(self, number: int, confirmed: list[int]) -> None:
        """Remove older targets than an answer's. The device may still be on the way to the answered one."""
        while self._pending and messages.to_signed(self._pending[0][0] - number) < 0:
            self._pending.popleft()
        if self._pending and self._pending[0] == (number, confirmed, confirmed):
            self._pending.popleft()
        self.low, self.high = _hull([confirmed, *(end for _, *ends in self._pending for end in ends)])


class Link:
    """Counts that were submitted to a microcontroller, sent and confirmed, over sessions, breaks and resets."""

    def __init__(self, draw_session: Callable[[], int], baud: int = 115200) -> None:
        """Take a function that returns session numbers: not 0, and never the same twice."""
        self.total, self.sent, self.confirmed = [0] * 4, [0] * 4, [0] * 4
        self.dropped = [0] * 4  # counts, with their signs
        # At resets of the board: counts sent and not confirmed, and the largest error, either way, of taking them for
        # confirmed.
        self.written_off, self.uncertain = [0] * 4, [0] * 4
        self.buttons = 0
        self.identity: messages.Identity | None = None  # of the current or last session
        self.status: messages.Status | None = None
        self.ack: messages.Ack | None = None
        self.foreign_version: int | None = None  # of a device with another protocol
        self.running = False
        self.blocked_since: float | None = None  # s; None if no blockage was detected
        self.last_answer = -np.inf  # s
        self.sessions = self.motions = self.acks = 0
        self.breaks = 0  # sessions that the line or the device ended
        self.notices: deque[str] = deque(maxlen=100)  # lines to log
        self._draw_session, self._retry_interval = draw_session, _RETRY_BITS / baud
        self._splitter = messages.Splitter()
        self._session = 0  # requested or current; 0: there is no port
        self._hello_time = 0.0
        # Counts at the session's start, and counters of the last ACK
        self._at_start, self._acknowledged = [0] * 4, [0] * 4
        self._targets = _Targets(self.confirmed)
        self._sent_buttons = 0
        self._number, self._answered = 0, -1  # of the next frame, and of the last one answered
        self._last_motion = self._tracker_reported = self._unconfirmed_since = -np.inf  # s
        self._in_flight: dict[int, float] = {}  # s, send time by number
        self._round_trips: deque[float] = deque(maxlen=_ROUND_TRIPS)
        self._status_requested = self._stop_requested = False

    # ---- from the tracker ----

    def add(self, counts: Sequence[int], now: float) -> None:
        """Add counts of x, y, wheel, pan."""
        self._tracker_reported = now
        if self.settled:
            self._unconfirmed_since = now
        for k, n in enumerate(counts):
            self.total[k] += int(n)
        self._drop_old(now)

    def keep_alive(self, now: float) -> None:
        """Keep the session without a report."""
        self._tracker_reported = now

    def drop_waiting(self, now: float) -> None:
        """Drop the counts that wait, and begin a new session, so that the device drops them as well."""
        if not self.settled:
            self._drop(self.sent)
            self._unconfirmed_since = -np.inf
            if self.running:
                self._begin(now)

    def has_failed(self, now: float) -> bool:
        """Return True if nothing arrives for longer than a new session takes."""
        return self.blocked_since is not None and now - self.blocked_since > FAILURE_DELAY

    def request_status(self) -> None:
        """Send STATUS? next."""
        self._status_requested = True

    def request_stop(self) -> None:
        """Send STOP next, which ends the session."""
        self._stop_requested = self.running

    # ---- from the port ----

    def port_opened(self, now: float) -> bytes:
        """Begin on a port without waiting bytes; return the bytes to send first."""
        self._splitter = messages.Splitter()
        self._begin(now)
        return b"\0"

    def port_closed(self, now: float) -> None:
        """End the session, because the port is gone."""
        self.breaks += self.running
        self._end(now)
        self._session = 0

    def receive(self, data: bytes, now: float) -> None:
        """Process bytes that came from the device by `now` (s)."""
        for frame in self._splitter.take(data):
            if frame.version != messages.VERSION:
                if frame.type == messages.IDENTITY:
                    self.foreign_version = frame.version
                continue
            self.last_answer = now
            message = messages.parse(frame)
            if isinstance(message, messages.Identity):
                self._on_identity(message, now)
            elif isinstance(message, messages.Ack):
                self._on_ack(message, now)
            elif isinstance(message, messages.Status):
                self.status = message

    # ---- to the port ----

    def next_frame(self, now: float) -> bytes | None:
        """Return the frame to send now; None if there is none."""
        self._drop_old(now)
        if self.running:
            if self._stop_requested:
                self._stop_requested = self.running = False
                self._session = 0
                return messages.encode(messages.STOP, self._take_number(now))
            oldest = min(self._in_flight.values(), default=now)
            if self._unanswered and now - max(self.last_answer, oldest) > _ANSWER_TIMEOUT:
                self.breaks += 1
                self._begin(now)
            elif now - self._tracker_reported < _TRACKER_TIMEOUT and now - self._last_motion >= SILENCE:
                self._begin(now)  # the device has ended the session
        if not self.running:
            if self._session and now >= self._hello_time:
                self._hello_time = now + _HELLO_INTERVAL
                return messages.hello(self._take_number(now), self._session)
            return None
        if self._status_requested:
            self._status_requested = False
            return messages.encode(messages.ASK_STATUS, self._take_number(now))
        return self._next_motion(now)

    def _next_motion(self, now: float) -> bytes | None:
        """Return the MOTION to send now; None if none is due.

        A change goes out at once, or at the retry interval if many frames are unanswered. Without a change, a MOTION
        keeps the session alive. Each has the sums of counts since the session's start, so it replaces a lost one. If
        the tracker does not report for 1 s, none is sent, and the device ends the session.
        """
        if now - self._tracker_reported >= _TRACKER_TIMEOUT:
            return None
        target = self._targets.limited(self.total)
        if target == self.sent and self.buttons == self._sent_buttons:
            interval = _KEEP_ALIVE_INTERVAL
        else:
            interval = self._retry_interval if self._unanswered >= _MAX_UNANSWERED else 0.0
        if now - self._last_motion < interval:
            return None
        self.sent, self._sent_buttons, self._last_motion = target, self.buttons, now
        self.motions += 1
        number = self._take_number(now)
        self._targets.add(number, target)
        counters = [s - b for s, b in zip(target, self._at_start, strict=True)]
        return messages.motion(number, counters, self.buttons)

    def next_wait(self, now: float) -> float:
        """Return the time (s) until `next_frame` may return a frame without new input."""
        if self.running:
            busy = self.total != self.sent and self._unanswered >= _MAX_UNANSWERED
            interval = self._retry_interval if busy else _KEEP_ALIVE_INTERVAL
            left = self._last_motion + interval - now if now - self._tracker_reported < _TRACKER_TIMEOUT else np.inf
        else:
            left = self._hello_time - now if self._session else np.inf
        return max(0.0, min(_KEEP_ALIVE_INTERVAL, left))

    @property
    def settled(self) -> bool:
        """True if all counts are confirmed or dropped."""
        return self.total == self.confirmed

    @property
    def waiting(self) -> list[int]:
        """Counts that were added and are neither confirmed nor dropped."""
        return [t - c for t, c in zip(self.total, self.confirmed, strict=True)]

    @property
    def damaged(self) -> int:
        """Damaged answers since the port was opened."""
        return self._splitter.damaged

    def round_trip(self, q: float) -> float:
        """Return a quantile of the last round-trip times (s); NaN before the first answer."""
        return float(np.quantile(self._round_trips, q)) if self._round_trips else float("nan")

    def summary(self) -> str:
        """Return the figures of a run over the line in words."""
        text = f"{self.motions} frames"
        if self._round_trips:
            median, slow = (1e3 * self.round_trip(q) for q in (0.5, 0.99))
            text = f"round trip {median:.2f} ms (99 %: {slow:.2f} ms); {text}"
        if self.ack is not None:
            text += f", {self.ack.lost} of them lost and made up for" if self.ack.lost else ""
            text += f", {self.ack.refused} refused" if self.ack.refused else ""
        text += f", {self.breaks} break{'' if self.breaks == 1 else 's'} of the line" if self.breaks else ""
        missing = (
            (self.dropped, "dropped (too late)"),
            (self.uncertain, "uncertain (the board was started again)"),
            (self.waiting, "not confirmed at the end"),
        )
        short = ", ".join(f"{n} {reason}" for counts, reason in missing if (n := sum(map(abs, counts))))
        return f"{text}; " + (f"counts that did not arrive: {short}" if short else "every count arrived")

    # ---- sessions ----

    @property
    def _unanswered(self) -> int:
        return (self._number - 1 - self._answered) & 0xFFFF

    def _take_number(self, now: float) -> int:
        number = self._number
        self._number = (number + 1) & 0xFFFF
        self._in_flight[number] = now
        while len(self._in_flight) > _MAX_IN_FLIGHT:
            del self._in_flight[next(iter(self._in_flight))]
        return number

    def _end(self, now: float) -> None:
        """Note that no session runs, and since when counts are blocked."""
        if self.running and self.blocked_since is None:
            self.blocked_since = now
        self.running = False

    def _begin(self, now: float) -> None:
        """Request a new session. Its number stays the same until the device answers."""
        if self.running or not self._session:
            self._end(now)
            self._session = self._draw_session()
        self._hello_time = now

    def _on_identity(self, identity: messages.Identity, now: float) -> None:
        """Begin the session that was requested, unless the answer is to an older request.

        The device's counters confirm what arrived in the last session. If it was started again, or another host has
        used it, they are lost, so all sent counts are taken for confirmed. If it accepted no MOTION of the last
        session, those counts are sent again. Counts that have waited for more than `_MAX_DELAY` are dropped. All
        counters of this session begin at 0.
        """
        if self.running or not self._session or identity.session != self._session:
            return
        previous, before = self.identity, list(self.confirmed)
        if previous is not None and identity.last == previous.session:
            self._confirm(identity.counters)
        elif previous is not None and (identity.first, identity.last) != (previous.first, previous.last):
            self._write_off()
        self.identity = identity
        if now - self._unconfirmed_since > _MAX_DELAY:
            self._drop(self.confirmed)
        if before != self.confirmed:
            self._unconfirmed_since = now
        self.sent, self._at_start, self._acknowledged = list(self.confirmed), list(self.confirmed), [0] * 4
        self._targets = _Targets(self.confirmed)
        self._in_flight.clear()
        self._answered, self._sent_buttons, self._last_motion = (self._number - 1) & 0xFFFF, 0, now
        self.running = True
        self.sessions += 1

    def _on_ack(self, ack: messages.Ack, now: float) -> None:
        if not self.running or not 0 < (ack.number - self._answered) & 0xFFFF <= self._unanswered:
            return  # of an older frame than the last answered one
        self.ack = ack
        self.acks += 1
        if ack.flags & messages.Flags.RUNNING and ack.flags & messages.Flags.USB_READY:
            self.blocked_since = None
        elif self.blocked_since is None:
            self.blocked_since = now
        if not ack.flags & messages.Flags.RUNNING:
            self.breaks += 1
            self._begin(now)
            return
        if ack.number in self._in_flight:
            self._round_trips.append(now - self._in_flight[ack.number])
        self._answered = ack.number
        for number in [n for n in self._in_flight if messages.to_signed(n - ack.number) <= 0]:
            del self._in_flight[number]
        before = list(self.confirmed)
        self._confirm(ack.counters)
        self._targets.acknowledge(ack.number, self.confirmed)
        if before != self.confirmed or self.settled:
            self._unconfirmed_since = now

    def _confirm(self, counters: Sequence[int]) -> None:
        """Add the growth of the device's counters, modulo 2^16, to the confirmed counts."""
        self.confirmed = [
            c + messages.to_signed(n - a) for c, n, a in zip(self.confirmed, counters, self._acknowledged, strict=True)
        ]
        self._acknowledged = list(counters)

    def _write_off(self) -> None:
        """Take all sent counts for confirmed, because the board has lost its counters. Nothing is sent twice."""
        bounds = zip(self.sent, self._targets.low, self._targets.high, strict=True)
        errors = [max(s - low, high - s) for s, low, high in bounds]
        self.uncertain = [u + n for u, n in zip(self.uncertain, errors, strict=True)]
        self.written_off = [w + s - c for w, s, c in zip(self.written_off, self.sent, self.confirmed, strict=True)]
        self.confirmed = list(self.sent)
        total = sum(errors)
        counts = f"; {total} count{'s' if total != 1 else ''} uncertain" if total else ""
        self.notices.append(f"the board was started again{counts}")

    def _drop_old(self, now: float) -> None:
        if not self.settled and now - self._unconfirmed_since > _MAX_DELAY:
            self._drop(self.sent)

    def _drop(self, keep: Sequence[int]) -> None:
        """Give up all counts above the totals `keep`, and count them as dropped."""
        self.dropped = [d + t - k for d, t, k in zip(self.dropped, self.total, keep, strict=True)]
        self.total = list(keep)


def _hull(points: Sequence[Sequence[int]]) -> tuple[list[int], list[int]]:
    return [min(axis) for axis in zip(*points, strict=True)], [max(axis) for axis in zip(*points, strict=True)]
