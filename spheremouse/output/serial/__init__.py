"""`serial:PORT[,baud=115200,third=none|wheel|pan]` and `serial:auto[,id=SERIAL]`: a board that is a USB mouse.

The board may be plugged into another computer than this one. docs/protocol.md says what goes over the line: counters,
not steps, so that nothing is lost and nothing doubled. `auto` takes the board whose USB product is "spheremouse", or
else the only USB serial adapter there is; `id` is its USB serial number where there are several.
A report is written by whoever sends it, without ever waiting; a thread reads answers, keeps the line alive and comes
back to a port that went away. Messages and, at the end, round-trip times go to standard error.
"""

import contextlib
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.output import DeliveryStatus, Report
from spheremouse.output.rate_limited_logger import RateLimitedLogger
from spheremouse.output.serial.link import Link
from spheremouse.output.serial.messages import Flags, Identity, Status
from spheremouse.output.serial.ports import Port, PortGoneError, example_port, find_board, foreign_text, nobody
from spheremouse.output.third_axis import NONE, validate_third

BAUD, SLOWEST, FASTEST = 115200, 38400, 4_000_000
NOT_TAKEN = "the mouse's computer takes no moves: it is off or asleep, or the board is not plugged into it"
TAKEN = "the mouse's computer takes moves again"
FIRST_ANSWER = 3.0  # s; a board that has just been plugged in starts in one or two
_BACK_OFF = (0.1, 0.2, 0.4, 0.8, 1.6, 2.0)  # s
_SILENT = 3.0  # s without an answer after which the port is opened anew; a computer can hold a board up for 2
_QUEUED = 38  # bytes: two frames that the system has not sent yet
_FLUSH = 0.5  # s
_ASK = 0.05  # s between two STATUS?
_AXIS = {"wheel": 2, "pan": 3}


@dataclass(frozen=True, slots=True)
class Statistics:
    """Figures of a run over the line."""

    round_trip: tuple[float, float]  # s, median and 99 %; NaN without answers
    motions: int  # frames
    answers: int
    sessions: int
    breaks: int  # sessions that the line or the board ended
    refused: int  # by the board since it was started
    lost: int
    dropped: int  # counts that came too late for a board that was away
    uncertain: int  # counts under way when the board was started again
    waiting: int  # counts given and not yet passed on, for all that is known here

    def __str__(self) -> str:
        median, slow = (1e3 * t for t in self.round_trip)
        text = f"round trip {median:.2f} ms (99 %: {slow:.2f} ms)" if self.answers else "no answer to a motion"
        text += f"; {self.motions} frames"
        text += f", {self.lost} of them lost and made up for" if self.lost else ""
        text += f", {self.refused} refused" if self.refused else ""
        text += f", {_counted(self.breaks, 'break')} of the line" if self.breaks else ""
        missing = (
            (self.dropped, "dropped (too late)"),
            (self.uncertain, "uncertain (the board was started again)"),
            (self.waiting, "not confirmed at the end"),
        )
        short = ", ".join(f"{n} {what}" for n, what in missing if n)
        return f"{text}; " + (f"counts that did not arrive: {short}" if short else "every count arrived")


