"""Files written whole or not at all, in folders that other people may write to, too.

A name is looked up in an open folder, so that what was looked at is what is written. A new file is made beside its
place, under a hidden name that nothing had before, and is given mode and owner by its descriptor. What stands at the
place is replaced; nothing behind a link, a second name, a device or a pipe is touched.

Root follows no link that another user made, wherever in a path. What is no file (`/dev/null`, a named pipe) is written
through where a person named it, and by root only in a folder where nobody else may write.
"""

import contextlib
import errno
import json
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from io import BufferedWriter
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from spheremouse.errors import ConfigurationError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

OLD = 3600.0  # s since the last byte: longer than any file of ours takes between that and its name
_LETTERS = "abcdefghijklmnopqrstuvwxyz0123456789_"
_RANDOM = 8  # of them: 41 bits
_LEFT = re.compile(rf"\.(?P<name>.+)\.[{_LETTERS}]{{{_RANDOM}}}\.new", re.S)
_PATIENCE = 60.0  # s until a folder is empty
_LINKS = 40  # in one path, as the kernel has it
_STREAMS = {"stdin": 0, "stdout": 1, "stderr": 2}
_STREAM = re.compile(r"/dev/(stdin|stdout|stderr)|/(?:dev|proc/self)/fd/(\d{1,9})")

_CLOSED = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)
_PLACE = getattr(os, "O_PATH", os.O_RDONLY) | getattr(os, "O_DIRECTORY", 0) | _CLOSED
_FOLDERS = os.open in os.supports_dir_fd and hasattr(os, "O_DIRECTORY")  # not on Windows: paths there


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
    if not (_STREAM.fullmatch(str(path)) or _is_beyond(path)):
        replace(path, data)
        return
    with os.fdopen(_open(path, os.O_WRONLY), "wb") as file:
        file.write(data)


def open_to_write(path: Path) -> BinaryIO:
    """The file a person named, made where it is missing, to be written from its start; OSError where it cannot be."""
    file = os.fdopen(_open(path, os.O_WRONLY | os.O_CREAT), "wb")
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode) and not _STREAM.fullmatch(str(path)):
        file.truncate(0)
    return file


def open_to_read(path: Path) -> BinaryIO:
    """A regular file to read, opened without waiting; OSError for anything else."""
    descriptor = _open(path, os.O_RDONLY | _NO_WAIT)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise OSError(errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL, "is no file", str(path))
    return os.fdopen(descriptor, "rb")


def remove_tree(folder: Path) -> None:
    """Remove a folder and all in it; links in it are removed, not followed, whoever changes it meanwhile.

    OSError where something stays. Where the system has no descriptors of folders, as `shutil.rmtree` can.
    """
    if not _FOLDERS:
        shutil.rmtree(folder)
        return
    place, name = _reach(folder, follow=False)
    try:
        top = os.open(name, os.O_RDONLY | os.O_DIRECTORY | _NO_LINK | _CLOSED, dir_fd=place)
        try:
            _empty(top)
        finally:
            os.close(top)
        os.rmdir(name, dir_fd=place)
    finally:
        os.close(place)


def exchangeable(folder: Path) -> bool:
    """Could another user put something else in place of what root makes in a folder, or of the folder?

    For what can only be written by its path, such as videos. Who has called sudo is no other user. OSError where the
    folder is not there.
    """
    if not _root():
        return False
    users, groups = ("0", os.environ.get("SUDO_UID")), ("0", os.environ.get("SUDO_GID"))
    return any(
        str(s.st_uid) not in users
        or (
            not s.st_mode & stat.S_ISVTX
            and (s.st_mode & stat.S_IWOTH or (s.st_mode & stat.S_IWGRP and str(s.st_gid) not in groups))
        )
        for s in (there.stat() for there in _passed(folder))
    )


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


def _passed(folder: Path) -> set[Path]:
    """The folders that a path goes through, its links' among them; OSError where links lead on and on."""
    found, left, links = set[Path](), [folder.absolute()], 0
    while left:
        path = left.pop()
        for there in (path, *path.parents):
            if there not in found and there.is_symlink():
                links += 1
                if links > _LINKS:
                    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(folder))
                left.append(there.parent / there.readlink())
            found.add(there)
    return found


def _empty(top: int) -> None:
    """Remove all in an open folder: what is in a folder of it comes up first, so that none is too deep.

    OSError where that cannot be, or somebody goes on putting things there.
    """
    until = time.monotonic() + _PATIENCE
    while names := os.listdir(top):
        for name in names:
            if time.monotonic() > until:
                raise OSError(errno.ENOTEMPTY, "somebody goes on writing there")
            if _unlinked(name, top):
                continue
            inner = os.open(name, os.O_RDONLY | os.O_DIRECTORY | _NO_LINK | _CLOSED, dir_fd=top)
            try:
                for there in os.listdir(inner):
                    if not _unlinked(there, inner):
                        os.rename(there, secrets.token_hex(16), src_dir_fd=inner, dst_dir_fd=top)
            finally:
                os.close(inner)
            os.rmdir(name, dir_fd=top)


def _unlinked(name: str, place: int) -> bool:
    """Whether a name in a folder is gone now; a folder's stays."""
    try:
        os.unlink(name, dir_fd=place)
    except FileNotFoundError:
        return True
    except (IsADirectoryError, PermissionError):  # what Linux and others say of a folder
        return False
    return True


