"""board.yaml: which board was printed, so that nobody has to type its squares again.

`calibrate print` and `calibrate practice` write one, `calibrate photos` keeps what it is told in the evening's folder.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spheremouse.calibrate.lengths import parse_board, parse_length
from spheremouse.errors import CalibrationError, ConfigurationError, printable
from spheremouse.files.atomic import write_atomically
from spheremouse.files.yaml import Problem, read_document, refuse_control_characters

NAME = "board.yaml"
PRINTED = Path("calibration/print")  # where `calibrate print` puts its sheets

_DICTIONARY = "DICT_5X5_100"


@dataclass(frozen=True, slots=True)
class BoardFile:
    """A board as options of the command line have it."""

    board: str = "11x8"  # inner corners, along and down
    square: str = "20mm"  # as `calibrate print` makes it on A4
    marker: str | None = None  # of a ChArUco board
    dictionary: str = _DICTIONARY

    @property
    def options(self) -> list[str]:
        """Options of `calibrate camera`."""
        words = ["--board", self.board, "--square", self.square]
        words += [] if self.marker is None else ["--marker", self.marker]
        return words + (
            [] if self.marker is None or self.dictionary == _DICTIONARY else ["--dictionary", self.dictionary]
        )


def text_of(board: BoardFile) -> str:
    """Content of a file."""
    lines = [
        "# The board. What you measure on the print, along a whole row of squares, `calibrate photos --square` keeps.",
        f"board: {board.board}  # inner corners along and down: one less than squares",
        f"square: {board.square}",
    ]
    if board.marker is not None:
        lines += [f"marker: {board.marker}  # it is a ChArUco board", f"dictionary: {board.dictionary}"]
    return "\n".join(lines) + "\n"


def save_board(path: Path, board: BoardFile) -> None:
    """Write a file whole; one that says so already is left as it is."""
    if not path.exists() or _loaded(path) != board:
        write_atomically(path, text_of(board))


def load_board(path: Path) -> BoardFile:
    """Of a file; ConfigurationError with a line per problem."""
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


def board_of(folder: Path) -> BoardFile | None:
    """The board of an evening's folder, or the one that was printed last where the sheets usually go; None: unknown.

    ConfigurationError where a file is damaged.
    """
    path = next((p for p in (folder / NAME, folder / "print" / NAME, PRINTED / NAME) if p.is_file()), None)
    return None if path is None else load_board(path)


def board_told(
    folder: Path, board: str | None, square: str | None, marker: str | None, dictionary: str | None
) -> BoardFile:
    """The board as a command line tells it; where that is silent as `board_of`, or as usually printed."""
    told = {"board": board, "square": square, "marker": marker, "dictionary": dictionary}
    known = (BoardFile() if board and square else board_of(folder)) or BoardFile()
    return replace(known, **{key: value for key, value in told.items() if value is not None})


def options_of(folder: Path) -> list[str]:
    """Options of `calibrate camera` for a folder's board; a file that is damaged is told by who needs it."""
    try:
        board = board_of(folder)
    except ConfigurationError:
        board = None
    return (board or BoardFile()).options


def options_made_of(provenance: dict[str, Any]) -> tuple[str, ...]:
    """Those that a camera file was made with, as in `--board 11x8 --square 0.086m`, or nothing."""
    try:
        board, square = provenance["board"], float(provenance["square"])
        columns, rows = parse_board(board) if isinstance(board, str) else board
        made = BoardFile(f"{int(columns)}x{int(rows)}", f"{square:g}m")
        if "marker" in provenance:
            made = replace(
                made, marker=f"{float(provenance['marker']):g}m", dictionary=printable(provenance["dictionary"])
            )
        return tuple(made.options)
    except (CalibrationError, KeyError, TypeError, ValueError):
        return ()


def _loaded(path: Path) -> BoardFile | None:
    try:
        return load_board(path)
    except ConfigurationError:
        return None
