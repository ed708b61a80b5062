"""A host and a board with a bad line between them and a clock that is turned by hand; `python -m tests.serial_world`.

The board is the firmware's own protocol.py, here under CPython; tests/output/serial/test_firmware.py puts
MicroPython in its place.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np

from spheremouse.output.serial.firmware import load_protocol
from spheremouse.output.serial.link import Link

PROTOCOL: Any = load_protocol()


class Board:
    """The firmware and a mouse that adds up."""

    def __init__(self, fine: int = 0b101) -> None:
        self.moved, self.buttons, self.usb = [0, 0, 0, 0], 0, True
        self._fine = fine
        self.reset()

    def reset(self) -> None:
        """Power off, power on."""
        self.buttons = 0
        self.line, self.device = PROTOCOL.Line(), PROTOCOL.Device(PROTOCOL.SIMULATOR, b"world")
        self.device.set_multipliers(self._fine)

    def turn(self, data: bytes, now: int) -> bytes:
        """What it answers to these bytes at `now` ms."""
        line, device, at = self.line, self.device, 0
        while at < len(data):
            at = line.take(data, at, len(data))
            if line.length:
                device.handle(line, now)
        device.tick(now)
        device.set_usb(self.usb)
        if device.due():
            for k in range(4):
                value = int.from_bytes(device.report[1 + 2 * k : 3 + 2 * k], "little", signed=True)
                self.moved[k] += value
            self.buttons = device.report[0]
            device.passed_on()
        out = b""
        while (frame := device.answer(line)) is not None:
            out += bytes(frame)
        return out


class Wire:
    """One direction of the line, and what it does to bytes."""

    def __init__(self, rng: np.random.Generator, damage: float = 0.0, lose: float = 0.0, twice: float = 0.0) -> None:
        """Shares of bytes damaged, and of pieces that are lost or come twice."""
        self.cut = False
        self.held: bytes | None = None  # comes after the next piece
        self._rng, self._damage, self._lose, self._twice = rng, damage, lose, twice
        self._gaps: Iterator[int] = self._geometric()
        self._sound = next(self._gaps) if damage else 0  # bytes until the next that is damaged

    def _geometric(self) -> Iterator[int]:
        while True:
            yield from (int(n) - 1 for n in self._rng.geometric(self._damage, 4096))

    def heal(self) -> None:
        """Nothing more becomes of what it is given."""
        self.cut, self._damage, self._lose, self._twice = False, 0.0, 0.0, 0.0

    def __call__(self, data: bytes) -> bytes:
        if not data or self.cut:
            return b""
        if self._lose and self._rng.random() < self._lose:
            return b""
        if self._twice and self._rng.random() < self._twice:
            data += data
        if not self._damage:
            return data
        if self._sound >= len(data):
            self._sound -= len(data)
            return data
        worn, at = bytearray(data), self._sound
        while at < len(worn):
            worn[at] ^= int(self._rng.integers(1, 256))
            at += 1 + next(self._gaps)
        self._sound = at - len(worn)
        return bytes(worn)


class World:
    """Host, board and two wires; `step` is a millisecond."""

    def __init__(self, board: Any, up: Wire, down: Wire, begin_ms: int = 0) -> None:
        numbers = count(1)
        self.link = Link(lambda: next(numbers) * 0x01010101 & 0xFFFFFFFF or 1)
        self.board, self.up, self.down = board, up, down
        self.ms, self.given = begin_ms, [0, 0, 0, 0]
        self._waiting, self.resets = b"", 0
        self._first = self.link.opened(self.now)

    @property
    def now(self) -> float:
        """s"""
        return self.ms / 1000.0

    def reset(self) -> None:
        """The board's button."""
        self.board.reset()
        self.resets += 1

    def give(self, counts: Any) -> None:
        """One motion."""
        for k, n in enumerate(counts):
            self.given[k] += int(n)
        self.link.add(counts, self.now)

    def step(self, extra: bytes = b"", run: bool = True) -> None:
        """A millisecond; `extra` bytes fall into the line; `run`: whether the host's program does."""
        data = self.up(self._first) + extra
        self._first = b""
        if run:
            while (frame := self.link.due(self.now)) is not None:
                data += self.up(frame)
        answer = self.board.turn(data, self.ms & 0x1FFFFFFF)
        self.ms += 1
        if run:
            self.link.receive(self._waiting, self.now)
            self._waiting = b""
        self._waiting += self.down(answer)

    def settle(self, most: int = 2000) -> None:
        """Let it come to rest, with a sound line and a tracker that says nothing new."""
        self.up.heal()
        self.down.heal()
        for _ in range(most):
            self.link.alive(self.now)
            self.step()
            if self.link.running and self.link.settled:
                return

    @property
    def short(self) -> list[int]:
        """Counts that were given and did not arrive."""
        return [g - m for g, m in zip(self.given, self.board.moved, strict=True)]


def exchange(board: Any, motions: int, damage: float, seed: int = 0) -> World:
    """Motions, one a millisecond and a frame each, over a line that damages a share of its bytes both ways."""
    rng = np.random.default_rng(seed)
    world = World(board, Wire(rng, damage), Wire(rng, damage))
    steps = rng.integers(-12, 13, (motions, 4)) + np.array([1, -1, 0, 0])  # drifts: the counters wrap
    for counts in steps.tolist():
        world.give(counts)
        world.step()
    world.settle()
    return world


def main() -> None:
    """A million motions, 1 % of the bytes damaged."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--motions", type=int, default=1_000_000)
    parser.add_argument("--damage", type=float, default=1.0, help="percent of bytes")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    start = time.perf_counter()
    world = exchange(Board(), arguments.motions, arguments.damage / 100.0, arguments.seed)
    device, link = world.board.device, world.link
    print(f"{arguments.motions} motions, {link.motions} frames, {time.perf_counter() - start:.1f} s")
    print(f"given {world.given}, arrived {world.board.moved}, dropped {link.dropped}, uncertain {link.uncertain}")
    print(f"board: {world.board.line.damaged} damaged, {device.lost} lost (modulo 65536), {device.refused} refused")
    print(f"host: {link.sessions} sessions, {link.acks} answers, {link.damaged} damaged answers")
    if world.short != [0, 0, 0, 0]:
        raise SystemExit("the sum is OFF")
    print("the sum is exact")


if __name__ == "__main__":
    main()
