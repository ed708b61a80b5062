"""`uinput[:third=none|wheel|rz]`: a mouse of the Linux kernel, which every program takes for a real one.

It has relative X and Y and three buttons that are never pressed: desktops and games recognise a mouse by REL_X, REL_Y
and BTN_LEFT. Name and ids never change, so a game's binding survives: name "spheremouse", bus 0x06 (virtual), vendor
0x5350, product 0x4d31, version 1. The third axis, the ball's spin about the vertical, is off by default. `wheel` sends
REL_WHEEL_HI_RES (one unit a count, 120 a notch), and REL_WHEEL for each whole notch, which every program understands.
`rz` sends REL_RZ, one unit a count, for programs that read space mice.
"""

import importlib.util
import os
import struct
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.access import access_problem
from spheremouse.finding import Finding, absent, ok, wrong
from spheremouse.output import Output, Report
from spheremouse.output.third_axis import parse_third, whole_notches

check = partial(parse_third, "uinput")

NAME = "spheremouse"
NODE = Path("/dev/uinput")
BUS, VENDOR, PRODUCT, VERSION = 0x06, 0x5350, 0x4D31, 1

# Linux, input-event-codes.h
EV_SYN, EV_KEY, EV_REL = 0x00, 0x01, 0x02
SYN_REPORT = 0x00
REL_X, REL_Y, REL_RZ, REL_WHEEL, REL_WHEEL_HI_RES = 0x00, 0x01, 0x05, 0x08, 0x0B
BTN_LEFT, BTN_RIGHT, BTN_MIDDLE = 0x110, 0x111, 0x112
_AXES = {"none": [], "wheel": [REL_WHEEL, REL_WHEEL_HI_RES], "rz": [REL_RZ]}
_EVENT = struct.Struct("@llHHi")  # the kernel's input_event: s, us, type, code, value; the kernel sets the time
_MAX_VALUE = 2**31 - 1  # an event's value is a signed 32-bit integer


def to_events(report: Report, third: str, notch: int = 0) -> tuple[list[tuple[int, int]], int]:
    """Return the events (code, value) of a report without its SYN_REPORT, and the units of a notch left over.

    `notch` was left over from the last report. Values are not 0, and saturate at 32 bits.
    """
    x, y, z = (max(-_MAX_VALUE, min(_MAX_VALUE, n)) for n in report.counts)
    events = [(REL_X, x), (REL_Y, y)]
    if third == "rz":
        events.append((REL_RZ, z))
    if third == "wheel":
        whole, notch = whole_notches(notch + z)
        events += [(REL_WHEEL, whole), (REL_WHEEL_HI_RES, z)]
    return [(code, value) for code, value in events if value], notch


class UInput(Output):
    """The kernel's mouse."""

    paced = True

    def __init__(self, device: Any, third: str) -> None:
        self._device, self._third, self._notch = device, third, 0

    def send(self, report: Report) -> None:
        """Write the report, unless it is empty. Raises OutputError if the kernel refuses it."""
        events, notch = to_events(report, self._third, self._notch)
        write_events("uinput", self._device, EV_REL, events)
        self._notch = notch

    def close(self) -> None:
        self._device.close()


def open(argument: str) -> UInput:
    third = check(argument)
    buttons, axes = [BTN_LEFT, BTN_RIGHT, BTN_MIDDLE], [REL_X, REL_Y, *_AXES[third]]
    return UInput(create("uinput", NAME, PRODUCT, {EV_KEY: buttons, EV_REL: axes}), third)


def probe(argument: str, kind: str = "uinput") -> list[Finding]:
    """Return whether this account may create a device for an output of a `kind`."""
    if obstacle := _obstacle():
        return [absent(kind, *obstacle)] if _has_evdev() else [wrong(kind, *obstacle)]
    return [ok(kind, f"{NODE} may be written")]


def _has_evdev() -> bool:
    return importlib.util.find_spec("evdev") is not None


def _obstacle() -> tuple[str, str] | None:
    """Return the reason why this account cannot create a device, and the remedy; None if it can."""
    if not _has_evdev():
        return "needs Linux and the Python package evdev", "use another output: desktop, serial:auto"
    if not NODE.exists():
        return f"{NODE} does not exist", "as root: modprobe uinput"
    return access_problem(NODE)


def write_events(kind: str, device: Any, event_type: int, events: Sequence[tuple[int, int]]) -> None:
    """Write events of one type, (code, value), as one report, if there are any; OutputError if the kernel refuses."""
    if not events:
        return
    report = [_EVENT.pack(0, 0, event_type, code, value) for code, value in events]
    try:  # by one system call; evdev makes one for each event
        os.write(device.fd, b"".join([*report, _EVENT.pack(0, 0, EV_SYN, SYN_REPORT, 0)]))
    except OSError as e:
        raise OutputError(
            f"{kind}: the kernel takes no more events ({e.strerror or e})", "start spheremouse again"
        ) from None


def create(kind: str, name: str, product: int, capabilities: dict[int, Sequence[Any]]) -> Any:
    """Create an input device, an evdev.UInput that the caller closes, for an output of a `kind`.

    `name` and `product`, a USB product number, identify it to programs. `capabilities` are those of evdev: codes by
    type of event. Raises OutputError, which begins with `kind`, without evdev, without access, or if it is refused.
    """
    if obstacle := _obstacle():
        problem, hint = obstacle
        raise OutputError(f"{kind}: {problem}", hint)
    import evdev

    class Device(evdev.UInput):
        """Does not open its own event node, because a service may write uinput but read no input device."""

        def _find_device(self, fd: int) -> Any:
            return None

    try:
        return Device(
            capabilities,
            name=name,
            vendor=VENDOR,
            product=product,
            version=VERSION,
            bustype=BUS,
            phys=f"{name}/input0",
            max_effects=0,  # evdev's default declares force feedback, which no device of ours has
        )
    except (OSError, evdev.UInputError) as e:
        raise OutputError(f"{kind}: the kernel refuses to create it: {' '.join(str(e).split())}") from None
