"""The control socket's file: its path, its lock and mode, and the credentials of its clients."""

import contextlib
import os
import socket
import stat
import struct
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from spheremouse.errors import ControlError, os_errors_as
from spheremouse.files.safe_files import others_may_change

SOCKET = "control.sock"
_SYSTEM = Path("/run/spheremouse")


def runtime_folder() -> Path:
    """Return the folder of the control socket: $RUNTIME_DIRECTORY, or else one that is created if it is missing.

    That is /run/spheremouse for root, and `_own_folder` for others. Raises ControlError if it cannot be created, if
    it is another user's, or if others may write there.
    """
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    root = _uid() == 0
    path = _SYSTEM if root else _own_folder()
    with os_errors_as(ControlError, f"{path}: cannot be made", "set control.socket to a path elsewhere"):
        path.mkdir(mode=0o755 if root else 0o700, exist_ok=True)
    if not _is_ours(path):
        raise ControlError(f"{path}: is another user's, or others may write there; remove it or set control.socket")
    return path


def socket_path(configured: str | None) -> Path:
    """Return the daemon's socket: as configured (`control.socket`), or in the runtime folder."""
    return runtime_folder() / SOCKET if configured is None else Path(configured).expanduser().absolute()


def find_socket() -> Path:
    """Return the path of the daemon's socket for a client.

    If $SPHEREMOUSE_SOCKET is set, that is the path, unchecked. Otherwise it is the first of `candidates` that answers,
    else the first that exists, else the first.
    """
    given = os.environ.get("SPHEREMOUSE_SOCKET")
    if given:
        return Path(given)
    places = list(candidates())
    existing = [p for p in places if _is_there(p)]
    for path in existing:
        with contextlib.suppress(OSError):
            _listener_at(path)
            return path
    return (existing or places)[0]


def candidates() -> Iterator[Path]:
    """Yield the paths at which a client looks for a daemon's socket. No file needs to exist there.

    They are in $RUNTIME_DIRECTORY if that is set, in the user's folder, and in the system's. The user's folder is in
    $XDG_RUNTIME_DIR, which is trusted. Without that it is in /tmp, and left out if another user made it.
    """
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if given:  # the service started us, for example to reload it
        yield Path(given) / SOCKET
    own = _own_folder()
    made_by_another = os.path.lexists(own) and not _is_ours(own)
    if os.environ.get("XDG_RUNTIME_DIR") or not made_by_another:
        yield own / SOCKET
    yield _SYSTEM / SOCKET


def _own_folder() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "spheremouse" if runtime else Path(tempfile.gettempdir()) / f"spheremouse-{_uid()}"


def _is_there(path: Path) -> bool:
    """Return True if the path exists, or may exist in a folder that is closed to us."""
    try:
        path.lstat()
    except OSError as e:
        return isinstance(e, PermissionError)
    return True


def _is_ours(path: Path) -> bool:
    """Return True for a folder, not a link, that only this user or root may write to."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid in (_uid(), 0) and not found.st_mode & 0o022


def _uid() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


_MAX_PATH_BYTES = 107 if sys.platform == "linux" else 103  # the kernel's limit
BACKLOG = 16  # connections that wait, and that asyncio accepts before it lets other threads run


class Peer(NamedTuple):
    """The process at the other end of a connection, as the kernel names it."""

    pid: int
    uid: int


def peer_of(connection: socket.socket) -> Peer | None:
    """Return the credentials of a connection's other end (SO_PEERCRED); None on systems without them."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    size = struct.calcsize("iII")
    pid, uid, _ = struct.unpack("iII", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
    return Peer(pid, uid)


@contextlib.contextmanager
def listening(path: Path, group: str | None) -> Iterator[socket.socket]:
    """Listen at `path`, for this user and root, and for the members of `group`, until the block ends.

    A lock file beside the socket makes sure that one daemon listens there. It stays when the socket is removed, because
    another daemon may be opening it; the kernel releases the lock with the process. Raises ControlError for a path that
    is too long, an unsafe or closed folder, another daemon, or an unknown group.
    """
    gid = None if group is None else _group_id(group)
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as listener, _lock(path):
        _remove_stale(path)
        refused = f"{path}: no socket can be made here", "set control.socket to a path elsewhere"
        with os_errors_as(ControlError, *refused):
            listener.bind(str(path))
        identity = path.lstat()
        try:
            with os_errors_as(ControlError, *refused):  # no client can connect before `listen`, so the mode is in time
                if gid is not None and path.stat().st_gid != gid:
                    _give_to_group(path, gid, group)
                path.chmod(0o600 if gid is None else 0o660)
                listener.listen(BACKLOG)
            yield listener
        finally:
            listener.close()
            with contextlib.suppress(OSError):
                if os.path.samestat(identity, path.lstat()):
                    path.unlink()


def _give_to_group(path: Path, gid: int, group: str | None) -> None:
    try:
        os.chown(path, -1, gid, follow_symlinks=False)
    except PermissionError:
        problem = f"control.group {group}: the daemon's user is no member, so it may not give the socket to this group"
        raise ControlError(problem, "make the user a member") from None


@contextlib.contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Hold the lock of a socket's path; ControlError if another daemon holds it or the folder is unsafe."""
    import fcntl  # not on every system that can import this

    if len(os.fsencode(path)) > _MAX_PATH_BYTES:
        hint = f"set control.socket to a path of {_MAX_PATH_BYTES} bytes or less"
        raise ControlError(f"{path}: too long for a socket", hint)
    folder, file = path.parent, path.with_name(path.name + ".lock")
    with os_errors_as(ControlError, f"{file}: cannot be made", "set control.socket to a path elsewhere"):
        mode = folder.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            raise ControlError(f"{folder}: anybody may write there; set control.socket to a path in a safer folder")
        if others_may_change(folder):  # the socket's mode and group are set by its path
            raise ControlError(f"{folder}: is another user's; set control.socket to a path in a folder of root's")
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        peer = None
        with contextlib.suppress(OSError):  # it may not listen yet, or not any more
            peer = _listener_at(path)
        raise _in_use_error(path, peer) from None
    finally:
        os.close(descriptor)


def _group_id(name: str) -> int:
    import grp

    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise ControlError(f"control.group: no group {name!r} on this machine; make it or name another") from None


def _remove_stale(path: Path) -> None:
    """Remove the socket of a daemon that was killed; ControlError for anything else."""
    try:
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise ControlError(f"{path}: is no socket; move it away or set control.socket to another path")
        raise _in_use_error(path, _listener_at(path))
    except FileNotFoundError:
        return
    except ConnectionRefusedError:
        path.unlink(missing_ok=True)
    except OSError as e:
        problem = f"{path}: cannot be replaced ({e.strerror or 'no answer'})"
        raise ControlError(problem, "set control.socket to a path elsewhere") from None


def _listener_at(path: Path) -> Peer | None:
    """Return the process that listens at `path`; OSError if there is none."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(1.0)
        probe.connect(str(path))
        return peer_of(probe)


def _in_use_error(path: Path, peer: Peer | None) -> ControlError:
    """Return the error of a path on which another daemon listens."""
    process = "" if peer is None else f" (process {peer.pid})"
    problem = f"{path}: another daemon listens there{process}"
    return ControlError(problem, "stop it, or set control.socket to another path")
