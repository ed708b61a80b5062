"""Pages in mm of ring targets, discs, chessboard and ChArUco board, and the instructions as an HTML page."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from math import ceil, floor
from typing import TYPE_CHECKING, TypeVar

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from spheremouse.calibrate.board import Board
from spheremouse.calibrate.prints.page import (
    BLACK,
    GREY,
    HAIR,
    Colour,
    Page,
    Paper,
    boxes,
    circle,
    disc,
    lines,
    paper,
    text_line,
)
from spheremouse.errors import CalibrationError
from spheremouse.files.report.page import page
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist

TARGETS = {1: "MCY", 2: "CYM", 3: "YMC", 4: "CMY", 5: "MYC", 6: "YCM"}  # as device.yaml numbers them
INKS: dict[str, Colour] = {"C": (0.0, 1.0, 1.0), "M": (1.0, 0.0, 1.0), "Y": (1.0, 1.0, 0.0)}
MARKER_SHARE = 0.75  # of a ChArUco square: the largest with white around the corners

_NAMES = {"C": "cyan", "M": "magenta", "Y": "yellow"}
_DICTIONARIES = (("5x5_100", 100), ("5x5_250", 250), ("5x5_1000", 1000))  # each begins with the one before
_QUIET_ZONE_MM = 1.5  # mm of white round a board, besides the margins
_LARGER = "or a larger --paper, up to a0 in a copy shop"

T = TypeVar("T")


def mm(length: float) -> str:
    """Write a length in mm without trailing zeros."""
    return f"{length:.2f}".rstrip("0").rstrip(".")


# ---- targets and discs ----


def target_pages(radii: Sequence[float], paper_name: str) -> list[Page]:
    """Return pages with the six ring targets. `radii` are those of inner disc, middle and outer ring, rising (mm).

    Each target has a square frame with ticks, its number and code, and the names of its inks from inside to outside.
    """
    white = 2.0 / 3.0 * (radii[1] - radii[0])  # outside the outer ring: the detection reads colours there, too
    half = radii[2] + max(white, 3.0) + 2.5  # of the frame's side
    size = "/".join(mm(r) for r in radii)

    def target(x: float, y: float, numbered_code: tuple[int, str]) -> "Iterator[Artist]":
        number, code = numbered_code
        for radius, ink in zip(reversed(radii), reversed(code), strict=True):
            yield disc(x, y, radius, INKS[ink])
        a, b, c, d = x - half, y - half, x + half, y + half
        yield lines([(a, b, c, b), (c, b, c, d), (c, d, a, d), (a, d, a, b)])
        yield _ticks(x, y, half - 2.5, half, 0.25)
        text_x, text_y = half - 1.5, half - 1.7
        yield text_line(x - text_x, y - text_y, f"{number} {code}", 4.0, bold=True)
        yield text_line(x + text_x, y - text_y, size, 2.1, "right")
        for k, ink in enumerate(code):
            yield text_line(x - text_x, y + half - 3.5 - 2.8 * k, _NAMES[ink], 2.1)
        yield text_line(x + text_x, y + half - 3.5, "from inside", 2.1, "right")

    sheet = paper(paper_name)
    places = _grid(sheet, 2.0 * half, f"--ring-radii: a target with its frame ({mm(2.0 * half)} mm)")
    notes = (
        "Put up 4 to 6, no code twice; at the very least 3.",
        "Flat, facing the camera. The ticks point at the centre.",
    )
    return _pages(Page(sheet, f"Ring targets, radii {size} mm", notes, ()), places, list(TARGETS.items()), target)


def disc_pages(n: int, radius: float, paper_name: str) -> list[Page]:
    """Return pages with discs 1 to n of one radius (mm); a flat disc keeps its radius along the ball's surface."""

    def numbered_disc(x: float, y: float, number: int) -> "Iterator[Artist]":
        yield disc(x, y, radius)
        yield circle(x, y, radius + 1.0, GREY, HAIR)
        yield _ticks(x, y, radius + 1.0, radius + 2.8, 0.15)
        yield text_line(x + radius + 2.2, y - radius - 1.6, str(number), 3.2, "right")

    sheet = paper(paper_name)
    cell = 2.0 * radius + 6.0
    places = _grid(sheet, cell, f"--disc-radius: a disc with its ticks ({mm(cell)} mm)")
    notes = (
        f"disc_radius: {radius / 1000:g} in device.yaml, along the surface.",
        "Cut along the thin circle: a white rim is harmless, a nick is not.",
    )
    return _pages(Page(sheet, f"Discs, radius {mm(radius)} mm", notes, ()), places, range(1, n + 1), numbered_disc)


