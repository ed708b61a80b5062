"""Write and read logs of a mouse: a table with one line for each report.

The header is `t,dx,dy,wheel,lost`: the kernel's time in s, counts, notches, and 1 if reports before this one were lost.
The first and the last line are empty reports. They give the time of listening, since a mouse at rest sends nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import Self

import numpy as np

from spheremouse.errors import DatasetError
from spheremouse.files.safe_files import NewFile
from spheremouse.files.tables import read_columns
from spheremouse.geometry.rotation import Array

COLUMNS = ("t", "dx", "dy", "wheel", "lost")
MAX_REPORTS = 5_000_000  # 80 minutes at 1000 Hz, 150 MB
_MAX_SECONDS = 6 * 3600.0
_MAX_COUNTS = 2**31  # an event's value is a signed 32-bit integer


@dataclass(frozen=True, slots=True)
class MouseReport:
    """One report of the mouse."""

    stamp: float  # s, time.monotonic()
    dx: int  # counts
    dy: int  # counts
    wheel: int = 0  # notches
    lost: bool = False  # the kernel dropped reports before this one


@dataclass(frozen=True, slots=True)
class MouseLog:
    """Reports of a mouse. The first and the last may be empty; they are the begin and the end of the log."""

    stamp: Array  # (n,) s, of the log's clock; not decreasing
    counts: Array  # (n, 2), x and y


class LogFile:
    """Writes a log line by line to a hidden file, which takes its name when the log ends."""

    def __init__(self, path: Path, about: str, force: bool = False) -> None:
        """Prepare a log with the comment `about`; without `force` an existing file raises DatasetError."""
        self.path, self._about, self._force = path, about, force
        self.reports = 0  # with motion
        self.counts = [0, 0]  # sums of the absolute values
        self.first: float | None = None  # s
        self.last = 0.0  # s

    def __enter__(self) -> Self:
        self._refuse_existing()
        with self._writing():
            self._new = NewFile(self.path)
        self._file = TextIOWrapper(self._new.file, encoding="utf-8", newline="\n")
        about = " ".join(self._about.split())
        self._file.write(f"# spheremouse log-mouse; {about}; t in s of the monotonic clock, dx and dy in counts\n")
        self._file.write(",".join(COLUMNS) + "\n")
        return self

    def add(self, report: MouseReport) -> None:
        """Write a line; DatasetError if the disk is full."""
        with self._writing():
            self._file.write(f"{report.stamp:.6f},{report.dx},{report.dy},{report.wheel},{int(report.lost)}\n")
        self.first = report.stamp if self.first is None else self.first
        self.last = report.stamp
        self.reports += bool(report.dx or report.dy or report.wheel)
        self.counts[0] += abs(report.dx)
        self.counts[1] += abs(report.dy)

    def __exit__(self, *_: object) -> None:
        try:
            with self._writing():
                self._file.flush()
                self._refuse_existing()  # another process may have made it in the meantime
                self._new.finish()
        finally:
            self._new.discard()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written: {e.strerror or e}") from None

    def _refuse_existing(self) -> None:
        if self.path.is_dir():
            raise DatasetError(f"{self.path}: is a directory; name a file in it")
        if self.path.exists() and not self._force:
            raise DatasetError(f"{self.path}: exists already; choose another name, or replace it with --force")


def read_log(path: Path) -> MouseLog:
    """Read times and counts of a log. DatasetError gives the line, or the number of the report."""
    if not path.exists():
        raise DatasetError(f"{path}: no such file; make one with `spheremouse log-mouse`")
    table = read_columns(path, COLUMNS[:3], most=MAX_REPORTS)
    stamp, counts = table["t"], np.stack([table["dx"], table["dy"]], axis=1)
    if len(stamp) > MAX_REPORTS:
        raise DatasetError(f"{path}: more than {MAX_REPORTS} reports; cut the log to the time of the recording")
    back = np.flatnonzero(np.diff(stamp) < 0.0)
    if len(back):
        k = int(back[0])
        raise DatasetError(f"{path}, report {k + 2}: t goes back, from {stamp[k]} to {stamp[k + 1]} s")
    if len(stamp) and stamp[-1] - stamp[0] > _MAX_SECONDS:
        raise DatasetError(
            f"{path}: spans {stamp[-1] - stamp[0]:.0f} s, more than {_MAX_SECONDS:g} s; cut the log to the time of "
            "the recording"
        )
    large = np.flatnonzero(np.any(np.abs(counts) > _MAX_COUNTS, axis=1))
    if len(large):
        raise DatasetError(f"{path}, report {large[0] + 1}: a mouse cannot count beyond {_MAX_COUNTS} in one report")
    return MouseLog(stamp, counts)
