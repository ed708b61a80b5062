"""Work in another user's folder, done by root with that user's rights alone: a trap laid there catches its owner.

By fork, not by starting a program anew: that user need not be able to read ours, nothing of the environment counts, and
the kernel lets nobody look into a process that has changed its user (prctl(2), PR_SET_DUMPABLE).
"""

import contextlib
import json
import os
import select
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spheremouse.errors import ServiceError, SpheremouseError

PATIENCE = 60.0  # s: seconds would do, but that user can hold the work up, for ever
_KILLED = 5.0  # s, more than any process needs to end that can
_MOST = 10_000_000  # bytes of an answer


def as_owner(folder: Path, work: Callable[[], Any], patience: float = PATIENCE) -> Any:
    """Result of `work`, as JSON can hold it; done in a process of the folder's owner where root asks for another.

    ServiceError with the reason where it does not work. Under other users than root it is simply called.
    """
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or not (owner := folder.stat().st_uid):
        return work()
    import pwd

    try:
        user = pwd.getpwuid(owner)
    except KeyError:
        raise ServiceError(f"{folder}: belongs to user {owner}, whom this system does not know") from None
    there, here = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(there)
        _work(user.pw_uid, user.pw_gid, work, here)
    os.close(here)
    try:
        told = _told(there, time.monotonic() + patience)
    finally:
        os.close(there)
        with contextlib.suppress(OSError):
            os.kill(child, signal.SIGKILL)  # it has answered, or will not
        _bury(child)
    try:
        done, answer = json.loads(told)
    except ValueError:
        raise ServiceError(f"{folder}: what was to be done there as {user.pw_name} did not come to an end") from None
    if not done:
        raise ServiceError(str(answer))
    return answer


def _bury(child: int) -> None:
    """Wait for it, though not for ever: what hangs in that user's file system cannot be killed."""
    end = time.monotonic() + _KILLED
    while os.waitpid(child, os.WNOHANG)[0] == 0 and time.monotonic() < end:
        time.sleep(0.01)


def _work(uid: int, gid: int, work: Callable[[], Any], here: int) -> None:
    """The child's life."""
    status = 1
    try:
        os.setsid()  # away from root's terminal
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        os.setgroups([])
        os.setresgid(gid, gid, gid)
        os.setresuid(uid, uid, uid)
        os.umask(0o027)
        try:
            answer = (True, work())
        except SpheremouseError as e:
            answer = (False, str(e))
        except Exception as e:
            answer = (False, f"{type(e).__name__}: {e}")
        with os.fdopen(here, "w", encoding="utf-8") as file:
            json.dump(answer, file)
        status = 0
    finally:
        os._exit(status)  # nothing of the parent's is to be flushed, or done twice


def _told(there: int, until: float) -> bytes:
    """All that comes until the end, as far as it comes in time."""
    told = b""
    while len(told) <= _MOST:
        if not select.select([there], [], [], max(0.0, until - time.monotonic()))[0]:
            return b""
        if not (piece := os.read(there, 1 << 16)):
            break
        told += piece
    return told
