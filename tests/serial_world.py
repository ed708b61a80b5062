"""A host and a board with a bad line between them, at a simulated time; `python -m tests.serial_world`.

The board is the Pico's protocol.py under CPython. tests/output/serial/test_firmware.py compares the other firmwares
with it, byte by byte.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np

from spheremouse.output.serial import messages
from spheremouse.output.serial.link import Link
from tests.simulated_board import Board


class Wire:
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
        return self.ms / 1000.0

    def reset(self) -> None:
        self.board.reset()
        self.resets += 1

    def reopen(self) -> None:
        self.link.port_closed(self.now)
        self._first = self.link.port_opened(self.now)

    def give(self, counts: Any) -> None:
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

    def run(self, ms: int, counts: Any = None) -> None:
        """Let some time pass, with these counts in each ms."""
        for _ in range(ms):
            if counts is not None:
                self.give(counts)
            self.step()

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


def conversation(rng: np.random.Generator, steps: int = 1500) -> Iterator[tuple[int, int, bytes]]:
    """Yield time (ms), line (0 or 1) and bytes of a host that sends all kinds of frames, late, damaged and cut ones."""
    now, counters, number, sessions = 0, np.zeros(4, dtype=int), [0, 0], [1, 2, 3, 0]
    for _ in range(steps):
        now += int(rng.choice([0, 0, 1, 1, 1, 2, 5, 20] if rng.random() < 0.98 else [98, 99, 100, 101, 150]))
        line, data = int(rng.random() < 0.1), b""
        number[line] = (number[line] + int(rng.choice([1] * 100 + [0, 2, 7, -1, 0x7FFF, 0x8000]))) & 0xFFFF
        for _ in range(int(rng.choice([0, 1, 1, 1, 2]))):
            what = rng.random()
            if what < 0.06:
                sessions.append(int(rng.integers(1, 2**32)))
                data += messages.hello(number[line], int(rng.choice(sessions[-3:])))
                counters[:] = 0
            elif what < 0.9:
                most = 3000 if rng.random() < 0.01 else 100
                counters += rng.integers(-most, most + 1, 4)
                data += messages.motion(number[line], counters.tolist(), int(rng.choice([0, 0, 1, 0xFF])))
            elif what < 0.97:
                data += messages.encode(messages.ASK_STATUS if what < 0.95 else messages.STOP, number[line])
            else:
                body, version = rng.bytes(int(rng.choice([0, 4, 9, 60]))), int(rng.choice([1, 1, 2]))
                data += messages.encode(int(rng.choice([0, 1, 2, 3, 4, 5, 0x82])), number[line], body, version)
        if rng.random() < 0.02:  # noise, a flood, a frame of any length, a cut one
            size = int(rng.choice([60, 63, 64, 65, 253, 254, 255, 256, 1000]))
            data += rng.bytes(size) + (b"\0" if rng.random() < 0.5 else b"")
        yield now, line, bytes(b if rng.random() > 0.002 else int(rng.integers(256)) for b in data)


def main() -> None:
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
    print(f"board: {world.board.lines[0].damaged} damaged, {device.lost} lost (modulo 65536), {device.refused} refused")
    print(f"host: {link.sessions} sessions, {link.acks} answers, {link.damaged} damaged answers")
    if world.short != [0, 0, 0, 0]:
        raise SystemExit("the sum is OFF")
    print("the sum is exact")


if __name__ == "__main__":
    main()
