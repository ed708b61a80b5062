"""Real time is asked for and never needed. What the whole process would feel is asked for in a process of its own."""

import gc
import os
import subprocess
import sys
import weakref

import pytest

from spheremouse.session.process import realtime


def alone(code):
    """What a program of its own prints; it does no work, so nobody starves."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_what_is_said_is_what_is():
    said, scheduler, inherited, locked = alone("""
import os, threading
from spheremouse.session.process import realtime
print(realtime.prepare())
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR, os.getpriority(os.PRIO_PROCESS, 0) < 0)
other = []
thread = threading.Thread(target=lambda: other.append(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK))
thread.start()
thread.join()
print(other[0] == os.SCHED_OTHER)
print([line for line in open("/proc/self/status") if line.startswith("VmLck")][0].split()[1] != "0")
""")
    real_time, nice = (word == "True" for word in scheduler.split())
    assert ("real-time scheduling" in said) == real_time
    assert ("nice -10" in said) == nice
    assert ("memory locked" in said and "not locked" not in said) == (locked == "True")
    assert inherited == "True"  # who writes files waits for who moves the pointer


def test_off_asks_for_nothing():
    said, scheduler, nice, locked = alone("""
import os
from spheremouse.session.process import realtime
print(realtime.prepare(False))
print(os.sched_getscheduler(0) == os.SCHED_OTHER)
print(os.getpriority(os.PRIO_PROCESS, 0))
print([line for line in open("/proc/self/status") if line.startswith("VmLck")][0].split()[1])
""")
    assert "off" in said
    assert (scheduler, locked) == ("True", "0")
    assert int(nice) == os.getpriority(os.PRIO_PROCESS, 0)


def test_what_is_not_granted_is_said(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "nice", refuse)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda _: (65536, 65536))
    assert realtime.prepare() == (
        "usual scheduling: the system grants no other (LimitRTPRIO=, or CAP_SYS_NICE); "
        "memory not locked: the system does not grant it (LimitMEMLOCK=infinity)"
    )


def test_a_thread_that_is_not_there_is_not_claimed():
    assert not realtime.claim(None)
    assert not realtime.claim(2**22 + 1)  # above the largest number that Linux gives


class Cycle:
    """Only the collector can take it away."""

    def __init__(self):
        self.me = self


def test_garbage_waits_for_a_rest_and_goes_however_old_it_is():
    """Also what has lived through several collections: a daemon runs for months."""
    switch = sys.getswitchinterval()
    pause = realtime.GcPause()
    try:
        assert not gc.isenabled()
        assert sys.getswitchinterval() < 0.005
        cycle = Cycle()
        gone = weakref.ref(cycle)
        for k in range(3):
            pause.rest(10.0 * k)
        del cycle
        assert gone() is not None
        pause.rest(20.1)  # not yet
        assert gone() is not None
        pause.rest(30.0)
        assert gone() is None
    finally:
        pause.close()
    assert gc.isenabled()
    assert sys.getswitchinterval() == pytest.approx(switch)
