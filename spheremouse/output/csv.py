"""`csv:FILE`: write samples as a table of text.

Comment lines give unit, frame and meaning of each column. Every number reads back exactly. Unknown values are empty.
"""

import contextlib
from collections.abc import Sequence
from functools import partial
from io import RawIOBase
from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.safe_files import is_stream, open_to_append
from spheremouse.finding import Finding
from spheremouse.output.columns import Column
from spheremouse.output.log_file import drop_unfinished_line, lock, probe_file, refuse_other_files
from spheremouse.output.table import Table, csv_line, open_table, table_file

_START = b"# spheremouse samples"

file_of = partial(table_file, "csv")


class CsvWriter:
    """Writes rows to a CSV file."""

    def __init__(self, path: Path) -> None:
        """Open the file to append to. Raise OSError or ValueError if that fails."""
        self._path, self._stream = path, is_stream(path)
        self._file: RawIOBase = open_to_append(path).detach()  # unbuffered
        if not self._stream:
            lock(path, self._file.fileno())
        drop_unfinished_line(path, self._file.fileno())
        self._size = 0 if self._stream else path.stat().st_size  # of whole rows

    def begin(self, columns: Sequence[Column]) -> None:
        """Write the head, unless the file has it."""
        head = header(columns)
        found = b""
        if not self._stream:
            with self._path.open("rb") as file:
                found = file.read(len(head))
        if found == head:
            return
        if not head.startswith(found):
            raise OutputError(f"{self._path}: exists and has other columns", "choose another name or remove it")
        if found:  # a full disk cut the head
            self._file.truncate(0)
            self._size = 0
        self._write(head)

    def write(self, rows: list[list[Any]]) -> None:
        """Write rows. If that fails, the file keeps whole rows."""
        self._write(b"".join(map(csv_line, rows)))

    def close(self) -> None:
        self._file.close()

    def _write(self, data: bytes) -> None:
        """Write all bytes; after an error, cut the file to whole rows."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) or 0 :]
        except OSError:
            if not self._stream:
                with contextlib.suppress(OSError):
                    self._file.truncate(self._size)
            raise
        self._size += len(data)


def header(columns: Sequence[Column]) -> bytes:
    """Return the comment lines and the line of names."""
    comments = [f"{_START.decode()}, one row a ball and frame; column [unit, frame]: meaning"]
    for column in columns:
        units = ", ".join(filter(None, (column.unit, column.frame)))
        comments.append(f"# {column.name}{f' [{units}]' if units else ''}: {column.meaning}")
    comments.append(",".join(column.name for column in columns))
    return "".join(f"{line}\n" for line in comments).encode()


def open(argument: str) -> Table:
    return open_table(file_of(argument), _START, CsvWriter)


def check(argument: str) -> None:
    refuse_other_files(file_of(argument), _START)


def probe(argument: str) -> list[Finding]:
    return probe_file(file_of(argument), "table")
