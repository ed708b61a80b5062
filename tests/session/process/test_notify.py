"""What systemd hears, on a socket of our own: READY, STATUS, and WATCHDOG after progress only."""

import contextlib
import os
import socket

import pytest

from spheremouse.session.process.notify import Notifier


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
    notifier.ready()
    notifier.status("tracking: all is well; 30 frames/s")
    notifier.status("tracking: all is well; 30 frames/s")
    notifier.status("no-camera: it said\nREADY=0")
    notifier.stopping()
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
        notifier.ready()
        notifier.status("x")
        notifier.stopping()


def test_a_manager_that_does_not_listen_holds_nobody_up(manager):
    """The kernel keeps ten messages or some hundreds, and then whoever sends would wait."""
    notifier = Notifier(lambda: manager.now)
    for k in range(2000):
        manager.now += 10.0
        notifier.progress(k)
    assert 0 < len(manager.heard()) < 2000
    notifier.status("it listens again")
    assert manager.heard() == ["STATUS=it listens again"]
