"""Spots of a disc's colour in a picture."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import Fields

_LEAST_AREA = 6  # px: smaller, a spot's centroid is a pixel's
_FILLED = 0.3  # of its upright box that an ellipse fills: pi / 4, less where it lies across
_SPOTS = 60  # the largest; more is no ball but a picture of one colour
_GLARE = 8  # places of glare, the largest: a ball shows as many as there are suns


@dataclass(frozen=True, slots=True)
class Spots:
    """Connected pixels of one colour each."""

    centre: Array  # (n, 2) px
    area: Array  # (n,) px²
    colour: NDArray[np.int64]  # (n,) index of the colour
    glare: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (m, 3) u, v px, area px²: pale places


def spots(fields: Fields) -> Spots:
    """Spots of the binary pictures that may be discs."""
    rows = []
    f = fields.factor
    for c, binary in enumerate(fields.binary):
        n, _, stats, centre = cv2.connectedComponentsWithStats(binary, connectivity=4)
        area = stats[:, cv2.CC_STAT_AREA]
        box = stats[:, cv2.CC_STAT_WIDTH] * stats[:, cv2.CC_STAT_HEIGHT]
        good = (area >= _LEAST_AREA) & (area <= binary.size / 8) & (area >= _FILLED * box)
        good[0] = False  # the background
        for i in np.flatnonzero(good[:n]):
            u, v = (centre[i] + 0.5) * f - 0.5
            rows.append((u + fields.left, v + fields.top, area[i] * f * f, c))
    rows.sort(key=lambda row: -row[2])
    table = np.array(rows[:_SPOTS], dtype=float).reshape(-1, 4)
    return Spots(table[:, :2], table[:, 2], table[:, 3].astype(np.int64), _glare_spots(fields))


def _glare_spots(fields: Fields) -> Array:
    """The largest places that glare makes pale, (m, 3): u, v px, area px²."""
    if len(fields.glare) == 0:
        return np.zeros((0, 3))
    f = fields.factor
    n, _, stats, centre = cv2.connectedComponentsWithStats((fields.glare[0] > 127).astype(np.uint8), connectivity=8)
    area = stats[1:n, cv2.CC_STAT_AREA].astype(float)
    place = (centre[1:n] + 0.5) * f - 0.5 + [fields.left, fields.top]
    largest = np.argsort(-area, kind="stable")[:_GLARE]
    return np.column_stack([place, area * f * f])[largest]
