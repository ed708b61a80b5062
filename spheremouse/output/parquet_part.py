"""Move rows from the part of a Parquet table, an Arrow stream, to the table.

A part that a killed run or a full disk has cut is read up to its last whole batch.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spheremouse.files.safe_files import NewFile
from spheremouse.output.extras import import_extra
from spheremouse.output.log_file import lock, refuse_other_files

_START = b"\xff\xff\xff\xff"  # of a message of Arrow
_GROUP_ROWS = 65_536  # 18 minutes of a ball at 60 Hz


def move_part(part: Path, path: Path) -> None:
    """Append the rows of a part, if there is one, to the table, and remove the part.

    Raise OSError or ValueError if that fails, OutputError if the part is another file. The part stays then.
    """
    pa, pq = arrow("pyarrow"), arrow("pyarrow.parquet")
    if not part.exists():
        return
    refuse_other_files(part, _START)
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
