"""The host's end of docs/protocol.md, without port, thread or clock: frames as dataclasses, and the link as a ledger.

Counts and bytes that came in, with the time in seconds, go in; bytes to send come out.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from spheremouse.output.serial.messages import (
    ASK_STATUS,
    IDENTITY,
    STOP,
    VERSION,
    Ack,
    Flags,
    Identity,
    Splitter,
    Status,
    encode,
    hello,
    motion,
    parse,
    signed,
)

STEP = 1200  # counts: 600 per radian x 20 rad/s x SILENCE
_REACH = STEP // 2  # between any two places that the board may have obeyed
SILENCE = 0.1  # s
AXES = ("X", "Y", "wheel", "pan")

_KEEP = 0.02  # s between two MOTIONs: five chances before the device goes silent
_REPEAT = 0.05  # s between two HELLOs
_PATIENCE = 0.2  # s without an answer: twice the silence, after which the device has ended the session anyway
_HANGS = 1.0  # s without a motion from the tracker: slower than any camera
_BREAK = 1.0  # s after which counts are too late to be wanted
# s without a session, or with a computer that takes nothing, after which that is a failure: without an answer a session
# is begun anew after 0.2 s, and in 0.5 s there are ten HELLOs, each answered within milliseconds.
STUCK = 0.5
_AHEAD = 8  # frames unanswered: 13 ms of a line at 115200 baud
_INSIST = 3 * 19 * 10  # bits: with more unanswered, a third of the line
_FLYING = 64  # frames under way that are told apart
_TIMES = 4096  # round trips remembered
_REMEMBERED = 64  # sessions


# ---- frames ----


# ---- the link ----


class Link:
    """Ledger of counts given, sent and passed on, over sessions, breaks and resets. Times in s of any steady clock."""

    def __init__(self, session: Callable[[], int], baud: int = 115200) -> None:
        """`session` draws numbers that are not 0 and never come again."""
        self._insist = _INSIST / baud  # s
        self.total, self.sent, self.confirmed = [0] * 4, [0] * 4, [0] * 4
        self.dropped = [0] * 4  # counts, with their signs
        # At each reset of the board, what was sent and not confirmed, with its sign; and how far from it, at most, what
        # arrived may be, either way.
        self.unproven, self.uncertain = [0] * 4, [0] * 4
        self.buttons = 0
        self.identity: Identity | None = None  # of the session that runs or ran last
        self.status: Status | None = None
        self.ack: Ack | None = None
        self.foreign: int | None = None  # version of a device that speaks another one
        self.running = False
        self.broken: float | None = None  # s, since when nothing gets through; None: it does, for all that is known
        self.heard = -np.inf  # s, last answer
        self.sessions = self.motions = self.acks = 0
        self.breaks = 0  # sessions that did not end by this end's own silence or word
        self.notices: deque[str] = deque(maxlen=100)
        self._draw = session
        self._frames = Splitter()
        self._asked = 0  # session; 0: none, there is no port
        self._drawn: deque[int] = deque(maxlen=_REMEMBERED)  # sessions, the last one asked for
        self._hello_at = 0.0
        self._mine: Identity | None = None
        self._heard_of: Ack | None = None  # the last one in this session
        self._strayed = False  # has an answer shown that a HELLO from before has begun another?
        self._base, self._acked = [0] * 4, [0] * 4
        self._pressed = 0  # in the last MOTION
        self._number, self._answered = 0, -1
        self._moved = self._said = self._since = -np.inf  # s: last MOTION, last `add`, nothing confirmed since
        self._flying: dict[int, float] = {}
        self._targets: deque[tuple[int, list[int], list[int]]] = deque()  # number, from, to: where the board may go
        self._lowest, self._highest = [0] * 4, [0] * 4  # of them, and of `confirmed`
        self._times: deque[float] = deque(maxlen=_TIMES)
        self._wants_status = self._wants_stop = False

    # ---- from the tracker ----

    def add(self, counts: Sequence[int], now: float) -> None:
        """Counts of x, y, wheel, pan."""
        self._said = now
        if self.total == self.confirmed:
            self._since = now
        for k, n in enumerate(counts):
            self.total[k] += int(n)
        self._expire(now)

    def alive(self, now: float) -> None:
        """The tracker lives, though it has nothing to say."""
        self._said = now

    def give_up(self, now: float) -> None:
        """Drop what has not got through; a session that runs is begun anew, so that the device drops it as well."""
        if not self.settled:
            self._drop(self.sent)
            self._since = -np.inf
            if self.running:
                self._begin(now)

    def stuck(self, now: float) -> bool:
        """Whether nothing gets through, and for longer than it takes to begin anew."""
        return self.broken is not None and now - self.broken > STUCK

    def ask_status(self) -> None:
        """Ask the device for its STATUS."""
        self._wants_status = True

    def stop(self) -> None:
        """Have STOP sent; the session ends with it."""
        self._wants_stop = self.running

    # ---- from the port ----

    def opened(self, now: float) -> bytes:
        """A port is open, and nothing waits in it: what to send first."""
        self._frames = Splitter()
        self._begin(now)
        return b"\0"

    def closed(self, now: float) -> None:
        """The port is gone."""
        self.breaks += self.running
        self._ended(now)
        self._asked = 0

    def receive(self, data: bytes, now: float) -> None:
        """Take in bytes that the device sent."""
        for frame in self._frames.take(data):
            if frame.version != VERSION:
                if frame.type == IDENTITY:
                    self.foreign = frame.version
                continue
            self.heard = now
            found = parse(frame)
            if isinstance(found, Identity):
                self._identified(found, now)
            elif isinstance(found, Ack):
                self._acknowledged(found, now)
            elif isinstance(found, Status):
                self.status = found

    # ---- to the port ----

    def due(self, now: float) -> bytes | None:
        """The next frame to send, if there is one now."""
        self._expire(now)
        if self.running:
            if self._wants_stop:
                self._wants_stop = False
                self.running, self._asked = False, 0
                return encode(STOP, self._next(now))
            if self._unanswered and now - max(self.heard, min(self._flying.values(), default=now)) > _PATIENCE:
                self.breaks += 1
                self._begin(now)
            elif now - self._said < _HANGS and now - self._moved >= SILENCE:
                self._begin(now)  # the device has gone silent
        if not self.running:
            if self._asked and now >= self._hello_at:
                self._hello_at = now + _REPEAT
                return hello(self._next(now), self._asked)
            return None
        if self._wants_status:
            self._wants_status = False
            return encode(ASK_STATUS, self._next(now))
        if now - self._said >= _HANGS:
            return None
        target = self._target()
        news = target != self.sent or self.buttons != self._pressed
        wait = _KEEP if not news else self._insist if self._unanswered >= _AHEAD else 0.0
        if now - self._moved < wait:
            return None
        self.sent, self._pressed, self._moved = target, self.buttons, now
        self.motions += 1
        self._targets.append((self._number, target, target))
        self._lowest, self._highest = _hull([self._lowest, self._highest, target])
        if len(self._targets) > _FLYING:  # two as one, that reaches as far as both
            (_, *one), (number, *other) = self._targets.popleft(), self._targets.popleft()
            self._targets.appendleft((number, *_hull([*one, *other])))
        counters = [s - b for s, b in zip(target, self._base, strict=True)]
        return motion(self._next(now), counters, self.buttons)

    def wake(self, now: float) -> float:
        """Seconds until `due` may have something to say though nothing comes in."""
        if self.running:
            wait = self._insist if self.total != self.sent and self._unanswered >= _AHEAD else _KEEP
            return max(0.0, min(_KEEP, self._moved + wait - now)) if now - self._said < _HANGS else _KEEP
        return max(0.0, min(_KEEP, self._hello_at - now)) if self._asked else _KEEP

    @property
    def settled(self) -> bool:
        """Whether all that was given has been passed on."""
        return self.total == self.confirmed

    @property
    def waiting(self) -> list[int]:
        """Counts that were given and neither passed on for all that is known, nor dropped."""
        return [t - c for t, c in zip(self.total, self.confirmed, strict=True)]

    @property
    def damaged(self) -> int:
        """Answers that came damaged since the port was opened."""
        return self._frames.damaged

    def round_trip(self, q: float) -> float:
        """Quantile of the round-trip time of the last answers, s; NaN before the first."""
        return float(np.quantile(self._times, q)) if self._times else float("nan")

    # ---- within ----

    @property
    def _unanswered(self) -> int:
        return (self._number - 1 - self._answered) & 0xFFFF

    def _target(self) -> list[int]:
        """Target of the next MOTION: not far from anything that is under way, whichever of it the board has obeyed.

        So no step is too large, and a board that is reset is nowhere farther from `sent` than that.
        """
        return [
            min(max(t, high - _REACH), low + _REACH)
            for t, low, high in zip(self.total, self._lowest, self._highest, strict=True)
        ]

    def _next(self, now: float) -> int:
        number = self._number
        self._number = (number + 1) & 0xFFFF
        self._flying[number] = now
        while len(self._flying) > _FLYING:
            del self._flying[next(iter(self._flying))]
        return number

    def _ended(self, now: float) -> None:
        if self.running and self.broken is None:
            self.broken = now
        self.running = False

    def _begin(self, now: float) -> None:
        """Ask for a new session; the number stays the same until it is answered."""
        if self.running or not self._asked:
            self._ended(now)
            self._asked = self._draw()
            self._drawn.append(self._asked)
        self._hello_at = now

    def _identified(self, found: Identity, now: float) -> None:
        if self.running and self._mine is not None and found.last == self._mine.session:
            self._leave_for(found, now)
        if self.running or not self._asked or found.session != self._asked:
            return
        mine, before = self._mine, self.confirmed
        if mine is not None and found.last == mine.session and not self._strayed:
            self._confirm(found.counters)
        elif mine is not None and (found.first, found.last) != (mine.first, mine.last):
            ours = found.last in self._drawn
            self._write_off("begun anew by a frame from before" if ours else "started again")
            if ours:  # it has obeyed us there
                self._acked = [0] * 4
                self._confirm(found.counters)
        self._mine = self.identity = found
        if now - self._since > _BREAK:
            self._drop(self.confirmed)
        if before != self.confirmed:
            self._since = now
        self.sent, self._base, self._acked = list(self.confirmed), list(self.confirmed), [0] * 4
        self._flying.clear()
        self._targets.clear()
        self._lowest, self._highest = list(self.confirmed), list(self.confirmed)
        self._answered, self._pressed, self._moved = (self._number - 1) & 0xFFFF, 0, now
        self.running, self._strayed, self._heard_of = True, False, None
        self.sessions += 1

    def _leave_for(self, found: Identity, now: float) -> None:
        """A HELLO from before has begun a session in place of ours; what the board does in it is ours as well."""
        self._confirm(found.counters)
        self._mine, self._acked = found, [0] * 4
        self.breaks += 1
        self._begin(now)

    def _acknowledged(self, ack: Ack, now: float) -> None:
        newer = 0 < (ack.number - self._answered) & 0xFFFF <= self._unanswered
        if not self.running or not newer:  # one from before: what came since has said more
            return
        if self._heard_of is not None and self._implausible(ack, self._heard_of):
            self._strayed = True
            self.breaks += 1
            self._begin(now)
            return
        self.ack = self._heard_of = ack
        self.acks += 1
        if ack.flags & Flags.RUNNING and ack.flags & Flags.USB_READY:
            self.broken = None
        elif self.broken is None:
            self.broken = now
        if not ack.flags & Flags.RUNNING:
            self.breaks += 1
            self._begin(now)
            return
        if ack.number in self._flying:
            self._times.append(now - self._flying[ack.number])
        self._answered = ack.number
        for number in [n for n in self._flying if signed(n - ack.number) <= 0]:
            del self._flying[number]
        before = list(self.confirmed)
        self._confirm(ack.counters)
        while self._targets and signed(self._targets[0][0] - ack.number) < 0:
            self._targets.popleft()  # the newest that was answered may be due still
        if self._targets and self._targets[0] == (ack.number, self.confirmed, self.confirmed):
            self._targets.popleft()
        self._lowest, self._highest = _hull([self.confirmed, *(t for _, *two in self._targets for t in two)])
        if before != self.confirmed or self.settled:
            self._since = now

    def _implausible(self, ack: Ack, before: Ack) -> bool:
        """Has the board missed more frames than were sent? Then a HELLO from before has set its numbers back."""
        return (ack.lost - before.lost) & 0xFFFF > (self._number - 1 - before.number) & 0xFFFF

    def _confirm(self, counters: Sequence[int]) -> None:
        self.confirmed = [c + signed(n - a) for c, n, a in zip(self.confirmed, counters, self._acked, strict=True)]
        self._acked = list(counters)

    def _write_off(self, why: str) -> None:
        """The board has forgotten where it was. What may have been passed on is not sent again."""
        far = [max(s - a, b - s) for s, a, b in zip(self.sent, self._lowest, self._highest, strict=True)]
        self.uncertain = [u + n for u, n in zip(self.uncertain, far, strict=True)]
        self.unproven = [u + s - c for u, s, c in zip(self.unproven, self.sent, self.confirmed, strict=True)]
        self.confirmed = list(self.sent)
        self.notices.append(f"the board was {why}" + (f"; {_several(far)} uncertain" if any(far) else ""))

    def _expire(self, now: float) -> None:
        if not self.settled and now - self._since > _BREAK:
            self._drop(self.sent)

    def _drop(self, keep: Sequence[int]) -> None:
        self.dropped = [d + t - s for d, t, s in zip(self.dropped, self.total, keep, strict=True)]
        self.total = list(keep)


def _hull(points: Sequence[Sequence[int]]) -> tuple[list[int], list[int]]:
    """The lowest and the highest of each axis."""
    return [min(axis) for axis in zip(*points, strict=True)], [max(axis) for axis in zip(*points, strict=True)]


def _several(counts: Sequence[int]) -> str:
    n = sum(map(abs, counts))
    return f"{n} count{'s' if n != 1 else ''}"
