"""`serial:PORT[,baud=115200,third=none|wheel|pan]` and `serial:auto[,id=SERIAL]`: a board that is a USB mouse.

The board may be plugged into another computer. docs/protocol.md defines the line. It carries counters, not steps, so
no count is lost or doubled. `auto` takes the board with the USB product "spheremouse", or else the only USB serial
adapter. `id` is the board's USB serial number, if there are several. `send` writes without waiting. A thread reads
answers, keeps the line alive and reopens a port that is gone. Messages go to standard error.
"""

import contextlib
import os
import secrets
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.files.access import access_problem
from spheremouse.files.registry import options
from spheremouse.finding import Finding, absent, ok
from spheremouse.output import Counts, DeliveryStatus, Output, Report
from spheremouse.output.rate_limited_logger import RateLimitedLogger
from spheremouse.output.response import KEYS
from spheremouse.output.serial.link import Link
from spheremouse.output.serial.messages import Flags, Identity, Status
from spheremouse.output.serial.ports import Port, PortGoneError, example_port, find_board, no_answer, version_mismatch
from spheremouse.output.third_axis import NONE, validate_third

BAUD, MIN_BAUD, MAX_BAUD = 115200, 38400, 4_000_000
NOT_TAKEN = "the mouse's computer takes no moves: it is off or asleep, or the board is not plugged into it"
TAKEN = "the mouse's computer takes moves again"
FIRST_ANSWER_TIMEOUT = 3.0  # s; a board that was just plugged in starts in one or two
CLOSE_TIMEOUT = 0.5  # s
_RETRY_DELAYS = (0.1, 0.2, 0.4, 0.8, 1.6, 2.0)  # s
_SILENCE_TIMEOUT = 3.0  # s without an answer until the port is reopened; a computer can block a board for 2
_MAX_QUEUED_BYTES = 38  # two frames in the system's queue
_STATUS_INTERVAL = 0.05  # s between two STATUS?
_AXIS_INDEX = {"wheel": 2, "pan": 3}  # of the third axis in a frame


