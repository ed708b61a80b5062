"""What a path leads to, opened in folders that other people may write to, too.

A name is looked up in an open folder, so that what was looked at is what is opened, written or removed. Root follows no
link that another user made, wherever in a path, and opens nothing that such a user may have put in place of a file.
Where the system has no descriptors of folders (Windows), paths must do.
"""

import errno
import os
import re
import secrets
import shutil
import stat
import sys
import time
from pathlib import Path
from typing import BinaryIO

FOLDERS = os.open in os.supports_dir_fd and hasattr(os, "O_DIRECTORY")  # can names be looked up in open ones?
NO_WAIT = getattr(os, "O_NONBLOCK", 0)
_CLOSED = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_PLACE = getattr(os, "O_PATH", os.O_RDONLY) | getattr(os, "O_DIRECTORY", 0) | _CLOSED

_PATIENCE = 60.0  # s until a folder is empty
_LINKS = 40  # in one path, as the kernel has it
_STREAMS = {"stdin": 0, "stdout": 1, "stderr": 2}
_STREAM = re.compile(r"/dev/(stdin|stdout|stderr)|/(?:dev|proc/self)/fd/(\d{1,9})")


def open_to_read(path: Path) -> BinaryIO:
    """A regular file to read, opened without waiting; OSError for anything else."""
    descriptor = open_path(path, os.O_RDONLY | NO_WAIT)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise OSError(errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL, "is no file", str(path))
    return os.fdopen(descriptor, "rb")


def open_to_write(path: Path) -> BinaryIO:
    """The file a person named, made where it is missing, to be written from its start; OSError where it cannot be."""
    file = os.fdopen(open_path(path, os.O_WRONLY | os.O_CREAT), "wb")
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode) and not _STREAM.fullmatch(str(path)):
        file.truncate(0)
    return file


def exchangeable(folder: Path) -> bool:
    """Could another user put something else in place of what root makes in a folder, or of the folder?

    For what can only be written by its path, such as videos. Who has called sudo is no other user. OSError where the
    folder is not there.
    """
    if not is_root():
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


def remove_tree(folder: Path) -> None:
    """Remove a folder and all in it; links in it are removed, not followed, whoever changes it meanwhile.

    OSError where something stays. Where the system has no descriptors of folders, as `shutil.rmtree` can.
    """
    if not FOLDERS:
        shutil.rmtree(folder)
        return
    place, name = reach(folder, follow=False)
    try:
        top = open_in(place, name, os.O_RDONLY | os.O_DIRECTORY)
        try:
            _empty(top)
        finally:
            os.close(top)
        os.rmdir(name, dir_fd=place)
    finally:
        os.close(place)


def is_stream(path: Path) -> bool:
    """Is it a stream of the program, a device or a pipe: there, and no file?"""
    if _STREAM.fullmatch(str(path)):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def is_root() -> bool:
    """Is it root who asks, on a system where a path can be walked step by step?"""
    return hasattr(os, "geteuid") and os.geteuid() == 0 and hasattr(os, "O_PATH")


def reach(path: Path, *, follow: bool) -> tuple[int, str]:
    """Descriptor of the folder of a path, and the name to look up in it; for root, if `follow`, where links end."""
    if not is_root():
        return os.open(path.parent, _PLACE), path.name
    path = path.absolute()
    here, steps, links = os.open("/", _PLACE), list(path.parts[1:]) or ["."], 0
    try:
        while True:
            name = steps.pop(0)
            if not steps and not follow:
                return here, name
            try:
                step = open_in(here, name, os.O_PATH)
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


def open_path(path: Path, flags: int) -> int:
    """Descriptor of what is there; for root of nothing that another user may have put there in place of a file."""
    if (stream := _STREAM.fullmatch(str(path))) is not None:  # the program's own, whatever the path would open
        for ours in (sys.stdout, sys.stderr):
            ours.flush()
        return os.dup(_STREAMS[stream[1]] if stream[1] else int(stream[2]))
    if not is_root():
        return os.open(path, flags | _CLOSED, 0o666)
    folder, name = reach(path, follow=True)
    try:
        alone = _ours_alone(folder)
        descriptor = open_in(folder, name, flags | (0 if alone else NO_WAIT))
    finally:
        os.close(folder)
    found = os.fstat(descriptor)
    if not alone and (found.st_nlink > 1 if stat.S_ISREG(found.st_mode) else not stat.S_ISDIR(found.st_mode)):
        os.close(descriptor)
        text = "is no file, or has a second name, and another user may write beside it: root leaves it alone"
        raise OSError(errno.EPERM, text, str(path))
    return descriptor


def open_in(folder: int | None, name: str, flags: int, mode: int = 0o666) -> int:
    """Descriptor of a name in an open folder; a link is not followed."""
    return os.open(name, flags | _NO_LINK | _CLOSED, mode, dir_fd=folder)


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


def _ours_alone(folder: int) -> bool:
    """May root alone make and remove names in an open folder?"""
    found = os.fstat(folder)
    return found.st_uid == 0 and not found.st_mode & 0o022


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
            inner = open_in(top, name, os.O_RDONLY | os.O_DIRECTORY)
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
