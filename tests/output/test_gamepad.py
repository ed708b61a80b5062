"""The gamepad's sticks as text, and on a device that keeps what is written; the kernel's own in tests/system."""

import contextlib
import os
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reporting import refused, rolling, until
from seats import LOOKS

from spheremouse.output import gamepad
from spheremouse.output.counts import MotionSettings
from spheremouse.output.response import Response

FULL = np.radians(180.0)
EVENT = struct.Struct("@llHHi")  # of the kernel: s, us, type, code, value


class Device:
    """Positions of the axes that a program would see."""

    def __init__(self):
        self._events, self.fd = os.pipe()
        os.set_blocking(self._events, False)
        self._axes, self.closed = {}, False

    @property
    def axes(self):
        with contextlib.suppress(BlockingIOError):
            while read := os.read(self._events, 4 * EVENT.size):  # a report: three axes, and its end
                *axes, end = EVENT.iter_unpack(read)
                assert end == (0, 0, 0, 0, 0)
                assert {kind for _, _, kind, _, _ in axes} == {gamepad.EV_ABS}
                self._axes |= {code: value for *_, code, value in axes}
        return self._axes

    def close(self):
        self.closed = True


def sticks(device):
    return tuple(device.axes.get(code, 0) for code in (gamepad.ABS_X, gamepad.ABS_Y, gamepad.ABS_RX))


@pytest.mark.parametrize("player", sorted(LOOKS))
def test_the_sticks_follow_the_hand_of_each_player(player):
    look = np.array(LOOKS[player], dtype=float)
    right, settings = np.cross(look, [0, 1, 0]), MotionSettings(player=player)
    half = Response(full=180.0, dead=0.0)
    made = {
        "right": gamepad.to_sticks(rolling(np.cross([0, 1, 0], right) * FULL / 2, settings), half),
        "away": gamepad.to_sticks(rolling(np.cross([0, 1, 0], look) * FULL / 2, settings), half),
        "clockwise": gamepad.to_sticks(rolling([0, -FULL / 2, 0], settings), half),
    }
    assert made == {"right": (16384, 0, 0), "away": (0, -16384, 0), "clockwise": (0, 0, 16384)}


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-50, 50))
def test_no_rate_leaves_the_range_of_the_axes(x, y, z):
    made = gamepad.to_sticks(rolling([x, y, z]), Response(curve=0.5))
    assert made is not None
    assert max(map(abs, made)) <= gamepad.FULL_DEFLECTION


def test_the_sticks_are_centred_when_reports_stop_and_at_the_end():
    device = Device()
    with gamepad.Gamepad(device, Response()) as output:
        for _ in range(2):
            output.send(rolling([0, -9, 0]))
            assert len(device.axes) == 3
            until(lambda: sticks(device) == (0, 0, 0))
        output.send(rolling([0, -9, 0]))
    assert sticks(device) == (0, 0, 0)
    assert device.closed


def test_the_numbers_are_the_kernels():
    ecodes = pytest.importorskip("evdev").ecodes
    names = "EV_ABS ABS_X ABS_Y ABS_RX ABS_RY BTN_SOUTH BTN_EAST BTN_NORTH BTN_WEST BTN_SELECT BTN_START"
    for name in names.split(" "):
        assert getattr(gamepad, name) == getattr(ecodes, name)


def test_the_gamepad_where_it_cannot_be_made():
    if os.path.exists("/dev/uinput"):
        pytest.skip("/dev/uinput is here; tests/system uses it")
    assert refused("gamepad") == "gamepad: /dev/uinput does not exist; as root: modprobe uinput"
