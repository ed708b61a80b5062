"""Folders that are there whole or not at all: made beside their place under a hidden name, then moved into it."""

import contextlib
import os
import re
import shutil
import time
from pathlib import Path

from spheremouse.errors import SpheremouseError
from spheremouse.files.atomic import OLD, random_letters
from spheremouse.files.lookup import exchangeable

_LEFT = re.compile(r"\..+\.[a-z0-9_]{8}", re.S)  # as `_hidden_name` names them


class NewFolder:
    """A folder under a hidden name beside its place.

    `make` makes it, `finish` gives it its name, `discard` removes it. A signal may end the program at any step: call
    `make` inside the `try` whose `finally` discards. `path` is what to write below. Where another user could put a link
    there while root writes, it leads by descriptor to the folder that root has made.
    """

    def __init__(self, path: Path, error: type[SpheremouseError]) -> None:
        """Nothing is made yet. Raises `error` if `path` is there and no folder."""
        if path.exists() and not path.is_dir():
            raise error(f"{path}: is a file; name a folder")
        self._place, self._error, self._descriptor = path, error, None
        self._old: Path | None = None  # the folder that is replaced, while it is
        self.path = self._hidden = _hidden_name(path)

    def make(self) -> Path:
        """Make the folder, empty, and return `path`; the error of the constructor if that cannot be."""
        try:
            self._place.parent.mkdir(parents=True, exist_ok=True)
            self._make_hidden()
            if exchangeable(self._place.parent):
                self._descriptor = os.open(self._hidden, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                self.path = Path(f"/proc/self/fd/{self._descriptor}")
                if os.fstat(self._descriptor).st_uid != 0:
                    raise self._error(f"{self._place}: another user changes what is in that folder; name another place")
        except OSError as e:
            raise self._error(f"{self._place}: cannot be written ({e.strerror})") from None
        return self.path

    def finish(self) -> None:
        """Move it to its place; a folder that is there is removed once the new one stands."""
        if not self._place.exists():
            os.replace(self._hidden, self._place)
            return
        self._old = _hidden_name(self._place)
        try:
            os.replace(self._place, self._old)
            os.replace(self._hidden, self._place)
        finally:
            self._clear_old()

    def discard(self) -> None:
        """Remove it and what is in it, unless it has its name."""
        self._clear_old()
        shutil.rmtree(self._hidden, ignore_errors=True)
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _clear_old(self) -> None:
        """Remove the folder that is replaced; put it back if nothing took its place."""
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
                self._hidden.mkdir(0o700)
                return
            except FileExistsError:  # not ours: never discarded
                self.path = self._hidden = _hidden_name(self._place)


def clear_left_folders(parent: Path) -> int:
    """Remove the empty folders under hidden names that killed processes of this user left; how many.

    A folder gets its first file at once: one that is still empty after OLD will have none. What is not empty stays.
    """
    removed = 0
    with contextlib.suppress(OSError):
        for left in parent.iterdir():
            if _LEFT.fullmatch(left.name):
                with contextlib.suppress(OSError):
                    found = left.lstat()
                    ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
                    if ours and time.time() - found.st_mtime > OLD:
                        left.rmdir()  # nothing but an empty folder, and no link
                        removed += 1
    return removed


def _hidden_name(path: Path) -> Path:
    """A name beside `path` that nobody can guess. Known before the folder is made, so that it can always be removed."""
    return path.with_name(f".{path.name}.{random_letters()}")
