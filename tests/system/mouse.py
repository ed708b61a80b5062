"""The mouse and the gamepad of outputs `uinput` and `gamepad`, as programs get them from the kernel.

Run by tests/system/run.
"""

import fcntl
import os
import subprocess
import sys
import time
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
import reporting
from reporter_world import EXACT

from spheremouse.errors import OutputError
from spheremouse.output import gamepad, open_output, uinput
from spheremouse.output.reporter import OutputThread

evdev = pytest.importorskip("evdev")
e = evdev.ecodes

MOTIONS = int(os.environ.get("MOTIONS", "1000"))
UI_DEV_DESTROY = 0x5502  # linux/uinput.h

# A game that uses SDL: prints the axes of its only gamepad for each line that it reads.
GAME = """
import os, sys
os.environ["SDL_VIDEODRIVER"] = "dummy"
import pygame
from pygame._sdl2 import controller
pygame.display.init()
controller.init()
(pad,) = [controller.Controller(i) for i in range(controller.get_count()) if controller.is_controller(i)]
print("ready", flush=True)
axes = [pygame.CONTROLLER_AXIS_LEFTX, pygame.CONTROLLER_AXIS_LEFTY, pygame.CONTROLLER_AXIS_RIGHTX]
for _ in sys.stdin:
    pygame.event.pump()
    print(*(pad.get_axis(axis) for axis in axes), flush=True)
"""


def devices(name=uinput.NAME):
    found = [evdev.InputDevice(path) for path in evdev.list_devices()]
    return [d for d in found if d.name == name]


@contextmanager
def reading(name=uinput.NAME, type_=e.EV_REL):
    """A function that waits for the next report of the only device of our name, as {code: value}."""
    (device,) = devices(name)
    events = device.read_loop()

    def report():
        found = {}
        while (event := next(events)).type != e.EV_SYN:
            assert event.type == type_, event
            found[event.code] = event.value
        assert event.code == e.SYN_REPORT, "events were dropped"
        return found

    with closing(device):
        yield report


def test_name_ids_and_capabilities():
    seen = []
    for _ in range(2):  # the same again after a restart
        with open_output("uinput"):
            (device,) = devices()
            info = device.info
            seen.append((device.phys, info.bustype, info.vendor, info.product, info.version))
            assert device.capabilities() == {
                e.EV_SYN: [e.SYN_REPORT, e.EV_KEY, e.EV_REL],  # the kernel lists the types under EV_SYN
                e.EV_KEY: [e.BTN_LEFT, e.BTN_RIGHT, e.BTN_MIDDLE],
                e.EV_REL: [e.REL_X, e.REL_Y],
            }
            entries = Path("/proc/bus/input/devices").read_text().split("\n\n")
            (entry,) = [text for text in entries if f'Name="{uinput.NAME}"' in text]
            assert "mouse" in entry.partition("Handlers=")[2].splitlines()[0]  # for the kernel itself
        assert devices() == []
    assert seen == [("spheremouse/input0", e.BUS_VIRTUAL, 0x5350, 0x4D31, 1)] * 2


def test_random_motions_arrive_exactly_with_x_and_y_in_one_report():
    rng = np.random.default_rng(2017)
    counts = rng.integers(-40, 41, (MOTIONS, 3)) * (rng.random((MOTIONS, 3)) < 0.7)
    counts[:5] = [(0, 0, 0), (2**31 - 1, 1 - 2**31, 0), (0, 0, 5), (40_000, -70_000, 0), (0, -1, 0)]
    sums = np.zeros(2, dtype=np.int64)
    reports = 0
    with open_output("uinput") as output, reading() as report:
        for x, y, z in counts.tolist():
            output.send(reporting.report(x, y, z))
            if x == 0 and y == 0:
                continue  # nothing arrives: the next report belongs to the next motion
            seen = report()
            assert seen == {code: value for code, value in ((e.REL_X, x), (e.REL_Y, y)) if value}
            sums += [seen.get(e.REL_X, 0), seen.get(e.REL_Y, 0)]
            reports += 1
    np.testing.assert_array_equal(sums, counts[:, :2].sum(axis=0))
    print(f"{len(counts)} motions, {reports} reports, sums {sums.tolist()}")
    assert reports > MOTIONS / 2


