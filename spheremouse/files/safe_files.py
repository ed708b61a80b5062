"""Read files of strangers with limits, and write files and folders whole or not at all.

The readers open regular files alone, with limits for bytes and lines. A refusal is an OSError whose `strerror` has
problem and remedy in one line.

The writers write under a hidden name beside the place and then rename, so at any moment the old file or the new one is
there. They write to a stream, device or pipe that a user gives (`/dev/null`, a named pipe), and never replace it.

Root refuses to write into a folder that another user may change, since that user could put a link there. The user who
called sudo counts as root.
"""

import contextlib
import errno
import glob
import json
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from functools import partial
from io import BufferedReader, BufferedWriter, TextIOWrapper
from pathlib import Path
from typing import Any

from spheremouse.errors import ConfigurationError, SpheremouseError, os_errors_as

MIN_LEFTOVER_AGE_S = 3600.0  # s since the last write; no file of ours takes so long until it has its name
MAX_LINE_CHARACTERS = 65_536  # characters of a table's line; a wand's truth of 20 balls has 6,000
_OPEN_FLAGS = sum(getattr(os, name, 0) for name in ("O_CLOEXEC", "O_NOCTTY", "O_BINARY"))
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)
_CHUNK_BYTES = 65_536
_MAX_LINKS = 40  # in one path, as in the kernel
_STREAMS = {"stdin": 0, "stdout": 1, "stderr": 2}
_STREAM = re.compile(r"/dev/(stdin|stdout|stderr)|/(?:dev|proc/self)/fd/(\d{1,9})")


def read_bytes(path: Path, max_bytes: int, kind: str) -> bytes:
    """Read a file. Raise OSError above `max_bytes`, which no file of this `kind` has."""
    with open_to_read(path) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(size + _CHUNK_BYTES) if size <= max_bytes else b""  # the file may have grown since
    if max(size, len(data)) > max_bytes:
        text = f"larger than {max_bytes / 1e6:g} MB, and no {kind} is; name another file"
        raise OSError(errno.EFBIG, text)
    return data


def read_text(path: Path, max_bytes: int, kind: str) -> str:
    """Read UTF-8 text as `read_bytes` does, without a byte order mark; UnicodeDecodeError for other text."""
    return read_bytes(path, max_bytes, kind).decode("utf-8-sig")


def open_to_read(path: Path) -> BufferedReader:
    """Open a regular file; OSError for anything else, without waiting for a pipe or opening a device."""
    _refuse_other_kinds(path.stat().st_mode)
    file = os.fdopen(os.open(path, os.O_RDONLY | _NO_WAIT | _OPEN_FLAGS), "rb")
    try:
        _refuse_other_kinds(os.fstat(file.fileno()).st_mode)  # another process may have exchanged it meanwhile
    except BaseException:
        file.close()
        raise
    return file


def lines(file: BufferedReader) -> Iterator[str]:
    """Yield the lines of a UTF-8 table with their ends; OSError for an endless line, or a quote that does not end."""
    text = TextIOWrapper(file, encoding="utf-8-sig", newline="")
    for number, line in enumerate(iter(partial(text.readline, MAX_LINE_CHARACTERS + 1), ""), 1):
        if len(line) > MAX_LINE_CHARACTERS:
            problem = f"line {number} is longer than {MAX_LINE_CHARACTERS} characters; is it a table?"
            raise OSError(errno.EINVAL, problem)
        if line.count('"') % 2:
            raise OSError(errno.EINVAL, f"line {number} has a quote that does not end; numbers need none")
        yield line


def open_to_append(path: Path) -> BufferedWriter:
    """Open the file, stream or pipe that a person named, to write at its end; a missing file is made."""
    return os.fdopen(_open_to_write(path, os.O_CREAT | os.O_APPEND), "ab")


def is_stream(path: Path) -> bool:
    """Return whether the path is a stream of this program, a device or a pipe."""
    other_kind = os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path))
    return other_kind or _STREAM.fullmatch(str(path)) is not None


def replace(path: Path, data: bytes, mode: int | None = None) -> None:
    """Write a file at `path` and replace an old one. Raise OSError if that fails.

    Without a `mode`, the new file takes mode and owner of the old one. Without an old file the umask sets the mode.
    """
    try:
        with new_file(path, mode) as file:
            file.write(data)
    except OSError as e:
        e.filename = str(path)  # not the hidden name
        raise


def write(path: Path, data: bytes) -> None:
    """Replace the file that a person named, or write to the stream, device or pipe; OSError if that fails."""
    if not is_stream(path):
        replace(path, data)
        return
    with os.fdopen(_open_to_write(path, 0), "wb") as file:
        file.write(data)


def write_atomically(path: Path, text: str) -> None:
    """Write text as `write` does; raise ConfigurationError if that fails."""
    with os_errors_as(ConfigurationError, f"{path}: cannot be written"):
        write(path, text.encode("utf-8"))


def write_json(path: Path, data: Any) -> bool:
    """Write data as JSON, to standard output for `-`. Return whether it was printed."""
    text = json.dumps(data, indent=1, allow_nan=False)
    if path == Path("-"):
        print(text)
        return True
    write_atomically(path, text + "\n")
    return False


