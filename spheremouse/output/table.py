"""A table of samples in a file, for the outputs `csv` and `parquet`, and the description of its run beside it.

A file with the same columns is continued. Each opening of it is one run of the JSON file.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from spheremouse.errors import OutputError
from spheremouse.files.safe_files import is_stream
from spheremouse.output import DescribeRun, Output, OutputClosed, Report
from spheremouse.output.columns import Column, columns, rows
from spheremouse.output.log_file import cannot_be_written, refuse_other_files
from spheremouse.output.run_json import RunRecord


class RowWriter(Protocol):
    """Writes rows to a file. Each method raises OSError if that fails."""

    def begin(self, columns: Sequence[Column]) -> None:
        """Write the head of the file. OutputError if it is continued and has other columns."""
        ...

    def write(self, rows: list[list[Any]]) -> None:
        """Write rows; at most those of the last second are lost if the program is killed."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class Table(Output):
    """Writes one row a ball and frame. The first frame determines the columns."""

    def __init__(self, path: Path, writer: RowWriter) -> None:
        self._path, self._writer = path, writer
        self._describe_run: DescribeRun = dict
        self._begun = False
        self._record: RunRecord | None = None  # a stream has none

    def begin(self, describe_run: DescribeRun) -> None:
        """Take the function that describes the run; the first frame calls it."""
        self._describe_run = describe_run

    def send(self, report: Report) -> None:
        """Write the rows of a frame."""
        if not report.samples:
            return
        try:
            if not self._begun:
                self._begin(report)
            self._writer.write(list(rows(report)))
        except BrokenPipeError:
            raise OutputClosed(str(self._path)) from None
        except OSError as e:
            raise cannot_be_written(self._path, e) from None
        if self._record is not None:
            self._record.add(report.samples)

    def describe(self, report: Report) -> str:
        """Return the rows as text."""
        return " | ".join(",".join("" if v is None else str(v) for v in row) for row in rows(report))

    def close(self) -> None:
        """Close the file, and complete the description of the run."""
        try:
            self._writer.close()
        except OSError as e:
            raise cannot_be_written(self._path, e) from None
        if self._record is not None:
            self._record.finish()

    def _begin(self, report: Report) -> None:
        self._writer.begin(columns(report.samples[0].coordinates))
        if not is_stream(self._path):
            self._record = RunRecord(beside(self._path), self._describe_run())
        self._begun = True


def open_table(path: Path, start: bytes, open_writer: Callable[[Path], RowWriter]) -> Table:
    """Open a file that begins with `start`, or a new one. Raise OutputError if that fails, or for another file."""
    try:
        refuse_other_files(path, start)
        return Table(path, open_writer(path))
    except (OSError, ValueError) as e:
        raise cannot_be_written(path, e) from None


def table_file(kind: str, argument: str) -> Path:
    """Return the file of `KIND:FILE`. Raise OutputError if there is none."""
    if argument in ("", "-"):
        raise OutputError(f"{kind}:{argument}: needs a file", f"write {kind}:FILE")
    return Path(argument)


def beside(path: Path) -> Path:
    """Return the file that describes the runs of a table."""
    return path.with_name(f"{path.name}.json")
