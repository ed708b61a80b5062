"""A board that is a mouse, as the kernel sees it: USB gadget, the firmware's logic in it, the host's output, evdev.

Run by tests/system/run.
"""

import contextlib
import ctypes
import multiprocessing
import os
import select
import subprocess
import time
from pathlib import Path

import gadget
import numpy as np
import pytest
from reporting import report, until

from spheremouse.capture.v4l2.usb import reset_camera
from spheremouse.output import open_output

evdev = pytest.importorskip("evdev")
e = evdev.ecodes

LIBRARY = Path("/tmp/firmware_avr.so")  # the AVR's protocol.c, made here
MOTIONS = int(os.environ.get("MOTIONS", "1000"))

FORK = multiprocessing.get_context("fork")  # for processes without waiting for their imports


def mice():
    found = []
    for path in evdev.list_devices():
        with contextlib.suppress(OSError):  # just gone
            found.append(evdev.InputDevice(path))
    return [d for d in found if (d.info.vendor, d.info.product) == (gadget.VENDOR, gadget.PRODUCT)]


class Process:
    """Runs `job(pipe, *given)` in a process of its own; leaving kills it."""

    def __init__(self, job, *given):
        self.pipe, end = FORK.Pipe()
        self._process = FORK.Process(target=job, args=(end, *given), daemon=True)
        self._process.start()
        assert self.pipe.poll(30)
        assert self.pipe.recv() == "ready"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.join()


def firmware(pipe, kind):
    gadget.run(kind, LIBRARY, lambda: pipe.send("ready"))


def board(kind):
    until(lambda: gadget.HID.exists() and gadget.SERIAL.exists())
    return Process(firmware, kind)


def read(pipe, path):
    """Collect the mouse's reports and keys; whenever asked, tell them and begin anew."""
    device = evdev.InputDevice(path)
    pipe.send("ready")
    reports, keys, report = [], [], {}
    while True:
        if device not in select.select([pipe, device], [], [])[0]:
            pipe.recv()
            pipe.send((reports, keys))
            reports, keys = [], []
            continue
        for event in device.read():
            if event.type == e.EV_REL:
                report[event.code] = event.value
            elif event.type == e.EV_KEY:
                keys.append((event.code, event.value))
            elif event.type == e.EV_SYN:
                assert event.code == e.SYN_REPORT, "events were dropped"
                reports += [report] if report else []
                report = {}


class Reader(Process):
    def __init__(self):
        (device,) = until(mice)
        super().__init__(read, device.path)
        self.reports, self.keys = [], []

    def sum(self, code):
        return sum(r.get(code, 0) for r in self.reports)

    def sums(self, *codes):
        self.pipe.send("")
        reports, keys = self.pipe.recv()
        self.reports += reports
        self.keys += keys
        return [self.sum(code) for code in codes]


@pytest.fixture(scope="module")
def cable():
    code = gadget.avr_board.load(gadget.avr_board.library(LIBRARY.parent))
    descriptor = bytes((ctypes.c_uint8 * 137).in_dll(code, "sm_descriptor"))
    gadget.create(descriptor)
    gadget.plug()
    until(mice)
    until(lambda: Path("/dev/ttyACM0").exists())
    yield descriptor
    gadget.unplug()


@pytest.fixture(params=["avr", "pico"])
def kind(request, cable):
    if request.param == "pico" and not (gadget.REPOSITORY / "service/firmware/pico/mouse.py").exists():
        pytest.skip("no firmware of the Pico here")
    return request.param


def replug():
    """A board that has no power forgets; the kernel then asks for its descriptors anew."""
    gadget.unplug()
    until(lambda: not mice())
    gadget.plug()
    until(mice)
    until(lambda: Path("/dev/ttyACM0").exists())


def test_the_kernel_takes_it_for_a_mouse_with_fine_wheels(cable):
    (device,) = mice()
    assert device.info.bustype == e.BUS_USB
    capabilities = device.capabilities()
    assert capabilities[e.EV_KEY] == [e.BTN_LEFT, e.BTN_RIGHT, e.BTN_MIDDLE, e.BTN_SIDE, e.BTN_EXTRA]
    assert sorted(capabilities[e.EV_REL]) == sorted(
        [e.REL_X, e.REL_Y, e.REL_WHEEL, e.REL_HWHEEL, e.REL_WHEEL_HI_RES, e.REL_HWHEEL_HI_RES]
    )
    entries = Path("/proc/bus/input/devices").read_text().split("\n\n")
    (entry,) = [t for t in entries if f"Vendor={gadget.VENDOR:04x} Product={gadget.PRODUCT:04x}" in t]
    handlers = next(line for line in entry.splitlines() if line.startswith("H: Handlers="))
    assert "mouse" in handlers
    (report_descriptor,) = Path("/sys/bus/hid/devices").glob(
        f"0003:{gadget.VENDOR:04X}:{gadget.PRODUCT:04X}.*/report_descriptor"
    )
    assert report_descriptor.read_bytes() == cable


def test_a_usb_reset_brings_the_device_back(cable):
    """As of a camera that answers with errors; the kernel has no camera in software behind USB here."""
    (before,) = mice()
    listed = Path("/sys/class/input")
    said = reset_camera(before.path, listed)
    print(said)
    assert f"({gadget.NAME}) was reset" in said
    log = subprocess.run(["dmesg"], capture_output=True, text=True, check=True).stdout
    assert "reset high-speed USB device" in log
    until(mice)


def settle(output):
    """Wait until the board has passed on all; a host that says nothing for 1 s would be taken for dead."""

    def settled():
        output.send(report())
        return output.link.settled

    until(settled)


def test_motions_arrive_exactly_with_x_and_y_in_one_report(kind):
    replug()
    rng = np.random.default_rng(2017)
    x, z = rng.integers(-40, 41, (2, MOTIONS)).tolist()
    x[5] = 40_000  # more than a frame may hold
    with board(kind), Reader() as mouse, open_output("serial:auto,third=wheel") as output:
        for a, b in zip(x, z, strict=True):
            output.send(report(a, -a, b))
            time.sleep(0.001)
        settle(output)
        link = output.link
        assert (link.dropped, link.uncertain) == ([0] * 4, [0] * 4)
        given = [sum(x), -sum(x), sum(z)]
        until(lambda: mouse.sums(e.REL_X, e.REL_Y, e.REL_WHEEL_HI_RES) == given)
        assert all(r.get(e.REL_X, 0) == -r.get(e.REL_Y, 0) for r in mouse.reports)
        assert mouse.sum(e.REL_WHEEL) == pytest.approx(sum(z) / 120, abs=1)
        assert mouse.keys == []
        print(f"{kind}: {MOTIONS} motions, {len(mouse.reports)} reports, sums {given}; {link.summary()}")
        assert len(mouse.reports) > 40
