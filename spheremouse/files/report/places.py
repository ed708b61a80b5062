"""Where words of a figure may stand: heights that keep apart, places around a point and along a line; px, y upwards."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

_AROUND = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1))  # the better first
_RINGS, _RING = 9, 0.6  # how often farther away, by so much of a word's height
_ALONG = np.linspace(0.0, 1.0, 21)


class End(NamedTuple):
    """Where a line ends, in data; without an x at the edge of the axes."""

    name: str
    y: float
    colour: Any
    x: float | None = None


def apart(values: Sequence[float], heights: Sequence[float], low: float, high: float) -> list[float]:
    """Ascending middles of boxes, moved as little as possible so that none meet (isotonic regression).

    Within bounds where there is room for all, else from the lower one on.
    """
    from scipy.optimize import isotonic_regression

    half = 0.5 * np.asarray(heights, float)
    steps = np.concatenate([[0.0], np.cumsum(half[:-1] + half[1:])])
    moved = isotonic_regression(np.asarray(values, float) - steps).x
    return (np.maximum(np.minimum(moved, high - half[-1] - steps[-1]), low + half[0]) + steps).tolist()


def around(x: float, y: float, width: float, height: float, gap: float) -> Iterator[tuple[float, float]]:
    """Middles of a box around a point and no nearer than `gap`, near ones first."""
    for k, (right, up) in product(range(_RINGS), _AROUND):
        near = (0.7 if right and up else 1.0) * gap + _RING * k * height
        yield x + right * (0.5 * width + near), y + up * (0.5 * height + near)


def along(
    left: float, right: float, y: float, width: float, height: float, gap: float
) -> Iterator[tuple[float, float]]:
    """Middles of a box on and under a line across at y, from one side on; `right` may be the smaller."""
    inwards = np.sign(right - left) * (0.5 * width + gap)
    for x, up in product(left + inwards + _ALONG * (right - left - 2.0 * inwards), (1.0, -1.0)):
        yield x, y + up * (0.5 * height + gap)
