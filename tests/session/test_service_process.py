"""The daemon as a process: the service manager, signals, standard error and the limit of threads."""

import contextlib
import fcntl
import os
import signal
import tempfile
import threading
import time
from pathlib import Path

import daemon_process
import pytest
from view_world import start

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client

PATIENCE = 60.0  # s
OTHER = 54321  # a uid that nobody has


@pytest.mark.slow
def test_systemd_hears_of_readiness_and_of_progress_and_of_nothing_else(unstarted, monkeypatch):
    """READY when the control socket answers; WATCHDOG after frames or attempts; a driver that hangs starves it."""
    world = unstarted
    heard = []
    monkeypatch.setattr("sdnotify.SystemdNotifier.notify", lambda _, text: heard.append(text))
    monkeypatch.setenv("WATCHDOG_USEC", "40000")
    monkeypatch.setattr("spheremouse.session.live_run.MAX_FRAME_GAP_S", 0.3)

    def fed():
        heard.clear()
        time.sleep(0.3)
        return heard.count("WATCHDOG=1")

    world.start()
    world.until(lambda: "READY=1" in heard)
    assert world.ask("status")["pid"] == os.getpid()
    world.reach("tracking")
    world.until(lambda: any(line.startswith("STATUS=tracking: ") for line in heard))
    assert fed() > 0
    world.missing = "unplugged"
    world.reach("no-camera")
    assert fed() > 0  # it is looked for again and again
    world.missing, world.hang = "", threading.Event()
    world.until(lambda: fed() == 0, "starved")
    assert fed() == 0
    world.hang.set()
    world.hang = None
    world.reach("tracking")
    assert fed() > 0
    world.stop()
    assert "STOPPING=1" in heard
    assert not world.logged("internal error")


class Process:
    """`spheremouse run` on a film, in a process of its own."""

    def __init__(self, folder, stderr=None, uid=""):
        self.folder, self.ask, self._log = folder, Client(folder / "s").ask, folder / f"{time.monotonic_ns()}.log"
        code = "import sys, daemon_process; daemon_process.main(*sys.argv[1:])"
        with self._log.open("w") as log:
            self.process = start("-c", code, folder, uid, stderr=log if stderr is None else stderr)

    @property
    def said(self):
        return self._log.read_text()

    def until(self, condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"it never came to be: {self.said}"
            assert self.process.poll() is None, f"ended: {self.said}"
            time.sleep(0.02)

    def until_tracking(self):
        def tracks():
            with contextlib.suppress(ControlError):
                return self.ask("status")["state"] == "tracking"

        self.until(tracks)

    def until_frames(self, more):
        frames = self.ask("status")["frames"] + more
        self.until(lambda: self.ask("status")["frames"] >= frames)

    def terminated(self):
        """It ends as it should, with the map saved."""
        self.process.terminate()
        assert self.process.wait(PATIENCE) == 0
        assert (self.folder / "rig.map.yaml").exists()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait(PATIENCE)


@pytest.fixture
def prepared(film):
    """A folder that another user may enter, with the film and what a daemon needs."""
    with tempfile.TemporaryDirectory() as folder:
        daemon_process.prepare(Path(folder), film)
        yield Path(folder)


@pytest.mark.slow
def test_signals_a_second_instance_and_kill_9(prepared):
    """A file stands for the camera's node: SIGHUP reloads, a second daemon is refused, kill -9 leaves nothing stuck,
    SIGTERM ends it with the map saved."""
    with Process(prepared) as first:
        first.until_tracking()
        first.process.send_signal(signal.SIGHUP)
        first.process.send_signal(signal.SIGHUP)
        first.until(lambda: "configuration applied: nothing has changed" in first.said)
        second = Process(prepared)
        assert second.process.wait(PATIENCE) == 2
        assert f"in use by another spheremouse (process {first.process.pid})" in second.said
        assert first.ask("status")["pid"] == first.process.pid
    assert (prepared / "s").exists()  # stale, after kill -9: nobody could remove it
    with Process(prepared) as third:
        third.until_tracking()
        assert third.ask("status")["pid"] == third.process.pid
        third.until_frames(100)  # enough to know some discs for good
        third.terminated()
        assert not (prepared / "s").exists()


@pytest.fixture(params=["closed pipe", "full disk", "pipe that nobody reads"])
def broken_stderr(request):
    reads, writes = os.pipe()
    with os.fdopen(writes, "wb"), os.fdopen(reads, "rb") as reader, open("/dev/full", "wb") as full:
        fcntl.fcntl(writes, fcntl.F_SETPIPE_SZ, 4096)
        if request.param == "closed pipe":
            reader.close()
        yield full if request.param == "full disk" else writes


@pytest.mark.slow
def test_nothing_that_happens_to_standard_error_stops_tracking(prepared, broken_stderr):
    """However much there is to say; and the end is an end like any other."""
    with Process(prepared, broken_stderr) as daemon:
        daemon.until_tracking()
        for _ in range(60):  # lines of 60 letters: more than the pipe takes
            daemon.ask("pause")
            daemon.ask("resume")
        daemon.until_frames(50)
        daemon.terminated()


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become a user whose tasks are limited")
def test_without_another_thread_to_be_had_only_what_needs_one_fails(prepared):
    """The task limit is the kernel's, reached when the daemon tracks: its own threads are there, and no other comes."""
    with Process(prepared, uid=str(OTHER)) as daemon:
        daemon.until_tracking()
        assert Path(daemon.ask("snapshot")["file"]).exists()
        assert daemon.ask("record")["folder"]
        with pytest.raises(ControlError, match="refuses a new thread, as its limit of tasks"):
            daemon.ask("set", assignments=["output=text:/dev/null"])
        assert daemon.ask("status")["outputs"][0]["spec"] == "null"
        assert daemon.ask("reload")["changed"] == []
        assert daemon.ask("set", assignments=["motion.scale_x=2"])["changed"] == ["motion"]
        assert daemon.ask("reinit")["message"]
        daemon.until_frames(100)
        daemon.terminated()
        assert "Traceback" not in daemon.said
        assert "internal error" not in daemon.said
