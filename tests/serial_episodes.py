"""Episodes of a bad line and a board that is reset, and whether the books are right at the end of each.

`python tests/serial_episodes.py --episodes 400 --replay` plays them and tells which were wrong.
"""

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np
from serial_world import Board, Wire, World


@dataclass(frozen=True)
class Kind:
    """What may happen in an episode."""

    resets: bool = True
    replay: bool = False  # frames that were on the line before come once more, however old
    speed: int = 12  # counts/ms, at most
    motions: int = 400


class History(Wire):
    """A wire that delays, and brings old pieces again."""

    def __init__(self, rng: np.random.Generator, delay: int, replay: float, **wire: float) -> None:
        super().__init__(rng, **wire)
        self._draw, self._replay = rng, replay
        self._held = [b""] * delay
        self.past: list[bytes] = []

    def heal(self) -> None:
        super().heal()
        self._replay = 0.0

    def __call__(self, data: bytes) -> bytes:
        if data:
            self.past += [piece + b"\0" for piece in data.split(b"\0") if piece]
        data = super().__call__(data)
        if self._replay and self.past and self._draw.random() < self._replay:
            data += self.past[int(self._draw.integers(len(self.past)))]
        self._held.append(data)
        return self._held.pop(0)


def play(seed: int, kind: Kind, board: Any = None) -> World:
    """One episode, to its end."""
    rng = np.random.default_rng(seed)

    def wire() -> Wire:
        share = 0.01 if kind.replay else 0.0
        return History(rng, int(rng.integers(0, 9)), share, damage=float(rng.choice([0.0, 1e-3, 1e-2])),
                       lose=float(rng.choice([0.0, 0.1, 0.4])), twice=float(rng.choice([0.0, 0.1])))  # fmt: skip

    world = World(board or Board(), wire(), wire())
    way = np.ones(4, int)
    for _ in range(kind.motions):
        way = np.where(rng.random(4) < 0.03, -way, way)
        world.give(way * rng.integers(0, kind.speed + 1, 4))
        event = rng.random()
        if kind.resets and event < 0.01:
            world.reset()
        elif event < 0.015:
            world.up.cut, world.down.cut = rng.random(2) < 0.5
        elif event < 0.025:
            world.up.cut = world.down.cut = False
        world.step()
    world.settle(5000)
    return world


def verdict(world: World) -> str:
    """What is wrong; empty where the books are right."""
    off = np.array(world.short) - world.link.dropped
    told = np.array(world.link.uncertain)
    if not (world.link.running and world.link.settled):
        return "never came to rest"
    if (np.abs(off) > told).any():
        return f"untold {int((np.abs(off) - told).max())}"
    return ""


def cost(world: World) -> int:
    """Counts that are missing or too many on any axis, but for those that the host has dropped and said so."""
    return int(np.abs(np.array(world.short) - world.link.dropped).max())


def main() -> None:
    """Play many and tell what was wrong."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--episodes", type=int, default=400)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--speed", type=int, default=12)
    parser.add_argument("--replay", action="store_true")
    parser.add_argument("--no-resets", action="store_true")
    a = parser.parse_args()
    wrong = most = 0
    for seed in range(a.first, a.first + a.episodes):
        world = play(seed, Kind(not a.no_resets, a.replay, a.speed))
        said = verdict(world)
        if world.resets == 1:
            most = max(most, cost(world))
        if said:
            wrong += 1
            print(f"{seed}: {said}; {world.resets} resets, short {world.short}, uncertain {world.link.uncertain}")
    print(f"{wrong} of {a.episodes} wrong; one reset costs at most {most} counts")


if __name__ == "__main__":
    main()
