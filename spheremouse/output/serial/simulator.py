"""A board without a board: the Pico's own protocol.py behind a pseudo-terminal, and a mouse that adds up its reports.

Damage on the line, resets, a computer that sleeps and pulled plugs are had for the asking.
"""

import contextlib
import os
import random
import select
import threading
import time
from collections.abc import Callable
from types import ModuleType, TracebackType
from typing import Any, Self

from spheremouse.errors import OutputError
from spheremouse.output.serial.firmware import load_protocol

Counts = tuple[int, int, int, int]  # x, y, wheel, pan


class Simulator:
    """A board at `port`; a context manager. Its thread is the firmware's loop."""

    def __init__(
        self,
        damage: float = 0.0,
        seed: int = 0,
        fine: bool = True,
        baud: int | None = None,
        on_move: Callable[[list[int]], None] | None = None,
        protocol: ModuleType | None = None,
    ) -> None:
        """`damage`: share of bytes that change on the way, in both directions; `fine`: 1/120 notches are on;
        `baud`: the line is no faster, either way; `on_move` is called with `moved` after every report.
        """
        try:
            import pty
            import tty
        except ImportError:
            raise OutputError("firmware simulate: needs pseudo-terminals, which Windows has not") from None
        self._protocol: Any = protocol or load_protocol()
        self._damage, self._random = damage, random.Random(seed)
        self._fine = 0b101 if fine else 0
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.moved = [0, 0, 0, 0]  # as the computer sees it; wheel and pan in 1/120 notches
        self.buttons = 0
        self.presses = 0  # reports in which buttons changed
        self.awake = True  # the computer whose mouse this is
        self.nods_off = False  # whether it falls asleep while the next report waits for it
        self.reports = self.resets = 0
        self._reset = False
        self._on_move = on_move
        self._pace = None if baud is None else baud / 10.0  # bytes/s
        self._earned, self._earned_at = 0.0, time.monotonic()
        self._free_at = 0.0  # s, when the line back is free again
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._boot()
        self._thread = threading.Thread(target=self._run, name="board", daemon=True)

    def reset(self) -> None:
        """Like its reset button: all it knew is gone."""
        self._reset = True
        while self._reset and self._thread.is_alive():
            time.sleep(0.001)

    def unplug(self) -> None:
        """Pull the serial cable; the board goes on without it."""
        with self._lock:
            for end in (self._master, self._slave):
                with contextlib.suppress(OSError):
                    os.close(end)
            self._master = self._slave = -1

    @property
    def device(self) -> Any:
        """The firmware's own state."""
        return self._device

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self.unplug()

    # ---- the firmware's loop ----

    def _boot(self) -> None:
        self._line = self._protocol.Line()
        self._device = self._protocol.Device(self._protocol.SIMULATOR, b"simulator")
        self._device.set_multipliers(self._fine)

    def _run(self) -> None:
        while not self._over.is_set():
            if self._reset:
                self._boot()
                self._release()
                self.resets += 1
                self._reset = False
            with self._lock:
                self._turn(_ticks())

    def _turn(self, now: int) -> None:
        device, line = self._device, self._line
        data = self._read()
        at = 0
        while at < len(data):
            at = line.take(data, at, len(data))
            if line.length:
                device.handle(line, now)
        device.tick(now)
        device.set_usb(self.awake)
        if device.due():
            if self.nods_off:
                self.awake = self.nods_off = False
                device.not_passed_on()
            else:
                self._move(device.report)
                device.passed_on()
        while time.monotonic() >= self._free_at and (frame := device.answer(line)) is not None:
            self._write(bytes(frame))

    def _move(self, report: bytearray) -> None:
        """Add a report to the pointer, as the computer does."""
        values = [int.from_bytes(report[k : k + 2], "little", signed=True) for k in (1, 3, 5, 7)]
        for k, n in enumerate(values):
            self.moved[k] += n * (1 if k < 2 or self._fine else self._protocol.NOTCH)
        self.presses += report[0] != self.buttons
        self.buttons = report[0]
        self.reports += 1
        if self._on_move is not None:
            self._on_move(self.moved)

    def _release(self) -> None:
        """A board that starts again is a mouse plugged in anew: no button is down."""
        self.presses += self.buttons != 0
        self.buttons = 0

    def _read(self) -> bytes:
        if self._master < 0:
            time.sleep(0.001)
            return b""
        if not select.select([self._master], [], [], 0.001)[0]:
            return b""
        room = 64 if self._pace is None else self._allowed(self._pace)
        try:
            return self._noisy(os.read(self._master, room)) if room else b""
        except OSError:
            return b""

    def _allowed(self, pace: float) -> int:
        """Bytes that a line of this speed has brought since the last ones were taken."""
        now = time.monotonic()
        self._earned = min(64.0, self._earned + pace * (now - self._earned_at))
        self._earned_at = now
        whole = int(self._earned)
        self._earned -= whole
        if not whole:
            time.sleep(1.0 / pace)
        return whole

    def _write(self, data: bytes) -> None:
        if self._pace is not None:
            self._free_at = time.monotonic() + len(data) / self._pace
        if self._master >= 0:
            with contextlib.suppress(OSError):  # nobody reads: gone, as on a wire
                os.write(self._master, self._noisy(data))

    def _noisy(self, data: bytes) -> bytes:
        if not self._damage:
            return data
        draw = self._random.random
        return bytes(b if draw() >= self._damage else b ^ self._random.randrange(1, 256) for b in data)


def _ticks() -> int:
    return int(time.monotonic() * 1000) & 0x1FFFFFFF
