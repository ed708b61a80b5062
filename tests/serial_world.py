"""A host and a board with a bad line between them, at a simulated time; `python -m tests.serial_world`.

The board is the firmware's protocol.py under CPython; tests/output/serial/test_firmware.py runs it under MicroPython.
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
    """The firmware, and a mouse that adds up its reports."""

    def __init__(self, fine: int = 0b101) -> None:
        self.moved, self.buttons, self.usb = [0, 0, 0, 0], 0, True
        self._fine = fine
        self.reset()

    def reset(self) -> None:
        """Reset the board."""
        self.buttons = 0
        self.line, self.device = PROTOCOL.Line(), PROTOCOL.Device(PROTOCOL.SIMULATOR, b"world")
        self.device.set_multipliers(self._fine)

    def turn(self, data: bytes, now: int) -> bytes:
        """Return the answers to these bytes at `now` (ms)."""
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
    """One direction of the line."""

    def __init__(
        self, rng: np.random.Generator, damage: float = 0.0, lose: float = 0.0, twice: float = 0.0, delay: int = 0
    ) -> None:
        """Take the fractions of damaged bytes and of lost and repeated pieces, and the delay (ms)."""
        self.cut = False
        self._rng, self._damage, self._lose, self._twice = rng, damage, lose, twice
        self._delayed = [b""] * delay
        self._gaps: Iterator[int] = self._geometric()
        self._sound = next(self._gaps) if damage else 0  # bytes until the next damaged one

    def _geometric(self) -> Iterator[int]:
        while True:
            yield from (int(n) - 1 for n in self._rng.geometric(self._damage, 4096))

    def heal(self) -> None:
        """Damage and lose nothing more."""
        self.cut, self._damage, self._lose, self._twice = False, 0.0, 0.0, 0.0

    def __call__(self, data: bytes) -> bytes:
        self._delayed.append(self._spoiled(data))
        return self._delayed.pop(0)

    def _spoiled(self, data: bytes) -> bytes:
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

    def __init__(self, board: Any, up: Wire, down: Wire, begin_ms: int = 0, first_session: int = 1) -> None:
        numbers = count(first_session)
        self.link = Link(lambda: next(numbers) * 0x01010101 & 0xFFFFFFFF or 1)
        self.board, self.up, self.down = board, up, down
        self.ms, self.given = begin_ms, [0, 0, 0, 0]
        self._answers, self.resets = b"", 0
        self._first = self.link.port_opened(self.now)

    @property
    def now(self) -> float:
        """Time, s."""
        return self.ms / 1000.0

    def reset(self) -> None:
        """Reset the board."""
        self.board.reset()
        self.resets += 1

    def reopen(self) -> None:
        """Close and open the port."""
        self.link.port_closed(self.now)
        self._first = self.link.port_opened(self.now)

    def give(self, counts: Any) -> None:
        """Add the counts of one motion."""
        for k, n in enumerate(counts):
            self.given[k] += int(n)
        self.link.add(counts, self.now)

    def step(self, noise: bytes = b"", run: bool = True) -> None:
        """Let a millisecond pass, with `noise` on the line; if not `run`, the host's program stands still."""
        data = self._first
        self._first = b""
        while run and (frame := self.link.next_frame(self.now)) is not None:
            data += frame
        answer = self.board.turn(self.up(data) + noise, self.ms & 0x1FFFFFFF)
        self.ms += 1
        if run:
            self.link.receive(self._answers, self.now)
            self._answers = b""
        self._answers += self.down(answer)

    def settle(self, max_ms: int = 2000) -> None:
        """Let it come to rest on a healed line, without new counts."""
        self.up.heal()
        self.down.heal()
        for _ in range(max_ms):
            self.link.keep_alive(self.now)
            self.step()
            if self.link.running and self.link.settled:
                return

    @property
    def short(self) -> list[int]:
        """Counts that were given and did not arrive."""
        return [g - m for g, m in zip(self.given, self.board.moved, strict=True)]


def exchange(board: Any, motions: int, damage: float, seed: int = 0) -> World:
    """Send motions, one a millisecond, over a line that damages a fraction of its bytes both ways."""
    rng = np.random.default_rng(seed)
    world = World(board, Wire(rng, damage), Wire(rng, damage))
    steps = rng.integers(-12, 13, (motions, 4)) + np.array([1, -1, 0, 0])  # drifts: the counters wrap
    for counts in steps.tolist():
        world.give(counts)
        world.step()
    world.settle()
    return world


def main() -> None:
    """Send a million motions, with 1 % of the bytes damaged."""
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
