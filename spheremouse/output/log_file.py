"""Files that an output continues: the check of their beginning and end, and findings about them."""

import contextlib
import os
import stat
import sys
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.files.access import STATE_FOLDER
from spheremouse.files.safe_files import is_stream
from spheremouse.finding import Finding, absent, ok, wrong

_MAX_LINE_BYTES = 65_536  # a JSON object has 2,000


def check_file(path: Path, start: bytes) -> None:
    """Raise OutputError if the file exists and does not begin with `start`. Opening it reports other problems."""
    with contextlib.suppress(OSError, ValueError):
        refuse_other_files(path, start)


def write_error(place: object, error: Exception) -> OutputError:
    """Return the error of a file or stream, named `place`, that the system refuses to open or write."""
    return OutputError(f"{place}: cannot be written: {getattr(error, 'strerror', None) or error}")


def refuse_other_files(path: Path, start: bytes) -> None:
    """Raise OutputError if a regular file exists and does not begin with `start`; OSError if it cannot be read."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return
    if not stat.S_ISREG(status.st_mode) or status.st_size == 0:
        return
    with path.open("rb") as file:
        if file.read(len(start)) == start:
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
