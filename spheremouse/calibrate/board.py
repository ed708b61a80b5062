"""The calibration board and its file board.yaml; lengths as a person types them (`86mm`).

`calibrate print`, `calibrate practice` and `calibrate photos` write board.yaml. Later commands read the
board from it.
"""

import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.yaml import Problem, read_document, refuse_control_characters
from spheremouse.geometry.rotation import Array

NAME = "board.yaml"
PRINTED = Path("calibration/print")  # default folder of `calibrate print`

_METRES = {"mm": Decimal("0.001"), "cm": Decimal("0.01"), "m": Decimal(1), "in": Decimal("0.0254")}
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?"
_MAX_LENGTH = 100.0  # m; nothing in front of a webcam is longer
_MAX_CORNERS = 200  # to a side of a board
_DICTIONARY = "DICT_5X5_100"
DICTIONARIES = tuple(f"DICT_{n}X{n}_{m}" for n in (4, 5, 6, 7) for m in (50, 100, 250, 1000))


# ---- lengths and corners, also as parsers of typer options ----


class Board(NamedTuple):
    """Numbers of inner corners, the points where four squares meet."""

    columns: int  # usually along the longer side
    rows: int


def parse_length(text: str) -> float:
    """Return the metres of `86mm`, `8.6 cm`, `0.086m` or `3.4in`; CalibrationError without a unit."""
    text = str(text).strip()
    if re.fullmatch(_NUMBER, text):
        raise CalibrationError(f"{text}: a length needs its unit, as in {text}mm or {text}cm")
    parts = re.fullmatch(rf"({_NUMBER})\s*([A-Za-z]+)", text)
    if not parts:
        comma = "a point, not a comma, and " if "," in text else ""
        raise CalibrationError(f"{text!r} is no length; write a number with {comma}its unit, as in 86mm or 8.6cm")
    number, unit = parts.groups()
    if unit.lower() not in _METRES:
        raise CalibrationError(f"{text!r}: {unit!r} is not a unit known here; write mm, cm, m or in, as in {number}mm")
    metres = float(Decimal(number) * _METRES[unit.lower()])  # decimal, so that 16.3 mm is 0.0163
    if not 0.0 < metres <= _MAX_LENGTH:
        raise CalibrationError(f"{text!r}: must be longer than 0 and not beyond {_MAX_LENGTH:g} m; check the unit")
    return metres


def parse_board(text: str) -> Board:
    """Return the inner corners (11, 8) of `11x8`, along and down; CalibrationError for anything else."""
    parts = re.fullmatch(r"(\d{1,4})\s*[xX×*]\s*(\d{1,4})", str(text).strip())
    if not parts:
        raise CalibrationError(f"{str(text)!r} is no board; write its inner corners along and down, as in 11x8")
    board = Board(int(parts[1]), int(parts[2]))
    if min(board) < 3 or max(board) > _MAX_CORNERS:
        raise CalibrationError(
            f"{str(text)!r}: a board has from 3 to {_MAX_CORNERS} inner corners each way (one less than it has squares)"
        )
    return board


# ---- a board ----


