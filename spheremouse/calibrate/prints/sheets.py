"""Pages in mm of ring targets, discs, chessboard and ChArUco board."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.calibrate.board import Board
from spheremouse.calibrate.prints.page import (
    BLACK,
    GREY,
    HAIR,
    PAPERS,
    Boxes,
    Circle,
    Colour,
    Page,
    Paper,
    Shape,
    Words,
    lines,
    paper,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array

TARGETS = {1: "MCY", 2: "CYM", 3: "YMC", 4: "CMY", 5: "MYC", 6: "YCM"}  # as device.yaml numbers them
INKS: dict[str, Colour] = {"C": (0.0, 1.0, 1.0), "M": (1.0, 0.0, 1.0), "Y": (1.0, 1.0, 0.0)}
MARKER_SHARE = 0.75  # of a ChArUco square: the largest with white around the corners
MAX_PAGES = 60  # of a board; more come from a wrong unit

_NAMES = {"C": "cyan", "M": "magenta", "Y": "yellow"}
_DICTIONARIES = (("5x5_100", 100), ("5x5_250", 250), ("5x5_1000", 1000))  # each begins with the one before
_QUIET = 1.5  # mm of white round a board, besides the margins
_MARKS = 6.0  # mm round a part of a board, for the cutting marks
_FLAP = 8.0  # mm under the next part
_BLEED = 2.0  # mm of pattern beyond a cut, so that an inexact cut leaves no white line


def mm(length: float) -> str:
    """Write a length in mm without trailing zeros."""
    return f"{length:.2f}".rstrip("0").rstrip(".")


# ---- targets ----


def target_pages(radii: Sequence[float], paper_name: str) -> list[Page]:
    """Return pages with the six ring targets of radii inner, middle, outer (mm)."""
    sheet = paper(paper_name)
    white = 2.0 / 3.0 * (radii[1] - radii[0])  # the detection reads colours outside a circle
    half = radii[2] + max(white, 3.0) + 2.5
    places = _grid(sheet, 2.0 * half, f"--ring-radii: a target of {mm(2 * radii[2])} mm")
    size = "/".join(mm(r) for r in radii)
    pages = []
    for first in range(0, len(TARGETS), len(places)):
        shapes: list[Shape] = []
        for place, (number, code) in zip(places, list(TARGETS.items())[first:], strict=False):
            shapes += _target(*place, half, radii, number, code)
        pages.append(
            Page(
                sheet,
                f"Ring targets, radii {size} mm{_numbered(first // len(places), ceil(len(TARGETS) / len(places)))}",
                (
                    "Put up 4 to 6, no code twice; at the very least 3.",
                    "Flat, facing the camera. The ticks point at the centre.",
                ),
                tuple(shapes),
            )
        )
    return pages


def _target(x: float, y: float, half: float, radii: Sequence[float], number: int, code: str) -> Iterator[Shape]:
    for radius, ink in zip(reversed(radii), reversed(code), strict=True):
        yield Circle(x, y, radius, INKS[ink])
    yield from _square(x, y, half)
    yield _ticks(x, y, half - 2.5, half, 0.25)
    near, high = half - 1.5, half - 1.7
    yield Words(x - near, y - high, f"{number} {code}", size=4.0, bold=True)
    yield Words(x + near, y - high, "/".join(mm(r) for r in radii), size=2.1, align="right")
    for k, ink in enumerate(code):
        yield Words(x - near, y + half - 3.5 - 2.8 * k, _NAMES[ink], size=2.1)
    yield Words(x + near, y + half - 3.5, "from inside", size=2.1, align="right")


def _ticks(x: float, y: float, inner: float, outer: float, width: float) -> Shape:
    """Four lines that point at x, y, between two distances from it: the arms of a cross."""
    arms = [(u * inner, v * inner, u * outer, v * outer) for u, v in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return lines(np.array(arms) + np.array([x, y, x, y]), width, BLACK)


def _square(x: float, y: float, half: float) -> Iterator[Shape]:
    a, b, c, d = x - half, y - half, x + half, y + half
    yield lines([(a, b, c, b), (c, b, c, d), (c, d, a, d), (a, d, a, b)])


# ---- discs ----


def disc_pages(n: int, radius: float, paper_name: str) -> list[Page]:
    """Return pages with discs 1 to n of one radius (mm); a flat disc keeps its radius along the ball's surface."""
    sheet = paper(paper_name)
    places = _grid(sheet, 2.0 * radius + 6.0, f"--disc-radius: a disc of {mm(2 * radius)} mm")
    pages = []
    for first in range(0, n, len(places)):
        shapes: list[Shape] = []
        for number, (x, y) in enumerate(places[: n - first], first + 1):
            shapes += _disc(x, y, radius, number)
        pages.append(
            Page(
                sheet,
                f"Discs, radius {mm(radius)} mm{_numbered(first // len(places), ceil(n / len(places)))}",
                (
                    f"disc_radius: {radius / 1000:g} in device.yaml, along the surface.",
                    "Cut along the thin circle: a white rim is harmless, a nick is not.",
                ),
                tuple(shapes),
            )
        )
    return pages


