"""`serial:PORT[,baud=115200,third=none|wheel|pan]` and `serial:auto[,id=SERIAL]`: a board that is a USB mouse.

The board may be plugged into another computer than this one. docs/protocol.md says what goes over the line: counters,
not steps, so that nothing is lost and nothing doubled. `auto` takes the board whose USB product is "spheremouse", or
else the only USB serial adapter there is; `id` is its USB serial number where there are several.
A motion is written by whoever sends it, without ever waiting; a thread reads answers, keeps the line alive and comes
back to a port that went away. Messages and, at the end, round-trip times go to standard error.
"""

import contextlib
import os
import secrets
import select
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import OutputError
from spheremouse.motion import Motion
from spheremouse.output._serial_protocol import VERSION, Identity, Link, Status
from spheremouse.spec import options

BAUD, SLOWEST = 115200, 38400
THIRD = ("none", "wheel", "pan")
PRODUCT = "spheremouse"
ADAPTERS = {  # USB vendor and product of chips that are nothing but a serial adapter
    (0x10C4, 0xEA60): "CP210x",
    (0x1A86, 0x7523): "CH340",
    (0x1A86, 0x55D4): "CH9102",
    (0x0403, 0x6001): "FT232R",
    (0x0403, 0x6015): "FT231X",
    (0x067B, 0x2303): "PL2303",
    (0x2E8A, 0x000C): "Debug Probe",
}
FIRST_ANSWER = 3.0  # s; a board that has just been plugged in starts in one or two
_BACK_OFF = (0.1, 0.2, 0.4, 0.8, 1.6, 2.0)  # s
_SILENT = 2.0  # s without an answer after which the port is opened anew
_QUEUED = 38  # bytes: two frames that the system has not sent yet
_FLUSH = 0.2  # s
_AXIS = {"wheel": 2, "pan": 3}


class PortGoneError(Exception):
    """The port cannot be used any more."""


class Port:
    """A serial port that never waits but to read."""

    def __init__(self, name: str, baud: int) -> None:
        """Raises OutputError where it cannot be opened."""
        import serial

        try:
            self._port = serial.Serial(name, baud, timeout=0.0, write_timeout=0.0, exclusive=True)
            self._port.reset_input_buffer()
            with contextlib.suppress(Exception):
                self._port.set_low_latency_mode(True)  # an FTDI chip holds answers back for 16 ms otherwise
        except (OSError, ValueError) as e:
            raise OutputError(f"serial: {_refusal(name, e)}") from None
        self.name = name
        self._posix = os.name == "posix"

    def read(self, timeout: float) -> bytes:
        """What has come in; waits for `timeout` s at most."""
        try:
            if not self._posix:
                return self._read_elsewhere(timeout)
            if not select.select([self._port.fileno()], [], [], timeout)[0]:
                return b""
            data = os.read(self._port.fileno(), 4096)
        except BlockingIOError:
            return b""
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None
        if not data:
            raise PortGoneError("unplugged")
        return data

    def write(self, data: bytes) -> int:
        """Bytes that were taken, without waiting."""
        try:
            return os.write(self._port.fileno(), data) if self._posix else int(self._port.write(data) or 0)
        except BlockingIOError:
            return 0
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None

    def queued(self) -> int:
        """Bytes that the system has taken and not sent."""
        try:
            return int(self._port.out_waiting)
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None

    def close(self) -> None:
        """Close it, whatever has become of it; what is still queued is not waited for."""
        with contextlib.suppress(Exception):
            self._port.reset_output_buffer()
        with contextlib.suppress(Exception):
            self._port.close()

    def _read_elsewhere(self, timeout: float) -> bytes:
        """Windows has no `select` for ports."""
        until = time.monotonic() + timeout
        while not (waiting := self._port.in_waiting) and time.monotonic() < until:
            time.sleep(0.001)
        return self._port.read(waiting) if waiting else b""


@dataclass(frozen=True, slots=True)
class Statistics:
    """What a run over the line came to."""

    round_trip: tuple[float, float]  # s, median and 99 %; NaN without answers
    motions: int  # frames
    answers: int
    sessions: int
    refused: int  # by the board since it was started
    lost: int
    dropped: int  # counts that came too late for a board that was away
    uncertain: int  # counts under way when the board was started again

    def __str__(self) -> str:
        median, slow = (1e3 * t for t in self.round_trip)
        text = f"round trip {median:.2f} ms (99 %: {slow:.2f} ms)" if self.answers else "no answer"
        text += f"; {self.motions} frames, {self.lost} lost, {self.refused} refused, {self.sessions} sessions"
        text += f"; {self.dropped} counts dropped" if self.dropped else ""
        return text + (f"; {self.uncertain} counts uncertain" if self.uncertain else "")


