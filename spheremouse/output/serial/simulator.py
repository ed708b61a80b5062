"""Simulate a board: the Pico's own protocol.py behind a pseudo-terminal, and a mouse that adds up its reports.

A caller can damage the line, reset the board, let its computer sleep, and unplug it.
"""

import contextlib
import os
import random
import select
import threading
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any, Self

from spheremouse.errors import OutputError
from spheremouse.output.serial.firmware import load_protocol


class Simulator:
    """A board at `port`; a context manager. Its thread runs the firmware's loop."""

    def __init__(
        self,
        damage: float = 0.0,
        seed: int = 0,
        fine: bool = True,
        baud: int | None = None,
        on_move: Callable[[list[int]], None] | None = None,
        protocol: ModuleType | None = None,
    ) -> None:
        """Make a board; `damage` is the fraction of bytes that change on the line, in each direction.

        `fine` enables 1/120 notches, `baud` limits the line's speed, and `on_move` is called with `moved` after each
        report.
        """
        try:
            import pty
            import tty
        except ImportError:
            raise OutputError("firmware simulate: needs pseudo-terminals, which Windows does not have") from None
        self._protocol: Any = protocol or load_protocol()
        self._damage, self._random = damage, random.Random(seed)
        self._fine = 0b101 if fine else 0
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.moved = [0, 0, 0, 0]  # as the computer sees it; wheel and pan in 1/120 notches
        self.buttons = 0
        self.awake = True  # the computer that has the mouse
        self.stalled = False  # the firmware stands still
        self.sleeps_next = False  # the computer falls asleep while the next report waits for it
        self.reports = self.resets = 0
        self._reset = False
        self._on_move = on_move
        self._bytes_per_second = None if baud is None else baud / 10.0
        self._allowance, self._allowance_time = 0.0, time.monotonic()  # bytes that may be read, at a time (s)
        self._write_free = 0.0  # s, when the line to the host is free
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._boot()
        self._thread = threading.Thread(target=self._run, name="board", daemon=True)

    def reset(self) -> None:
        """Reset the board, which then has no session."""
        self._reset = True
        while self._reset and self._thread.is_alive():
            time.sleep(0.001)

    def unplug(self) -> None:
        """Unplug the serial cable. The board keeps running."""
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

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._thread.join()
        self.unplug()

    # ---- the firmware's loop ----

    def _boot(self) -> None:
        self._line = self._protocol.Line()
        self._device = self._protocol.Device(self._protocol.SIMULATOR, b"simulator")
        self._device.set_multipliers(self._fine)

    def _run(self) -> None:
        while not self._closing.is_set():
            if self._reset:
                self._boot()
                self.buttons = 0  # the computer sees a new mouse
                self.resets += 1
                self._reset = False
            if self.stalled:
                time.sleep(0.001)
                continue
            with self._lock:
                self._step(int(time.monotonic() * 1000) & 0x1FFFFFFF)

    def _step(self, now: int) -> None:
        device, line = self._device, self._line
        data, at = self._read(), 0
        while at < len(data):
            at = line.take(data, at, len(data))
            if line.length:
                device.handle(line, now)
        device.tick(now)
        device.set_usb(self.awake)
        if device.due():
            if self.sleeps_next:
                self.awake = self.sleeps_next = False
                device.not_passed_on()
            else:
                self._move(device.report)
                device.passed_on()
        while time.monotonic() >= self._write_free and (frame := device.answer(line)) is not None:
            self._write(bytes(frame))

    def _move(self, report: bytearray) -> None:
        """Add a report to the sums, as the computer does."""
        values = [int.from_bytes(report[k : k + 2], "little", signed=True) for k in (1, 3, 5, 7)]
        for k, n in enumerate(values):
            self.moved[k] += n * (1 if k < 2 or self._fine else self._protocol.NOTCH)
        self.buttons = report[0]
        self.reports += 1
        if self._on_move is not None:
            self._on_move(self.moved)

    def _read(self) -> bytes:
        if self._master < 0:
            time.sleep(0.001)
            return b""
        if not select.select([self._master], [], [], 0.001)[0]:
            return b""
        size = 64 if self._bytes_per_second is None else self._allowed(self._bytes_per_second)
        try:
            return self._damaged(os.read(self._master, size)) if size else b""
        except OSError:
            return b""

    def _allowed(self, bytes_per_second: float) -> int:
        """Return the number of bytes that a line of this speed has brought since the last call."""
        now = time.monotonic()
        self._allowance = min(64.0, self._allowance + bytes_per_second * (now - self._allowance_time))
        self._allowance_time = now
        whole = int(self._allowance)
        self._allowance -= whole
        if not whole:
            time.sleep(1.0 / bytes_per_second)
        return whole

    def _write(self, data: bytes) -> None:
        if self._bytes_per_second is not None:
            self._write_free = time.monotonic() + len(data) / self._bytes_per_second
        if self._master >= 0:
            with contextlib.suppress(OSError):  # without a reader the bytes are lost, as on a wire
                os.write(self._master, self._damaged(data))

    def _damaged(self, data: bytes) -> bytes:
        if not self._damage:
            return data
        draw = self._random.random
        return bytes(b if draw() >= self._damage else b ^ self._random.randrange(1, 256) for b in data)