@contextlib.contextmanager
def new_file(path: Path, mode: int | None = None) -> Iterator[BufferedWriter]:
    """Open a file under a hidden name in this block; at its end it gets its name, or is removed after an exception.

    `mode`: see `replace`. Raises OSError for a device or pipe, or if no file can be made.
    """
    if is_stream(path):
        raise OSError(errno.EINVAL, "is a device or pipe; name a file")
    refuse_shared_folder(path.parent)
    old = path.stat() if mode is None and os.path.isfile(path) else None
    mode = mode if old is None else stat.S_IMODE(old.st_mode) & 0o777
    hidden = _hidden_name(path, ".new")
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | _OPEN_FLAGS
    descriptor = os.open(hidden, flags, 0o666 if mode is None else 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            if old is not None and hasattr(os, "fchown"):
                with contextlib.suppress(OSError):  # only root may give files away
                    os.fchown(descriptor, old.st_uid, old.st_gid)
            if mode is not None and hasattr(os, "fchmod"):
                os.fchmod(descriptor, mode)
            os.fsync(descriptor)
        os.replace(hidden, path)
        _clear_left(path)
    finally:
        with contextlib.suppress(OSError):  # it has its name
            hidden.unlink()


def _clear_left(path: Path) -> None:
    """Remove the hidden files that killed processes left beside this file, if they have the age MIN_LEFTOVER_AGE_S."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.{'?' * 8}.new"):
        with contextlib.suppress(OSError):
            if time.time() - left.lstat().st_mtime > MIN_LEFTOVER_AGE_S:
                left.unlink()


class NewFolder:
    """A folder under a hidden name beside its place.

    `make` makes it, `finish` renames it to its place, `discard` removes it. Write below `path`. A signal may end the
    program at any step, so call `make` inside a `try` statement and `discard` in its `finally`.
    """

    def __init__(self, path: Path, error: type[SpheremouseError]) -> None:
        """Prepare the folder `path`; only `make` writes to the disk. Raises `error` if `path` is a file."""
        if path.exists() and not path.is_dir():
            raise error(f"{path}: is a file; name a folder")
        self._target, self._error = path, error
        self._old: Path | None = None  # hidden name of the folder that is being replaced
        self.path = _hidden_name(path)

    def make(self) -> Path:
        """Make the folder, empty, and return `path`; raise the error of the constructor if that fails."""
        with os_errors_as(self._error, f"{self._target}: cannot be written"):
            self._target.parent.mkdir(parents=True, exist_ok=True)
            refuse_shared_folder(self._target.parent)
            self.path.mkdir(0o700)
        return self.path

    def finish(self) -> None:
        """Move the folder to its place and remove the old one. OSError: the old one is put back if possible."""
        if not self._target.exists():
            os.replace(self.path, self._target)
            return
        self._old = _hidden_name(self._target)
        try:
            os.replace(self._target, self._old)
            os.replace(self.path, self._target)
        finally:
            self._clear_old()

    def discard(self) -> None:
        """Remove the folder with its content, unless it has its name."""
        self._clear_old()
        shutil.rmtree(self.path, ignore_errors=True)

    def _clear_old(self) -> None:
        """Remove the old folder; put it back if the new one has not reached its place."""
        if self._old is None:
            return
        if self._target.exists():
            shutil.rmtree(self._old, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                os.replace(self._old, self._target)


def refuse_shared_folder(folder: Path) -> None:
    """Raise OSError if this is root and another user may change the folder, one above it, or a link on the way."""
    if others_may_change(folder):
        text = "root does not write into a folder that others may change; write as its owner, or into another folder"
        raise OSError(errno.EPERM, text, str(folder))


def others_may_change(folder: Path) -> bool:
    """Return whether this is root and another user may exchange the folder, one above it, a link on the way, or a file.

    In a folder with the sticky bit, such as /tmp, users cannot exchange files of others. Raises OSError if the folder
    does not exist.
    """
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        return False
    users, groups = ("0", os.environ.get("SUDO_UID")), ("0", os.environ.get("SUDO_GID"))
    for path in _folders_on_the_way(folder):
        found = path.stat()
        others_write = found.st_mode & stat.S_IWOTH or (
            found.st_mode & stat.S_IWGRP and str(found.st_gid) not in groups
        )
        if str(found.st_uid) not in users or (others_write and not found.st_mode & stat.S_ISVTX):
            return True
    return False


def _folders_on_the_way(folder: Path) -> set[Path]:
    """Return the folders through which a path leads, those of its links included; OSError for a loop of links."""
    found, left, links = set[Path](), [folder.absolute()], 0
    while left:
        path = left.pop()
        for place in (path, *path.parents):
            if place not in found and place.is_symlink():
                links += 1
                if links > _MAX_LINKS:
                    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(folder))
                left.append(place.parent / place.readlink())
            found.add(place)
    return found


def _refuse_other_kinds(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is not a file; name one")


def _open_to_write(path: Path, flags: int) -> int:
    if (stream := _STREAM.fullmatch(str(path))) is not None:  # this program's own; the path could open another file
        for ours in (sys.stdout, sys.stderr):
            ours.flush()
        return os.dup(_STREAMS[stream[1]] if stream[1] else int(stream[2]))
    refuse_shared_folder(path.parent)
    return os.open(path, os.O_WRONLY | flags | _OPEN_FLAGS, 0o666)


def _hidden_name(path: Path, ending: str = "") -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}{ending}")
