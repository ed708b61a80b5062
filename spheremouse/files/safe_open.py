"""Open files that strangers may have written, and refuse folders in which others could mislead root.

Reading: a regular file, or a pipe if the caller allows one (`/dev/stdin`, `<(...)` of a shell), with a limit of bytes
or of a line's length. Every refusal is an OSError whose `strerror` gives problem and remedy in one line.

Writing: root writes only in a folder that nobody else may change, since another user could put a link there. The user
who has called sudo counts as root.
"""

import errno
import os
import re
import select
import stat
import sys
import time
from collections.abc import Iterator
from io import BufferedReader, TextIOWrapper
from pathlib import Path
from typing import BinaryIO

PIPE_TIMEOUT_S = 10.0  # until the writer of a pipe has closed it
LONGEST_LINE = 65_536  # characters of a table's line; a wand's truth of 20 balls has 6,000
_FLAGS = sum(getattr(os, name, 0) for name in ("O_CLOEXEC", "O_NOCTTY", "O_BINARY"))
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)
_CHUNK_BYTES = 65_536
_MAX_LINKS = 40  # in one path, as in the kernel
_STREAMS = {"stdin": 0, "stdout": 1, "stderr": 2}
_STREAM = re.compile(r"/dev/(stdin|stdout|stderr)|/(?:dev|proc/self)/fd/(\d{1,9})")


# ---- read ----


def read_bytes(path: Path, max_bytes: int, kind: str, *, pipe: bool = False) -> bytes:
    """Read a file, or a `pipe`. Raise OSError above `max_bytes`, which no file of this `kind` has."""
    with _open_checked(path, pipe) as file:
        found = os.fstat(file.fileno())
        if found.st_size > max_bytes:
            raise _too_large(max_bytes, kind)
        if stat.S_ISFIFO(found.st_mode):
            data = _read_pipe(file.fileno(), max_bytes)
        else:
            data = file.read(found.st_size + _CHUNK_BYTES)  # the file may have grown since
    if len(data) > max_bytes:
        raise _too_large(max_bytes, kind)
    return data


def read_text(path: Path, max_bytes: int, kind: str, *, pipe: bool = False) -> str:
    """Read UTF-8 text as `read_bytes` does, without a byte order mark; UnicodeDecodeError for other text."""
    return read_bytes(path, max_bytes, kind, pipe=pipe).decode("utf-8-sig")


def open_to_read(path: Path) -> BufferedReader:
    """Open a regular file without waiting; OSError for anything else."""
    return _open_checked(path, pipe=False)


def lines(file: BufferedReader) -> Iterator[str]:
    """Yield the lines of a UTF-8 table with their ends; OSError for an endless line, or a quote that does not end."""
    text, number = TextIOWrapper(file, encoding="utf-8-sig", newline=""), 0
    while line := text.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise OSError(errno.EINVAL, f"line {number} is longer than {LONGEST_LINE} characters; is it a table?")
        if line.count('"') % 2:
            raise OSError(errno.EINVAL, f"line {number} has a quote that does not end; numbers need none")
        yield line


# ---- write ----


def open_to_append(path: Path) -> BinaryIO:
    """Open the file, stream or pipe that a person named, to write at its end; a missing file is made."""
    return os.fdopen(_open_to_write(path, os.O_CREAT | os.O_APPEND), "ab")


def open_stream(path: Path) -> BinaryIO:
    """Open a stream, device or pipe that a person named to write to it."""
    return os.fdopen(_open_to_write(path, 0), "wb")


def is_stream(path: Path) -> bool:
    """Is the path a stream of this program, a device or a pipe: neither a file nor a folder, nor missing?"""
    if _STREAM.fullmatch(str(path)):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


# ---- what root refuses ----


def refuse_shared_folder(folder: Path) -> None:
    """Raise OSError if this is root and another user may change the folder, one above it, or a link on the way."""
    if others_may_change(folder):
        text = "root does not write into a folder that others may change; write as its owner, or into another folder"
        raise OSError(errno.EPERM, text, str(folder))


def others_may_change(folder: Path) -> bool:
    """Is this root, and may another user exchange the folder, one above it, a link on the way, or what is in it?

    In a folder with the sticky bit, such as /tmp, nobody can exchange the file of another user. OSError if the folder
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
        for there in (path, *path.parents):
            if there not in found and there.is_symlink():
                links += 1
                if links > _MAX_LINKS:
                    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(folder))
                left.append(there.parent / there.readlink())
            found.add(there)
    return found


# ---- within ----


def _too_large(max_bytes: int, kind: str) -> OSError:
    return OSError(errno.EFBIG, f"larger than {max_bytes / 1e6:g} MB, and no {kind} is; name another file")


def _open_checked(path: Path, pipe: bool) -> BufferedReader:
    """Open without waiting for a pipe's writer, and without opening a device, which could start something."""
    _check_kind(path.stat().st_mode, pipe)
    file = os.fdopen(os.open(path, os.O_RDONLY | _NO_WAIT | _FLAGS), "rb")
    try:
        _check_kind(os.fstat(file.fileno()).st_mode, pipe)  # somebody may have exchanged it meanwhile
    except BaseException:
        file.close()
        raise
    return file


def _check_kind(mode: int, pipe: bool) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode) and not (pipe and stat.S_ISFIFO(mode)):
        raise OSError(errno.EINVAL, "is not a file; name one")


def _read_pipe(descriptor: int, max_bytes: int) -> bytes:
    """Read until the writer closes the pipe, or beyond `max_bytes`; the writer may open it later."""
    data, end = bytearray(), time.monotonic() + PIPE_TIMEOUT_S
    while len(data) <= max_bytes:
        if not select.select([descriptor], [], [], max(0.0, end - time.monotonic()))[0]:
            raise OSError(errno.ETIMEDOUT, f"a pipe whose writer has not ended in {PIPE_TIMEOUT_S:g} s; name a file")
        chunk = os.read(descriptor, _CHUNK_BYTES)
        if not chunk:
            break
        data += chunk
    return bytes(data)


def _open_to_write(path: Path, flags: int) -> int:
    if (stream := _STREAM.fullmatch(str(path))) is not None:  # this program's own; the path could open another file
        for ours in (sys.stdout, sys.stderr):
            ours.flush()
        return os.dup(_STREAMS[stream[1]] if stream[1] else int(stream[2]))
    refuse_shared_folder(path.parent)
    return os.open(path, os.O_WRONLY | flags | _FLAGS, 0o666)
