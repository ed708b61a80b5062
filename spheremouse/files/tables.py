"""Read tables of numbers from csv files with a header. A number takes 8 bytes, so a table takes at most 400 MB."""

import csv
import math
from array import array
from pathlib import Path

import numpy as np

from spheremouse.errors import DatasetError
from spheremouse.files.safe_files import lines, open_to_read
from spheremouse.geometry.rotation import Array

MAX_NUMBERS = 50_000_000  # in all columns that are read


def read_columns(
    path: Path, columns: tuple[str, ...], optional: tuple[str, ...] = (), most: int | None = None
) -> dict[str, Array]:
    """Return the `columns` by name, each (n,), with nan for empty cells of the `optional` ones; skip all others.

    Lines that begin with # are comments. Reading stops after `most` rows and one more. Raises DatasetError, with the
    line, if a cell is no number, a row has another width than the header, or the table has too many rows.
    """
    fit = MAX_NUMBERS // len(columns)
    try:
        with open_to_read(path) as file:
            reader = csv.reader("\n" if line.startswith("#") else line for line in lines(file))
            rows = filter(None, reader)
            header = [name.strip() for name in next(rows, [])]
            missing = [c for c in columns if c not in header]
            if missing:
                problem = f"{path}, line {max(1, reader.line_num)}: no column {', '.join(missing)}"
                raise DatasetError(problem, "the table begins with a line of column names")
            wanted = [(array("d"), header.index(c), c, c in optional) for c in columns]
            for count, cells in enumerate(rows, 1):
                line = reader.line_num
                if len(cells) != len(header):
                    raise DatasetError(f"{path}, line {line}: {len(cells)} cells under {len(header)} columns")
                if count > fit:
                    raise DatasetError(f"{path}: more than {fit} rows; shorten the recording")
                for kept, place, column, may_be_empty in wanted:
                    kept.append(_number(path, line, column, cells[place], may_be_empty))
                if most is not None and count > most:
                    break
    except (OSError, UnicodeDecodeError, csv.Error) as e:
        raise DatasetError(f"{path}: cannot be read: {getattr(e, 'strerror', None) or e}") from None
    return {c: np.frombuffer(kept) if kept else np.empty(0) for kept, _, c, _ in wanted}


def _number(path: Path, line: int, column: str, text: str, may_be_empty: bool) -> float:
    """Return a cell as a number. Raises DatasetError unless it is finite, or empty where it may be; that is nan."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isfinite(value) or (may_be_empty and not text.strip()):
        return value
    raise DatasetError(f"{path}, line {line}: {column}: {text[:40]!r} is not a number")
