"""Protection from delays by other programs and by Python: scheduling, locked memory, garbage collection.

All are optional. If the system refuses one, the daemon logs it and runs without.
"""

import ctypes
import gc
import os
import resource
import sys

PRIORITY = 5  # of SCHED_RR: above all threads without real time, below audio servers
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
# s; how long a thread of Python may keep the others waiting (5 ms by default, more than a report)
_SWITCH_INTERVAL_S = 5e-4


def prepare(wanted: bool = True) -> str:
    """Apply the available protection to this process and this thread. Return the result in words."""
    if not sys.platform.startswith("linux"):
        return "usual scheduling: this system has no other that we know"
    if not wanted:
        return "usual scheduling, as configured (realtime: off)"
    if claim(0):
        scheduling = f"real-time scheduling (RR {PRIORITY})"
    else:
        try:
            os.nice(-10 - os.nice(0))
            scheduling = "scheduled before usual programs (nice -10)"
        except OSError:
            scheduling = "usual scheduling: the system grants no other (LimitRTPRIO=, or CAP_SYS_NICE)"
    return f"{scheduling}; {_lock_memory()}"


def claim(thread: int | None) -> bool:
    """Request real-time scheduling for a thread by its native number, 0 for this one. Return False if it is refused.

    Threads that it starts do not inherit the class: threads that write files must wait. The control socket's thread has
    the class, since the worker waits for it while it holds the interpreter.
    """
    if thread is None or not sys.platform.startswith("linux"):
        return False
    try:
        os.sched_setscheduler(thread, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def _lock_memory() -> str:
    """Lock each page in memory once it is used."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if os.geteuid() != 0 and limit != resource.RLIM_INFINITY:
        return "memory not locked: the system does not grant it (LimitMEMLOCK=infinity)"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        return f"memory not locked: {os.strerror(ctypes.get_errno()).lower()}"
    return "memory locked"


class GcPause:
    """No garbage collection while a frame is tracked, from the constructor until `close`.

    Garbage is collected when a frame has been sent. Present objects, most of them of libraries, are excluded, so that a
    whole collection takes less than a millisecond.
    """

    _INTERVAL_S = 5.0

    def __init__(self) -> None:
        self._due = 0.0
        self._switch = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        gc.collect()
        gc.freeze()
        gc.disable()

    def collect_if_due(self, now: float) -> None:
        """Collect garbage if it is due, since no frame waits."""
        if now >= self._due:
            self._due = now + self._INTERVAL_S
            gc.collect()

    def close(self) -> None:
        """Restore Python's own garbage collection."""
        sys.setswitchinterval(self._switch)
        gc.unfreeze()
        gc.enable()
