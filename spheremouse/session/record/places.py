"""Folder, names and permissions of recordings and snapshots, and the limit of the disk.

They may show people, so only owner and group can read them. An unfinished recording has a hidden name and a lock, which
separates it from the remains of a crash.
"""

import contextlib
import fcntl
import os
import re
import shutil
import time
from pathlib import Path

from spheremouse.errors import DatasetError, SpheremouseError, os_errors_as
from spheremouse.files.access import state_folder
from spheremouse.session.settings import RecordSettings

FOLDER, FILE = 0o750, 0o640  # modes
_UNFINISHED = re.compile(r"\..+\.[0-9a-f]{8}$")  # the hidden names of files/safe_files


def recordings_folder(settings: RecordSettings) -> Path:
    """Return the folder of recordings: as configured, else recordings/ in the state directory of service or user."""
    if settings.folder is not None:
        return Path(settings.folder).expanduser().absolute()
    return state_folder() / "recordings"


def next_name(folder: Path, now: time.struct_time | None = None, suffix: str = "") -> Path:
    """Return a free name in the folder: date and time, with the `suffix` of a picture."""
    stem = time.strftime("%Y-%m-%d-%H%M%S", time.localtime() if now is None else now)
    path, number = folder / f"{stem}{suffix}", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}{suffix}"
    return path


def tidy(folder: Path) -> int:
    """Remove the unfinished recordings of a crash from the folder of recordings, and return their number.

    Those in progress stay.
    """
    removed = 0
    with contextlib.suppress(OSError):
        for left in filter(_UNFINISHED.match, sorted(os.listdir(folder))):
            with contextlib.suppress(OSError):
                held = lock(folder / left)
                shutil.rmtree(folder / left, ignore_errors=True)
                os.close(held)
                removed += not (folder / left).exists()
    return removed


def lock(folder: Path) -> int:
    """Lock the folder of an unfinished recording, and return the descriptor to close. OSError if that fails."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def made_folder(folder: Path, error: type[SpheremouseError]) -> None:
    """Make a folder and its missing parents, whatever the umask. Raise `error` if that fails."""
    with os_errors_as(error, f"{folder}: cannot be made"):
        for missing in [p for p in (*reversed(folder.parents), folder) if not p.exists()]:
            missing.mkdir(FOLDER, exist_ok=True)
            missing.chmod(FOLDER)


def disk_is_full(folder: Path, settings: RecordSettings, least: float = 0.0) -> bool:
    """Return True if no more is free than the reserve or `least` bytes."""
    return shutil.disk_usage(folder).free < max(1e6 * settings.free_megabytes, least)


def refuse_full_disk(path: Path, settings: RecordSettings, least: float = 0.0) -> None:
    """Raise DatasetError if the disk has no room for `path`. Its folder must exist."""
    if disk_is_full(path.parent, settings, least):
        problem = f"{path}: less than {settings.free_megabytes:g} MB are free on the disk"
        raise DatasetError(f"{problem}: remove recordings that are not needed")
