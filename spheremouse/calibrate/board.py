"""The calibration board and its file board.yaml; lengths as a person types them (`86mm`).

`calibrate print`, `calibrate practice` and `calibrate photos` write board.yaml. Later commands read the
board from it.
"""

import re
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from spheremouse.errors import CalibrationError, ConfigurationError, printable
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.yaml import Problem, read_document, refuse_control_characters

NAME = "board.yaml"
PRINTED = Path("calibration/print")  # default folder of `calibrate print`

_METRES = {"mm": Decimal("0.001"), "cm": Decimal("0.01"), "m": Decimal(1), "in": Decimal("0.0254")}
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?"
_MAX_LENGTH = 100.0  # m; nothing in front of a webcam is longer
_MAX_CORNERS = 200  # to a side of a board
_DICTIONARY = "DICT_5X5_100"


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


# ---- the file ----


@dataclass(frozen=True, slots=True)
class BoardFile:
    """A board in the words of the command line."""

    board: str = "11x8"  # inner corners, along and down
    square: str = "20mm"  # default of `calibrate print` on A4
    marker: str | None = None  # of a ChArUco board
    dictionary: str = _DICTIONARY

    @property
    def options(self) -> list[str]:
        """Options of `calibrate camera` for this board."""
        words = ["--board", self.board, "--square", self.square]
        if self.marker is not None:
            words += ["--marker", self.marker]
            words += [] if self.dictionary == _DICTIONARY else ["--dictionary", self.dictionary]
        return words

    @property
    def text(self) -> str:
        """Content of board.yaml."""
        lines = [
            "# The board. `calibrate photos --square` writes the side of a square as you measured it here.",
            f"board: {self.board}  # inner corners along and down: one less than squares",
            f"square: {self.square}",
        ]
        if self.marker is not None:
            lines += [f"marker: {self.marker}  # it is a ChArUco board", f"dictionary: {self.dictionary}"]
        return "\n".join(lines) + "\n"


def save_board(path: Path, board: BoardFile) -> None:
    """Write board.yaml, unless it describes this board already."""
    try:
        if load_board(path) == board:
            return
    except ConfigurationError:
        pass
    write_atomically(path, board.text)


def load_board(path: Path) -> BoardFile:
    """Read board.yaml; ConfigurationError with a line for each problem."""
    document = read_document(path)
    data = document.data
    if not isinstance(data, dict):
        raise document.error([Problem((), "must be lines like `square: 20mm`")])
    refuse_control_characters(document)
    problems = [Problem((key,), "is not known here") for key in data if key not in BoardFile.__dataclass_fields__]
    for key, parse in (("board", parse_board), ("square", parse_length), ("marker", parse_length)):
        try:
            if key in data:
                parse(data[key])
        except CalibrationError as e:
            problems.append(Problem((key,), str(e)))
    if problems:
        raise document.error(problems)
    return BoardFile(**{key: str(value) for key, value in data.items()})


def known_board(folder: Path) -> BoardFile | None:
    """Return the board of a calibration's folder, else the one printed last, else None.

    Raises ConfigurationError if its file is damaged.
    """
    path = next((p for p in (folder / NAME, folder / "print" / NAME, PRINTED / NAME) if p.is_file()), None)
    return None if path is None else load_board(path)


def chosen_board(
    folder: Path, board: str | None, square: str | None, marker: str | None, dictionary: str | None
) -> BoardFile:
    """Return the board that a command line names; `known_board` or the default print completes it."""
    given = {"board": board, "square": square, "marker": marker, "dictionary": dictionary}
    known = (BoardFile() if board and square else known_board(folder)) or BoardFile()
    return replace(known, **{key: value for key, value in given.items() if value is not None})


def board_options(folder: Path) -> list[str]:
    """Return the options of `calibrate camera` for a folder's board; the default print if the file is damaged."""
    try:
        board = known_board(folder)
    except ConfigurationError:
        board = None
    return (board or BoardFile()).options


def options_from_provenance(provenance: dict[str, Any]) -> tuple[str, ...]:
    """Return the board options in a camera file's provenance, as in `--board 11x8 --square 0.086m`, or nothing."""
    try:
        board, square = provenance["board"], float(provenance["square"])
        columns, rows = parse_board(board) if isinstance(board, str) else board
        found = BoardFile(f"{int(columns)}x{int(rows)}", f"{square:g}m")
        if "marker" in provenance:
            marker, dictionary = f"{float(provenance['marker']):g}m", printable(provenance["dictionary"])
            found = replace(found, marker=marker, dictionary=dictionary)
        return tuple(found.options)
    except (CalibrationError, KeyError, TypeError, ValueError):
        return ()
