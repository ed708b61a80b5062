"""What desktops get of output `uinput`: libinput's own tool looks at the mouse that udev hands it.

`libinput debug-events` prints counts before acceleration and wheel steps in 1/120 of a notch, downwards positive.
Run by tests/system/run; skipped where the packages libinput-tools and udev are missing.
"""

import re
import shutil
import subprocess
import time
from contextlib import contextmanager

import numpy as np
import pytest
import reporting

from spheremouse.output import open_output, uinput

evdev = pytest.importorskip("evdev")

UDEVD = "/lib/systemd/systemd-udevd"
MOVED = re.compile(r"POINTER_MOTION .*\(\s*([-+][\d.]+)/\s*([-+][\d.]+)\)")
SCROLLED = re.compile(r"POINTER_SCROLL_WHEEL .*vert [-\d.]+/([-\d.]+)\*")
HALF = 60  # 1/120 of a notch: libinput before 1.29 waits for so many when the wheel has rested for half a second
PATIENCE = 30.0  # s, for what takes one in this guest


@pytest.fixture(scope="module")
def udev():
    """The daemon that says what kind of device each is; this guest begins without."""
    if shutil.which("libinput") is None or shutil.which("udevadm") is None:
        pytest.skip("needs the packages libinput-tools and udev: apt-get install libinput-tools udev")
    subprocess.run([UDEVD, "--daemon"], check=True, timeout=PATIENCE)  # back when it listens
    yield
    subprocess.run(["udevadm", "control", "--exit"], check=True, timeout=PATIENCE)


def properties(path):
    """What udev says of a device, once it has said it."""
    end = time.monotonic() + PATIENCE
    while True:
        told = subprocess.check_output(["udevadm", "info", "-q", "property", "-n", path], text=True)
        if "ID_INPUT=1" in told:
            return told.split()
        assert time.monotonic() < end, f"udev says nothing of {path}: {told}"
        time.sleep(0.05)


@contextmanager
def watched(spec):
    """An output, and the lines that libinput prints of its mouse, complete once the block is left."""
    with open_output(spec) as output:
        found = [device for device in map(evdev.InputDevice, evdev.list_devices()) if device.name == uinput.NAME]
        (path,) = [device.path for device in found]
        assert "ID_INPUT_MOUSE=1" in properties(path)
        tool = subprocess.Popen(
            ["libinput", "debug-events", "--device", path], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert tool.stdout is not None
        first, lines = tool.stdout.readline(), []
        assert "DEVICE_ADDED" in first, first
        try:
            yield output, lines
            time.sleep(0.5)
        finally:
            tool.terminate()
            lines += tool.stdout.read().splitlines()
            tool.wait(PATIENCE)


def moves(lines):
    return np.array([[float(v) for v in m.groups()] for line in lines if (m := MOVED.search(line))])


def steps(lines):
    """1/120 notches of each turn of the wheel, away from the user positive."""
    return [-float(m[1]) for line in lines if (m := SCROLLED.search(line))]


def test_counts_and_wheel_arrive_at_whom_desktops_ask(udev):
    rng = np.random.default_rng(120)
    counts = np.vstack([rng.integers(-40, 41, (150, 3)), [(0, 0, 240), (0, 0, -240)]])  # the ends: past any waiting
    with watched("uinput:third=wheel") as (output, lines):
        for x, y, z in counts.tolist():
            output.send(reporting.report(x, y, z))
            time.sleep(0.004)
    assert moves(lines).sum(axis=0).tolist() == counts[:, :2].sum(axis=0).tolist()
    assert sum(steps(lines)) == counts[:, 2].sum()
    print(f"{len(counts)} reports: {len(moves(lines))} moves, {len(steps(lines))} turns of the wheel")


def test_a_slow_spin_waits_for_half_a_notch_and_loses_nothing(udev):
    """A count every 20 ms, then a few every 0.6 s, which is longer than libinput waits."""
    with watched("uinput:third=wheel") as (output, lines):
        for _ in range(90):
            output.send(reporting.report(z=1))
            time.sleep(0.02)
        for _ in range(6):
            time.sleep(0.6)
            output.send(reporting.report(z=-20))
    print(f"steps {steps(lines)}")
    assert len(moves(lines)) == 0
    assert sum(s for s in steps(lines) if s > 0) == 90
    assert sum(s for s in steps(lines) if s < 0) == -120
    assert max(map(abs, steps(lines))) <= HALF


def test_a_spin_as_rz_is_for_those_who_read_the_device_itself(udev):
    with watched("uinput:third=rz") as (output, lines):
        for _ in range(10):
            output.send(reporting.report(3, -2, 50))
            time.sleep(0.02)
    assert moves(lines).sum(axis=0).tolist() == [30, -20]
    assert steps(lines) == []
    assert all(MOVED.search(line) for line in lines if "POINTER_" in line), lines
