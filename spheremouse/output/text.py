"""`text:-` and `text:FILE`: one line per report, after a header line that begins with `#`.

A line is `stamp dx dy dz rx ry rz wx wy wz`: s, counts, rotation vector since the last line (rad, obj), rate (rad/s,
obj), with all digits. Every line is flushed. The output appends to FILE, so a second run or a full disk costs no line.
Each opening writes the header line again. A file with other contents is refused.
"""

import contextlib
import os
import stat
import sys
from io import TextIOWrapper
from pathlib import Path
from typing import Self, TextIO

import numpy as np

from spheremouse.errors import OutputError
from spheremouse.files.access import STATE_FOLDER
from spheremouse.files.safe_files import is_stream, open_to_append
from spheremouse.finding import Finding, absent, ok, wrong
from spheremouse.output import OutputClosed, Report

NAMES = "# stamp dx dy dz rx ry rz wx wy wz"
HEADER = f"{NAMES} (s, counts, rotation since the last line in rad and rate in rad/s, both in obj)"

_MAX_LINE_BYTES = 65_536  # a line of a wand has 600


class Text:
    """Writes reports as lines."""

    def __init__(self, file: TextIO, name: str, header: str = HEADER) -> None:
        self._file, self._name, self._reader_gone = file, name, False
        with contextlib.suppress(OutputClosed):  # the first `send` raises it, inside the `with` block
            self._write(header)

    def send(self, report: Report) -> None:
        """Write one line."""
        self._write(line(report))

    def describe(self, report: Report) -> str:
        """Return the line."""
        return line(report)

    def _write(self, text: str) -> None:
        if self._reader_gone:
            raise OutputClosed(self._name)
        try:
            self._file.write(text + "\n")
            self._file.flush()
        except BrokenPipeError:
            self._reader_gone = True
            self._drop_unwritten()
            raise OutputClosed(self._name) from None
        except OSError as e:
            self._drop_unwritten()
            raise OutputError(f"{self._name}: cannot be written: {e.strerror or e}") from None

    def _drop_unwritten(self) -> None:
        """Send the rest of the buffer to the null device; otherwise Python's flush at its exit prints an error."""
        with contextlib.suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._file.fileno())
            os.close(null)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> bool:
        if self._file is not sys.stdout:
            self._file.close()
        return isinstance(error, OutputClosed)


def open(argument: str) -> Text:
    """Open standard output (`-` or nothing) or a file."""
    return Text(*open_log(argument, NAMES))


def check(argument: str) -> None:
    """Raise OutputError if the file exists and is not such a log."""
    if argument in ("", "-"):
        return
    with contextlib.suppress(OSError, ValueError):  # `open` reports these
        _refuse_other_files(Path(argument), NAMES)


def probe(argument: str) -> list[Finding]:
    """Return whether this account may write the file."""
    if argument in ("", "-"):
        return [ok("output", "text to standard output")]
    path = Path(argument)
    if not path.parent.is_dir():
        missing = wrong if path.parent != STATE_FOLDER else absent
        return [missing("output", f"{path.parent}: no such folder", "make it, or name another")]
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        return [wrong("output", f"{path} may not be written", "name a file elsewhere")]
    return [ok("output", f"text to {path}")]


def open_log(argument: str, names: str) -> tuple[TextIO, str]:
    """Open a file to append lines to; return it and its name for messages. Its first line must begin with `names`."""
    if argument in ("", "-"):
        return sys.stdout, "standard output"
    path = Path(argument)
    try:
        _refuse_other_files(path, names)
        file = open_to_append(path)
        _drop_unfinished_line(path, file.fileno())
        return TextIOWrapper(file, encoding="utf-8"), str(path)
    except (OSError, ValueError) as e:
        reason = (e.strerror if isinstance(e, OSError) else None) or e
        raise OutputError(f"{path}: cannot be written: {reason}") from None


def line(report: Report) -> str:
    """Return a report as a line. Each number reads back exactly."""
    estimate = report.estimate
    rate = estimate.rate[:3] if estimate.confirmed else np.zeros(3)
    exact = [float(v) for v in (*estimate.increment[:3], *rate)]
    return " ".join([repr(float(estimate.stamp)), *(str(int(n)) for n in report.counts), *map(repr, exact)])


def _refuse_other_files(path: Path, names: str) -> None:
    if _is_other_file(path, names):
        raise OutputError(f"{path}: exists and is no log of motions; choose another name or remove it")


def _drop_unfinished_line(path: Path, descriptor: int) -> None:
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


def _is_other_file(path: Path, names: str) -> bool:
    """Return True if a regular file exists and its first line does not begin with `names`."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return False
    if not stat.S_ISREG(status.st_mode) or status.st_size == 0:
        return False
    with path.open("rb") as file:
        return file.read(len(names)) != names.encode()