def _disc(x: float, y: float, radius: float, number: int) -> Iterator[Shape]:
    yield Circle(x, y, radius)
    yield Circle(x, y, radius + 1.0, GREY, HAIR)
    yield _ticks(x, y, radius + 1.0, radius + 2.8, 0.15)
    yield Words(x + radius + 2.2, y - radius - 1.6, str(number), size=3.2, align="right")


def _grid(sheet: Paper, cell: float, what: str) -> list[tuple[float, float]]:
    """Centres of square cells, from the top left: one cut parts two of them."""
    left, bottom, right, top = sheet.room
    columns, rows = floor((right - left) / cell + 1e-9), floor((top - bottom) / cell + 1e-9)
    if columns < 1 or rows < 1:
        raise CalibrationError(f"{what} across does not fit on {sheet.name} with room to cut; {_larger(sheet)}")
    first = (left + right - (columns - 1) * cell) / 2.0
    return [(first + i * cell, top - (j + 0.5) * cell) for j in range(rows) for i in range(columns)]


def _larger(sheet: Paper) -> str:
    largest = max(PAPERS, key=lambda name: PAPERS[name])
    return "take a smaller one" if sheet.name == largest else f"take a smaller one or --paper {largest}"


def _numbered(k: int, n: int) -> str:
    return f" · {k + 1} of {n}" if n > 1 else ""


# ---- boards ----


@dataclass(frozen=True, slots=True)
class Pattern:
    """A board as black rectangles, in mm from its lower left corner."""

    name: str  # on the page
    file: str
    black: Array  # (n, 4)
    across: float
    height: float
    square: float


def largest_square(board: Board, paper_name: str) -> float:
    """Return the largest square of a board on one page, in whole mm from 1 mm on."""
    fits = max(_fitting(board, paper(paper_name, wide=wide)) for wide in (False, True))
    return float(floor(fits + 1e-9)) if fits >= 1.0 else fits


def _fitting(board: Board, sheet: Paper) -> float:
    left, bottom, right, top = sheet.room
    white = 2.0 * _QUIET
    return min((right - left - white) / (board.columns + 1), (top - bottom - white) / (board.rows + 1))


def chessboard(board: Board, square: float) -> Pattern:
    """Return a chessboard of inner corners and squares (mm), black at the upper left."""
    rows, columns = np.mgrid[: board.rows + 1, : board.columns + 1]
    black = (rows + columns) % 2 == 0
    name = f"Chessboard {board.columns}×{board.rows}, squares {mm(square)} mm"
    file = f"chessboard-{board.columns}x{board.rows}-{mm(square)}mm"
    return Pattern(name, file, _squares(rows[black], columns[black], board, square), *_size(board, square), square)


