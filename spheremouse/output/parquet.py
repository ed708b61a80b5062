"""`parquet:FILE`: write samples as an Apache Parquet table. Unit, frame and meaning are metadata of each column.

A Parquet file is unreadable without its end, so rows go to an Arrow stream first, `FILE.part`, once a second. Closing
the output moves them to FILE. After a run that was killed, the next opening of FILE does.
"""

import contextlib
import importlib
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.safe_files import NewFile, is_stream, open_to_append
from spheremouse.finding import Finding
from spheremouse.output.columns import Column
from spheremouse.output.log_file import probe_file, refuse_other_files
from spheremouse.output.table import Table, check_table, open_table, table_file

_START, _PART_START = b"PAR1", b"\xff\xff\xff\xff"
_PERIOD = 1.0  # s between two writes
_GROUP_ROWS = 65_536  # 18 minutes of a ball at 60 Hz


class PartWriter:
    """Writes rows to a part, and moves them to a Parquet file."""

    def __init__(self, path: Path) -> None:
        """Move the rows of a part that was left. Raise OSError, ValueError or OutputError if that fails."""
        self._pa = _arrow("pyarrow")
        self._path, self._part = path, path.with_name(f"{path.name}.part")
        self._rows: list[list[Any]] = []
        self._written = time.monotonic()
        self._stream: Any = None
        self._schema: Any = None
        _finish(self._path, self._part)
        self._file = open_to_append(self._part)

    def begin(self, columns: Sequence[Column]) -> None:
        """Write the head of the part."""
        pa = self._pa
        types = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
        words = [{"unit": c.unit, "frame": c.frame, "meaning": c.meaning} for c in columns]
        fields = [pa.field(c.name, types[c.type], metadata=w) for c, w in zip(columns, words, strict=True)]
        self._schema = pa.schema(fields)
        if self._path.exists() and not _arrow("pyarrow.parquet").read_schema(self._path).equals(self._schema):
            raise OutputError(f"{self._path}: exists and has other columns", "choose another name or remove it")
        self._stream = pa.ipc.new_stream(self._file, self._schema)

    def write(self, rows: list[list[Any]]) -> None:
        """Keep rows, and write them to the part once a second."""
        self._rows += rows
        if time.monotonic() - self._written >= _PERIOD:
            self._write()

    def close(self) -> None:
        """Move the rows to the file."""
        try:
            if self._stream is not None:
                self._write()
                self._stream.close()
        finally:
            with contextlib.suppress(OSError):
                self._file.close()
        _finish(self._path, self._part)

    def _write(self) -> None:
        rows, self._rows, self._written = self._rows, [], time.monotonic()
        if rows:
            arrays = [self._pa.array(v, f.type) for v, f in zip(zip(*rows, strict=True), self._schema, strict=True)]
            self._stream.write_batch(self._pa.record_batch(arrays, schema=self._schema))
            self._file.flush()


def _finish(path: Path, part: Path) -> None:
    """Append the rows of a part to the table, and remove the part."""
    pa, pq = _arrow("pyarrow"), _arrow("pyarrow.parquet")
    if not part.exists():
        return
    refuse_other_files(part, _PART_START)
    with part.open("rb") as file:
        try:
            stream = pa.ipc.open_stream(file)
        except pa.ArrowInvalid:  # its head is cut, and no row was written
            stream = None
        if stream is not None:
            with NewFile(path) as new, pq.ParquetWriter(new.file, stream.schema) as table:
                if path.exists():
                    for batch in pq.ParquetFile(path).iter_batches(_GROUP_ROWS):
                        table.write_batch(batch)
                for batches in _groups(stream):
                    table.write_table(pa.Table.from_batches(batches))
    part.unlink()


def _groups(stream: Any) -> Iterator[list[Any]]:
    """Yield the whole batches of a stream, in lists of a row group each."""
    batches: list[Any] = []
    try:
        for batch in stream:
            batches.append(batch)
            if sum(b.num_rows for b in batches) >= _GROUP_ROWS:
                yield batches
                batches = []
    except (OSError, ValueError) as e:
        if getattr(e, "errno", None):  # the disk fails; otherwise a killed run or a full disk cut the last batch
            raise
    if batches:
        yield batches


def _arrow(name: str) -> Any:
    """Return a module of pyarrow. Raise OutputError if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise OutputError("parquet: needs the package pyarrow", "pip install 'spheremouse[parquet]'") from None


def open(argument: str) -> Table:
    """Open a file that rows are added to. Raise OutputError if it is another file."""
    check(argument)
    return open_table(file_of(argument), _START, PartWriter)


def check(argument: str) -> None:
    """Raise OutputError if the argument is invalid, pyarrow is missing, or the file exists and is not such a table."""
    path = file_of(argument)
    _arrow("pyarrow")
    if is_stream(path):
        raise OutputError(f"{path}: is no regular file", "name one, or use csv")
    check_table(path, _START)


def file_of(argument: str) -> Path:
    """Return the file that an argument names."""
    return table_file("parquet", argument)


def probe(argument: str) -> list[Finding]:
    """Return whether this account may write the file."""
    return probe_file(file_of(argument), "table")
