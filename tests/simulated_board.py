"""Simulate a board: the Pico's own protocol.py behind a pseudo-terminal, and a mouse that adds up its reports.

A caller can damage the line, reset the board, let its computer sleep, and unplug it. `python -m tests.simulated_board`
prints the port of one, and the motion of its mouse until Ctrl-C.
"""

import argparse
import contextlib
import importlib.util
import os
import random
import select
import sys
import threading
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any, Self

from spheremouse.files.access import service_files
from spheremouse.output.serial.firmware import PICO


def load_protocol() -> ModuleType:
    """Return the board's protocol.py as a module, because it runs in CPython too."""
    folder = service_files(PICO)
    spec = importlib.util.spec_from_file_location("spheremouse_firmware_protocol", folder / "protocol.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(folder))  # of frames.py
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(folder))
    return module


class Board:
    """The firmware, and a mouse that adds up its reports; bytes in, bytes out."""

    def __init__(
        self, fine: int = 0b101, protocol: ModuleType | None = None, identity: tuple[int, bytes] | None = None
    ) -> None:
        """Take the resolution multipliers that the computer sets, as the byte of report 2.

        `identity` is the firmware's kind and the board's name; default: the simulator's.
        """
        self._protocol: Any = protocol or load_protocol()
        self._fine, self._identity = fine, identity or (self._protocol.SIMULATOR, b"simulator")
        self.moved = [0, 0, 0, 0]  # as the computer sees it; wheel and pan in 1/120 notches
        self.awake = True  # the computer that has the mouse
        self.sleeps_next = False  # the computer falls asleep while the next report waits for it
        self.reports = 0
        self.reset()

    def reset(self) -> None:
        """Reset the board, which then has no session, and is a new mouse to the computer."""
        self.buttons = 0
        self.lines: Any = [self._protocol.Line(), self._protocol.Line()]
        self.device: Any = self._protocol.Device(*self._identity)
        self.device.set_multipliers(self._fine)

    def describe(self) -> str:
        """Return the sums of the mouse, in one line of text."""
        names = ("X", "Y", "wheel", "pan")
        return " ".join(f"{name} {n:+d}" for name, n in zip(names, self.moved, strict=True))

    def turn(self, data: bytes, now: int, line: int = 0) -> bytes:
        """Return the answers, on both lines, to these bytes on one at `now` (ms modulo 2^29)."""
        device, source, at = self.device, self.lines[line], 0
        while at < len(data):
            at = source.take(data, at, len(data))
            if source.length:
                device.handle(source, now)
        device.tick(now)
        device.set_usb(self.awake)
        if device.due():
            if self.sleeps_next:
                self.awake = self.sleeps_next = False
                device.not_passed_on()
            else:
                self._move(device.report)
                device.passed_on()
        answers = b""
        for each in self.lines:
            while (frame := device.answer(each)) is not None:
                answers += bytes(frame)
        return answers

    def _move(self, report: bytearray) -> None:
        """Add a report to the sums, as the computer does."""
        for k in range(4):
            value = int.from_bytes(report[1 + 2 * k : 3 + 2 * k], "little", signed=True)
            self.moved[k] += value * (1 if k < 2 or self._fine else self._protocol.NOTCH)
        self.buttons = report[0]
        self.reports += 1


class Simulator(Board):
    """A board at `port`; a context manager. Its thread runs the firmware's loop."""

    def __init__(
        self,
        damage: float = 0.0,
        seed: int = 0,
        baud: int | None = None,
        on_move: Callable[[list[int]], None] | None = None,
        protocol: ModuleType | None = None,
    ) -> None:
        """Make a board; `damage` is the fraction of bytes that change on the line, in each direction.

        `baud` limits the line's speed, and `on_move` is called with `moved` after each report.
        """
        import pty
        import tty

        self._lock = threading.RLock()
        self.resets = -1  # the first one starts the board
        super().__init__(protocol=protocol)
        self._damage, self._random = damage, random.Random(seed)
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.stalled = False  # the firmware does not run
        self._on_move = on_move
        self._seconds_per_byte = 0.0 if baud is None else 10.0 / baud
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="board", daemon=True)

    def reset(self) -> None:
        with self._lock:
            super().reset()
            self.resets += 1

    def unplug(self) -> None:
        with self._lock:
            for end in (self._master, self._slave):
                with contextlib.suppress(OSError):
                    os.close(end)
            self._master = self._slave = -1

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._thread.join()
        self.unplug()

    # ---- the firmware's loop ----

    def _run(self) -> None:
        while not self._closing.is_set():
            if self.stalled:
                time.sleep(0.001)
                continue
            with self._lock:
                data = self._read()
                time.sleep(self._seconds_per_byte * len(data))
                answers = self.turn(data, int(time.monotonic() * 1000) & 0x1FFFFFFF)
                self._write(answers)
            time.sleep(self._seconds_per_byte * len(answers))

    def _move(self, report: bytearray) -> None:
        super()._move(report)
        if self._on_move is not None:
            self._on_move(self.moved)

    def _read(self) -> bytes:
        if self._master < 0:
            time.sleep(0.001)
            return b""
        if not select.select([self._master], [], [], 0.001)[0]:
            return b""
        with contextlib.suppress(OSError):
            return self._damaged(os.read(self._master, 64))
        return b""

    def _write(self, data: bytes) -> None:
        if data and self._master >= 0:
            with contextlib.suppress(OSError):  # without a reader the bytes are lost, as on a wire
                os.write(self._master, self._damaged(data))

    def _damaged(self, data: bytes) -> bytes:
        if not self._damage:
            return data
        draw = self._random.random
        return bytes(b if draw() >= self._damage else b ^ self._random.randrange(1, 256) for b in data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--damage", type=float, default=0.0, help="damaged bytes each way, per cent")
    with Simulator(parser.parse_args().damage / 100.0) as board, contextlib.suppress(KeyboardInterrupt):
        print(f"serial:{board.port}")
        while True:
            print(f"{board.describe()} buttons {board.buttons:05b}")
            time.sleep(1.0)


if __name__ == "__main__":
    main()
