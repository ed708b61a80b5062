"""Lengths and boards as a person types them: `86mm` in metres, `11x8` in corners. As parsers of typer options, too."""

import re
from decimal import Decimal
from typing import NamedTuple

from spheremouse.errors import CalibrationError

_METRES = {"mm": Decimal("0.001"), "cm": Decimal("0.01"), "m": Decimal(1), "in": Decimal("0.0254")}
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?"
_LONGEST = 100.0  # m; nothing in front of a webcam is longer
_MOST = 200  # corners to a side of a board


class Board(NamedTuple):
    """Inner corners of a board: where four squares meet."""

    columns: int  # along the longer side as a rule
    rows: int


def parse_length(text: str) -> float:
    """Metres of `86mm`, `8.6 cm`, `0.086m` or `3.4in`; CalibrationError without a unit."""
    text = str(text).strip()
    if re.fullmatch(_NUMBER, text):
        raise CalibrationError(f"{text} of what? give the length with its unit, as in {text}mm or {text}cm")
    found = re.fullmatch(rf"({_NUMBER})\s*([A-Za-z]+)", text)
    if not found:
        comma = "a point, not a comma, and " if "," in text else ""
        raise CalibrationError(f"{text!r} is no length; write a number with {comma}its unit, as in 86mm or 8.6cm")
    number, unit = found.groups()
    if unit.lower() not in _METRES:
        raise CalibrationError(f"{text!r}: {unit!r} is not a unit known here; write mm, cm, m or in, as in {number}mm")
    metres = float(Decimal(number) * _METRES[unit.lower()])  # decimal, so that 16.3 mm is 0.0163
    if not 0.0 < metres <= _LONGEST:
        raise CalibrationError(f"{text!r}: must be longer than 0 and not beyond {_LONGEST:g} m; check the unit")
    return metres


def parse_board(text: str) -> Board:
    """(11, 8) of `11x8`: inner corners along and down; CalibrationError for anything else."""
    found = re.fullmatch(r"(\d{1,4})\s*[xX×*]\s*(\d{1,4})", str(text).strip())
    if not found:
        raise CalibrationError(f"{str(text)!r} is no board; write its inner corners along and down, as in 11x8")
    board = Board(int(found[1]), int(found[2]))
    if min(board) < 3 or max(board) > _MOST:
        raise CalibrationError(
            f"{str(text)!r}: a board has from 3 to {_MOST} inner corners each way (one less than it has squares)"
        )
    return board
