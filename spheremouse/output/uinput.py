"""`uinput[:third=none|wheel|rz]`: a mouse of the Linux kernel, as real to every program as one that is plugged in.

One relative pointer with three buttons that are never pressed (desktops and games take a device for a mouse by
REL_X, REL_Y and BTN_LEFT). It is created once and keeps its name and ids, so that a game's binding survives:
name "spheremouse", bus 0x06 (virtual), vendor 0x5350, product 0x4d31, version 1. X and Y go together.
The third axis, the ball spinning about the vertical, is off unless asked for: `wheel` sends REL_WHEEL_HI_RES (120 to a
notch: one count each) with REL_WHEEL for each whole notch, which every program understands; `rz` sends REL_RZ, which
programs for space mice read, one per count.
"""

import os
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.output import Report
from spheremouse.output.third_axis import NONE, checked

NAME = "spheremouse"
BUS, VENDOR, PRODUCT, VERSION = 0x06, 0x5350, 0x4D31, 1
NOTCH = 120  # REL_WHEEL_HI_RES units of one detent

# Linux, input-event-codes.h
EV_KEY, EV_REL = 0x01, 0x02
REL_X, REL_Y, REL_RZ, REL_WHEEL, REL_WHEEL_HI_RES = 0x00, 0x01, 0x05, 0x08, 0x0B
BTN_LEFT, BTN_RIGHT, BTN_MIDDLE = 0x110, 0x111, 0x112
_NAMES = {0x00: "REL_X", 0x01: "REL_Y", 0x05: "REL_RZ", 0x08: "REL_WHEEL", 0x0B: "REL_WHEEL_HI_RES"}
_AXES = {"none": [], "wheel": [REL_WHEEL, REL_WHEEL_HI_RES], "rz": [REL_RZ]}
_MOST = 2**31 - 1  # an event's value is a signed 32-bit integer


@dataclass(frozen=True, slots=True)
class Events:
    """What one report becomes: relative events that end with one SYN_REPORT, and the part of a notch left over."""

    events: tuple[tuple[int, int], ...]  # code, value; never 0
    notch: int = 0  # REL_WHEEL_HI_RES units

    def __str__(self) -> str:
        return " ".join([*(f"{_NAMES[code]} {value:+d}" for code, value in self.events), "SYN"] if self.events else [])


def events_of(report: Report, third: str, notch: int = 0) -> Events:
    """Events of a report; `notch` is what the last report left over. Values beyond 32 bits saturate."""
    x, y, z = (max(-_MOST, min(_MOST, n)) for n in report.counts)
    events = [(REL_X, x), (REL_Y, y)]
    if third == "rz":
        events.append((REL_RZ, z))
    if third == "wheel":
        notch += z
        whole = abs(notch) // NOTCH * (1 if notch > 0 else -1)
        notch -= whole * NOTCH
        events += [(REL_WHEEL, whole), (REL_WHEEL_HI_RES, z)]
    return Events(tuple((code, value) for code, value in events if value), notch)


class UInput:
    """The kernel's mouse."""

    def __init__(self, device: Any, third: str) -> None:
        self._device, self._third, self._notch = device, third, 0

    def send(self, report: Report) -> None:
        """Write the report, unless it is empty."""
        made = events_of(report, self._third, self._notch)
        try:
            for code, value in made.events:
                self._device.write(EV_REL, code, value)
            if made.events:
                self._device.syn()
        except OSError as e:
            raise OutputError(f"uinput: the kernel takes no more events ({e.strerror or e}); start again") from None
        self._notch = made.notch

    def describe(self, report: Report) -> str:
        """The report's events, as in `REL_X +3 REL_Y -2 SYN`."""
        return str(events_of(report, self._third, self._notch))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._device.close()


def open(argument: str) -> UInput:
    """Create the mouse."""
    third = check(argument)
    return UInput(_create(third), third)


def check(argument: str) -> str:
    """The way of the third axis; OutputError where the argument is of no use."""
    given = options(argument, {"third": str}, f"uinput:{argument}", OutputError)
    return checked("uinput", str(given.get("third", NONE)))


def _create(third: str) -> Any:
    try:
        import evdev
    except ImportError:
        raise OutputError("uinput: needs Linux and the package evdev; elsewhere use serial:auto or desktop") from None
    node = "/dev/uinput"
    if not os.path.exists(node):
        raise OutputError(f"uinput: {node} does not exist; load the kernel module: sudo modprobe uinput")
    if not os.access(node, os.W_OK):
        raise OutputError(
            f"uinput: {node} may not be written; add a udev rule "
            '\'KERNEL=="uinput", GROUP="input", MODE="0660", OPTIONS+="static_node=uinput"\', be in the group input, '
            "and log in again"
        )
    capabilities = {EV_KEY: [BTN_LEFT, BTN_RIGHT, BTN_MIDDLE], EV_REL: [REL_X, REL_Y, *_AXES[third]]}

    class Mouse(evdev.UInput):
        """Without a look at its own event node: a service may write to uinput and read no input device."""

        def _find_device(self, fd: int) -> Any:
            return None

    try:
        return Mouse(
            capabilities,
            name=NAME,
            vendor=VENDOR,
            product=PRODUCT,
            version=VERSION,
            bustype=BUS,
            phys=f"{NAME}/input0",
            max_effects=0,  # evdev would make it a device with force feedback, which no mouse is
        )
    except (OSError, evdev.UInputError) as e:
        raise OutputError(f"uinput: the kernel refuses to create the mouse: {' '.join(str(e).split())}") from None