class Serial:
    """Sends reports to a board."""

    def __init__(self, find: Callable[[], str], baud: int, third: str, say: Callable[[str], None]) -> None:
        """`find` names the port, anew each time it is opened. Waits for the board's first answer."""
        self._find, self._baud, self._third, self._say = find, baud, third, RateLimitedLogger(say)
        self._lock = threading.Lock()  # of all below; held for microseconds
        self._link = Link(lambda: secrets.randbelow(2**32 - 1) + 1, baud)
        self._port: Port | None = None
        self._unsent = b""
        self._gone = ""  # port and why it is
        self._greeted: Identity | None = None
        self._missed = False  # told that it is away
        self._told_foreign: int | None = None
        self._ready = True  # whether the computer that has the mouse takes reports, as last told
        self._failure: BaseException | None = None
        self._over = threading.Event()
        self._connect_first()
        self._thread = threading.Thread(target=self._run, name="serial", daemon=True)
        self._thread.start()

    def send(self, report: Report) -> None:
        """Add the counts and write a frame if the line takes one now; never waits."""
        x, y, z = report.counts
        counts = [x, y, 0, 0]
        if self._third != "none":
            counts[_AXIS[self._third]] = z
        with self._lock:
            self._link.add(counts, time.perf_counter())
            self._flush()
        if self._failure is not None:
            raise OutputError(f"serial: {self._failure}; start again") from self._failure

    def hold(self, buttons: int) -> None:
        """Buttons that are down from now on: bits 0 to 4. For Python callers; the trackball itself has none."""
        with self._lock:
            self._link.buttons = buttons & 0x1F
            self._link.alive(time.perf_counter())
            self._flush()

    def describe(self, report: Report) -> str:
        """The text twin: what the mouse will do, as in `X +3 Y -2 wheel +1`; and if there is none now."""
        x, y, z = report.counts
        named = (("X", x), ("Y", y), (self._third, z if self._third != "none" else 0))
        text = " ".join(f"{name} {n:+d}" for name, n in named if n)
        return f"{text} (waits for the board)" if text and not self._link.running else text

    def delivery(self) -> DeliveryStatus:
        """Counts that the board has not passed on, and the reason why."""
        axes = (0, 1, *(() if self._third == "none" else (_AXIS[self._third],)))
        with self._lock:
            link, waiting = self._link, self._link.waiting
            lost = [d + u for d, u in zip(link.dropped, link.unproven, strict=True)]
            trouble = f"serial: {self._trouble()}" if link.stuck(time.perf_counter()) else ""
            return DeliveryStatus(trouble, _three(waiting[k] for k in axes), _three(lost[k] for k in axes))

    def drop_waiting(self) -> None:
        """Drop what the board has not passed on."""
        with self._lock:
            self._link.give_up(time.perf_counter())

    def _trouble(self) -> str:
        """The reason why counts do not get through."""
        if self._port is None:
            return f"{self._gone}; plug the board in again"
        if self._link.running and self._link.ack is not None and not self._link.ack.flags & Flags.USB_READY:
            return NOT_TAKEN
        if self._link.foreign is not None:
            return foreign_text(self._link.foreign)
        return f"{self._port.name}: the board does not answer; plug it in again"

    def statistics(self) -> Statistics:
        """Figures of the line so far."""
        with self._lock:
            link = self._link
            return Statistics(
                (link.round_trip(0.5), link.round_trip(0.99)),
                link.motions,
                link.acks,
                link.sessions,
                link.breaks,
                link.ack.refused if link.ack else 0,
                link.ack.lost if link.ack else 0,
                sum(map(abs, link.dropped)),
                sum(map(abs, link.uncertain)),
                sum(map(abs, link.waiting)),
            )

    def status(self, timeout: float = 1.0) -> Status | None:
        """The board's STATUS; None if it does not come within `timeout` s."""
        self._link.status = None
        asked, until = -_ASK, time.perf_counter() + timeout
        while (found := self._link.status) is None and (now := time.perf_counter()) < until:
            if now - asked >= _ASK:  # again: question or answer may be lost
                asked = now
                with self._lock:
                    self._link.ask_status()
                    self._flush()
            time.sleep(0.002)
        return found

    @property
    def identity(self) -> Identity | None:
        """The device that answered."""
        return self._link.identity

    @property
    def settled(self) -> bool:
        """Whether the board has passed on all that was sent."""
        return self._link.settled

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Wait a moment until all has been passed on, release the buttons, close the port."""
        if self._over.is_set():
            return
        until = time.perf_counter() + _FLUSH
        while self._port is not None and not self._link.settled and time.perf_counter() < until:
            with self._lock:
                self._link.alive(time.perf_counter())
            time.sleep(0.001)
        self._over.set()
        self._thread.join(5.0)
        with self._lock:
            self._link.stop()
            stop = self._link.due(time.perf_counter()) if self._link.running else None
            last = self._unsent + (b"\0" + stop if stop else b"")
            port, self._port, self._unsent = self._port, None, b""
        if port is not None:
            with contextlib.suppress(PortGoneError):
                _write_all(port, last, time.perf_counter() + _FLUSH)
            port.close()
        self._say.flush(end=True)
        self._say(f"{self.statistics()}")

    # ---- the thread ----

    def _connect_first(self) -> None:
        try:
            self._open()
            until = time.perf_counter() + FIRST_ANSWER
            while not self._link.running:
                assert self._port is not None
                now = time.perf_counter()
                if self._link.foreign is not None:
                    raise OutputError(f"serial: {self._port.name}: {foreign_text(self._link.foreign)}")
                if now > until:
                    raise OutputError(f"serial: {self._port.name}: {nobody(self._link.damaged)}")
                self._turn(self._port)
        except PortGoneError as e:
            raise OutputError(f"serial: the port went away ({e}); plug the board in again") from None
        finally:
            if not self._link.running and self._port is not None:
                self._port.close()
        self._tell()

    def _run(self) -> None:
        failures = 0
        try:
            while not self._over.is_set():
                if self._port is None:
                    if self._over.wait(_BACK_OFF[min(failures, len(_BACK_OFF) - 1)]):
                        return
                    failures += 1
                    with contextlib.suppress(Exception):  # whatever becomes of a port that is just coming or going
                        self._open()
                    continue
                try:
                    self._turn(self._port)
                    if self._link.running:
                        failures = 0
                    elif time.perf_counter() - max(self._link.heard, self._opened) > _SILENT:
                        raise PortGoneError("no answer")
                except PortGoneError as e:
                    self._close(str(e), quiet=failures > 0)
                self._tell()
        except Exception as e:  # told by the next `send`
            self._failure = e

    def _turn(self, port: Port) -> None:
        """Read what there is, or wait a little; write what is due."""
        with self._lock:
            wait = 0.001 if self._unsent or port.queued() > _QUEUED else self._link.wake(time.perf_counter())
        data = port.read(wait)
        with self._lock:
            if data:
                self._link.receive(data, time.perf_counter())
            self._flush(raising=True)

    def _flush(self, raising: bool = False) -> None:
        """Write as much as the line takes now. The thread alone deals with a port that is gone."""
        try:
            while self._port is not None:
                if not self._unsent:
                    if self._port.queued() > _QUEUED:
                        return
                    self._unsent = self._link.due(time.perf_counter()) or b""
                    if not self._unsent:
                        return
                taken = self._port.write(self._unsent)
                self._unsent = self._unsent[taken:]
                if self._unsent:
                    return
        except PortGoneError:
            if raising:
                raise

    def _open(self) -> None:
        port = Port(self._find(), self._baud)
        with self._lock:
            self._port, self._opened = port, time.perf_counter()
            self._unsent = self._link.opened(self._opened)
            self._flush(raising=True)

    def _close(self, why: str, quiet: bool) -> None:
        with self._lock:
            port, self._port, self._unsent = self._port, None, b""
            self._gone = f"{'the port' if port is None else port.name}: {why}"
            self._link.closed(time.perf_counter())
        if not quiet:
            self._missed = True
            self._say(f"{self._gone}; trying again until it is back")
        if port is not None:
            port.close()  # systems can wait here for seconds

    def _tell(self) -> None:
        """Say what is new."""
        self._say.flush()
        while self._link.notices:
            self._say(self._link.notices.popleft())
        found, port, running = self._link.identity, self._port, self._link.running
        if not running and self._link.foreign not in (None, self._told_foreign):
            self._told_foreign = self._link.foreign
            self._say(foreign_text(self._told_foreign or 0))
        if found is not None and port is not None and running:
            if self._missed or self._greeted is None or found.first != self._greeted.first:
                self._say(f"{found} at {port.name}{' is back' if self._missed else ''}")
            self._greeted, self._missed, self._told_foreign, self._link.foreign = found, False, None, None
        ack = self._link.ack
        if running and ack is not None and self._ready != bool(ack.flags & Flags.USB_READY):
            self._ready = not self._ready
            self._say(TAKEN if self._ready else NOT_TAKEN)


def check_speed(baud: int, name: str) -> int:
    """The speed of a line, if lines have it; else an OutputError that begins with its `name`."""
    if not SLOWEST <= baud <= FASTEST:
        raise OutputError(f"{name}={baud}: must be from {SLOWEST} to {FASTEST}")
    return baud


def open(argument: str) -> Serial:
    """Connect to a board."""
    name, identifier, baud, third = check(argument)

    def find() -> str:
        return name if name != "auto" else find_board(identifier)

    return Serial(find, baud, third, lambda text: print(f"serial: {text}", file=sys.stderr))


def check(argument: str) -> tuple[str, str | None, int, str]:
    """Port or `auto`, serial number of the board, baud and way of the third axis; OutputError on a slip."""
    name, _, rest = argument.partition(",")
    name, whole = "auto" if name.lower() == "auto" else name, f"serial:{argument}".removesuffix(":")
    given = options(rest, {"baud": int, "third": str, "id": str}, whole, OutputError)
    baud, identifier = int(given.get("baud", BAUD)), given.get("id")
    third = validate_third("serial", str(given.get("third", NONE)))
    if not name or "=" in name:
        raise OutputError(f"{whole}: names no port; write serial:auto or serial:{example_port()}")
    check_speed(baud, "serial: baud")
    if identifier is not None and name != "auto":
        raise OutputError(f"{whole}: id= goes with serial:auto; a named port needs none")
    return name, None if identifier is None else str(identifier), baud, third


def _write_all(port: Port, data: bytes, until: float) -> None:
    """Write and see it gone from the system's queue, if it goes in time."""
    while data and time.perf_counter() < until:
        data = data[port.write(data) :]
        time.sleep(0.001 if data else 0.0)
    while port.queued() and time.perf_counter() < until:
        time.sleep(0.001)


def _three(counts: Iterable[int]) -> tuple[int, int, int]:
    """Of x, y and the third axis; 0 where that goes nowhere."""
    x, y, z, *_ = *counts, 0
    return x, y, z


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
