"""The socket's file: made so that nobody connects who may not, kept to one daemon, and who is at the other end."""

import contextlib
import os
import socket
import stat
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

from spheremouse.errors import ControlError
from spheremouse.files.safe_open import others_may_change

_SO_PEERGROUPS = 59  # Linux; Python has no name for it
_LONGEST = 107 if sys.platform == "linux" else 103  # bytes of a path, what the kernel has room for
_BACKLOG = 64


@dataclass(frozen=True, slots=True)
class Peer:
    """Who is at the other end, as the kernel says."""

    uid: int
    pid: int
    groups: frozenset[int]


def peer_of(connection: socket.socket) -> Peer | None:
    """Who connected, as the kernel noted it then; None where the system does not say."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    size = struct.calcsize("iII")
    pid, uid, gid = struct.unpack("iII", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
    groups = {gid}
    with contextlib.suppress(OSError):  # a kernel before 4.13, or more than 256 groups
        found = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, 1024)  # Python asks for no more
        groups.update(struct.unpack(f"{len(found) // 4}I", found))
    return Peer(uid, pid, frozenset(groups))


def lock(path: Path) -> int:
    """A descriptor that holds the lock of a socket's path; the kernel gives it back however the process ends."""
    import fcntl  # not on every system that can import this

    if len(os.fsencode(path)) > _LONGEST:
        raise ControlError(f"{path}: too long for a socket; set control.socket to a path of {_LONGEST} bytes or less")
    folder, file = path.parent, lock_path(path)
    try:
        mode = folder.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            raise ControlError(f"{folder}: anybody may write there; set control.socket to a path in a safer folder")
        if others_may_change(folder):  # the socket's mode and group are set by its path
            raise ControlError(f"{folder}: is another user's; set control.socket to a path in a folder of root's")
        while True:
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(descriptor), file.lstat()):
                    return descriptor
            except FileNotFoundError:  # its last holder has just removed it
                pass
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)
    except BlockingIOError:
        peer = None
        with contextlib.suppress(OSError):  # it may be about to listen, or to end
            peer = _listener_at(path)
        raise _taken(path, peer) from None
    except OSError as e:
        raise ControlError(f"{file}: cannot be made ({e.strerror}); set control.socket to a path elsewhere") from None


def lock_path(path: Path) -> Path:
    """The lock's file, beside the socket."""
    return path.with_name(path.name + ".lock")


def listen(path: Path, group: str | None) -> socket.socket:
    """A socket that listens at `path`, whose lock we hold; what a daemon that died left there is replaced."""
    gid = None if group is None else group_id(group)
    _remove_stale(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)
        listener.bind(str(path))
        try:  # nobody can connect before it listens, so there is no moment in which too many may
            if gid is not None and path.stat().st_gid != gid:
                os.chown(path, -1, gid, follow_symlinks=False)
            path.chmod(0o600 if gid is None else 0o660)
            listener.listen(_BACKLOG)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
    except OSError as e:
        listener.close()
        if isinstance(e, PermissionError) and group is not None:
            raise ControlError(
                f"control.group {group}: the daemon's user may not give the socket to it; make it a member"
            ) from None
        raise ControlError(f"{path}: no socket can be made here ({e.strerror or e}); set control.socket") from None
    return listener


def group_id(name: str) -> int:
    """The number of a group; a ControlError where there is none of that name."""
    import grp

    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise ControlError(f"control.group: no group {name!r} on this machine; make it or name another") from None


def _remove_stale(path: Path) -> None:
    try:
        found = path.lstat()
    except FileNotFoundError:
        return
    except OSError as e:
        raise ControlError(f"{path}: {e.strerror}; set control.socket to a path elsewhere") from None
    if not stat.S_ISSOCK(found.st_mode):
        raise ControlError(f"{path}: is no socket; move it away or set control.socket to another path")
    try:
        raise _taken(path, _listener_at(path))
    except (ConnectionRefusedError, FileNotFoundError):
        path.unlink(missing_ok=True)
    except OSError as e:  # it listens, or may not be touched
        why = e.strerror or "no answer"
        raise ControlError(f"{path}: cannot be replaced ({why}); set control.socket to a path elsewhere") from None


def _listener_at(path: Path) -> Peer | None:
    """Who listens there; OSError where nobody does."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        probe.connect(str(path))
        return peer_of(probe)


def _taken(path: Path, peer: Peer | None) -> ControlError:
    who = "" if peer is None else f" (process {peer.pid})"
    return ControlError(f"{path}: another daemon listens there{who}; stop it, or set control.socket to another path")
