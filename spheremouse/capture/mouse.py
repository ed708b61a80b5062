"""Read the reports of a mouse from the kernel's event devices."""

import contextlib
import os
import re
import select
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from spheremouse.errors import SourceError
from spheremouse.files.mouse_log import MouseReport

_INPUT = Path("/dev/input")
_SYS = Path("/sys/class/input")

# Linux, input-event-codes.h and input.h
EV_SYN, EV_REL = 0x00, 0x02
SYN_REPORT, SYN_DROPPED = 0x00, 0x03
REL_X, REL_Y, REL_WHEEL = 0x00, 0x01, 0x08
_POLL_S = 0.1  # between two checks whether to stop
_EVIOCSCLOCKID = 0x400445A0  # _IOW('E', 0xa0, int)


# ---- reports ----


@dataclass(slots=True)
class Assembler:
    """Joins the kernel's events to reports: all events between two SYN_REPORT are one."""

    _counts: dict[int, int] = field(default_factory=dict)
    _lost: bool = False
    _skipping: bool = False  # events from SYN_DROPPED to the next SYN_REPORT are incomplete

    def feed(self, stamp: float, kind: int, code: int, value: int) -> MouseReport | None:
        """Return the report that this event ends; None before its end, and for a report without motion."""
        if kind == EV_SYN and code == SYN_DROPPED:
            self._lost = self._skipping = True
            self._counts.clear()
            return None
        if kind == EV_REL and not self._skipping and code in (REL_X, REL_Y, REL_WHEEL):
            self._counts[code] = self._counts.get(code, 0) + value
        if kind != EV_SYN or code != SYN_REPORT:
            return None
        if self._skipping:
            self._skipping = False
            return None
        if not any(self._counts.values()):
            self._counts.clear()
            return None
        dx, dy, wheel = (self._counts.get(code, 0) for code in (REL_X, REL_Y, REL_WHEEL))
        report = MouseReport(stamp, dx, dy, wheel, self._lost)
        self._counts.clear()
        self._lost = False
        return report


# ---- devices ----


@dataclass(frozen=True, slots=True)
class Mouse:
    """A device of the kernel that moves a pointer."""

    node: Path
    name: str

    def __str__(self) -> str:
        return f"{self.node} ({self.name})"


def mice(sys_input: Path = _SYS, nodes: Path = _INPUT) -> list[Mouse]:
    """Return the devices with relative X and Y, whether you may read them or not."""
    found = []
    for folder in sorted(sys_input.glob("event*"), key=lambda p: int(re.sub(r"\D", "", p.name) or 0)):
        with contextlib.suppress(OSError, ValueError):
            bits = int((folder / "device/capabilities/rel").read_text().split()[-1], 16)
            if bits & 1 << REL_X and bits & 1 << REL_Y:
                found.append(Mouse(nodes / folder.name, (folder / "device/name").read_text().strip()))
    return found


def choose(wanted: str | None, found: list[Mouse]) -> Mouse:
    """Return the mouse of that path or part of a name; SourceError lists the connected mice."""
    if wanted is not None and wanted.startswith("/"):
        path = Path(os.path.realpath(wanted))  # /dev/input/by-id/... are links
        mouse = next((m for m in found if m.node in (path, Path(wanted))), None)
        if mouse is None and not Path(wanted).exists():
            connected = f" Connected are:\n{_listed(found)}" if found else ""
            raise SourceError(f"{wanted}: no such device; is it plugged in?{connected}")
        return mouse or Mouse(Path(wanted), "not known")
    if not found:
        raise SourceError("no mouse or trackball is connected; plug it in, or name it with --device /dev/input/eventN")
    fitting = found if wanted is None else [m for m in found if wanted.casefold() in m.name.casefold()]
    if len(fitting) == 1:
        return fitting[0]
    if not fitting:
        raise SourceError(f"--device {wanted}: no mouse has that in its name; connected are:\n{_listed(found)}")
    what = f"{len(found)} mice are connected" if wanted is None else f"--device {wanted}: fits {len(fitting)} mice"
    raise SourceError(f"{what}; choose one with --device PATH or part of its name:\n{_listed(fitting)}")


def _listed(found: list[Mouse]) -> str:
    return "\n".join(f"  {mouse}" for mouse in found)


class Listener:
    """Reads a mouse, as a context manager. Raises SourceError if it cannot be opened."""

    def __init__(self, mouse: Mouse, grab: bool = False) -> None:
        self._mouse, self._device = mouse, _opened(mouse)
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


def _opened(mouse: Mouse) -> Any:
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
