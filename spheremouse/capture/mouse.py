"""The log of a mouse: read from the kernel's event device, written to a file as it comes, and read back.

A file is text, a line per report under the header `t,dx,dy,wheel,lost`: the kernel's time in s, counts, notches, and 1
where reports before this one are known to be lost. Lines that begin with # are for people. The first and the last line
are empty reports: they say from when to when the mouse was listened to, since a mouse at rest says nothing.
"""

import contextlib
import csv
import math
import os
import re
import select
import struct
import time
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import TextIOWrapper
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from spheremouse.errors import DatasetError, SourceError
from spheremouse.files.atomic import NewFile
from spheremouse.files.bounded import lines, opened

if TYPE_CHECKING:  # a mouse is listened to at once, and not when the numerics have been loaded
    from spheremouse.simulate.ball.trackball import MouseLog

COLUMNS = ("t", "dx", "dy", "wheel", "lost")
MOST = 5_000_000  # reports of a log: 80 minutes at 1000 Hz, 150 MB
_MOST_BYTES = 100 * MOST
_MOST_SECONDS = 6 * 3600.0
_INPUT = Path("/dev/input")
_SYS = Path("/sys/class/input")
_MOST_COUNTS = 2**31  # an event's value is a signed 32-bit integer

# Linux, input-event-codes.h and input.h
EV_SYN, EV_REL = 0x00, 0x02
SYN_REPORT, SYN_DROPPED = 0x00, 0x03
REL_X, REL_Y, REL_WHEEL = 0x00, 0x01, 0x08
_WAIT = 0.1  # s; as late is it heard that it shall end
_EVIOCSCLOCKID = 0x400445A0  # _IOW('E', 0xa0, int)


# ---- reports ----


@dataclass(frozen=True, slots=True)
class MouseReport:
    """What the mouse said at once."""

    stamp: float  # s, time.monotonic()
    dx: int  # counts
    dy: int  # counts
    wheel: int = 0  # notches
    lost: bool = False  # the kernel dropped reports before this one

    def line(self) -> str:
        """As it stands in the file."""
        return f"{self.stamp:.6f},{self.dx},{self.dy},{self.wheel},{int(self.lost)}\n"


@dataclass(slots=True)
class Assembler:
    """Puts the kernel's events together to reports: those between two SYN_REPORT are one."""

    _counts: dict[int, int] = field(default_factory=dict)
    _lost: bool = False
    _skipping: bool = False  # after SYN_DROPPED what comes up to the next SYN_REPORT is a rest

    def feed(self, stamp: float, kind: int, code: int, value: int) -> MouseReport | None:
        """The report that this event ends; None while it goes on, or where it says nothing of motion."""
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


# ---- the file ----


class LogFile:
    """Writes a log: line by line to a hidden file beside it, which takes its name at the end, whatever ends it."""

    def __init__(self, path: Path, about: str, force: bool = False) -> None:
        """`about` is a line for people. Raises DatasetError where `path` is there already, or cannot be written."""
        self.path, self._about, self._force = path, about, force
        self.reports = 0
        self.counts = [0, 0]  # to and fro
        self.first: float | None = None  # s
        self.last = 0.0  # s

    def __enter__(self) -> Self:
        self._refuse()
        try:
            self._new = NewFile(self.path)
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written: {e.strerror or e}") from None
        self._file = TextIOWrapper(self._new.file, encoding="utf-8", newline="\n")
        about = " ".join(self._about.split())
        self._file.write(f"# spheremouse log-mouse; {about}; t in s of the monotonic clock, dx and dy in counts\n")
        self._file.write(",".join(COLUMNS) + "\n")
        return self

    def add(self, report: MouseReport) -> None:
        """One more line; DatasetError where the disk takes no more."""
        try:
            self._file.write(report.line())
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written further: {e.strerror or e}") from None
        self.first = report.stamp if self.first is None else self.first
        self.last = report.stamp
        if report.dx or report.dy or report.wheel:
            self.reports += 1
            self.counts[0] += abs(report.dx)
            self.counts[1] += abs(report.dy)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.flush()
            self._refuse()  # once more: somebody may have come first
            self._new.finish()
        except OSError as e:
            raise DatasetError(f"{self.path}: cannot be written: {e.strerror or e}") from None
        finally:
            self._new.discard()

    def _refuse(self) -> None:
        if self.path.is_dir():
            raise DatasetError(f"{self.path}: is a directory; name a file in it")
        if self.path.exists() and not self._force:
            raise DatasetError(f"{self.path}: exists already; choose another name, or replace it with --force")