def _pages(
    empty: Page,
    places: Sequence[tuple[float, float]],
    items: Sequence[T],
    draw: "Callable[[float, float, T], Iterator[Artist]]",
) -> list[Page]:
    """As many pages like an empty one as it takes to draw each item at a place of its own."""
    n, pages = ceil(len(items) / len(places)), []
    for k in range(n):
        group = items[k * len(places) : (k + 1) * len(places)]
        shapes = (shape for (x, y), item in zip(places, group, strict=False) for shape in draw(x, y, item))
        title = f"{empty.title} · {k + 1} of {n}" if n > 1 else empty.title
        pages.append(Page(empty.paper, title, empty.notes, shapes))
    return pages


def _ticks(x: float, y: float, inner: float, outer: float, width: float) -> "Artist":
    """Four lines that point at x, y, between two distances from it: the arms of a cross."""
    arms = [(u * inner, v * inner, u * outer, v * outer) for u, v in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return lines(np.array(arms) + np.array([x, y, x, y]), width, BLACK)


def _grid(sheet: Paper, cell: float, part: str) -> list[tuple[float, float]]:
    """Centres of square cells, from the top left: one cut parts two of them."""
    left, bottom, right, top = sheet.room
    columns, rows = floor((right - left) / cell + 1e-9), floor((top - bottom) / cell + 1e-9)
    if columns < 1 or rows < 1:
        raise CalibrationError(f"{part} does not fit on {sheet.name}; take a smaller one {_LARGER}")
    first = (left + right - (columns - 1) * cell) / 2.0
    return [(first + i * cell, top - (j + 0.5) * cell) for j in range(rows) for i in range(columns)]


# ---- boards ----


@dataclass(frozen=True, slots=True)
class Pattern:
    """A board as black rectangles, in mm from its lower left corner."""

    name: str  # on the page
    file: str
    black: Array  # (n, 4) mm: left, bottom, right, top
    board: Board
    square: float  # mm


def largest_square(board: Board, paper_name: str) -> float:
    """Return the largest square of a board on one page, in whole mm from 1 mm on."""
    fits = max(_fitting(board, paper(paper_name, wide=wide)) for wide in (False, True))
    return float(floor(fits + 1e-9)) if fits >= 1.0 else fits


def _fitting(board: Board, sheet: Paper) -> float:
    left, bottom, right, top = sheet.room
    white = 2.0 * _QUIET_ZONE_MM
    return min((right - left - white) / (board.columns + 1), (top - bottom - white) / (board.rows + 1))


def chessboard(board: Board, square: float) -> Pattern:
    """Return a chessboard of inner corners and squares (mm), black at the upper left."""
    rows, columns = np.mgrid[: board.rows + 1, : board.columns + 1]
    black = (rows + columns) % 2 == 0
    name = f"Chessboard {board.columns}×{board.rows}, squares {mm(square)} mm"
    file = f"chessboard-{board.columns}x{board.rows}-{mm(square)}mm"
    return Pattern(name, file, _squares(rows[black], columns[black], board, square), board, square)


def charuco(board: Board, square: float) -> Pattern:
    """Return a ChArUco board of inner corners and squares (mm); CalibrationError if no dictionary has enough markers.

    The layout is that of OpenCV's CharucoBoard (not the legacy pattern), with the markers' bits as rectangles.
    """
    columns, rows = board.columns + 1, board.rows + 1
    markers = columns * rows // 2
    label = next((name for name, n in _DICTIONARIES if n >= markers), None)
    if label is None:
        raise CalibrationError(
            f"--board {board.columns}x{board.rows}: needs {markers} markers, but there are 1000 codes"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{label.upper()}"))
    marker = MARKER_SHARE * square
    laid = cv2.aruco.CharucoBoard((columns, rows), square, marker, dictionary)
    modules = dictionary.markerSize + 2  # bits and a black border
    bit = marker / modules
    found, white = [], np.zeros((rows, columns), dtype=bool)
    for number, corners in zip(np.ravel(laid.getIds()), laid.getObjPoints(), strict=True):
        x, y = corners[0][:2]  # upper left, y down
        white[int(y // square), int(x // square)] = True
        bits = cv2.aruco.generateImageMarker(dictionary, int(number), modules)
        found += [
            (x + a * bit, y + r * bit, x + b * bit, y + (r + 1) * bit)
            for r, row in enumerate(bits)
            for a, b in _runs(row == 0)
        ]
    down = np.array(found)
    upright = np.stack([down[:, 0], rows * square - down[:, 3], down[:, 2], rows * square - down[:, 1]], axis=1)
    dark_rows, dark_columns = np.nonzero(~white)
    black = np.concatenate([_squares(dark_rows, dark_columns, board, square), upright])
    size = f"{mm(square)} mm, markers {mm(marker)} mm"
    name = f"ChArUco {columns}×{rows}, squares {size}, DICT_{label.upper()}"
    file = f"charuco-{board.columns}x{board.rows}-{mm(square)}mm-{mm(marker)}mm-{label}"
    return Pattern(name, file, black, board, square)


def _squares(rows: NDArray[np.intp], columns: NDArray[np.intp], board: Board, square: float) -> Array:
    x, y = columns * square, (board.rows - rows) * square
    return np.stack([x, y, x + square, y + square], axis=1).astype(float)


def _runs(row: Array) -> Iterator[tuple[int, int]]:
    """First and after-last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def board_page(pattern: Pattern, paper_name: str) -> Page:
    """Return the page of a board, upright or wide; CalibrationError if it does not fit."""
    board, square = pattern.board, pattern.square
    given = f"--board {board.columns}x{board.rows} --square {mm(square)}mm"
    sheets = (paper(paper_name, wide=True), paper(paper_name))
    sheet = next((s for s in sheets if _fitting(board, s) >= square - 1e-9), None)
    if sheet is None:
        raise CalibrationError(f"{given}: does not fit on {paper_name}; take a smaller square {_LARGER}")
    left, bottom, right, top = sheet.room
    across, height = (board.columns + 1) * square, (board.rows + 1) * square
    at = np.array([(left + right - across) / 2.0, (bottom + top - height) / 2.0])
    notes = (
        "Glue it flat on something stiff (glass, foam board), and keep the white round it.",
        f"{given}; measure: {board.columns + 1} squares are {mm(across)} mm.",
    )
    return Page(sheet, pattern.name, notes, map(boxes, [pattern.black + np.tile(at, 2)]))


# ---- instructions ----


def recipe(board: Board, square: float, paper_name: str) -> str:
    """Return `recipe.md` with its drawings as one HTML page, with commands for a board of squares of so many mm."""
    from markdown_it import MarkdownIt

    folder = resources.files(__package__ or "")

    def drawing(match: re.Match[str]) -> str:
        return f'<figure class="{match[1]}">{folder.joinpath(f"{match[1]}.svg").read_text(encoding="utf-8")}</figure>'

    text = folder.joinpath("recipe.md").read_text(encoding="utf-8")
    text = text.replace("--board 11x8", f"--board {board.columns}x{board.rows}")
    title, text = text.replace("--square 20mm", f"--square {mm(square)}mm").removeprefix("# ").split("\n", 1)
    body = re.sub(r"<!-- sketch: (\w+) -->", drawing, MarkdownIt("commonmark").render(text))
    paper = paper_name.capitalize() if paper_name == "letter" else paper_name.upper()
    return page(title, "", Markup(body), paper=paper)
