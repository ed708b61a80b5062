"""Gestures of a player -> the directions of the pointer: one motion to the right, one away, one of the third axis.

A gesture is a motion one way between two rests. What is asked for is in the player's words, what comes is in `obj` or
`cam`: the settings whose directions fit it best are the player's.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spheremouse.geometry.rotation import Array

_WINDOW = 0.5  # s over which a speed is taken: a pose that jitters by half a degree seems to go at 3 °/s then
_BEGINS, _ENDS = 0.3, 0.15  # rad/s: 17 °/s is meant, 9 °/s is what a hand does that rests
_REST = 0.7  # s that a rest lasts: a hand that reaches round for more takes less
_LEAST = 0.35  # rad: 20° tell a direction to a degree or two, and nobody moves so far by chance
_STRAIGHT = 0.8  # of the greatest distance from its beginning; what ends nearer has gone to and fro
_FITS = float(np.cos(np.radians(55.0)))  # two seats are 90° apart: who stands between them is 45° off


class Gesture(NamedTuple):
    """One motion between two rests."""

    way: Array  # (3,) rad or m, from end to end
    furthest: float  # rad or m, greatest distance from its beginning

    @property
    def size(self) -> float:
        """rad or m."""
        return float(np.linalg.norm(self.way))

    @property
    def straight(self) -> bool:
        """Has it gone one way?"""
        return self.size >= _STRAIGHT * self.furthest


class Watch:
    """Tells gestures among motions, as they come."""

    def __init__(self, unit: float = 1.0) -> None:
        """`unit` of what comes is taken for a radian: 1, or the metres of a hand's shift."""
        self._unit = unit
        self._recent: deque[tuple[float, Array]] = deque()  # stamp and place, of the window
        self._place = np.zeros(3)  # sum of all
        self._start: Array | None = None  # place where a gesture began
        self._furthest, self._moved = 0.0, 0.0

    def add(self, stamp: float, way: Array) -> Gesture | None:
        """A motion since the one before, (3,) rad or m, at `stamp`, s; the gesture, if with it one has ended."""
        self._place = self._place + way
        self._recent.append((stamp, self._place))
        while stamp - self._recent[0][0] > _WINDOW:
            self._recent.popleft()
        (began, place), speed = self._recent[0], 0.0
        if stamp > began:
            speed = float(np.linalg.norm(self._place - place)) / (stamp - began) / self._unit
        if self._start is None and speed >= _BEGINS:
            self._start, self._furthest = place, 0.0
        if self._start is None:
            return None
        self._furthest = max(self._furthest, float(np.linalg.norm(self._place - self._start)))
        if speed >= _ENDS:
            self._moved = stamp
        return self.ended() if stamp - self._moved >= _REST else None

    def ended(self) -> Gesture | None:
        """The gesture that is under way, which ends here; None where there is none, or hardly any."""
        start, self._start = self._start, None
        if start is None or self._furthest < _LEAST * self._unit:
            return None
        return Gesture(self._place - start, self._furthest)


class Understood(NamedTuple):
    """Whose directions some gestures fit best."""

    candidate: int  # its number
    off: tuple[float, ...]  # rad, angle between each gesture and what was asked for

    @property
    def fits(self) -> bool:
        """Each is nearer to what was asked for than to anything else."""
        return all(np.cos(angle) >= _FITS for angle in self.off)


def understood(made: Sequence[Array], asked: Sequence[Array]) -> Understood:
    """The candidate that the gestures, (3,) each, go with best: `asked` has (n, 3) unit vectors of each candidate."""
    unit = np.array([way / np.linalg.norm(way) for way in made])
    cosines = np.array([np.sum(unit * directions, axis=1) for directions in asked])
    candidate = int(np.argmax(cosines.sum(axis=1)))
    return Understood(candidate, tuple(np.arccos(np.clip(cosines[candidate], -1.0, 1.0)).tolist()))
