"""`gamepad[:full=DEG_PER_S,dead=FRACTION,...]`: a gamepad of the Linux kernel, for cockpit games and SDL.

Its left stick goes where the pointer goes, and its deflection is the ball's angular velocity: `full` is a full
deflection. The options are those of `Response`. The right stick's X is the spin, positive clockwise from above. The
sticks are in the centre if the ball is not tracked, and after 0.3 s without a confirmed frame. No button is ever
pressed; games recognise a gamepad by them.
Name and ids never change: name "spheremouse gamepad", bus 0x06 (virtual), vendor 0x5350, product 0x4d32, version 1.
"""

import time
from typing import Any

from spheremouse.finding import Finding
from spheremouse.output import Output, Report, uinput
from spheremouse.output.deflection import CHECK_PERIOD, RELEASE_TIME, pointer_rate
from spheremouse.output.response import STICK_RESPONSE, Response, parse_response

NAME = "spheremouse gamepad"
PRODUCT = 0x4D32
RESPONSE = STICK_RESPONSE
FULL_DEFLECTION = 32767

# Linux, input-event-codes.h
EV_ABS = 0x03
ABS_X, ABS_Y, ABS_RX, ABS_RY = 0x00, 0x01, 0x03, 0x04
BTN_SOUTH, BTN_EAST, BTN_NORTH, BTN_WEST, BTN_SELECT, BTN_START = 0x130, 0x131, 0x133, 0x134, 0x13A, 0x13B
_BUTTONS = [BTN_SOUTH, BTN_EAST, BTN_NORTH, BTN_WEST, BTN_SELECT, BTN_START]

Sticks = tuple[int, int, int]  # ABS_X, ABS_Y, ABS_RX
_CENTRE: Sticks = (0, 0, 0)


def to_sticks(report: Report, response: Response) -> Sticks | None:
    """Return the positions of the sticks; None if the frame is not confirmed and they keep theirs."""
    rate, sample = pointer_rate(report, response), report.pointing_sample
    if rate is None:
        return None
    if sample is not None and sample.coordinates == "obj":
        rate[2] = -rate[2]  # counter-clockwise from above; that of a hand-held ball is clockwise
    rate = response.to_axes(rate)
    x, y, spin = (round(FULL_DEFLECTION * d) for d in response.deflection(rate[:2]) + response.deflection(rate[2:]))
    return x, y, spin


class Gamepad(Output):
    """The kernel's gamepad."""

    blocks = False
    period = CHECK_PERIOD

    def __init__(self, device: Any, response: Response) -> None:
        self._device, self._response = device, response
        self._sticks, self._confirmed = _CENTRE, 0.0  # s, monotonic, the last time

    def send(self, report: Report) -> None:
        """Move the sticks. Without a confirmed frame they keep their positions, for 0.3 s at most."""
        sticks, now = to_sticks(report, self._response), time.monotonic()
        if sticks is not None:
            self._confirmed = now
            self._move(sticks)
        elif now > self._confirmed + RELEASE_TIME:
            self._move(_CENTRE)

    def close(self) -> None:
        """Centre the sticks, and remove the device."""
        try:
            self._move(_CENTRE)
        finally:
            self._device.close()

    def _move(self, sticks: Sticks) -> None:
        if sticks != self._sticks:
            events = tuple(zip((ABS_X, ABS_Y, ABS_RX), sticks, strict=True))
            uinput.write_events("gamepad", self._device, EV_ABS, events)
            self._sticks = sticks


def open(argument: str) -> Gamepad:
    response = check(argument)
    # Value, min, max, fuzz, flat, resolution. SDL scales any other range to this one, and moves the centre.
    stick = (0, -FULL_DEFLECTION - 1, FULL_DEFLECTION, 0, 0, 0)
    # SDL takes ABS_RX for the right stick only if there is ABS_RY.
    axes = [(code, stick) for code in (ABS_X, ABS_Y, ABS_RX, ABS_RY)]
    return Gamepad(uinput.create("gamepad", NAME, PRODUCT, {uinput.EV_KEY: _BUTTONS, EV_ABS: axes}), response)


def check(argument: str) -> Response:
    return parse_response(argument, f"gamepad:{argument}", RESPONSE)


def probe(argument: str) -> list[Finding]:
    return uinput.probe(argument, "gamepad")
