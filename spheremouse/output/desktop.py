"""`desktop[:third=none|wheel]`: move the pointer of this desktop by pynput, on X11, Windows and macOS.

Use it if there is neither uinput nor a board. One count is one pixel, and the pointer stops at the edges of the screen.
Programs that read the mouse and not the pointer receive nothing. Wayland lets no program move its pointer. With
`third=wheel` the ball's spin scrolls, 120 counts to a notch.
"""

import os
import sys
from functools import partial
from typing import Any

from spheremouse.errors import OutputError, reason_of
from spheremouse.finding import Finding, absent, ok
from spheremouse.output import Output, Report
from spheremouse.output.third_axis import parse_third, whole_notches

check = partial(parse_third, "desktop")

_PLACE = "desktop: "  # begins each message
_MAX_STEP_PX = 10_000  # X11 takes positions of 16 bits, and no screen is wider


class Desktop(Output):
    """The desktop's pointer."""

    paced = True

    def __init__(self, mouse: Any, third: str) -> None:
        """Take a `pynput.mouse.Controller`."""
        self._mouse: Any = mouse
        self._third, self._notch = third, 0

    def send(self, report: Report) -> None:
        """Move the pointer, and scroll if whole notches are due. Raises OutputError if the desktop has ended."""
        x, y, z = report.counts
        x, y = _clip(x), _clip(y)
        notches, left = whole_notches(self._notch + (z if self._third == "wheel" else 0))
        try:
            if x or y:
                self._mouse.move(x, y)
            if notches:
                self._mouse.scroll(0, notches)
        except Exception as e:  # the system's binding may raise anything if the desktop ends
            raise OutputError(f"desktop: the pointer cannot be moved any more: {reason_of(e)}") from None
        self._notch = left

    def close(self) -> None:
        """Disconnect from the display."""
        self._mouse = None  # pynput disconnects from the display when the last reference is deleted


def open(argument: str) -> Desktop:
    third = check(argument)
    return Desktop(_connect(), third)


def probe(argument: str) -> list[Finding]:
    try:
        with open(argument):
            return [ok("desktop", "its pointer can be moved; games that read the mouse itself see nothing of it")]
    except OutputError as e:
        return [absent("desktop", e.problem.removeprefix(_PLACE), e.hint)]


def _connect() -> Any:
    if sys.platform not in ("win32", "darwin"):
        if os.environ.get("WAYLAND_DISPLAY") or os.environ.get("XDG_SESSION_TYPE") == "wayland":
            raise _refusal("on Wayland no program may move the pointer", "use uinput, or log in to an X11 session")
        if not os.environ.get("DISPLAY"):
            raise _refusal("no desktop here (DISPLAY is not set)", "start it within the X11 session, or use uinput")
    try:
        from pynput.mouse import Controller

        mouse = Controller()
        mouse.position  # noqa: B018  the first call that needs an answer of the display
    except Exception as e:
        raise _system_refusal(reason_of(e)) from None
    return mouse


def _refusal(problem: str, hint: str) -> OutputError:
    return OutputError(f"{_PLACE}{problem}", hint)


def _system_refusal(reason: str) -> OutputError:
    if sys.platform == "darwin":
        return _refusal(f"macOS refuses ({reason})", "allow it in System Settings, Privacy & Security, Accessibility")
    if sys.platform == "win32":
        return _refusal(f"Windows refuses ({reason})", "start it in the session of the user at the screen")
    problem = f"the X11 display {os.environ.get('DISPLAY')} does not answer or refuses"
    return _refusal(problem, "check DISPLAY and XAUTHORITY, or use uinput")


def _clip(pixels: int) -> int:
    return max(-_MAX_STEP_PX, min(_MAX_STEP_PX, pixels))