class NewFile:
    """A file under a hidden name beside its place; `finish` gives it its name, `discard` removes it."""

    def __init__(self, path: Path, mode: int | None = None) -> None:
        """`mode`: as of `replace`. OSError where no file can be made there."""
        self._parent = path.parent
        self._folder, self._name = _reach(path, follow=False) if _FOLDERS else (None, path.name)
        try:
            self._old = None if mode is not None else self._there()
            self._mode = mode if self._old is None else stat.S_IMODE(self._old.st_mode) & 0o777
            self._temporary = f".{self._name}.{''.join(secrets.choice(_LETTERS) for _ in range(_RANDOM))}.new"
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
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_LINK | _CLOSED
        descriptor = os.open(self._at(self._temporary), flags, at_first, dir_fd=self._folder)
        if fcntl is not None:
            with contextlib.suppress(OSError):  # not every file system can
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.fdopen(descriptor, "wb")

    def _there(self) -> os.stat_result | None:
        """The file that will be replaced, if it is one whose mode may be taken over."""
        try:  # root's links may be somebody's trap, others' are their own
            found = os.stat(self._at(self._name), dir_fd=self._folder, follow_symlinks=not _root())
        except FileNotFoundError:
            return None
        return found if stat.S_ISREG(found.st_mode) and (found.st_nlink == 1 or not _root()) else None

    def _at(self, name: str) -> str:
        return name if self._folder is not None else str(self._parent / name)

    def _leave(self) -> None:
        self._temporary = ""
        if self._folder is not None:
            os.close(self._folder)
            self._folder = None


# ---- within ----


def _root() -> bool:
    return hasattr(os, "geteuid") and os.geteuid() == 0 and hasattr(os, "O_PATH")


def _ours_alone(folder: int) -> bool:
    """May root alone make and remove names in an open folder?"""
    found = os.fstat(folder)
    return found.st_uid == 0 and not found.st_mode & 0o022


def _reach(path: Path, *, follow: bool) -> tuple[int, str]:
    """Descriptor of the folder of a path, and the name to look up in it; for root, if `follow`, where links end."""
    if not _root():
        return os.open(path.parent, _PLACE), path.name
    path = path.absolute()
    here, steps, links = os.open("/", _PLACE), list(path.parts[1:]) or ["."], 0
    try:
        while True:
            name = steps.pop(0)
            if not steps and not follow:
                return here, name
            try:
                step = os.open(name, os.O_PATH | _NO_LINK | _CLOSED, dir_fd=here)
            except FileNotFoundError:
                if not steps:
                    return here, name
                raise
            try:
                found = os.fstat(step)
                if stat.S_ISLNK(found.st_mode):
                    links += 1
                    if found.st_uid != 0:
                        text = f"root does not follow {name}, a link that another user made; name what it leads to"
                        raise OSError(errno.ELOOP, text, str(path))
                    if links > _LINKS:
                        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
                    target = Path(os.readlink("", dir_fd=step))
                    steps = [*(target.parts[1:] if target.is_absolute() else target.parts), *steps] or ["."]
                    if target.is_absolute():
                        os.close(here)
                        here = os.open("/", _PLACE)
                elif not steps:
                    return here, name
                elif not stat.S_ISDIR(found.st_mode):
                    raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
                else:
                    here, step = step, here
            finally:
                os.close(step)
    except BaseException:
        os.close(here)
        raise


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int | None]:
    """A folder, open to be listed; None where names in it can only be given as paths."""
    if not _FOLDERS:
        yield None
        return
    place, _ = _reach(folder / "x", follow=False)
    try:
        listed = os.open(".", os.O_RDONLY | os.O_DIRECTORY | _CLOSED, dir_fd=place)
    finally:
        os.close(place)
    try:
        yield listed
    finally:
        os.close(listed)


def _open(path: Path, flags: int) -> int:
    """Descriptor of what is there; for root of nothing that another user may have put there in place of a file."""
    if (stream := _STREAM.fullmatch(str(path))) is not None:  # the program's own, whatever the path would open
        for ours in (sys.stdout, sys.stderr):
            ours.flush()
        return os.dup(_STREAMS[stream[1]] if stream[1] else int(stream[2]))
    if not _root():
        return os.open(path, flags | _CLOSED, 0o666)
    folder, name = _reach(path, follow=True)
    try:
        alone = _ours_alone(folder)
        waits = 0 if alone else _NO_WAIT
        descriptor = os.open(name, flags | waits | _NO_LINK | _CLOSED, 0o666, dir_fd=folder)
    finally:
        os.close(folder)
    found = os.fstat(descriptor)
    if not alone and (found.st_nlink > 1 if stat.S_ISREG(found.st_mode) else not stat.S_ISDIR(found.st_mode)):
        os.close(descriptor)
        text = "is no file, or has a second name, and another user may write beside it: root leaves it alone"
        raise OSError(errno.EPERM, text, str(path))
    return descriptor


def _is_beyond(path: Path) -> bool:
    """Is it there, and no file?"""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _removed(name: str, folder: int | None) -> bool:
    """Remove a file that was left, if it is one, ours, old and nobody's any more."""
    found = os.stat(name, dir_fd=folder, follow_symlinks=False)
    ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
    if not (stat.S_ISREG(found.st_mode) and ours and found.st_nlink == 1 and time.time() - found.st_mtime > OLD):
        return False
    if fcntl is not None:
        descriptor = os.open(name, os.O_RDONLY | _NO_LINK | _NO_WAIT | _CLOSED, dir_fd=folder)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(descriptor)
    os.unlink(name, dir_fd=folder)
    return True


def write_json(path: Path, data: Any) -> bool:
    """Write data as JSON, whole or not at all; to standard output for `-`. Whether it was printed."""
    text = json.dumps(data, indent=1, allow_nan=False)
    if path == Path("-"):
        print(text)
        return True
    write_atomically(path, text + "\n")
    return False


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that at any moment either the old or the new one is there, whole.

    A device or a pipe is written to, never replaced: see the module.
    """
    try:
        write(path, text.encode("utf-8"))
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be written: {e.strerror or e}") from None
