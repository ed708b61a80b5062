"""Bytes and lines of a file that anybody may have sent: never more of them than their reader has use for.

A file is regular, or a pipe where one may be meant (`/dev/stdin`, `<(...)` of a shell). Everything else is refused
before it is opened, as an OSError whose `strerror` says in one line what is wrong and what to do.
"""

import errno
import os
import select
import stat
import time
from collections.abc import Iterator
from io import BufferedReader, TextIOWrapper
from pathlib import Path

PATIENCE = 10.0  # s in which all that a pipe brings must have come
FRAME_PIXELS = 8192 * 4320  # 8K of the cinema; webcams have 4K at most
LONGEST_LINE = 65_536  # characters of a table's line; a wand's truth of 20 balls has 6,000
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY"))
_PIECE = 65_536  # bytes


def read_bytes(path: Path, most: int, kind: str, *, pipe: bool = False) -> bytes:
    """All bytes of a file, or of a `pipe`; OSError where they are more than `most`, which no file of its `kind` has."""
    with _opened(path, pipe) as file:
        found = os.fstat(file.fileno())
        if found.st_size > most:
            raise _too_large(most, kind)
        piped = stat.S_ISFIFO(found.st_mode)
        data = _from_pipe(file.fileno(), most) if piped else file.read(found.st_size + _PIECE)  # or it has grown
    if len(data) > most:
        raise _too_large(most, kind)
    return data


def read_text(path: Path, most: int, kind: str, *, pipe: bool = False) -> str:
    """The same as UTF-8 text, without a byte order mark; UnicodeDecodeError where it is none."""
    return read_bytes(path, most, kind, pipe=pipe).decode("utf-8-sig")


def opened(path: Path) -> BufferedReader:
    """A regular file, to be read piece by piece; OSError for everything else."""
    return _opened(path, pipe=False)


def lines(file: BufferedReader) -> Iterator[str]:
    """Lines of a table, UTF-8 with their ends; OSError where a line does not end, or a quote: so would a row."""
    text, number = TextIOWrapper(file, encoding="utf-8-sig", newline=""), 0
    while line := text.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise OSError(errno.EINVAL, f"line {number} is longer than {LONGEST_LINE} characters; is it a table?")
        if line.count('"') % 2:
            raise OSError(errno.EINVAL, f"line {number} has a quote that does not end; numbers need none")
        yield line


def _too_large(most: int, kind: str) -> OSError:
    return OSError(errno.EFBIG, f"larger than {most / 1e6:g} MB, and no {kind} is; name another file")


def _opened(path: Path, pipe: bool) -> BufferedReader:
    """The file: no fifo without a writer is waited for, and no device is steered by being opened."""
    _check(path.stat().st_mode, pipe)
    file = os.fdopen(os.open(path, _FLAGS), "rb")
    try:
        _check(os.fstat(file.fileno()).st_mode, pipe)  # it may be another one by now
    except BaseException:
        file.close()
        raise
    return file


def _check(mode: int, pipe: bool) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode) and not (pipe and stat.S_ISFIFO(mode)):
        raise OSError(errno.EINVAL, "is not a file; name one")


def _from_pipe(descriptor: int, most: int) -> bytes:
    """Bytes of a pipe until its writer ends, or more than `most`; a writer need not be there yet."""
    data, end = bytearray(), time.monotonic() + PATIENCE
    while len(data) <= most:
        if not select.select([descriptor], [], [], max(0.0, end - time.monotonic()))[0]:
            raise OSError(errno.ETIMEDOUT, f"a pipe whose writer has not ended in {PATIENCE:g} s; name a file")
        piece = os.read(descriptor, _PIECE)
        if not piece:
            break
        data += piece
    return bytes(data)
