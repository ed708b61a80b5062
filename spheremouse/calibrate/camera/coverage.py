"""Coverage of a camera by views of a board: regions of the image, and tilts of the board.

A lens is known in regions with corners. A focal length needs tilted boards: in views square to the camera only its
ratio to the distance is determined. Instructions name the missing views.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

VIEWS = 10  # the mean of so many has a third of the error of one
LEANS = ("left", "right", "up", "down")  # direction of the board's face, as the camera sees it
MIN_LEAN = float(np.radians(15.0))  # of a tilted board; it shortens by 3 %, which corners measure well
_VIEWS_PER_LEAN = 2  # so that one checks the other
_LONG_REGIONS, _SHORT_REGIONS = 6, 4  # along the image's sides
_MIN_CORNERS = 2  # of a view in a region
_EDGES = {"upper": "top", "lower": "bottom"}
_MIN_DIFFERENCE = 0.1  # of the image's diagonal, of a view from all others


@dataclass(frozen=True, slots=True)
class Coverage:
    """Numbers of views by region and tilt."""

    views: int
    regions: NDArray[np.intp]  # (rows, columns) views with corners there
    leans: NDArray[np.intp]  # (4,) views that lean each way, as LEANS
    reach: float  # 0 to 1: how far out corners lie, of the way from the image's middle to its corner


def region_grid(size: tuple[int, int]) -> tuple[int, int]:
    """Return rows and columns of regions in images of `size` (width, height)."""
    return (_SHORT_REGIONS, _LONG_REGIONS) if size[0] >= size[1] else (_LONG_REGIONS, _SHORT_REGIONS)


def regions_of(uv: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return True for regions with two or more of the corners `uv`, (n, 2) px, as (rows, columns).

    `size` is (width, height) px. Corners outside the image count in the nearest region.
    """
    rows, columns = region_grid(size)
    column = np.clip((uv[:, 0] + 0.5) * columns / size[0], 0, columns - 1).astype(int)
    row = np.clip((uv[:, 1] + 0.5) * rows / size[1], 0, rows - 1).astype(int)
    count = np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns)
    return count >= _MIN_CORNERS


def leans_of(R: Array) -> NDArray[np.bool_]:
    """Return True for the directions of tilt, (4,), of a board with R_cam_board, (3, 3)."""
    x, y, z = -R[:, 2] if R[2, 2] > 0.0 else R[:, 2]  # out of the printed face
    s = np.sin(MIN_LEAN)
    return np.array([x < -s, x > s, y < -s, y > s]) & (z < 0.0)


def coverage(size: tuple[int, int], corners: Sequence[Array], rotations: Array) -> Coverage:
    """Return the coverage by views with corners, (n, 2) px each, and R_cam_board, (v, 3, 3)."""
    rows, columns = region_grid(size)
    regions, leans, reach = np.zeros((rows, columns), np.intp), np.zeros(4, np.intp), 0.0
    middle = 0.5 * (np.array(size) - 1.0)
    for uv, R in zip(corners, rotations, strict=True):
        regions += regions_of(uv, size)
        leans += leans_of(R)
        reach = max(reach, float(np.linalg.norm(uv - middle, axis=1).max() / np.linalg.norm(middle)))
    return Coverage(len(corners), regions, leans, min(reach, 1.0))


def missing_regions(found: Coverage) -> list[str]:
    """Name places of the picture without a view, as in "in the upper left corner", from the top left."""
    return _places(found.regions == 0)


def missing_leans(found: Coverage) -> list[str]:
    """Name the directions with fewer than two tilted views."""
    return [way for way, n in zip(LEANS, found.leans, strict=True) if n < _VIEWS_PER_LEAN]


def missing(found: Coverage) -> list[str]:
    """List instructions for the missing views; left and right as the camera sees them."""
    suffix = {way: ", once more" if n else "" for way, n in zip(LEANS, found.leans, strict=True)}
    words = [f"tilt the board by 20° to 45°, so that it faces {way}{suffix[way]}" for way in missing_leans(found)]
    return words + [f"hold the board {place} of the picture" for place in missing_regions(found)]


def join_words(words: Sequence[str]) -> str:
    """Join words as in "a, b or c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def enough(found: Coverage) -> bool:
    """Return True for all regions, all tilts and enough views."""
    return found.views >= VIEWS and not missing(found)


def gain(found: Coverage, size: tuple[int, int], uv: Array, R: Array, before: Sequence[Array]) -> str | None:
    """Return a description of the coverage that a view adds to the others, or None if it adds none.

    `uv` (n, 2) px are its corners, R (3, 3) is R_cam_board; `before` are the accepted views' corners, (k, 2) each.
    """
    fresh = regions_of(uv, size) & (found.regions == 0)
    if fresh.any():
        return ", ".join(_places(fresh))
    differs = all(_apart(uv, other) > _MIN_DIFFERENCE * float(np.hypot(*size)) for other in before)
    new_leans = leans_of(R) & (found.leans < (_VIEWS_PER_LEAN if differs else 1))  # a repeated view is no check
    if new_leans.any():
        return "facing " + " and ".join(way for way, new in zip(LEANS, new_leans, strict=True) if new)
    return "another view" if differs and found.views < VIEWS else None


def _apart(a: Array, b: Array) -> float:
    """Difference of two views, px, of their middles and their spreads."""
    return float(np.linalg.norm(a.mean(axis=0) - b.mean(axis=0)) + np.linalg.norm(np.cov(a.T) - np.cov(b.T)) ** 0.5)


def _places(cells: NDArray[np.bool_]) -> list[str]:
    """Names of regions as corners, edges and middle, from the top left."""
    rows, columns = cells.shape
    names: list[str] = []
    for row, column in np.argwhere(cells):
        down = "upper" if row == 0 else "lower" if row == rows - 1 else ""
        along = "left" if column == 0 else "right" if column == columns - 1 else ""
        if down and along:
            name = f"in the {down} {along} corner"
        elif down or along:
            name = f"at the {_EDGES.get(down, along)} edge"
        else:
            name = "in the middle"
        if name not in names:
            names.append(name)
    return names
