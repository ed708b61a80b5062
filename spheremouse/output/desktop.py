"""`desktop[:third=none|wheel]`: moves the pointer of the desktop that runs here, through pynput: X11, Windows, macOS.

For where there is neither uinput nor a board. The pointer is put where it is plus the counts, one pixel to a count: it
stops at the screen's edges, and programs that read the mouse itself and not the pointer see nothing of it. Wayland lets
no program move its pointer. With `third=wheel` the ball's spin scrolls, 120 counts to a notch.
"""

import os
import sys
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.output import Report
from spheremouse.output.third_axis import NONE, checked

NOTCH = 120  # counts, as of the other outputs' fine wheels
_MOST = 10_000  # px: X11 takes positions of 16 bits, and no screen is wider than that


class Desktop:
    """The desktop's pointer."""

    def __init__(self, mouse: Any, third: str) -> None:
        """`mouse` is pynput's controller."""
        self._mouse: Any = mouse
        self._third, self._notch = third, 0

    def send(self, report: Report) -> None:
        """Move the pointer, and scroll if whole notches are due."""
        x, y, notches, left = self._made(report)
        try:
            if x or y:
                self._mouse.move(x, y)
            if notches:
                self._mouse.scroll(0, notches)
        except Exception as e:  # whatever the system's binding raises when the desktop goes away
            raise OutputError(f"desktop: the pointer cannot be moved any more: {_line(e)}") from None
        self._notch = left

    def describe(self, report: Report) -> str:
        """What `send` does, as in `pointer +3 -2 scroll +1`."""
        x, y, notches, _ = self._made(report)
        parts = [f"pointer {x:+d} {y:+d}"] if x or y else []
        return " ".join(parts + ([f"scroll {notches:+d}"] if notches else []))

    def _made(self, report: Report) -> tuple[int, int, int, int]:
        """Pixels right and down, whole notches, and counts of the wheel left over."""
        x, y, z = report.counts
        turned = self._notch + (z if self._third == "wheel" else 0)
        notches = abs(turned) // NOTCH * (1 if turned > 0 else -1)
        return max(-_MOST, min(_MOST, x)), max(-_MOST, min(_MOST, y)), notches, turned - notches * NOTCH

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._mouse = None  # pynput leaves the display when nobody holds it


def open(argument: str) -> Desktop:
    """Find the desktop."""
    third = check(argument)
    return Desktop(_find(), third)


def check(argument: str) -> str:
    """The way of the third axis; OutputError where the argument is of no use."""
    given = options(argument, {"third": str}, f"desktop:{argument}", OutputError)
    return checked("desktop", str(given.get("third", NONE)))


def _find() -> Any:
    if sys.platform not in ("win32", "darwin"):
        if os.environ.get("WAYLAND_DISPLAY") or os.environ.get("XDG_SESSION_TYPE") == "wayland":
            raise OutputError(
                "desktop: on Wayland no program may move the pointer; use uinput, or log in to an X11 session"
            )
        if not os.environ.get("DISPLAY"):
            raise OutputError(
                "desktop: no desktop here (DISPLAY is not set); start it within the X11 session, or use uinput"
            )
    try:
        from pynput.mouse import Controller

        mouse = Controller()
        mouse.position  # noqa: B018  the first that needs an answer
    except Exception as e:
        raise OutputError(f"desktop: {_refusal(e)}") from None
    return mouse


def _refusal(error: Exception) -> str:
    if sys.platform == "darwin":
        return f"macOS refuses ({_line(error)}); allow it in System Settings, Privacy & Security, Accessibility"
    if sys.platform == "win32":
        return f"Windows refuses ({_line(error)}); start it in the session of whoever sits at the screen"
    display = os.environ.get("DISPLAY")
    return f"the X11 display {display} does not answer or refuses; check DISPLAY and XAUTHORITY, or use uinput"


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
