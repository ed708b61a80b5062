"""Write and read logs of a mouse: the reports of a trackball as a table."""

import csv
import math
import os
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from spheremouse.errors import DatasetError
from spheremouse.files.atomic import NewFile
from spheremouse.files.safe_open import lines, open_to_read

if TYPE_CHECKING:  # so that a log begins at once, before NumPy is loaded
    pass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

COLUMNS = ("t", "dx", "dy", "wheel", "lost")
MOST = 5_000_000  # reports of a log: 80 minutes at 1000 Hz, 150 MB
_MOST_BYTES = 100 * MOST
_MOST_SECONDS = 6 * 3600.0
_MOST_COUNTS = 2**31  # an event's value is a signed 32-bit integer


@dataclass(frozen=True, slots=True)
class MouseReport:
    """One report of the mouse."""

    stamp: float  # s, time.monotonic()
    dx: int  # counts
    dy: int  # counts
    wheel: int = 0  # notches
    lost: bool = False  # the kernel dropped reports before this one

    def line(self) -> str:
        """The report as a line of the file."""
        return f"{self.stamp:.6f},{self.dx},{self.dy},{self.wheel},{int(self.lost)}\n"


class LogFile:
    """Writes a log line by line to a hidden file, which takes its name when the log ends."""

    def __init__(self, path: Path, about: str, force: bool = False) -> None:
        """`about` is a comment. Raises DatasetError if `path` exists, or cannot be written."""
        self.path, self._about, self._force = path, about, force
        self.reports = 0
        self.counts = [0, 0]  # to and fro
        self.first: float | None = None  # s
        self.last = 0.0  # s

    def __enter__(self) -> Self:
        self._refuse()
        try:
            self._new = NewFile(self.path)
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written: {e.strerror or e}") from None
        self._file = TextIOWrapper(self._new.file, encoding="utf-8", newline="\n")
        about = " ".join(self._about.split())
        self._file.write(f"# spheremouse log-mouse; {about}; t in s of the monotonic clock, dx and dy in counts\n")
        self._file.write(",".join(COLUMNS) + "\n")
        return self

    def add(self, report: MouseReport) -> None:
        """Add a line; DatasetError if the disk is full."""
        try:
            self._file.write(report.line())
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written further: {e.strerror or e}") from None
        self.first = report.stamp if self.first is None else self.first
        self.last = report.stamp
        if report.dx or report.dy or report.wheel:
            self.reports += 1
            self.counts[0] += abs(report.dx)
            self.counts[1] += abs(report.dy)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.flush()
            self._refuse()  # another process may have made it meanwhile
            self._new.finish()
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written: {e.strerror or e}") from None
        finally:
            self._new.discard()

    def _refuse(self) -> None:
        if self.path.is_dir():
            raise DatasetError(f"{self.path}: is a directory; name a file in it")
        if self.path.exists() and not self._force:
            raise DatasetError(f"{self.path}: exists already; choose another name, or replace it with --force")


def write_log(path: Path, log: "MouseLog", about: str = "simulated") -> None:
    """Write a whole log, in place of an old file."""
    with LogFile(path, about, force=True) as file:
        for k in range(len(log)):
            dx, dy = (round(c) for c in log.counts[k].tolist())
            file.add(MouseReport(float(log.stamp[k]), dx, dy, round(float(log.wheel[k])), bool(log.lost[k])))


def read_log(path: Path) -> "MouseLog":
    """Read a log. Columns wheel and lost are optional; # lines are comments. DatasetError has file and line."""
    import numpy as np

    rows, first, last, count = array("d"), 0.0, -math.inf, 0
    places: list[int] = []
    width = 0
    try:
        with open_to_read(path) as file:
            if os.fstat(file.fileno()).st_size > _MOST_BYTES:
                raise DatasetError(f"{path}: larger than {_MOST_BYTES} bytes; cut the log to what was recorded")
            reader = csv.reader(_bare(lines(file)))
            for number, cells in _numbered(reader):
                if not places:
                    width, places = len(cells), _places(path, number, cells)
                    continue
                if len(cells) != width:
                    raise DatasetError(f"{path}:{number}: {len(cells)} cells under {width} columns")
                row = [_number(path, number, cells[k], COLUMNS[i]) for i, k in enumerate(places) if k >= 0]
                if row[0] < last:
                    raise DatasetError(f"{path}:{number}: t goes back, from {last} to {row[0]} s")
                first = row[0] if count == 0 else first
                if row[0] - first > _MOST_SECONDS:
                    raise DatasetError(
                        f"{path}:{number}: t is {row[0] - first:.0f} s after the first; {_MOST_SECONDS:g} s at most: "
                        "cut the log to what was recorded"
                    )
                rows.extend(row)
                last, count = row[0], count + 1
                if count > MOST:
                    raise DatasetError(f"{path}:{number}: more than {MOST} reports; cut the log to what was recorded")
    except FileNotFoundError:
        raise DatasetError(f"{path}: no such file; make one with `spheremouse log-mouse`") from None
    except IsADirectoryError:
        raise DatasetError(f"{path}: is a directory; name the log in it") from None
    except UnicodeDecodeError:
        raise DatasetError(f"{path}:1: not text; name a log that `spheremouse log-mouse` wrote") from None
    except (OSError, csv.Error, ValueError) as e:
        raise DatasetError(
            f"{path}: cannot be read: {' '.join((getattr(e, 'strerror', None) or str(e)).split())}"
        ) from None
    if not places:
        raise DatasetError(f"{path}:1: empty; the first line is {','.join(COLUMNS)}")
    table = np.zeros((count, len(COLUMNS)))
    there = [i for i, k in enumerate(places) if k >= 0]
    table[:, there] = np.frombuffer(rows).reshape(count, len(there)) if count else 0.0
    return MouseLog(table[:, 0].copy(), table[:, 1:3].copy(), table[:, 3].copy(), table[:, 4] != 0.0)


def _bare(given: Iterator[str]) -> Iterator[str]:
    """Yield the lines, with comments left empty."""
    for line in given:
        yield "\n" if line.startswith("#") else line


def _numbered(reader: Any) -> Iterator[tuple[int, list[str]]]:
    for cells in reader:
        if cells:
            yield reader.line_num, cells


def _places(path: Path, number: int, header: list[str]) -> list[int]:
    names = [name.strip() for name in header]
    missing = [c for c in COLUMNS[:3] if c not in names]
    if missing:
        raise DatasetError(
            f"{path}:{number}: no column {', '.join(missing)}; a log of `spheremouse log-mouse` begins "
            f"{','.join(COLUMNS)}"
        )
    return [names.index(c) if c in names else -1 for c in COLUMNS]


def _number(path: Path, number: int, text: str, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (column != "t" and abs(value) > _MOST_COUNTS):
        raise DatasetError(f"{path}:{number}: {column}: {text[:40]!r} is not a number that can be")
    return value


@dataclass(frozen=True, slots=True)
class MouseLog:
    """Reports of a mouse. The first and the last may be empty; they are the begin and the end of the log."""

    stamp: Array  # (n,) s, of the log's clock; not decreasing
    counts: Array  # (n, 2), x and y
    wheel: Array  # (n,) notches
    lost: NDArray[np.bool_]  # (n,) reports between the one before and this one are known to be lost

    def __len__(self) -> int:
        return len(self.stamp)
