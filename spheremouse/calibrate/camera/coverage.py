"""What views of a board show of a camera: which regions of its image, and the board leaning which ways.

A lens is known where corners were seen, and a focal length only from boards that lean: in views square to the camera
it cannot be told from the distance. What is missing is said in words for whoever holds the board.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

VIEWS = 10  # from which the mean of their errors is a third of one's
LEANS = ("left", "right", "up", "down")  # where the board's face turns, as the camera sees it
LEANT = float(np.radians(15.0))  # from which a board leans; its shortening is 3 %, which its corners tell well
_LEAN_VIEWS = 2  # to each side: one alone has nobody to check it
_LONG, _SHORT = 6, 4  # regions along the image's sides
_CORNERS = 2  # of the board that a view must show in a region
_EDGES = {"upper": "top", "lower": "bottom"}
_ANOTHER = 0.1  # of the image's diagonal by which a view must differ from all others to be more than a repetition


@dataclass(frozen=True, slots=True)
class Coverage:
    """Numbers of views by what they show."""

    views: int
    regions: NDArray[np.intp]  # (rows, columns) views with corners there
    leans: NDArray[np.intp]  # (4,) views that lean each way, as LEANS
    reach: float  # 0 to 1: how far out corners lie, of the way from the image's middle to its corner


def region_grid(size: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of regions in images of `size` (width, height)."""
    return (_SHORT, _LONG) if size[0] >= size[1] else (_LONG, _SHORT)


def regions_of(uv: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Regions in which corners, (n, 2) px, lie, (rows, columns)."""
    rows, columns = region_grid(size)
    column = np.clip((uv[:, 0] + 0.5) * columns / size[0], 0, columns - 1).astype(int)
    row = np.clip((uv[:, 1] + 0.5) * rows / size[1], 0, rows - 1).astype(int)
    count = np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns)
    return count >= _CORNERS


def leans_of(R: Array) -> NDArray[np.bool_]:
    """Ways, (4,), that a board leans whose R_cam_board, (3, 3), has its third axis away from the camera."""
    x, y, z = -R[:, 2] if R[2, 2] > 0.0 else R[:, 2]  # out of the printed face
    s = np.sin(LEANT)
    return np.array([x < -s, x > s, y < -s, y > s]) & (z < 0.0)


def coverage(size: tuple[int, int], corners: Sequence[Array], rotations: Array) -> Coverage:
    """Of views with corners (n, 2) px each and R_cam_board, (v, 3, 3)."""
    rows, columns = region_grid(size)
    regions, leans, reach = np.zeros((rows, columns), np.intp), np.zeros(4, np.intp), 0.0
    middle = 0.5 * (np.array(size) - 1.0)
    for uv, R in zip(corners, rotations, strict=True):
        regions += regions_of(uv, size)
        leans += leans_of(R)
        reach = max(reach, float(np.linalg.norm(uv - middle, axis=1).max() / np.linalg.norm(middle)))
    return Coverage(len(corners), regions, leans, min(reach, 1.0))


def missing_regions(found: Coverage) -> list[str]:
    """Places of the picture that no view shows, as in "in the upper left corner", from the top left."""
    return _places(found.regions == 0)


def missing_leans(found: Coverage) -> list[str]:
    """Ways that the board was not turned, or once only: a tilt has to be checked by another."""
    return [way for way, n in zip(LEANS, found.leans, strict=True) if n < _LEAN_VIEWS]


def missing(found: Coverage) -> list[str]:
    """Views still wanted, as what to do with the board; left and right as the camera sees them."""
    again = {way: ", once more" if n else "" for way, n in zip(LEANS, found.leans, strict=True)}
    words = [f"tilt the board by 20° to 45°, so that it faces {way}{again[way]}" for way in missing_leans(found)]
    return words + [f"hold the board {place} of the picture" for place in missing_regions(found)]


def listed(words: Sequence[str]) -> str:
    """ "a, b or c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def enough(found: Coverage) -> bool:
    """All regions, all ways, and the views that make it a mean."""
    return found.views >= VIEWS and not missing(found)


def gain(found: Coverage, size: tuple[int, int], uv: Array, R: Array, before: Sequence[Array]) -> str | None:
    """The gain of a view beside those there are, in words; None where it adds nothing.

    `uv` (n, 2) px are its corners, R (3, 3) R_cam_board; `before` are the accepted views' corners, (k, 2) each.
    """
    fresh = regions_of(uv, size) & (found.regions == 0)
    if fresh.any():
        return ", ".join(_places(fresh))
    apart = all(_apart(uv, other) > _ANOTHER * float(np.hypot(*size)) for other in before)
    few = leans_of(R) & (found.leans < (_LEAN_VIEWS if apart else 1))  # the same view again checks nothing
    if few.any():
        return "facing " + " and ".join(way for way, new in zip(LEANS, few, strict=True) if new)
    return "another view" if apart and found.views < VIEWS else None


def _apart(a: Array, b: Array) -> float:
    """Difference of two views, px: of their middles, and of their spreads along and across."""
    return float(np.linalg.norm(a.mean(axis=0) - b.mean(axis=0)) + np.linalg.norm(np.cov(a.T) - np.cov(b.T)) ** 0.5)


def _places(cells: NDArray[np.bool_]) -> list[str]:
    """Names of regions, coarser than they are: corners, edges, middle; from the top left."""
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
