"""`parquet:FILE`: write samples as an Apache Parquet table. Unit, frame and meaning are metadata of each column.

A Parquet file is unreadable without its end, so rows go to an Arrow stream first, `FILE.part`. Closing
the output moves them to FILE. After a run that was killed, the next opening of FILE does, up to the last whole batch.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.safe_files import is_stream, new_file, open_to_append
from spheremouse.finding import Finding
from spheremouse.output.columns import Column
from spheremouse.output.extras import import_extra
from spheremouse.output.log_file import lock, probe_file, refuse_other_files
from spheremouse.output.table import Table, open_table, table_file

_START = b"PAR1"
_PART_START = b"\xff\xff\xff\xff"  # of a message of Arrow
_GROUP_BATCHES = 256  # to a row group; a batch has the rows of a second

arrow = partial(import_extra, "parquet", "pyarrow", "parquet")  # module name -> module, or OutputError if it is missing
file_of = partial(table_file, "parquet")


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
        pa = self._pa
        types = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
        words = [{"unit": c.unit, "frame": c.frame, "meaning": c.meaning} for c in columns]
        fields = [pa.field(c.name, types[c.type], metadata=w) for c, w in zip(columns, words, strict=True)]
        self._schema = pa.schema(fields)
        if self._path.exists() and not arrow("pyarrow.parquet").read_schema(self._path).equals(self._schema):
            raise OutputError(f"{self._path}: exists and has other columns", "choose another name or remove it")
        self._stream = pa.ipc.new_stream(self._file, self._schema)

    def write(self, rows: list[list[Any]]) -> None:
        arrays = [self._pa.array(v, f.type) for v, f in zip(zip(*rows, strict=True), self._schema, strict=True)]
        self._stream.write_batch(self._pa.record_batch(arrays, schema=self._schema))
        self._file.flush()

    def close(self) -> None:
        with self._file:
            if self._stream is not None:
                self._stream.close()
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
            with new_file(path) as new, pq.ParquetWriter(new, stream.schema) as table:
                if path.exists():
                    for batch in pq.ParquetFile(path).iter_batches():
                        table.write_batch(batch)
                batches = _whole_batches(stream)
                while group := list(islice(batches, _GROUP_BATCHES)):
                    table.write_table(pa.Table.from_batches(group))
    part.unlink()


def _whole_batches(stream: Any) -> Iterator[Any]:
    try:
        yield from stream
    except (OSError, ValueError) as e:
        if getattr(e, "errno", None):  # the disk fails; otherwise a killed run or a full disk cut the last batch
            raise


def open(argument: str) -> Table:
    check(argument)
    return open_table(file_of(argument), _START, PartWriter)


def check(argument: str) -> None:
    """Raise OutputError if the argument is invalid, pyarrow is missing, or the file exists and is not such a table."""
    path = file_of(argument)
    arrow("pyarrow")
    if is_stream(path):
        raise OutputError(f"{path}: is no regular file", "name one, or use csv")
    refuse_other_files(path, _START)


def probe(argument: str) -> list[Finding]:
    return probe_file(file_of(argument), "table")