class Serial(Output):
    """Sends reports to a board."""

    paced = True

    def __init__(self, find_port: Callable[[], str], baud: int, third: str, log: Callable[[str], None]) -> None:
        """Open the port that `find_port` returns, now and after each loss, and wait for the board's first answer."""
        self._find_port, self._baud, self._third, self._log = find_port, baud, third, RateLimitedLogger(log)
        self._lock = threading.Lock()  # for the link, the port and the unsent bytes; held for microseconds
        self.link = Link(lambda: secrets.randbelow(2**32 - 1) + 1, baud)
        self._port: Port | None = None
        self._unsent = b""
        self._port_trouble = ""  # name of a port that is gone, and the reason
        self._announced: Identity | None = None
        self._loss_logged = False
        self._logged_version: int | None = None
        self._usb_ready = True  # as last logged
        self._failure: BaseException | None = None  # of the thread; the next `send` raises it
        self._closing = threading.Event()
        self._connect_first()
        self._thread = threading.Thread(target=self._run, name="serial", daemon=True)
        self._thread.start()

    def send(self, report: Report) -> None:
        """Add the counts, and write a frame if the line takes one now. Never waits. Raises a failure of the thread."""
        x, y, z = report.counts
        counts = [x, y, *(z if third == self._third else 0 for third in _AXIS_INDEX)]
        with self._lock:
            self.link.add(counts, time.perf_counter())
            self._flush()
        if self._failure is not None:
            raise OutputError(f"serial: {self._failure}", "start again") from self._failure

    def hold(self, buttons: int) -> None:
        """Press the buttons in bits 0 to 4 and release the others, for Python callers."""
        with self._lock:
            self.link.buttons = buttons & 0x1F
            self.link.keep_alive(time.perf_counter())
            self._flush()

    def delivery(self) -> DeliveryStatus:
        """Return the counts that the board has not confirmed, and the reason."""
        with self._lock:
            link, waiting = self.link, self.link.waiting
            lost = [d + w for d, w in zip(link.dropped, link.written_off, strict=True)]
            trouble = f"serial: {self._trouble()}" if link.has_failed(time.perf_counter()) else ""
            return DeliveryStatus(trouble, self._of_report(waiting), self._of_report(lost))

    def _of_report(self, counts: Sequence[int]) -> Counts:
        """Return x, y and third axis of the counts of a frame; 0 for a third axis that is not sent."""
        return counts[0], counts[1], counts[_AXIS_INDEX[self._third]] if self._third != NONE else 0

    def drop_waiting(self) -> None:
        with self._lock:
            self.link.drop_waiting(time.perf_counter())

    def _trouble(self) -> str:
        if self._port is None:
            return f"{self._port_trouble}; plug the board in again"
        if self.link.running and self.link.ack is not None and not self.link.ack.flags & Flags.USB_READY:
            return NOT_TAKEN
        if self.link.foreign_version is not None:
            return str(version_mismatch(self.link.foreign_version))
        return f"{self._port.name}: the board does not answer; plug it in again"

    def status(self, timeout: float = 1.0) -> Status | None:
        """Return the board's STATUS; None if it does not come within `timeout` (s)."""
        self.link.status = None
        requested, end = float("-inf"), time.perf_counter() + timeout
        while (status := self.link.status) is None and (now := time.perf_counter()) < end:
            if now - requested >= _STATUS_INTERVAL:  # repeated, because a frame may be lost
                requested = now
                with self._lock:
                    self.link.request_status()
                    self._flush()
            time.sleep(0.002)
        return status

    def close(self) -> None:
        """Wait up to 0.5 s for confirmation of all counts, release the buttons, close the port and log statistics."""
        if self._closing.is_set():
            return
        end = time.perf_counter() + CLOSE_TIMEOUT
        while self._port is not None and not self.link.settled and time.perf_counter() < end:
            with self._lock:
                self.link.keep_alive(time.perf_counter())
            time.sleep(0.001)
        self._closing.set()
        self._thread.join(5.0)
        with self._lock:
            self.link.request_stop()
            stop = self.link.next_frame(time.perf_counter()) if self.link.running else None
            last = self._unsent + (b"\0" + stop if stop else b"")
            port, self._port, self._unsent = self._port, None, b""
        if port is not None:
            with contextlib.suppress(PortGoneError):
                port.write_all(last, time.perf_counter() + CLOSE_TIMEOUT)
            port.close()
        self._log.flush(end=True)
        self._log(self.link.summary())

    # ---- the thread ----

    def _connect_first(self) -> None:
        try:
            self._open()
            end = time.perf_counter() + FIRST_ANSWER_TIMEOUT
            while not self.link.running:
                assert self._port is not None
                place = f"serial: {self._port.name}: "
                if self.link.foreign_version is not None:
                    raise version_mismatch(self.link.foreign_version, place)
                if time.perf_counter() > end:
                    raise no_answer(self.link.damaged, place)
                self._read_and_write(self._port)
        except PortGoneError as e:
            raise OutputError(f"serial: the port went away ({e})", "plug the board in again") from None
        finally:
            if not self.link.running and self._port is not None:
                self._port.close()
        self._log_changes()

    def _run(self) -> None:
        """Open the port and exchange frames, until the output closes. A lost port is opened again, ever more rarely."""
        failures = 0
        try:
            while not self._closing.is_set():
                if self._port is None:
                    if self._closing.wait(_RETRY_DELAYS[min(failures, len(_RETRY_DELAYS) - 1)]):
                        return
                    failures += 1
                    with contextlib.suppress(Exception):  # a port that just appears may raise anything
                        self._open()
                    continue
                try:
                    self._read_and_write(self._port)
                    if self.link.running:
                        failures = 0
                    elif time.perf_counter() - max(self.link.last_answer, self._opened) > _SILENCE_TIMEOUT:
                        raise PortGoneError("no answer")
                except PortGoneError as e:
                    self._close_port(str(e), quiet=failures > 0)
                self._log_changes()
        except Exception as e:
            self._failure = e

    def _read_and_write(self, port: Port) -> None:
        """Read the bytes that came, or wait a little; write the frames that are due."""
        with self._lock:
            busy = self._unsent or port.queued() > _MAX_QUEUED_BYTES
            wait = 0.001 if busy else self.link.next_wait(time.perf_counter())
        data = port.read(wait)
        with self._lock:
            if data:
                self.link.receive(data, time.perf_counter())
            self._write_due()

    def _flush(self) -> None:
        with contextlib.suppress(PortGoneError):  # the thread handles it
            self._write_due()

    def _write_due(self) -> None:
        """Write the rest of the last frame, then frames that are due, until the port's queue is full.

        A short queue keeps the motion in it recent. The caller holds the lock. Raises PortGoneError if the port fails.
        """
        port = self._port
        while port is not None and (self._unsent or port.queued() <= _MAX_QUEUED_BYTES):
            self._unsent = self._unsent or self.link.next_frame(time.perf_counter()) or b""
            if not self._unsent:
                return
            self._unsent = self._unsent[port.write(self._unsent) :]
            if self._unsent:
                return

    def _open(self) -> None:
        port = Port(self._find_port(), self._baud)
        with self._lock:
            self._port, self._opened = port, time.perf_counter()
            self._unsent = self.link.port_opened(self._opened)
            self._write_due()

    def _close_port(self, reason: str, quiet: bool) -> None:
        with self._lock:
            port, self._port, self._unsent = self._port, None, b""
            self._port_trouble = f"{'the port' if port is None else port.name}: {reason}"
            self.link.port_closed(time.perf_counter())
        if not quiet:
            self._loss_logged = True
            self._log(f"{self._port_trouble}; trying again until it is back")
        if port is not None:
            port.close()  # may wait for seconds

    def _log_changes(self) -> None:
        """Log the link's notices and each change since the last call: another protocol, the board, its USB state."""
        self._log.flush()
        link, port = self.link, self._port
        while link.notices:
            self._log(link.notices.popleft())
        if not link.running and link.foreign_version not in (None, self._logged_version):
            self._logged_version = link.foreign_version
            self._log(str(version_mismatch(link.foreign_version)))
        identity = link.identity
        if identity is not None and port is not None and link.running:
            if self._loss_logged or self._announced is None or identity.first != self._announced.first:
                self._log(f"{identity} at {port.name}{' is back' if self._loss_logged else ''}")
            self._announced, self._loss_logged, self._logged_version = identity, False, None
            link.foreign_version = None
        if link.running and link.ack is not None and self._usb_ready != bool(link.ack.flags & Flags.USB_READY):
            self._usb_ready = not self._usb_ready
            self._log(TAKEN if self._usb_ready else NOT_TAKEN)