@pytest.mark.parametrize(
    ("third", "axes"),
    [("wheel", [e.REL_X, e.REL_Y, e.REL_WHEEL, e.REL_WHEEL_HI_RES]), ("rz", [e.REL_X, e.REL_Y, e.REL_RZ])],
)
def test_the_third_axis(third, axes):
    rng = np.random.default_rng(26)
    turns = rng.integers(-300, 301, 50).tolist()
    sums = dict.fromkeys(axes, 0)
    with open_output(f"uinput:third={third}") as output, reading() as report:
        (device,) = devices()
        assert sorted(device.capabilities()[e.EV_REL]) == sorted(axes)
        for z in turns:
            output.send(reporting.report(1, -1, z))
            seen = report()
            assert (seen[e.REL_X], seen[e.REL_Y]) == (1, -1)
            for code, value in seen.items():
                sums[code] += value
    if third == "rz":
        assert sums[e.REL_RZ] == sum(turns)
    else:
        assert sums[e.REL_WHEEL_HI_RES] == sum(turns)
        assert abs(sum(turns) - 120 * sums[e.REL_WHEEL]) < 120


def test_name_ids_and_capabilities_of_the_gamepad():
    with open_output("gamepad"):
        (device,) = devices(gamepad.NAME)
        info = device.info
        assert (info.bustype, info.vendor, info.product, info.version) == (e.BUS_VIRTUAL, 0x5350, 0x4D32, 1)
        capabilities = device.capabilities()
        assert {e.BTN_SOUTH, e.BTN_EAST, e.BTN_NORTH, e.BTN_WEST} <= set(capabilities[e.EV_KEY])
        axes = dict(capabilities[e.EV_ABS])
        assert sorted(axes) == [e.ABS_X, e.ABS_Y, e.ABS_RX, e.ABS_RY]
        assert {(a.value, a.min, a.max) for a in axes.values()} == {(0, -32768, 32767)}
        entries = Path("/proc/bus/input/devices").read_text().split("\n\n")
        (entry,) = [t for t in entries if f'Name="{gamepad.NAME}"' in t]
        assert "mouse" not in entry.partition("Handlers=")[2].splitlines()[0]
    assert devices(gamepad.NAME) == []


def test_the_sticks_arrive_and_are_centred_when_reports_stop():
    rng = np.random.default_rng(12)
    seen = {e.ABS_X: 0, e.ABS_Y: 0, e.ABS_RX: 0}
    thread = OutputThread(lambda: open_output("gamepad:full=90,dead=0,curve=2"), EXACT, print)
    reporting.until(lambda: devices(gamepad.NAME))
    with closing(thread), reading(gamepad.NAME, e.EV_ABS) as report:
        for rate in rng.uniform(-2.0, 2.0, (20, 3)):
            thread.submit(reporting.rolling(rate), time.monotonic())
            sticks = gamepad.to_sticks(reporting.rolling(rate), gamepad.check("full=90,dead=0,curve=2"))
            wanted = dict(zip(seen, sticks, strict=True))
            while seen != wanted:  # a slow guest may release them in between
                seen.update(report())
        while any(seen.values()):
            seen.update(report())


@pytest.mark.slow
def test_sdl_takes_it_for_a_gamepad():
    pytest.importorskip("pygame")
    rolls = reporting.rolling([np.radians(45), np.radians(-90), np.radians(-45)])
    with (
        open_output("gamepad:full=180,dead=0") as output,
        subprocess.Popen(
            [sys.executable, "-c", GAME], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as game,
    ):
        assert game.stdin is not None
        assert game.stdout is not None
        while game.stdout.readline() not in ("ready\n", ""):  # pygame prints its version
            pass
        seen = []
        for _ in range(200):  # the first ones may be late, and a slow guest may release the sticks in between
            output.send(rolls)
            print(file=game.stdin, flush=True)
            seen.append(game.stdout.readline().split())
            if "0" not in seen[-1]:
                break
        assert tuple(map(int, seen[-1])) == gamepad.to_sticks(rolls, gamepad.check("full=180,dead=0"))
        game.stdin.close()


def test_a_mouse_that_is_destroyed_is_a_failed_output():
    """The kernel takes no report of it any more; the output opens another one."""
    with open_output("uinput") as output:
        fcntl.ioctl(output._device.fd, UI_DEV_DESTROY)
        with pytest.raises(OutputError, match="uinput"):
            output.send(reporting.report(1))
    with open_output("uinput") as output:
        output.send(reporting.report(1))


def test_without_permission_the_error_says_what_to_do():
    assert "may be used by its owner alone" in reporting.error_of_nobody(lambda: open_output("uinput"))
