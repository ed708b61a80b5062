"""The path of the control socket, for the daemon and for its clients."""

import os
import socket
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from spheremouse.errors import ControlError

SOCKET = "control.sock"
_SYSTEM = Path("/run/spheremouse")


def runtime_folder() -> Path:
    """Return the runtime folder, made if needed: systemd's, else for root the system's, for others the user's."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    root = _uid() == 0
    path = _SYSTEM if root else _own_folder()
    try:
        path.mkdir(mode=0o755 if root else 0o700, exist_ok=True)
    except OSError as e:
        raise ControlError(f"{path}: cannot be made ({e.strerror}); set control.socket to a path elsewhere") from None
    if not _is_ours(path):
        raise ControlError(f"{path}: is another user's, or others may write there; remove it or set control.socket")
    return path


def socket_path(configured: str | None) -> Path:
    """Return the daemon's socket: as configured (`control.socket`), or in the runtime folder."""
    return runtime_folder() / SOCKET if configured is None else Path(configured).expanduser().absolute()


def find_socket() -> Path:
    """Return the socket for a client: $SPHEREMOUSE_SOCKET, else the user's daemon, else the system's.

    Of several, it is the first that answers, else the first that exists.
    """
    given = os.environ.get("SPHEREMOUSE_SOCKET")
    if given:
        return Path(given)
    places = list(candidates())
    there = [p for p in places if _is_there(p)]
    return next((p for p in there if _answers(p)), (there or places)[0])


def candidates() -> Iterator[Path]:
    """Yield the usual paths of a daemon's socket."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if given:  # the service started us, for example to reload it
        yield Path(given) / SOCKET
    own = _own_folder()
    if os.environ.get("XDG_RUNTIME_DIR") or not own.exists() or _is_ours(own):
        yield own / SOCKET  # not if another user made it in /tmp
    yield _SYSTEM / SOCKET


def _own_folder() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "spheremouse" if runtime else Path(tempfile.gettempdir()) / f"spheremouse-{_uid()}"


def _is_there(path: Path) -> bool:
    """Return True if the path exists, or may exist in a folder that is closed to us."""
    try:
        path.lstat()
    except PermissionError:
        return True
    except OSError:
        return False
    return True


def _is_ours(path: Path) -> bool:
    """Return True for a folder, not a link, that only this user or root may write to."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid in (_uid(), 0) and not found.st_mode & 0o022


def _answers(path: Path) -> bool:
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(str(path))
    except OSError:
        return False
    return True


def _uid() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0
