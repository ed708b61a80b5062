"""`spheremouse log-mouse` on a trackball that the kernel has, made with uinput. Run by tests/system/run."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from reporting import error_of_nobody, until

from spheremouse.capture.mouse import Listener, choose, mice
from spheremouse.files.mouse_log import read_log

evdev = pytest.importorskip("evdev")
e = evdev.ecodes

REPORTS = int(os.environ.get("MOTIONS", "1000"))
NAME = "Old Trackball"


@contextmanager
def trackball(name=NAME):
    axes = {e.EV_KEY: [e.BTN_LEFT, e.BTN_RIGHT], e.EV_REL: [e.REL_X, e.REL_Y, e.REL_WHEEL]}
    with evdev.UInput(axes, name=name) as device:
        until(lambda: any(m.name == name and os.access(m.node, os.R_OK) for m in mice()))
        yield device


@contextmanager
def logging(out, *words):
    """The command in a process of its own, once it listens."""
    command = [sys.executable, "-m", "spheremouse", "log-mouse", "--out", str(out), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        said = process.stderr.readline()
        assert said.startswith("listening to "), said + process.stderr.read()
        time.sleep(0.3)
        try:
            yield process
        finally:
            process.kill()


def move(device, x, y):
    for code, value in ((e.REL_X, x), (e.REL_Y, y)):
        if value:
            device.write(e.EV_REL, code, value)
    device.syn()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_every_report_is_in_the_log_by_the_monotonic_clock(tmp_path, number):
    out = tmp_path / "log.csv"
    rng = np.random.default_rng(4)
    sent = rng.integers(-30, 31, (REPORTS, 2))
    sent = sent[np.any(sent != 0, axis=1)]
    times = np.zeros(len(sent))
    with trackball() as device, logging(out, "--device", "old track") as process:
        for k, (x, y) in enumerate(sent.tolist()):
            move(device, x, y)
            times[k] = time.monotonic()
            time.sleep(0.002)
        time.sleep(0.3)
        process.send_signal(number)
        said, complaints = process.communicate(timeout=30)
        assert (process.returncode, complaints) == (0, "")
    log = read_log(out)
    np.testing.assert_array_equal(log.counts[1:-1], sent)
    late = times - log.stamp[1:-1]
    print(f"{len(sent)} reports; stamped {1e3 * np.median(late):.3f} ms before the writer had done, median")
    assert np.all(late > -1e-3)
    assert np.median(late) < 0.05
    assert log.stamp[0] < times[0]
    assert log.stamp[-1] > times[-1]
    assert said.startswith(f"{out}: {len(sent)} reports in ")
    assert said.endswith(f"next: spheremouse match RECORDING {out}\n")
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]


def test_the_desktop_still_gets_its_motion_unless_it_is_grabbed(tmp_path):
    for words, moves in (([], 1), (["--grab"], 0)):
        out = tmp_path / f"log{len(words)}.csv"
        with trackball() as device, logging(out, *words, "--device", NAME, "--seconds", "3") as process:
            other = evdev.InputDevice(str(choose(NAME, mice()).node))
            move(device, 5, 0)
            time.sleep(0.5)
            events = []
            with suppress(BlockingIOError):
                events = [x for x in other.read() if x.type == e.EV_REL]
            other.close()
            assert len(events) == moves
            process.communicate(timeout=30)
        assert read_log(out).counts.sum(axis=0).tolist() == [5.0, 0.0]


def test_without_permission_it_says_what_to_do():
    with trackball():
        mouse = choose(NAME, mice())
        os.chmod(mouse.node, 0o600)
        assert "the group input (sudo usermod -aG input $USER)" in error_of_nobody(lambda: Listener(mouse))
