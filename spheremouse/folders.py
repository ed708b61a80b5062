"""Folders that are there whole or not at all: made beside their place under a hidden name, then moved into it."""

import os
import shutil
import tempfile
from pathlib import Path

from spheremouse.errors import SpheremouseError


def begin_folder(path: Path, error: type[SpheremouseError]) -> Path:
    """An empty folder beside `path`, for what is to become `path`; `error` where that is there and no folder."""
    if path.exists() and not path.is_dir():
        raise error(f"{path}: is a file; name a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as e:
        raise error(f"{path}: cannot be written ({e.strerror})") from None
    return made


def finish_folder(made: Path, path: Path) -> None:
    """Move it to its place; a folder that is there is removed once the new one stands."""
    if not path.exists():
        os.replace(made, path)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    os.replace(path, old)
    os.replace(made, path)
    shutil.rmtree(old, ignore_errors=True)