def charuco(board: Board, square: float) -> Pattern:
    """Return a ChArUco board of inner corners and squares (mm); CalibrationError if no dictionary has enough markers.

    The layout is that of OpenCV's CharucoBoard (not the legacy pattern), with the markers' bits as rectangles.
    """
    columns, rows = board.columns + 1, board.rows + 1
    markers = columns * rows // 2
    label = next((name for name, n in _DICTIONARIES if n >= markers), None)
    if label is None:
        raise CalibrationError(f"--board {board.columns}x{board.rows}: needs {markers} markers; 1000 can be told apart")
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{label.upper()}"))
    marker = MARKER_SHARE * square
    laid = cv2.aruco.CharucoBoard((columns, rows), square, marker, dictionary)
    modules = dictionary.markerSize + 2  # bits and a black border
    found, white = [], np.zeros((rows, columns), dtype=bool)
    for number, corners in zip(np.ravel(laid.getIds()), laid.getObjPoints(), strict=True):
        x, y = corners[0][:2]  # upper left, y down
        white[int(y // square), int(x // square)] = True
        bits = cv2.aruco.generateImageMarker(dictionary, int(number), modules)
        found += [
            (
                x + a * marker / modules,
                y + r * marker / modules,
                x + b * marker / modules,
                y + (r + 1) * marker / modules,
            )
            for r, row in enumerate(bits)
            for a, b in _runs(row == 0)
        ]
    down = np.array(found)
    upright = np.stack([down[:, 0], rows * square - down[:, 3], down[:, 2], rows * square - down[:, 1]], axis=1)
    dark_rows, dark_columns = np.nonzero(~white)
    black = np.concatenate([_squares(dark_rows, dark_columns, board, square), upright])
    size = f"{mm(square)} mm, markers {mm(marker)} mm"
    return Pattern(
        f"ChArUco {columns}×{rows}, squares {size}, DICT_{label.upper()}",
        f"charuco-{board.columns}x{board.rows}-{mm(square)}mm-{mm(marker)}mm-{label}",
        black,
        *_size(board, square),
        square,
    )


def _squares(rows: NDArray[np.intp], columns: NDArray[np.intp], board: Board, square: float) -> Array:
    x, y = columns * square, (board.rows - rows) * square
    return np.stack([x, y, x + square, y + square], axis=1).astype(float)


def _size(board: Board, square: float) -> tuple[float, float]:
    return (board.columns + 1) * square, (board.rows + 1) * square


def _runs(row: Array) -> Iterator[tuple[int, int]]:
    """First and after-last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def board_pages(pattern: Pattern, board: Board, paper_name: str) -> list[Page]:
    """Return a board on one page, or in parts on several; CalibrationError if a square is too large."""
    corners = f"--board {board.columns}x{board.rows}, {mm(pattern.square)} mm a square"
    for wide in (True, False):
        sheet = paper(paper_name, wide=wide)
        if _fitting(board, sheet) >= pattern.square - 1e-9:
            return [_whole(pattern, board, sheet)]
    both = []
    for wide in (True, False):
        sheet = paper(paper_name, wide=wide)
        left, bottom, right, top = sheet.room
        x = _cuts(pattern.across, pattern.square, right - left - 2.0 * _MARKS)
        y = _cuts(pattern.height, pattern.square, top - bottom - 2.0 * _MARKS)
        if x and y:
            both.append((sheet, x, y))
    if not both:
        raise CalibrationError(f"{corners}: a square is too large for {paper_name}; {_larger(sheet)}")
    sheet, x, y = min(both, key=lambda b: len(b[1]) * len(b[2]))
    n = (len(x) - 1) * (len(y) - 1)
    if n > MAX_PAGES:
        raise CalibrationError(f"{corners}: {n} pages of {paper_name}; check the unit, or take a smaller square")
    return [_part(pattern, board, sheet, x, y, i, j) for j in range(len(y) - 1) for i in range(len(x) - 1)]


def _whole(pattern: Pattern, board: Board, sheet: Paper) -> Page:
    left, bottom, right, top = sheet.room
    at = np.array([(left + right - pattern.across) / 2.0, (bottom + top - pattern.height) / 2.0])
    notes = (
        "Glue it flat on something stiff (glass, foam board), and keep the white round it.",
        f"--board {board.columns}x{board.rows} --square {mm(pattern.square)}mm; measure: {_span(pattern, board)}",
    )
    return Page(sheet, pattern.name, notes, (Boxes(pattern.black + np.tile(at, 2)),))


def _span(pattern: Pattern, board: Board) -> str:
    return f"{board.columns + 1} squares are {mm(pattern.across)} mm."


def _cuts(length: float, square: float, limit: float) -> list[float]:
    """Places to cut a board into parts that fit, both ends included; empty without any.

    Cuts run through the middle of squares, so that the corners stay whole.
    """
    halves = np.arange(0.5, length / square, 1.0) * square
    for parts in range(1, 2 * MAX_PAGES):
        ideal = length * np.arange(1, parts) / parts
        inner = sorted({float(halves[np.argmin(np.abs(halves - c))]) for c in ideal})
        cuts = [0.0, *inner, length]
        sizes = np.diff(cuts)
        sizes[:-1] += _FLAP
        sizes[1:] += _BLEED
        if np.all(sizes <= limit + 1e-9):
            return cuts
    return []


def _part(pattern: Pattern, board: Board, sheet: Paper, x: list[float], y: list[float], i: int, j: int) -> Page:
    """The part of column i and row j (from the top), with flaps to the right and below for the next parts."""
    columns, rows = len(x) - 1, len(y) - 1
    last_column, last_row = i == columns - 1, j == rows - 1
    cut_left, cut_top = (_BLEED if i else 0.0), (_BLEED if j else 0.0)
    flap_right, flap_below = (0.0 if last_column else _FLAP), (0.0 if last_row else _FLAP)
    window = np.array(
        [
            x[i] - cut_left,
            pattern.height - y[j + 1] - flap_below,
            x[i + 1] + flap_right,
            pattern.height - y[j] + cut_top,
        ]
    )
    left, bottom, right, top = sheet.room
    width, height = window[2] - window[0], window[3] - window[1]
    move = np.array([(left + right - width) / 2.0, (bottom + top - height) / 2.0]) - window[:2]
    shapes: list[Shape] = [Boxes(_clipped(pattern.black, window) + np.tile(move, 2))]
    a, b, c, d = window + np.tile(move, 2)
    if i:
        at = a + _BLEED
        shapes += [lines([(at, d + 1.0, at, d + 5.0), (at, b - 5.0, at, b - 1.0)], 0.2, BLACK)]
        shapes += [Words(a - 1.2, (b + d) / 2.0, "cut from mark to mark", size=2.0, align="center", upwards=True)]
    if j:
        at = d - _BLEED
        shapes += [lines([(a - 5.0, at, a - 1.0, at), (c + 1.0, at, c + 5.0, at)], 0.2, BLACK)]
        shapes += [Words((a + c) / 2.0, d + 1.2, "cut from mark to mark", size=2.0, align="center")]
    over = f"glue the next page over the last {mm(_FLAP)} mm, so that the pattern runs on"
    if not last_column:
        shapes += [lines([(s, t, s, t + 4.0) for s in (c - _FLAP,) for t in (d + 1.0, b - 5.0)], 0.2, GREY)]
        shapes += [Words(c + 3.0, (b + d) / 2.0, over, size=2.0, align="center", upwards=True)]
    if not last_row:
        shapes += [lines([(s, b + _FLAP, s + 4.0, b + _FLAP) for s in (a - 5.0, c + 1.0)], 0.2, GREY)]
        shapes += [Words((a + c) / 2.0, b - 3.2, over, size=2.0, align="center")]
    notes = (
        f"Row {j + 1} of {rows}, column {i + 1} of {columns}; glue from row 1, column 1 on.",
        f"--board {board.columns}x{board.rows} --square {mm(pattern.square)}mm; measure: {_span(pattern, board)}",
    )
    return Page(sheet, pattern.name, notes, tuple(shapes))


def _clipped(black: Array, window: Array) -> Array:
    """Clip rectangles (n, 4) to a window (4,)."""
    low, high = np.maximum(black[:, :2], window[:2]), np.minimum(black[:, 2:], window[2:])
    inside = np.all(high - low > 1e-9, axis=1)
    return np.concatenate([low[inside], high[inside]], axis=1)