@dataclass(frozen=True, slots=True)
class Pattern:
    """A board: `marker` makes it a ChArUco board. Its frame: first corner, X along a row, Y down, Z into the board."""

    columns: int = 11  # inner corners in a row
    rows: int = 8
    square: float = 0.02  # m; the default is that of `calibrate print` on A4
    marker: float | None = None  # m, side of a ChArUco marker
    dictionary: str = _DICTIONARY

    def corners(self) -> Array:
        """All inner corners row by row, (columns * rows, 3) m."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * self.square

    @property
    def grid(self) -> tuple[int, int]:
        """Numbers of inner corners, the larger one first."""
        return max(self.columns, self.rows), min(self.columns, self.rows)

    @property
    def words(self) -> dict[str, str]:
        """The board in the words of the command line and of board.yaml."""
        words = {"board": f"{self.columns}x{self.rows}", "square": f"{1e3 * self.square:.9g}mm"}
        if self.marker is not None:
            words |= {"marker": f"{1e3 * self.marker:.9g}mm", "dictionary": self.dictionary}
        return words

    @property
    def options(self) -> list[str]:
        """Options of `calibrate camera` for this board."""
        return [w for key, word in self.words.items() if word != _DICTIONARY for w in (f"--{key}", word)]

    @property
    def text(self) -> str:
        """Content of board.yaml."""
        lines = [
            "# The board. `calibrate photos --square` writes the side of a square as you measured it here.",
            "# board: inner corners along and down, one less than squares; marker: it is a ChArUco board.",
            *(f"{key}: {word}" for key, word in self.words.items()),
        ]
        return "\n".join(lines) + "\n"


def parse_pattern(board: str, square: str, marker: str | None = None, dictionary: str = _DICTIONARY) -> Pattern:
    """Return the board of a command line's words; CalibrationError if there can be no such board."""
    columns, rows = parse_board(board)
    side = parse_length(square)
    if marker is None:
        return Pattern(columns, rows, side)
    inner = parse_length(marker)
    if inner >= side:
        raise CalibrationError(f"--marker {marker}: must be smaller than the square around it, which is {square}")
    name = str(dictionary).upper()
    name = name if name.startswith("DICT_") else f"DICT_{name}"
    if name not in DICTIONARIES:
        raise CalibrationError(f"--dictionary {dictionary}: not known; one of {', '.join(DICTIONARIES)}")
    needed, has = (columns + 1) * (rows + 1) // 2, int(name.rpartition("_")[2])  # one in every second square
    if needed > has:
        raise CalibrationError(
            f"--dictionary {name}: has {has} markers, and a board of {columns}x{rows} inner corners carries {needed}; "
            "name the dictionary that is printed on the board"
        )
    return Pattern(columns, rows, side, inner, name)


# ---- its file ----


def save_board(path: Path, board: Pattern) -> None:
    """Write board.yaml, unless it describes this board already."""
    try:
        if load_board(path) == board:
            return
    except ConfigurationError:
        pass
    write_atomically(path, board.text)


def load_board(path: Path) -> Pattern:
    """Read board.yaml; ConfigurationError with a line for each problem."""
    document = read_document(path)
    data = document.data
    if not isinstance(data, dict):
        raise document.error([Problem((), "must be lines like `square: 20mm`")])
    refuse_control_characters(document)
    known = {"board": parse_board, "square": parse_length, "marker": parse_length, "dictionary": str}
    problems = []
    for key, value in data.items():
        try:
            known[key](value)
        except KeyError:
            problems.append(Problem((key,), "is not known here"))
        except CalibrationError as e:
            problems.append(Problem((key,), str(e)))
    if problems:
        raise document.error(problems)
    try:
        return parse_pattern(**{**Pattern().words, **{key: str(value) for key, value in data.items()}})
    except CalibrationError as e:
        raise document.error([Problem(("marker",), str(e))]) from None


def known_board(folder: Path) -> Pattern | None:
    """Return the board of a calibration's folder, else the one printed last, else None.

    Raises ConfigurationError if its file is damaged.
    """
    path = next((p for p in (folder / NAME, folder / "print" / NAME, PRINTED / NAME) if p.is_file()), None)
    return None if path is None else load_board(path)


def chosen_board(
    folder: Path, board: str | None, square: str | None, marker: str | None, dictionary: str | None
) -> Pattern:
    """Return the board that a command line names; `known_board` or the default print completes it."""
    given = {"board": board, "square": square, "marker": marker, "dictionary": dictionary}
    known = (Pattern() if board and square else known_board(folder)) or Pattern()
    return parse_pattern(**{**known.words, **{key: word for key, word in given.items() if word is not None}})


def board_options(folder: Path) -> list[str]:
    """Return the options of `calibrate camera` for a folder's board; the default print if the file is damaged."""
    try:
        board = known_board(folder)
    except ConfigurationError:
        board = None
    return (board or Pattern()).options


def options_from_provenance(provenance: dict[str, Any]) -> list[str]:
    """Return the board options in a camera file's provenance, as in `--board 11x8 --square 86mm`, or nothing."""
    try:
        lengths = {key: f"{float(provenance[key]):g}m" for key in ("square", "marker") if key in provenance}
        others = {key: str(provenance[key]) for key in ("board", "dictionary") if key in provenance}
        return parse_pattern(**lengths, **others).options
    except (CalibrationError, TypeError, ValueError):
        return []
