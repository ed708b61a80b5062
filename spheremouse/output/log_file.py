"""Files that an output continues: the check of their beginning and end, findings about them, and writes in batches.

A file gets the reports of half a second at once: to format each alone takes five times as long.
"""

import contextlib
import os
import stat
import sys
import time
from math import inf
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.files.access import STATE_FOLDER
from spheremouse.files.safe_files import is_stream
from spheremouse.finding import Finding, absent, ok, wrong
from spheremouse.output import Output, Report

PERIOD_S = 0.5  # s between two writes
MAX_WAIT_S = 1.0  # s between two writes in a run of a recording, where no thread calls them
_MAX_LINE_BYTES = 65_536  # a JSON object has 2,000


def write_error(place: object, error: Exception) -> OutputError:
    """Return the error of a file or stream, named `place`, that the system refuses to open or write."""
    return OutputError(f"{place}: cannot be written: {getattr(error, 'strerror', None) or error}")


def refuse_other_files(path: Path, start: bytes) -> None:
    """Raise OutputError if a regular file exists and does not begin with `start`. Opening it reports other problems."""
    with contextlib.suppress(OSError, ValueError):
        if path.is_file():
            with path.open("rb") as file:
                if file.read(len(start)) in (start, b""):
                    return
            raise OutputError(f"{path}: exists and is no log in this format", "choose another name or remove it")


def lock(path: Path, descriptor: int) -> None:
    """Lock an open file until it is closed. Raise OutputError if another run writes it. Windows has no such lock."""
    if sys.platform != "win32":
        import fcntl

        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(f"{path}: another run writes it", "choose another name, or stop that run") from None


def drop_unfinished_line(path: Path, descriptor: int) -> None:
    """Remove the last line of a file if its end is missing, as after a full disk. Its last number may be cut."""
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_size == 0 or is_stream(path):
        return
    with path.open("rb") as file:
        start = max(0, status.st_size - _MAX_LINE_BYTES)
        file.seek(start)
        end = file.read(_MAX_LINE_BYTES)
    kept = end.rfind(b"\n") + 1
    if kept < len(end) and (kept or start == 0):
        os.ftruncate(descriptor, start + kept)


def probe_file(path: Path, output: str) -> list[Finding]:
    """Return whether this account may write the file; `output` names its content, such as "table"."""
    if not path.parent.is_dir():
        missing = wrong if path.parent != STATE_FOLDER else absent
        return [missing("output", f"{path.parent}: no such folder", "make it, or name another")]
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        return [wrong("output", f"{path} may not be written", "name a file elsewhere")]
    return [ok("output", f"{output} to {path}")]


class BatchOutput(Output):
    """Keeps reports, and writes them each period. Derive an output from it and override `write`.

    The first report is written at once, since it proves that the file can be written. A reader of a stream gets each
    report at once.
    """

    def __init__(self, *, at_once: bool) -> None:
        self._reports: list[Report] = []  # not written yet
        self._at_once, self.period = at_once, inf if at_once else PERIOD_S
        self._written = 0.0  # s, monotonic

    def write(self, reports: list[Report]) -> None:
        """Write reports. Raise OutputError if that fails, or OutputClosed if the reader is gone."""
        raise NotImplementedError

    def send(self, report: Report) -> None:
        """Keep a report, or write all if they are due. An empty report means that they are."""
        if report.samples or self._at_once:
            self._reports.append(report)
        if self.blocks or not report.samples or time.monotonic() > self._written + MAX_WAIT_S:
            self.write_kept()

    def write_kept(self) -> None:
        """Write what is kept."""
        reports, self._reports = self._reports, []
        self._written = time.monotonic()
        if reports:
            self.write(reports)
            self.blocks = self._at_once
