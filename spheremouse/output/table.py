"""A table of samples in a file, for the outputs `csv` and `parquet`, and the description of its run beside it.

A file with the same columns is continued. Each opening of it is one run of the JSON file. Rows are written each second.
"""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import orjson

from spheremouse.errors import OutputError, os_errors_as
from spheremouse.files.safe_files import is_stream
from spheremouse.output import DescribeRun, OutputClosed, Report
from spheremouse.output.batch import BatchOutput
from spheremouse.output.columns import Column, columns, rows
from spheremouse.output.log_file import refuse_other_files, write_error
from spheremouse.output.run_json import RunRecord


class RowWriter(Protocol):
    """Writes rows to a file. Each method raises OSError if that fails."""

    def begin(self, columns: Sequence[Column]) -> None:
        """Write the head of the file. OutputError if it is continued and has other columns."""
        ...

    def write(self, rows: list[list[Any]]) -> None:
        """Write rows."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class Table(BatchOutput):
    """Writes one row a ball and frame. The first frame determines the columns."""

    def __init__(self, path: Path, writer: RowWriter) -> None:
        self._path, self._writer = path, writer
        self._describe_run: DescribeRun = dict
        self._begun, self._stream = False, is_stream(path)
        super().__init__(at_once=self._stream)
        self._run_record: RunRecord | None = None  # a stream has none

    def begin(self, describe_run: DescribeRun) -> None:
        self._describe_run = describe_run

    def write(self, reports: list[Report]) -> None:
        try:
            self._write([report for report in reports if report.samples])
        except BrokenPipeError:
            raise OutputClosed(str(self._path)) from None
        except OSError as e:
            raise write_error(self._path, e) from None

    def close(self) -> None:
        """Write the last rows, close the table, and complete the JSON file beside it.

        Raises OutputError; then the JSON file keeps the end null.
        """
        with os_errors_as(OutputError, f"{self._path}: cannot be written"), contextlib.closing(self._writer):
            self.write_kept()
        if self._run_record is not None:
            self._run_record.finish()

    def _write(self, reports: list[Report]) -> None:
        if not reports:
            return
        if not self._begun:
            self._writer.begin(columns(reports[0].samples[0].coordinates))
            if not self._stream:
                self._run_record = RunRecord(beside(self._path), self._describe_run())
            self._begun = True
        self._writer.write([row for report in reports for row in rows(report)])
        if self._run_record is not None:
            for report in reports:
                self._run_record.add(report.samples)


def open_table(path: Path, start: bytes, open_writer: Callable[[Path], RowWriter]) -> Table:
    """Open a file that begins with `start`, or a new one. Raise OutputError if that fails, or for another file."""
    try:
        refuse_other_files(path, start)
        return Table(path, open_writer(path))
    except (OSError, ValueError) as e:
        raise write_error(path, e) from None


def csv_line(row: list[Any]) -> bytes:
    """Return a row of a CSV file. Every number reads back exactly, unknown values are empty, and text has quotes."""
    return orjson.dumps(row)[1:-1].replace(b",null", b",") + b"\n"


def table_file(kind: str, argument: str) -> Path:
    """Return the file of `KIND:FILE`. Raise OutputError if there is none."""
    if argument in ("", "-"):
        raise OutputError(f"{kind}:{argument}: needs a file", f"write {kind}:FILE")
    return Path(argument)


def beside(path: Path) -> Path:
    """Return the file that describes the runs of a table."""
    return path.with_name(f"{path.name}.json")