class Serial:
    """Sends motions to a board."""

    def __init__(self, find: Callable[[], str], baud: int, third: str, say: Callable[[str], None]) -> None:
        """`find` names the port, anew each time it is opened. Waits for the board's first answer."""
        self._find, self._baud, self._third, self._say = find, baud, third, say
        self._lock = threading.Lock()  # of all below; held for microseconds
        self._link = Link(lambda: secrets.randbelow(2**32 - 1) + 1, baud)
        self._port: Port | None = None
        self._unsent = b""
        self._greeted: Identity | None = None
        self._failure: BaseException | None = None
        self._over = threading.Event()
        self._connect_first()
        self._thread = threading.Thread(target=self._run, name="serial", daemon=True)
        self._thread.start()

    def send(self, motion: Motion) -> None:
        """Add the counts and write a frame if the line takes one now; never waits."""
        x, y, z = motion.counts
        counts = [x, y, 0, 0]
        if self._third != "none":
            counts[_AXIS[self._third]] = z
        with self._lock:
            self._link.add(counts, time.monotonic())
            self._flush()
        if self._failure is not None:
            raise OutputError(f"serial: {self._failure}; start again") from self._failure

    def hold(self, buttons: int) -> None:
        """Buttons that are down from now on: bits 0 to 4."""
        with self._lock:
            self._link.buttons = buttons & 0x1F
            self._link.alive(time.monotonic())
            self._flush()

    def describe(self, motion: Motion) -> str:
        """The text twin: what the mouse will do, as in `X +3 Y -2 wheel +1`; and if there is none now."""
        x, y, z = motion.counts
        named = (("X", x), ("Y", y), (self._third, z if self._third != "none" else 0))
        text = " ".join(f"{name} {n:+d}" for name, n in named if n)
        return f"{text} (waits for the board)" if text and not self._link.running else text

    def statistics(self) -> Statistics:
        """How the line does."""
        with self._lock:
            link = self._link
            return Statistics(
                (link.round_trip(0.5), link.round_trip(0.99)),
                link.motions,
                link.acks,
                link.sessions,
                link.ack.refused if link.ack else 0,
                link.ack.lost if link.ack else 0,
                sum(map(abs, link.dropped)),
                sum(map(abs, link.uncertain)),
            )

    def status(self, timeout: float = 1.0) -> Status | None:
        """What the board says of how it fares; None if it does not within `timeout` s."""
        with self._lock:
            self._link.status = None
            self._link.ask_status()
            self._flush()
        until = time.monotonic() + timeout
        while (found := self._link.status) is None and time.monotonic() < until:
            time.sleep(0.005)
        return found

    @property
    def identity(self) -> Identity | None:
        """Who answered."""
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
        until = time.monotonic() + _FLUSH
        while self._link.running and not self._link.settled and time.monotonic() < until:
            time.sleep(0.001)
        self._over.set()
        self._thread.join(5.0)
        with self._lock:
            self._link.stop()
            with contextlib.suppress(PortGoneError):
                if self._port is not None and self._unsent:
                    self._port.write(self._unsent)
                if self._port is not None and (stop := self._link.due(time.monotonic())):
                    self._port.write(stop)
                    while self._port.queued() and time.monotonic() < until + _FLUSH:
                        time.sleep(0.001)
            if self._port is not None:
                self._port.close()
                self._port = None
        self._say(f"{self.statistics()}")

    # ---- the thread ----

    def _connect_first(self) -> None:
        self._open()
        until = time.monotonic() + FIRST_ANSWER
        try:
            while not self._link.running:
                assert self._port is not None
                now = time.monotonic()
                if self._link.foreign is not None:
                    raise OutputError(f"serial: {self._port.name}: {_foreign(self._link.foreign)}")
                if now > until:
                    raise OutputError(
                        f"serial: {self._port.name}: no board of ours answers; see `spheremouse firmware check`, "
                        "and on a plain serial line whether RX and TX are exchanged"
                    )
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
                    with contextlib.suppress(OutputError, PortGoneError):
                        self._open()
                    continue
                try:
                    self._turn(self._port)
                    if self._link.running:
                        failures = 0
                    elif time.monotonic() - max(self._link.heard, self._opened) > _SILENT:
                        raise PortGoneError("no answer")
                except PortGoneError as e:
                    self._close(str(e), quiet=failures > 0)
                self._tell()
        except Exception as e:  # told by the next `send`
            self._failure = e

    def _turn(self, port: Port) -> None:
        """Read what there is, or wait a little; write what is due."""
        with self._lock:
            wait = 0.001 if self._unsent or port.queued() > _QUEUED else self._link.wake(time.monotonic())
        data = port.read(wait)
        with self._lock:
            if data:
                self._link.receive(data, time.monotonic())
            self._flush(raising=True)

    def _flush(self, raising: bool = False) -> None:
        """Write as much as the line takes now. The thread alone deals with a port that is gone."""
        try:
            while self._port is not None:
                if not self._unsent:
                    if self._port.queued() > _QUEUED:
                        return
                    self._unsent = self._link.due(time.monotonic()) or b""
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
            self._port, self._opened = port, time.monotonic()
            self._unsent = self._link.opened(self._opened)
            self._flush(raising=True)

    def _close(self, why: str, quiet: bool) -> None:
        with self._lock:
            name = "the port" if self._port is None else self._port.name
            if self._port is not None:
                self._port.close()
            self._port, self._unsent = None, b""
            self._link.closed()
        if not quiet:
            self._say(f"{name}: {why}; trying again until it is back")

    def _tell(self) -> None:
        """Say what is new."""
        while self._link.notices:
            self._say(self._link.notices.popleft())
        found = self._link.identity
        first = None if found is None else found.first
        known = None if self._greeted is None else self._greeted.first
        if found is not None and self._port is not None and self._link.running and first != known:
            self._greeted = found
            self._say(f"{found} at {self._port.name}")


