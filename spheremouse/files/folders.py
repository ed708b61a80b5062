"""Folders that are there whole or not at all: made beside their place under a hidden name, then moved into it."""

import contextlib
import os
import re
import shutil
import tempfile
import time
from pathlib import Path

from spheremouse.errors import SpheremouseError
from spheremouse.files.atomic import OLD
from spheremouse.files.lookup import exchangeable

_LEFT = re.compile(r"\..+\.[a-z0-9_]{8}", re.S)  # as `_hidden` names them


class NewFolder:
    """A folder under a hidden name beside its place; `finish` gives it its name, `discard` removes it.

    `path` is what to write below. Where another user could put a link there while root writes, it leads by descriptor
    to the folder that root has made.
    """

    def __init__(self, path: Path, error: type[SpheremouseError]) -> None:
        """An empty folder for what is to become `path`; `error` where that is there and no folder, or none can be."""
        if path.exists() and not path.is_dir():
            raise error(f"{path}: is a file; name a folder")
        self._place, self._descriptor = path, None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.path = self._hidden = _hidden(path)
            if exchangeable(path.parent):
                self._descriptor = os.open(self._hidden, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                self.path = Path(f"/proc/self/fd/{self._descriptor}")
                if os.fstat(self._descriptor).st_uid != 0:
                    raise error(f"{path}: another user changes what is in that folder; name another place")
        except OSError as e:
            raise error(f"{path}: cannot be written ({e.strerror})") from None

    def finish(self) -> None:
        """Move it to its place; a folder that is there is removed once the new one stands."""
        if not self._place.exists():
            os.replace(self._hidden, self._place)
            return
        old = _hidden(self._place)
        os.replace(self._place, old)
        os.replace(self._hidden, self._place)
        shutil.rmtree(old, ignore_errors=True)

    def discard(self) -> None:
        """Remove it and what is in it, unless it has its name."""
        shutil.rmtree(self._hidden, ignore_errors=True)
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


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


def _hidden(path: Path) -> Path:
    return Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
