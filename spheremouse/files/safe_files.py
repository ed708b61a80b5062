"""Write files and folders whole or not at all.

The program writes under a hidden name beside the place and then renames. At any moment the old one or the new one is
there. What a killed process leaves is removed once it is OLD. Root writes only where nobody else may: see `safe_open`.

A stream, device or pipe (`/dev/null`, a named pipe) that a person named is written to and never replaced.
"""

import contextlib
import json
import os
import re
import secrets
import shutil
import stat
import time
from io import BufferedWriter
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ConfigurationError, SpheremouseError
from spheremouse.files.safe_open import is_stream, open_stream, others_may_change, refuse_shared_folder

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

OLD = 3600.0  # s since the last byte; no file of ours takes so long until it has its name
_LETTERS = "abcdefghijklmnopqrstuvwxyz0123456789_"
_RANDOM_LETTERS = 8  # 41 bits
_HIDDEN_FILE = re.compile(rf"\.(?P<name>.+)\.[{_LETTERS}]{{{_RANDOM_LETTERS}}}\.new", re.S)
_HIDDEN_FOLDER = re.compile(rf"\..+\.[{_LETTERS}]{{{_RANDOM_LETTERS}}}", re.S)


# ---- files ----


def replace(path: Path, data: bytes, mode: int | None = None) -> None:
    """Put a file of this content at `path` in place of what is there; raise OSError if that fails.

    Without a `mode`, the new file takes mode and owner of the old one; without an old one the umask decides.
    """
    try:
        with NewFile(path, mode) as new:
            new.file.write(data)
    except OSError as e:
        e.filename = str(path)  # not the hidden name
        raise


def write(path: Path, data: bytes) -> None:
    """Replace the file that a person named, or write to the stream, device or pipe; OSError if that fails."""
    if not is_stream(path):
        replace(path, data)
        return
    with open_stream(path) as file:
        file.write(data)


def write_atomically(path: Path, text: str) -> None:
    """Write text as `write` does; raise ConfigurationError if that fails."""
    try:
        write(path, text.encode("utf-8"))
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be written: {e.strerror or e}") from None


def write_json(path: Path, data: Any) -> bool:
    """Write data as JSON, to standard output for `-`. Return whether it was printed."""
    text = json.dumps(data, indent=1, allow_nan=False)
    if path == Path("-"):
        print(text)
        return True
    write_atomically(path, text + "\n")
    return False


class NewFile:
    """A file under a hidden name beside its place; `finish` gives it its name, `discard` removes it."""

    def __init__(self, path: Path, mode: int | None = None) -> None:
        """Make the hidden file. `mode`: see `replace`. Raises OSError if no file can be made there."""
        refuse_shared_folder(path.parent)
        self._path = path
        self._old = None if mode is not None else _regular(path)
        self._mode = mode if self._old is None else stat.S_IMODE(self._old.st_mode) & 0o777
        self._hidden: Path | None = _hidden_name(path, ".new")
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        descriptor = os.open(self._hidden, flags, 0o666 if self._mode is None else 0o600)
        if fcntl is not None:
            with contextlib.suppress(OSError):  # some file systems have no locks
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.file: BufferedWriter = os.fdopen(descriptor, "wb")

    def finish(self) -> None:
        """Give the file its name, once all of it is on the disk."""
        assert self._hidden is not None
        self.file.flush()
        descriptor = self.file.fileno()
        if self._old is not None and hasattr(os, "fchown"):
            with contextlib.suppress(OSError):  # only root may give files away
                os.fchown(descriptor, self._old.st_uid, self._old.st_gid)
        if self._mode is not None and hasattr(os, "fchmod"):
            os.fchmod(descriptor, self._mode)
        os.fsync(descriptor)
        self.file.close()
        os.replace(self._hidden, self._path)
        self._hidden = None
        clear_left(self._path.parent, self._path.name)

    def discard(self) -> None:
        """Remove the file, unless it has its name."""
        with contextlib.suppress(OSError):
            self.file.close()
        if self._hidden is not None:
            with contextlib.suppress(OSError):
                self._hidden.unlink()
            self._hidden = None

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