def validate_baud(baud: int, name: str) -> int:
    """Return a line's speed. Raise OutputError with the option's `name` if no line has it."""
    if not MIN_BAUD <= baud <= MAX_BAUD:
        raise OutputError(f"{name}={baud}: must be from {MIN_BAUD} to {MAX_BAUD}")
    return baud


def open(argument: str) -> Serial:
    name, identifier, baud, third = check(argument)

    def find_port() -> str:
        return name if name != "auto" else find_board(identifier)

    return Serial(find_port, baud, third, lambda text: print(f"serial: {text}", file=sys.stderr))


def check(argument: str) -> tuple[str, str | None, int, str]:
    """Return port or `auto`, the board's USB serial number (None: any), baud and `third=`; OutputError if invalid."""
    name, _, rest = argument.partition(",")
    name, whole = "auto" if name.lower() == "auto" else name, f"serial:{argument}".removesuffix(":")
    given = options(rest, {"baud": int, "third": str, "id": str, **KEYS}, whole, OutputError)
    baud, identifier = int(given.get("baud", BAUD)), given.get("id")
    third = validate_third("serial", str(given.get("third", NONE)))
    if not name or "=" in name:
        raise OutputError(f"{whole}: names no port", f"write serial:auto or serial:{example_port()}")
    validate_baud(baud, "serial: baud")
    if identifier is not None and name != "auto":
        raise OutputError(f"{whole}: id= goes with serial:auto", "a named port needs none")
    return name, None if identifier is None else str(identifier), baud, third


def probe(argument: str) -> list[Finding]:
    name, identifier, _, _ = check(argument)
    try:
        port = Path(find_board(identifier) if name == "auto" else name)
    except OutputError as e:
        return [absent("serial board", e.problem, e.hint)]
    if os.name == "posix":
        if not port.exists():
            return [
                absent("serial board", f"{port} does not exist", "plug the board in, or name its port: serial:auto")
            ]
        if problem := access_problem(port):
            return [absent("serial board", *problem)]
    return [ok("serial board", f"at {port}; check it with `spheremouse firmware check`")]
