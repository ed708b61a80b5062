"""Threads, their priority, and the service manager."""

import contextlib
import gc
import os
import socket
import subprocess
import sys
import threading
import time
import weakref
from functools import partial

import pytest
from reporting import until

from spheremouse.errors import ControlError
from spheremouse.session.process import realtime
from spheremouse.session.process.notify import Notifier
from spheremouse.session.process.threads import WorkerPool, as_future, begin


def alone(code):
    """What a program of its own prints; it does no work, so nobody starves."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("wanted", [True, False])
def test_what_is_said_is_what_is(wanted):
    """A thread that is begun later has usual scheduling: who writes files waits for who moves the pointer."""
    said, scheduler, nice, inherited, locked = alone(f"""
import os, threading
from spheremouse.session.process import realtime
print(realtime.prepare({wanted}))
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR)
print(os.getpriority(os.PRIO_PROCESS, 0))
other = []
thread = threading.Thread(target=lambda: other.append(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK))
thread.start()
thread.join()
print(other[0] == os.SCHED_OTHER)
print([line for line in open("/proc/self/status") if line.startswith("VmLck")][0].split()[1] != "0")
""")
    assert ("real-time scheduling" in said) == (scheduler == "True")
    assert ("nice -10" in said) == (int(nice) < 0 if wanted else int(nice) != os.getpriority(os.PRIO_PROCESS, 0))
    assert ("memory locked" in said and "not locked" not in said) == (locked == "True")
    assert inherited == "True"
    if not wanted:
        assert "off" in said
        assert (scheduler, locked) == ("False", "False")


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
            pause.collect_if_due(10.0 * k)
        del cycle
        assert gone() is not None
        pause.collect_if_due(20.1)  # not yet
        assert gone() is not None
        pause.collect_if_due(30.0)
        assert gone() is None
    finally:
        pause.close()
    assert gc.isenabled()
    assert sys.getswitchinterval() == pytest.approx(switch)


@pytest.fixture
def workers():
    said = []
    made = WorkerPool(("one", "two"), said.append)
    made.said = said
    made.begin()
    yield made
    made.end("one", "two")


def test_a_kind_waits_for_its_own_and_for_no_other(workers):
    gate, done = threading.Event(), []
    workers.submit("one", gate.wait)
    workers.submit("one", lambda: done.append("one"))
    workers.submit("two", lambda: done.append("two"))
    until(lambda: done)
    assert done == ["two"]
    assert workers.busy("one")
    gate.set()
    until(lambda: not workers.busy("one"))
    assert done == ["two", "one"]


def test_an_error_is_told_and_the_next_work_is_done(workers):
    with pytest.raises(ZeroDivisionError):
        as_future(lambda: 1 // 0, partial(workers.submit, "one")).result(20.0)
    workers.submit("one", lambda: 1 // 0)
    assert as_future(lambda: 5, partial(workers.submit, "one")).result(20.0) == 5
    until(lambda: not workers.busy("one"))
    assert "ZeroDivisionError" in workers.said[0]


def test_what_was_given_is_done_before_the_end(workers):
    done = []
    workers.submit("one", lambda: time.sleep(0.05))
    workers.submit("one", lambda: done.append(1))
    workers.end("one")
    assert done == [1]


def test_a_thread_that_is_not_to_be_had_is_a_line(monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading, "_start_new_thread", refuse, raising=False)
    monkeypatch.setattr(threading, "_start_joinable_thread", refuse, raising=False)
    with pytest.raises(ControlError, match=r"refuses a new thread.*raise TasksMax") as e:
        begin(threading.Thread(target=print))
    assert len(str(e.value).splitlines()) == 1


class Manager:
    def __init__(self, path):
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.setblocking(False)
        self.now = 100.0

    def heard(self):
        messages = []
        with contextlib.suppress(BlockingIOError):
            while True:
                messages.append(self._socket.recv(4096).decode())
        return messages

    def close(self):
        self._socket.close()


@pytest.fixture
def manager(tmp_path, monkeypatch):
    made = Manager(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    monkeypatch.setenv("WATCHDOG_USEC", "20000000")
    yield made
    made.close()


def test_ready_status_and_end(manager):
    notifier = Notifier()
    notifier.send("READY=1")
    notifier.status("tracking: all is well; 30 frames/s")
    notifier.status("tracking: all is well; 30 frames/s")
    notifier.status("no-camera: it said\nREADY=0")
    notifier.send("STOPPING=1")
    assert manager.heard() == [
        "READY=1",
        "STATUS=tracking: all is well; 30 frames/s",
        "STATUS=no-camera: it said READY=0",  # one line, or it would be an order
        "STOPPING=1",
    ]


def test_the_watchdog_is_fed_by_progress_only_and_not_at_every_frame(manager):
    notifier = Notifier(lambda: manager.now)
    fed = []
    for k in range(320):  # frames for 20 s, then none for 20 s
        manager.now += 0.125
        notifier.progress(("frames", min(k, 160)))
        fed += [0.125 * k] * len(manager.heard())
    assert fed == [0.0, 5.0, 10.0, 15.0, 20.0]
    notifier.progress(("attempts", 1))  # an attempt to open the camera is progress
    manager.now += 60.0
    notifier.progress(("attempts", 1))  # the same one is none: it hangs
    assert manager.heard() == ["WATCHDOG=1"]
    notifier.progress(("attempts", 2))
    assert manager.heard() == ["WATCHDOG=1"]


@pytest.mark.parametrize(
    "change",
    [{"WATCHDOG_USEC": None}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_PID": str(os.getpid() + 1)}, {"WATCHDOG_PID": "x"}],
)
def test_without_a_watchdog_none_is_fed(manager, monkeypatch, change):
    for key, value in change.items():
        monkeypatch.setenv(key, value) if value else monkeypatch.delenv(key)
    notifier = Notifier(lambda: manager.now)
    for k in range(5):
        manager.now += 100.0
        notifier.progress(k)
    assert manager.heard() == []


def test_nobody_listens(monkeypatch, tmp_path):
    """No service manager, or one that has gone: nothing happens."""
    for path in (None, str(tmp_path / "nothing")):
        monkeypatch.setenv("NOTIFY_SOCKET", path) if path else monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
        notifier = Notifier()
        notifier.send("READY=1")
        notifier.status("x")
        notifier.send("STOPPING=1")


def test_a_manager_that_does_not_listen_holds_nobody_up(manager):
    """The kernel keeps ten messages or some hundreds, and then whoever sends would wait."""
    notifier = Notifier(lambda: manager.now)
    for k in range(2000):
        manager.now += 10.0
        notifier.progress(k)
    assert 0 < len(manager.heard()) < 2000
    notifier.status("it listens again")
    assert manager.heard() == ["STATUS=it listens again"]
