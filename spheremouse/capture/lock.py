"""Lock a camera's device node, so that one process uses it. The kernel releases the lock when the process ends.

The kernel lists the owner in /proc/locks, so no PID file is needed that could be stale.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from spheremouse.capture import Camera, OpenCamera
from spheremouse.errors import SourceError


@contextlib.contextmanager
def locked(node: Path) -> Iterator[None]:
    """Lock a device within the `with` block. Raises SourceError with the process that holds the lock.

    A node that cannot be opened, or has no locks, is not locked: the camera reports the error when it opens the node.
    """
    with contextlib.ExitStack() as stack:
        try:
            held = os.open(node, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            stack.callback(os.close, held)
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = "another spheremouse" if (pid := holder(node)) is None else f"another spheremouse (process {pid})"
            remedy = "end that one first, or ask it: spheremouse ctl status"
            raise SourceError(f"{node}: in use by {owner}", remedy) from None
        except OSError:
            pass
        yield


def holder(node: Path) -> int | None:
    """Return the process that has locked a file, or None if the kernel does not list it."""
    try:
        status = os.stat(node)
        lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    for line in lines:
        words = line.split()
        if len(words) >= 6 and words[1] == "FLOCK" and words[5] == place:
            return int(words[4]) if int(words[4]) > 0 else None
    return None


@contextlib.contextmanager
def locked_camera(node: Path, open_camera: OpenCamera) -> Iterator[Camera]:
    """Lock a camera's node until the end of the `with` block, and open the camera."""
    with locked(node), open_camera() as camera:
        yield camera