def write_log(path: Path, log: "MouseLog", about: str = "simulated") -> None:
    """Write a whole log, in place of what was there."""
    with LogFile(path, about, force=True) as file:
        for k in range(len(log)):
            dx, dy = (round(c) for c in log.counts[k].tolist())
            file.add(MouseReport(float(log.stamp[k]), dx, dy, round(float(log.wheel[k])), bool(log.lost[k])))


def read_log(path: Path) -> "MouseLog":
    """Read a log; DatasetError says file and line. Columns wheel and lost may be missing, # lines are passed over."""
    import numpy as np

    from spheremouse.simulate.ball.trackball import MouseLog

    rows, first, last, count = array("d"), 0.0, -math.inf, 0
    places: list[int] = []
    width = 0
    try:
        with opened(path) as file:
            if os.fstat(file.fileno()).st_size > _MOST_BYTES:
                raise DatasetError(f"{path}: larger than {_MOST_BYTES} bytes; cut the log to what was recorded")
            reader = csv.reader(_bare(lines(file)))
            for number, cells in _numbered(reader):
                if not places:
                    width, places = len(cells), _places(path, number, cells)
                    continue
                if len(cells) != width:
                    raise DatasetError(f"{path}:{number}: {len(cells)} cells under {width} columns")
                row = [_number(path, number, cells[k], COLUMNS[i]) for i, k in enumerate(places) if k >= 0]
                if row[0] < last:
                    raise DatasetError(f"{path}:{number}: t goes back, from {last} to {row[0]} s")
                first = row[0] if count == 0 else first
                if row[0] - first > _MOST_SECONDS:
                    raise DatasetError(
                        f"{path}:{number}: t is {row[0] - first:.0f} s after the first; {_MOST_SECONDS:g} s at most: "
                        "cut the log to what was recorded"
                    )
                rows.extend(row)
                last, count = row[0], count + 1
                if count > MOST:
                    raise DatasetError(f"{path}:{number}: more than {MOST} reports; cut the log to what was recorded")
    except FileNotFoundError:
        raise DatasetError(f"{path}: no such file; make one with `spheremouse log-mouse`") from None
    except IsADirectoryError:
        raise DatasetError(f"{path}: is a directory; name the log in it") from None
    except UnicodeDecodeError:
        raise DatasetError(f"{path}:1: not text; name a log that `spheremouse log-mouse` wrote") from None
    except (OSError, csv.Error, ValueError) as e:
        raise DatasetError(
            f"{path}: cannot be read: {' '.join((getattr(e, 'strerror', None) or str(e)).split())}"
        ) from None
    if not places:
        raise DatasetError(f"{path}:1: empty; the first line is {','.join(COLUMNS)}")
    table = np.zeros((count, len(COLUMNS)))
    there = [i for i, k in enumerate(places) if k >= 0]
    table[:, there] = np.frombuffer(rows).reshape(count, len(there)) if count else 0.0
    return MouseLog(table[:, 0].copy(), table[:, 1:3].copy(), table[:, 3].copy(), table[:, 4] != 0.0)


def _bare(given: Iterator[str]) -> Iterator[str]:
    """Lines, those for people left empty."""
    for line in given:
        yield "\n" if line.startswith("#") else line


def _numbered(reader: Any) -> Iterator[tuple[int, list[str]]]:
    for cells in reader:
        if cells:
            yield reader.line_num, cells


def _places(path: Path, number: int, header: list[str]) -> list[int]:
    names = [name.strip() for name in header]
    missing = [c for c in COLUMNS[:3] if c not in names]
    if missing:
        raise DatasetError(
            f"{path}:{number}: no column {', '.join(missing)}; a log of `spheremouse log-mouse` begins "
            f"{','.join(COLUMNS)}"
        )
    return [names.index(c) if c in names else -1 for c in COLUMNS]


