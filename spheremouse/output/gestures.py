"""Find a player's gestures, and the settings with pointer directions that fit them: right, away, and the third axis.

A gesture is a motion in one direction between two rests. The requested directions are in the player's terms and the
measured ones in `obj` or `cam`. The settings that fit best are the player's.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spheremouse.geometry.rotation import Array

_SPEED_WINDOW = 0.5  # s; with it a pose that jitters by half a degree seems to move at 3 °/s
_START_SPEED, _REST_SPEED = 0.3, 0.15  # rad/s: 17 °/s is intended, 9 °/s is a hand at rest
_MIN_REST = 0.7  # s; a hand that reaches round for more takes less
_MIN_ANGLE = 0.35  # rad: 20° define a direction to a degree or two, and do not happen by accident
_MIN_STRAIGHTNESS = 0.8  # final to greatest distance from the start; less is a motion to and fro
_MIN_COSINE = float(np.cos(np.radians(55.0)))  # seats are 90° apart: a player between two of them is 45° off


class Gesture(NamedTuple):
    """One motion between two rests."""

    displacement: Array  # (3,) rad or m, from start to end
    max_distance: float  # rad or m from the start

    @property
    def size(self) -> float:
        """Length of the displacement, rad or m."""
        return float(np.linalg.norm(self.displacement))

    @property
    def straight(self) -> bool:
        """True if the motion went in one direction."""
        return self.size >= _MIN_STRAIGHTNESS * self.max_distance


class GestureDetector:
    """Finds gestures in a sequence of motions."""

    def __init__(self, unit: float = 1.0) -> None:
        """Take `unit` of the motions for a radian: 1 for rotations, or the metres of a hand's shift."""
        self._unit = unit
        self._recent: deque[tuple[float, Array]] = deque()  # stamps and positions in the window
        self._position = np.zeros(3)  # sum of all motions
        self._start: Array | None = None  # position where the current gesture began
        self._max_distance, self._last_motion = 0.0, 0.0

    def add(self, stamp: float, motion: Array) -> Gesture | None:
        """Add a motion (3,) rad or m since the one before; return the gesture that ended by `stamp` (s), or None."""
        self._position = self._position + motion
        self._recent.append((stamp, self._position))
        while stamp - self._recent[0][0] > _SPEED_WINDOW:
            self._recent.popleft()
        (first, position), speed = self._recent[0], 0.0
        if stamp > first:
            speed = float(np.linalg.norm(self._position - position)) / (stamp - first) / self._unit
        if self._start is None and speed >= _START_SPEED:
            self._start, self._max_distance = position, 0.0
        if self._start is None:
            return None
        self._max_distance = max(self._max_distance, float(np.linalg.norm(self._position - self._start)))
        if speed >= _REST_SPEED:
            self._last_motion = stamp
        return self.finish() if stamp - self._last_motion >= _MIN_REST else None

    def finish(self) -> Gesture | None:
        """End the current gesture and return it; None if there is none or it is too small."""
        start, self._start = self._start, None
        if start is None or self._max_distance < _MIN_ANGLE * self._unit:
            return None
        return Gesture(self._position - start, self._max_distance)


class DirectionMatch(NamedTuple):
    """The candidate settings with the directions that fit some gestures best."""

    candidate: int  # index
    errors: tuple[float, ...]  # rad, angle between each gesture and its requested direction

    @property
    def fits(self) -> bool:
        """True if each gesture is nearer to its requested direction than to any other."""
        return all(np.cos(angle) >= _MIN_COSINE for angle in self.errors)


def match_directions(gestures: Sequence[Array], candidates: Sequence[Array]) -> DirectionMatch:
    """Return the best candidate for the displacements (3,) each; a candidate is (n, 3), one unit vector a gesture."""
    unit = np.array([displacement / np.linalg.norm(displacement) for displacement in gestures])
    cosines = np.array([np.sum(unit * directions, axis=1) for directions in candidates])
    best = int(np.argmax(cosines.sum(axis=1)))
    return DirectionMatch(best, tuple(np.arccos(np.clip(cosines[best], -1.0, 1.0)).tolist()))
