"""A table of samples in a file, for the outputs `csv` and `parquet`, and the description of its runs beside it.

A file with the same columns is continued. Rows are written each second. The description is a JSON file,
`{"schema": 1, "runs": [...]}`, with one object for each opening of the table. The first row writes it, with the end
null. Closing the table completes it, so a run that was killed keeps null.
"""

import contextlib
import json
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import orjson

from spheremouse.errors import OutputError, os_errors_as
from spheremouse.files import plain_json
from spheremouse.files.safe_files import is_stream, read_text, replace
from spheremouse.output import DescribeRun, OutputClosed, Report
from spheremouse.output.columns import Column, columns, rows
from spheremouse.output.log_file import BatchOutput, refuse_other_files, write_error
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status

_MAX_DESCRIPTION_BYTES = 100_000_000


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


class RunRecord:
    """The description of one run, with the times at which a ball was lost."""

    def __init__(self, path: Path, description: dict[str, Any]) -> None:
        """Add a run to the file. Raise OutputError if it cannot be written, or is another file."""
        self._path, self._runs = path, _runs(path)
        self._run: dict[str, Any] = {"start": _now(), "end": None, "verdict": None, **description}
        self._runs.append(self._run)
        self._rows = self._tracked = self._missing = 0
        self._first: Sample | None = None
        self._last: Sample | None = None
        self._losses: list[dict[str, Any]] = []
        self._lost: dict[int, dict[str, Any]] = {}  # losses that have not ended, by ball
        self._write()

    def add(self, samples: Iterable[Sample]) -> None:
        """Count the samples of a frame."""
        for sample in samples:
            self._rows += 1
            self._tracked += sample.status is Status.TRACKING
            self._count_loss(sample)
            if self._last is not None:
                self._missing += max(0, int(sample.sequence) - int(self._last.sequence) - 1)
            self._first, self._last = self._first or sample, sample

    def finish(self) -> None:
        """Complete the description. Raise OutputError if it cannot be written."""
        self._run |= {
            "end": _now(),
            "verdict": self._verdict(),
            "stamps": [float(s.stamp) for s in (self._first, self._last) if s is not None],
            "rows": self._rows,
            "rows_tracked": self._tracked,
            "frames_missing": self._missing,
            "losses": self._losses,
        }
        self._write()

    def _count_loss(self, sample: Sample) -> None:
        lost, stamp = self._lost.get(sample.ball), float(sample.stamp)
        if lost is None and sample.status is Status.LOST:
            self._lost[sample.ball] = lost = {"ball": sample.ball, "start": stamp, "end": None}
            self._losses.append(lost)
        elif lost is not None and sample.status is not Status.LOST:
            lost["end"] = stamp
            del self._lost[sample.ball]

    def _verdict(self) -> str:
        end = float(self._last.stamp) if self._last is not None else 0.0
        seconds = sum((end if loss["end"] is None else loss["end"]) - loss["start"] for loss in self._losses)
        n, share = len(self._losses), 100.0 * self._tracked / max(self._rows, 1)
        lost = f"lost {n} time{'s' if n > 1 else ''}, {seconds:.2f} s in all" if n else "never lost"
        missing = f"; {self._missing} frames are missing" if self._missing else ""
        return f"{self._tracked} of {self._rows} rows tracked ({share:.1f} %), {lost}{missing}"

    def _write(self) -> None:
        text = json.dumps({"schema": 1, "runs": self._runs}, indent=1, allow_nan=False)
        with os_errors_as(OutputError, f"{self._path}: cannot be written"):
            replace(self._path, text.encode() + b"\n")


def _runs(path: Path) -> list[dict[str, Any]]:
    """Return the runs of a file, none if it does not exist."""
    try:
        found = plain_json.loads(read_text(path, _MAX_DESCRIPTION_BYTES, "description of runs"))
        if isinstance(found, dict) and found.get("schema") == 1 and isinstance(found.get("runs"), list):
            return found["runs"]
    except FileNotFoundError:
        return []
    except OSError as e:
        raise write_error(path, e) from None
    except ValueError:
        pass
    raise OutputError(f"{path}: exists and is no description of runs", "choose another name or remove it")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


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
        """Write the last rows, close the table, and complete its description; its end stays null if that fails."""
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