def _number(path: Path, number: int, text: str, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (column != "t" and abs(value) > _MOST_COUNTS):
        raise DatasetError(f"{path}:{number}: {column}: {text[:40]!r} is not a number that can be")
    return value


# ---- devices ----


@dataclass(frozen=True, slots=True)
class Mouse:
    """A device of the kernel that moves a pointer."""

    node: Path
    name: str

    def __str__(self) -> str:
        return f"{self.node} ({self.name})"


def mice(sys_input: Path = _SYS, nodes: Path = _INPUT) -> list[Mouse]:
    """Those with relative X and Y, whether they may be read or not."""
    found = []
    for folder in sorted(sys_input.glob("event*"), key=lambda p: int(re.sub(r"\D", "", p.name) or 0)):
        with contextlib.suppress(OSError, ValueError):
            bits = int((folder / "device/capabilities/rel").read_text().split()[-1], 16)
            if bits & 1 << REL_X and bits & 1 << REL_Y:
                found.append(Mouse(nodes / folder.name, (folder / "device/name").read_text().strip()))
    return found


def choose(wanted: str | None, found: list[Mouse]) -> Mouse:
    """The mouse of that path or part of a name; SourceError lists what there is."""
    listed = "\n".join(f"  {mouse}" for mouse in found)
    if wanted is not None and wanted.startswith("/"):
        path = Path(os.path.realpath(wanted))  # /dev/input/by-id/... are links
        for mouse in found:
            if path == mouse.node or Path(wanted) == mouse.node:
                return mouse
        if not Path(wanted).exists():
            raise SourceError(
                f"{wanted}: no such device; is it plugged in?" + (f" There are:\n{listed}" if found else "")
            )
        return Mouse(Path(wanted), "not known")
    if not found:
        raise SourceError("no mouse or trackball is there; plug it in, or name it with --device /dev/input/eventN")
    if wanted is not None:
        fitting = [m for m in found if wanted.casefold() in m.name.casefold()]
        if not fitting:
            raise SourceError(f"--device {wanted}: no mouse has that in its name; there are:\n{listed}")
        if len(fitting) > 1:
            listed = "\n".join(f"  {mouse}" for mouse in fitting)
            raise SourceError(f"--device {wanted}: fits {len(fitting)} mice; name one by its path:\n{listed}")
        return fitting[0]
    if len(found) > 1:
        raise SourceError(f"{len(found)} mice are there; say which with --device PATH or part of its name:\n{listed}")
    return found[0]


class Listener:
    """A mouse that is listened to; a context manager. Raises SourceError where it cannot be."""

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):  # it may be gone
            self._device.close()

    def listen(self, add: Callable[[MouseReport], None], ended: Callable[[], bool]) -> str | None:
        """Hand over every report until `ended`; what ended it otherwise, in words.

        Begins and ends with an empty report, so that the log says from when to when it knows that nothing moved.
        """
        assembler, last = Assembler(), time.monotonic()
        add(MouseReport(last, 0, 0))
        while True:
            done = ended()
            until = time.monotonic()
            try:
                ready = select.select([self._device.fd], [], [], 0.0 if done else _WAIT)[0]
                events = list(self._device.read()) if ready else []
            except BlockingIOError:
                events = []
            except OSError as e:
                add(MouseReport(last, 0, 0))
                return f"{self._mouse} is gone ({e.strerror or e})"
            for event in events:
                stamp = event.sec + 1e-6 * event.usec
                report = assembler.feed(stamp, event.type, event.code, event.value)
                if report is not None and report.stamp >= last:  # what lay in the queue before has another clock
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
            f"{mouse}: may not be read; add yourself to the group input (sudo usermod -aG input $USER) and log in "
            "again, or use sudo"
        ) from None
    except OSError as e:
        raise SourceError(f"{mouse}: cannot be opened: {e.strerror or e}; is it an event device?") from None


def _on_monotonic_clock(device: Any, mouse: Mouse) -> None:
    """The clock of the frames' stamps, in place of the wall clock's, which may be set back."""
    import fcntl

    try:
        fcntl.ioctl(device.fd, _EVIOCSCLOCKID, struct.pack("i", time.CLOCK_MONOTONIC))
    except OSError as e:
        raise SourceError(f"{mouse}: the kernel does not stamp its events by the monotonic clock: {e}") from None
