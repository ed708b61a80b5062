"""Folders that are there whole or not at all: made beside their place under a hidden name, then moved into it."""

import contextlib
import os
import re
import shutil
import tempfile
import time
from pathlib import Path

from spheremouse.errors import SpheremouseError
from spheremouse.files.atomic import OLD, exchangeable

_LEFT = re.compile(r"\..+\.[a-z0-9_]{8}", re.S)  # as `_hidden` names them


def begin_folder(path: Path, error: type[SpheremouseError]) -> Path:
    """An empty folder beside `path`, for what is to become `path`; `error` where that is there and no folder."""
    if path.exists() and not path.is_dir():
        raise error(f"{path}: is a file; name a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if exchangeable(path.parent):
            text = "another user may change what is in that folder; root makes nothing there: name another place, or do"
            raise error(f"{path}: {text} it as that user")
        made = _hidden(path)
    except OSError as e:
        raise error(f"{path}: cannot be written ({e.strerror})") from None
    return made


def finish_folder(made: Path, path: Path) -> None:
    """Move it to its place; a folder that is there is removed once the new one stands."""
    if not path.exists():
        os.replace(made, path)
        return
    old = _hidden(path)
    os.replace(path, old)
    os.replace(made, path)
    shutil.rmtree(old, ignore_errors=True)


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
