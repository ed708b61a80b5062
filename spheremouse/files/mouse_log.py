"""Write and read logs of a mouse: a table with one line for each report.

The header is `t,dx,dy`: the kernel's time in s, and counts. The first and the last line are empty reports. They give
the time of listening, since a mouse at rest sends nothing.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spheremouse.errors import DatasetError
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.tables import read_columns
from spheremouse.geometry.rotation import Array

_COLUMNS = ("t", "dx", "dy")
_MAX_SECONDS = 6 * 3600.0


class MouseReport(NamedTuple):
    stamp: float  # s, time.monotonic()
    dx: int  # counts
    dy: int  # counts


@dataclass(frozen=True, slots=True)
class MouseLog:
    """Reports of a mouse. The first and the last may be empty; they are the begin and the end of the log."""

    stamp: Array  # (n,) s, of the log's clock; not decreasing
    counts: Array  # (n, 2), x and y


def write_log(path: Path, about: str, reports: Iterable[MouseReport]) -> None:
    """Write a log with the comment `about`; ConfigurationError if that fails."""
    comment = f"# spheremouse log-mouse; {' '.join(about.split())}; t in s of the monotonic clock, dx and dy in counts"
    lines = (f"{r.stamp:.6f},{r.dx},{r.dy}" for r in reports)
    write_atomically(path, "\n".join((comment, ",".join(_COLUMNS), *lines, "")))


def read_log(path: Path) -> MouseLog:
    """Return times and counts of a log that `spheremouse log-mouse` wrote.

    Raises DatasetError with the line of a malformed value, with the number of a report, from 1, whose time is before
    that of the last one, or if the log is longer than a recording can be.
    """
    if not path.exists():
        raise DatasetError(f"{path}: no such file; make one with `spheremouse log-mouse`")
    table = read_columns(path, _COLUMNS)
    stamp = table["t"]
    decreasing = np.flatnonzero(np.diff(stamp) < 0.0)
    if len(decreasing):
        k = int(decreasing[0])
        raise DatasetError(f"{path}, report {k + 2}: t goes back, from {stamp[k]} to {stamp[k + 1]} s")
    if len(stamp) and stamp[-1] - stamp[0] > _MAX_SECONDS:
        raise DatasetError(
            f"{path}: spans {stamp[-1] - stamp[0]:.0f} s, more than {_MAX_SECONDS:g} s; cut the log to the time of "
            "the recording"
        )
    return MouseLog(stamp, np.stack([table["dx"], table["dy"]], axis=1))