def clear_left(folder: Path, name: str | None = None) -> int:
    """Remove the hidden files that killed processes of this user left in a folder (for `name`). Return their number.

    A file that somebody still writes is locked, and younger than OLD.
    """
    removed = 0
    with contextlib.suppress(OSError):
        if others_may_change(folder):
            return 0
        for path in list(folder.iterdir()):
            found = _HIDDEN_FILE.fullmatch(path.name)
            if found and name in (None, found["name"]):
                with contextlib.suppress(OSError):
                    removed += _remove_left_file(path)
    return removed


def _remove_left_file(path: Path) -> bool:
    found = path.lstat()
    if not (stat.S_ISREG(found.st_mode) and found.st_nlink == 1 and _is_old_and_ours(found)):
        return False
    if fcntl is not None:
        with path.open("rb") as file:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    path.unlink()
    return True


# ---- folders ----


class NewFolder:
    """A folder under a hidden name beside its place.

    `make` makes it, `finish` gives it its name, `discard` removes it. Write below `path`. A signal may end the program
    at any step, so call `make` inside the `try` whose `finally` discards.
    """

    def __init__(self, path: Path, error: type[SpheremouseError]) -> None:
        """Make nothing yet. Raises `error` if `path` is a file."""
        if path.exists() and not path.is_dir():
            raise error(f"{path}: is a file; name a folder")
        self._place, self._error = path, error
        self._old: Path | None = None  # hidden name of the folder that is being replaced
        self.path = _hidden_name(path)

    def make(self) -> Path:
        """Make the folder, empty, and return `path`; raise the error of the constructor if that fails."""
        try:
            self._place.parent.mkdir(parents=True, exist_ok=True)
            refuse_shared_folder(self._place.parent)
            self._make_hidden()
        except OSError as e:
            raise self._error(f"{self._place}: cannot be written ({e.strerror})") from None
        return self.path

    def finish(self) -> None:
        """Move the folder to its place; then remove the one that was there."""
        if not self._place.exists():
            os.replace(self.path, self._place)
            return
        self._old = _hidden_name(self._place)
        try:
            os.replace(self._place, self._old)
            os.replace(self.path, self._place)
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
        if self._place.exists():
            shutil.rmtree(self._old, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                os.replace(self._old, self._place)

    def _make_hidden(self) -> None:
        while True:
            try:
                self.path.mkdir(0o700)
                return
            except FileExistsError:  # somebody else's; `discard` must not remove it
                self.path = _hidden_name(self._place)


def clear_left_folders(parent: Path) -> int:
    """Remove the empty hidden folders that killed processes of this user left. Return their number.

    A new folder gets its first file at once, so one that is still empty after OLD is abandoned.
    """
    removed = 0
    with contextlib.suppress(OSError):
        for left in parent.iterdir():
            if _HIDDEN_FOLDER.fullmatch(left.name):
                with contextlib.suppress(OSError):
                    if _is_old_and_ours(left.lstat()):
                        left.rmdir()  # removes an empty folder alone, and no link
                        removed += 1
    return removed


# ---- within ----


def _hidden_name(path: Path, ending: str = "") -> Path:
    """Return a name beside `path` that nobody can guess."""
    letters = "".join(secrets.choice(_LETTERS) for _ in range(_RANDOM_LETTERS))
    return path.with_name(f".{path.name}.{letters}{ending}")


def _regular(path: Path) -> os.stat_result | None:
    """Return the status of the regular file at `path`, if there is one."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found if stat.S_ISREG(found.st_mode) else None


def _is_old_and_ours(found: os.stat_result) -> bool:
    ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
    return ours and time.time() - found.st_mtime > OLD
