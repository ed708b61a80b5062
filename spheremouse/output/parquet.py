"""`parquet:FILE`: write samples as an Apache Parquet table. Unit, frame and meaning are metadata of each column.

A Parquet file is unreadable without its end, so rows go to an Arrow stream first, `FILE.part`. Closing
the output moves them to FILE. After a run that was killed, the next opening of FILE does, up to the last whole batch.
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.safe_files import NewFile, is_stream, open_to_append
from spheremouse.finding import Finding
from spheremouse.output.columns import Column
from spheremouse.output.extras import import_extra
from spheremouse.output.log_file import check_file, lock, probe_file, refuse_other_files
from spheremouse.output.table import Table, open_table, table_file

_START = b"PAR1"
_PART_START = b"\xff\xff\xff\xff"  # of a message of Arrow
_GROUP_ROWS = 65_536  # 18 minutes of a ball at 60 Hz


class PartWriter:
    """Writes rows to a part, and moves them to a Parquet file."""

    def __init__(self, path: Path) -> None:
        """Move the rows of a part that was left. Raise OSError, ValueError or OutputError if that fails."""
        self._pa = arrow("pyarrow")
        self._pa.array([])  # the first array imports pandas, which takes half a second; a frame would wait for it
        self._path, self._part = path, path.with_name(f"{path.name}.part")
        self._stream: Any = None
        self._schema: Any = None
        move_part(self._part, self._path)
        self._file = open_to_append(self._part)
        lock(self._part, self._file.fileno())

    def begin(self, columns: Sequence[Column]) -> None:
        """Write the head of the part."""
        pa = self._pa
        types = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
        words = [{"unit": c.unit, "frame": c.frame, "meaning": c.meaning} for c in columns]
        fields = [pa.field(c.name, types[c.type], metadata=w) for c, w in zip(columns, words, strict=True)]
        self._schema = pa.schema(fields)
        if self._path.exists() and not arrow("pyarrow.parquet").read_schema(self._path).equals(self._schema):
            raise OutputError(f"{self._path}: exists and has other columns", "choose another name or remove it")
        self._stream = pa.ipc.new_stream(self._file, self._schema)

    def write(self, rows: list[list[Any]]) -> None:
        """Write rows to the part."""
        arrays = [self._pa.array(v, f.type) for v, f in zip(zip(*rows, strict=True), self._schema, strict=True)]
        self._stream.write_batch(self._pa.record_batch(arrays, schema=self._schema))
        self._file.flush()

    def close(self) -> None:
        """Move the rows to the file."""
        try:
            if self._stream is not None:
                self._stream.close()
        finally:
            with contextlib.suppress(OSError):
                self._file.close()
        move_part(self._part, self._path)


def move_part(part: Path, path: Path) -> None:
    """Append the rows of a part, if there is one, to the table, and remove the part.

    Raise OSError or ValueError if that fails, OutputError if the part is another file. The part stays then.
    """
    pa, pq = arrow("pyarrow"), arrow("pyarrow.parquet")
    if not part.exists():
        return
    refuse_other_files(part, _PART_START)
    with part.open("rb") as file:
        lock(part, file.fileno())
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


def arrow(name: str) -> Any:
    """Return a module of pyarrow. Raise OutputError if it is not installed."""
    return import_extra("parquet", "pyarrow", "parquet", name)


def open(argument: str) -> Table:
    """Open a table to add rows. Raise OutputError as `check`, or if the file cannot be written."""
    check(argument)
    return open_table(file_of(argument), _START, PartWriter)


def check(argument: str) -> None:
    """Raise OutputError if the argument is invalid, pyarrow is missing, or the file exists and is not such a table."""
    path = file_of(argument)
    arrow("pyarrow")
    if is_stream(path):
        raise OutputError(f"{path}: is no regular file", "name one, or use csv")
    check_file(path, _START)


def file_of(argument: str) -> Path:
    """Return the file that an argument names."""
    return table_file("parquet", argument)


def probe(argument: str) -> list[Finding]:
    """Return whether this account may write the file."""
    return probe_file(file_of(argument), "table")
