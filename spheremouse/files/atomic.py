"""Files written whole or not at all, in folders that other people may write to, too.

A new file is made beside its place, under a hidden name that nothing had before, and is given mode and owner by its
descriptor. What stands at the place is replaced; nothing behind a link, a second name, a device or a pipe is touched.

What is no file (`/dev/null`, a named pipe) is written through where a person named it, and by root only in a folder
where nobody else may write: see `lookup`.
"""

import contextlib
import json
import os
import re
import secrets
import stat
import time
from collections.abc import Iterator
from io import BufferedWriter
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ConfigurationError
from spheremouse.files.lookup import FOLDERS, NO_WAIT, is_root, is_stream, open_in, open_path, reach

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

OLD = 3600.0  # s since the last byte: longer than any file of ours takes between that and its name
_LETTERS = "abcdefghijklmnopqrstuvwxyz0123456789_"
_RANDOM = 8  # of them: 41 bits
_LEFT = re.compile(rf"\.(?P<name>.+)\.[{_LETTERS}]{{{_RANDOM}}}\.new", re.S)


def replace(path: Path, data: bytes, mode: int | None = None) -> None:
    """Put a file of this content at `path`, whole or not at all, in place of what is there; OSError where it cannot be.

    Without a `mode`, a file that is there gives its own, and its owner; a new one is made as the umask wants.
    """
    try:
        with NewFile(path, mode) as new:
            new.file.write(data)
    except OSError as e:
        e.filename = str(path)  # not the hidden name
        raise


def write(path: Path, data: bytes) -> None:
    """`replace` what a person named; a stream, device or pipe is written to instead. OSError where it cannot be."""
    if not is_stream(path):
        replace(path, data)
        return
    with os.fdopen(open_path(path, os.O_WRONLY), "wb") as file:
        file.write(data)


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that at any moment either the old or the new one is there, whole.

    A device or a pipe is written to, never replaced: see the module.
    """
    try:
        write(path, text.encode("utf-8"))
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be written: {e.strerror or e}") from None


def write_json(path: Path, data: Any) -> bool:
    """Write data as JSON, whole or not at all; to standard output for `-`. Whether it was printed."""
    text = json.dumps(data, indent=1, allow_nan=False)
    if path == Path("-"):
        print(text)
        return True
    write_atomically(path, text + "\n")
    return False


def random_letters() -> str:
    """The part of a hidden name that nobody can guess."""
    return "".join(secrets.choice(_LETTERS) for _ in range(_RANDOM))


def clear_left(folder: Path, name: str | None = None) -> int:
    """Remove what killed processes of this user left half-written in a folder (of the file `name`); how many files.

    What somebody is still at is locked, and a moment before that too new: OLD.
    """
    removed = 0
    with contextlib.suppress(OSError), _opened(folder) as place:
        for there in os.listdir(folder if place is None else place):
            found = _LEFT.fullmatch(there)
            if found and name in (None, found["name"]):
                with contextlib.suppress(OSError):
                    removed += _removed(there if place is not None else str(folder / there), place)
    return removed


class NewFile:
    """A file under a hidden name beside its place; `finish` gives it its name, `discard` removes it."""

    def __init__(self, path: Path, mode: int | None = None) -> None:
        """`mode`: as of `replace`. OSError where no file can be made there."""
        self._parent = path.parent
        self._folder, self._name = reach(path, follow=False) if FOLDERS else (None, path.name)
        try:
            self._old = None if mode is not None else self._there()
            self._mode = mode if self._old is None else stat.S_IMODE(self._old.st_mode) & 0o777
            self._temporary = f".{self._name}.{random_letters()}.new"
            self.file = self._made()
        except BaseException:
            self._leave()
            raise

    def finish(self) -> None:
        """Give it its name, once all is on the disk."""
        self.file.flush()
        descriptor = self.file.fileno()
        if self._old is not None and hasattr(os, "fchown"):
            with contextlib.suppress(OSError):  # others than root may give files to few, if any
                os.fchown(descriptor, self._old.st_uid, self._old.st_gid)
        if self._mode is not None and hasattr(os, "fchmod"):
            os.fchmod(descriptor, self._mode)
        os.fsync(descriptor)
        self.file.close()
        os.replace(self._at(self._temporary), self._at(self._name), src_dir_fd=self._folder, dst_dir_fd=self._folder)
        self._leave()
        clear_left(self._parent, self._name)

    def discard(self) -> None:
        """Remove it, unless it has its name."""
        with contextlib.suppress(OSError):
            self.file.close()
        if self._temporary:
            with contextlib.suppress(OSError):
                os.unlink(self._at(self._temporary), dir_fd=self._folder)
        self._leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self.discard()

    def _made(self) -> BufferedWriter:
        at_first = 0o666 if self._mode is None else 0o600  # nobody reads more of it than of what it becomes
        temporary = self._at(self._temporary)
        descriptor = open_in(self._folder, temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, at_first)
        if fcntl is not None:
            with contextlib.suppress(OSError):  # not every file system can
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.fdopen(descriptor, "wb")

    def _there(self) -> os.stat_result | None:
        """The file that will be replaced, if it is one whose mode may be taken over."""
        try:  # root's links may be somebody's trap, others' are their own
            found = os.stat(self._at(self._name), dir_fd=self._folder, follow_symlinks=not is_root())
        except FileNotFoundError:
            return None
        return found if stat.S_ISREG(found.st_mode) and (found.st_nlink == 1 or not is_root()) else None

    def _at(self, name: str) -> str:
        return name if self._folder is not None else str(self._parent / name)

    def _leave(self) -> None:
        self._temporary = ""
        if self._folder is not None:
            os.close(self._folder)
            self._folder = None


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int | None]:
    """A folder, open to be listed; None where names in it can only be given as paths."""
    if not FOLDERS:
        yield None
        return
    place, _ = reach(folder / "x", follow=False)
    try:
        listed = open_in(place, ".", os.O_RDONLY | os.O_DIRECTORY)
    finally:
        os.close(place)
    try:
        yield listed
    finally:
        os.close(listed)


def _removed(name: str, folder: int | None) -> bool:
    """Remove a file that was left, if it is one, ours, old and nobody's any more."""
    found = os.stat(name, dir_fd=folder, follow_symlinks=False)
    ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
    if not (stat.S_ISREG(found.st_mode) and ours and found.st_nlink == 1 and time.time() - found.st_mtime > OLD):
        return False
    if fcntl is not None:
        descriptor = open_in(folder, name, os.O_RDONLY | NO_WAIT)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(descriptor)
    os.unlink(name, dir_fd=folder)
    return True