def open(argument: str) -> Serial:
    """Connect to a board."""
    name, _, rest = argument.partition(",")
    whole = f"serial:{argument}"
    given = options(rest, {"baud": int, "third": str, "id": str}, whole, OutputError)
    baud, third, identifier = int(given.get("baud", BAUD)), str(given.get("third", "none")), given.get("id")
    if not name or "=" in name:
        raise OutputError(f"{whole}: names no port; write serial:auto or serial:{_example_port()}")
    if third not in THIRD:
        raise OutputError(f"serial: third={third}; write third= with one of {', '.join(THIRD)}")
    if not SLOWEST <= baud <= 4_000_000:
        raise OutputError(f"serial: baud={baud}: must be from {SLOWEST} to 4000000")
    if identifier is not None and name != "auto":
        raise OutputError(f"{whole}: id= goes with serial:auto; a named port needs none")

    def find() -> str:
        return name if name != "auto" else find_board(None if identifier is None else str(identifier))

    return Serial(find, baud, third, lambda text: print(f"serial: {text}", file=sys.stderr))


def find_board(identifier: str | None = None, ports: list[Any] | None = None) -> str:
    """The port of the board by its USB identity; `ports` as pyserial lists them."""
    if ports is None:
        from serial.tools import list_ports

        ports = list(list_ports.comports())
    ports = [p for p in ports if p.vid is not None]
    found = _by_board([p for p in ports if PRODUCT in f"{p.product} {p.serial_number}".lower()])
    if not found and identifier is None:
        found = _by_board([p for p in ports if (p.vid, p.pid) in ADAPTERS])
    elif identifier is not None:
        found = {key: port for key, port in _by_board(ports).items() if port.serial_number == identifier}
    if len(found) == 1:
        return next(iter(found.values())).device
    if found:
        several = ", ".join(f"id={p.serial_number} at {p.device}" for p in found.values())
        raise OutputError(f"serial:auto: several boards ({several}); write serial:auto,id=... or serial:PORT")
    there = ", ".join(p.device for p in ports)
    raise OutputError(
        "serial:auto: no board "
        + (f"with id={identifier}" if identifier is not None else "of ours")
        + (f" among {there}; name its port: serial:PORT" if there else " is plugged in; plug it in")
        + ", or see `spheremouse firmware install`"
    )


def _by_board(ports: list[Any]) -> dict[Any, Any]:
    """One port per board: of a console and a data port, which come in this order, the data port.

    Never the console: a Ctrl-C among the bytes of a frame would stop the firmware.
    """
    found: dict[Any, Any] = {}
    for port in sorted(ports, key=_interface):
        found[(port.vid, port.pid, port.serial_number or port.location or port.device)] = port
    return found


def _interface(port: Any) -> tuple[int, str, int, str]:
    """Data ports behind consoles: by the interface's name, else by its number, else by the port's name."""
    number = (port.location or "").rpartition(":")[2]
    return (int("CDC2" in (port.interface or "")), number, len(port.device), port.device)


def _foreign(version: int) -> str:
    what = "another version" if version == VERSION else f"version {version}"
    return f"the board speaks {what} of the protocol, this is {VERSION}; run `spheremouse firmware install`"


def _refusal(name: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if isinstance(error, FileNotFoundError) or number == 2:
        return f"{name} does not exist; plug the board in, or see which ports there are with serial:auto"
    if isinstance(error, PermissionError) or number == 13:
        return f"{name} may not be used; be in its group (dialout on Debian: sudo adduser $USER dialout), log in again"
    if number in (11, 16) or "exclusively lock" in str(error):
        return f"{name} is in use by another program; end that one"
    return f"{name} cannot be opened: {_reason(error)}"


def _reason(error: Exception) -> str:
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return " ".join(text.split())


def _example_port() -> str:
    return "COM5" if os.name == "nt" else "/dev/ttyACM1"
