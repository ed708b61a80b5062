"""Read the reports of a mouse from the kernel's event devices."""

import contextlib
import os
import re
import select
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from spheremouse.errors import SourceError
from spheremouse.files.mouse_log import MouseReport

_INPUT = Path("/dev/input")
_SYS = Path("/sys/class/input")

# Linux, input-event-codes.h and input.h
EV_SYN, EV_REL = 0x00, 0x02
SYN_REPORT, SYN_DROPPED = 0x00, 0x03
REL_X, REL_Y = 0x00, 0x01
_POLL_S = 0.1  # between two checks whether to stop
_EVIOCSCLOCKID = 0x400445A0  # _IOW('E', 0xa0, int)


# ---- reports ----


class Assembler:
    """Joins the kernel's events to reports: all events between two SYN_REPORT are one."""

    def __init__(self) -> None:
        self._counts = {REL_X: 0, REL_Y: 0}
        self._skipping = False  # events from SYN_DROPPED to the next SYN_REPORT are incomplete

    def feed(self, stamp: float, kind: int, code: int, value: int) -> MouseReport | None:
        """Return the report that this event ends; None before its end, and for a report without motion."""
        if kind == EV_REL and code in self._counts:
            self._counts[code] += value
        if kind != EV_SYN or code not in (SYN_REPORT, SYN_DROPPED):
            return None
        report = MouseReport(stamp, self._counts[REL_X], self._counts[REL_Y])
        whole, self._skipping = not self._skipping and code == SYN_REPORT, code == SYN_DROPPED
        self._counts = {REL_X: 0, REL_Y: 0}
        return report if whole and (report.dx or report.dy) else None


# ---- devices ----


@dataclass(frozen=True, slots=True)
class Mouse:
    """A device of the kernel that moves a pointer."""

    node: Path
    name: str

    def __str__(self) -> str:
        return f"{self.node} ({self.name})"


def mice(sys_input: Path = _SYS, nodes: Path = _INPUT) -> list[Mouse]:
    """Return the devices that report relative X and Y, in the order of their numbers.

    Sysfs lists also devices whose node this account may not read. Entries that cannot be read are left out.
    """
    found = []
    for folder in sorted(sys_input.glob("event*"), key=lambda p: int(re.sub(r"\D", "", p.name) or 0)):
        with contextlib.suppress(OSError, ValueError, IndexError):
            bits = int((folder / "device/capabilities/rel").read_text().split()[-1], 16)
            if bits & 1 << REL_X and bits & 1 << REL_Y:
                found.append(Mouse(nodes / folder.name, (folder / "device/name").read_text().strip()))
    return found


def choose(wanted: str | None, found: list[Mouse]) -> Mouse:
    """Return the mouse of that path or part of a name; SourceError lists the connected mice."""
    named = wanted or ""
    fitting = [m for m in found if named.casefold() in m.name.casefold() or m.node == Path(os.path.realpath(named))]
    if len(fitting) == 1:
        return fitting[0]  # of /dev/input/by-id/... too, which are links
    if named.startswith("/") and Path(named).exists():
        return Mouse(Path(named), "not known")
    fit = f"{len(fitting) or 'no'} mice are connected" + (f" that fit --device {named}" if named else "")
    connected = "\n".join(f"  {mouse}" for mouse in fitting or found)
    raise SourceError(fit, f"plug one in, or choose by --device PATH or part of a name:\n{connected}".rstrip(":\n"))


class Listener:
    """Reads a mouse, as a context manager. Raises SourceError if it cannot be opened."""

    def __init__(self, mouse: Mouse, grab: bool = False) -> None:
        self._mouse, self._device = mouse, _open(mouse)
        try:
            _on_monotonic_clock(self._device, mouse)
            if grab:
                self._device.grab()
        except OSError as e:
            self._device.close()
            raise SourceError(f"{mouse}: cannot be taken from the desktop: {e.strerror or e}") from None
        except BaseException:
            self._device.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):  # it may be gone
            self._device.close()

    def listen(self, add: Callable[[MouseReport], None], ended: Callable[[], bool]) -> str | None:
        """Pass every report to `add` until `ended`; return None. If the mouse is unplugged before, return a message.

        The first and the last report are empty. They give the time of listening.
        """
        assembler, last = Assembler(), time.monotonic()
        add(MouseReport(last, 0, 0))
        while True:
            done = ended()
            until = time.monotonic()
            try:
                ready = select.select([self._device.fd], [], [], 0.0 if done else _POLL_S)[0]
                events = list(self._device.read()) if ready else []
            except BlockingIOError:
                events = []
            except OSError as e:
                add(MouseReport(last, 0, 0))
                return f"{self._mouse} is gone ({e.strerror or e})"
            for event in events:
                stamp = event.sec + 1e-6 * event.usec
                report = assembler.feed(stamp, event.type, event.code, event.value)
                if report is not None and report.stamp >= last:  # reports queued before have another clock
                    last = report.stamp
                    add(report)
            if done:
                add(MouseReport(max(last, until), 0, 0))
                return None


def _open(mouse: Mouse) -> Any:
    """Open a mouse's event device. Raise SourceError with the remedy."""
    try:
        import evdev
    except ImportError:
        raise SourceError("log-mouse needs Linux and the package evdev") from None
    try:
        return evdev.InputDevice(str(mouse.node))
    except PermissionError:
        raise SourceError(
            f"{mouse}: permission denied; add yourself to the group input (sudo usermod -aG input $USER) and log in "
            "again, or use sudo"
        ) from None
    except OSError as e:
        raise SourceError(f"{mouse}: cannot be opened: {e.strerror or e}; is it an event device?") from None


def _on_monotonic_clock(device: Any, mouse: Mouse) -> None:
    """Stamp events by the clock of the frames. The default is the wall clock, which can be set back."""
    import fcntl

    try:
        fcntl.ioctl(device.fd, _EVIOCSCLOCKID, struct.pack("i", time.CLOCK_MONOTONIC))
    except OSError as e:
        raise SourceError(f"{mouse}: the kernel does not stamp its events by the monotonic clock: {e}") from None
