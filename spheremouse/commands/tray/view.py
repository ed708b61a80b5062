"""What the tray shows: a status in; icon, tooltip, menu and notices out. Pure: desktop and threads are in tray_live.

Each state has a colour, and an outline and a sign as well: whoever sees no colours tells them apart all the same.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from PIL import Image, ImageDraw

from spheremouse.session.control.status import STATES as DAEMON_STATES

NO_DAEMON = "no-daemon"
STATES = (*DAEMON_STATES, NO_DAEMON)

_LONGEST_TOOLTIP = 127  # characters; Windows takes no more
_LONGEST_LINE = 90  # characters of a line in the menu
_FINE = 4  # drawn so many times larger, then reduced: smooth edges
_INK = (24, 26, 28, 255)
_PAPER = (255, 255, 255, 255)


# ---- what is known of the daemon ----


@dataclass(frozen=True, slots=True)
class View:
    """The parts of a status that the tray needs."""

    state: str
    reason: str = ""
    fps: float | None = None
    paused: bool = False
    recording: str | None = None  # folder of the recording that runs
    page: str | None = None  # URL of the live page

    @property
    def there(self) -> bool:
        """Whether a daemon answers."""
        return self.state != NO_DAEMON


def view(status: dict[str, Any]) -> View:
    """Of a status as docs/control.md has it. What is missing or of another kind is left out."""
    state = _text(status.get("state")) or "unknown"
    fps, paused = status.get("fps"), status.get("paused")
    recording, page = status.get("recording"), _text(status.get("page"))
    return View(
        state="unknown" if state == NO_DAEMON else state,
        reason=_text(status.get("reason")),
        fps=float(fps) if isinstance(fps, int | float) and not isinstance(fps, bool) and 0 <= fps < 1e6 else None,
        paused=paused if isinstance(paused, bool) else state == "paused",
        recording=_text(recording.get("folder")) or "?" if isinstance(recording, dict) else None,
        page=page if re.match(r"https?://[\w\[]", page) else None,  # nothing else is opened on a status' word
    )


def no_daemon(reason: str) -> View:
    """Nobody answers; without the details in brackets, which fill the menu."""
    return View(NO_DAEMON, re.sub(r"\s*\([^()]*\)", "", _text(reason)))


def _text(value: Any) -> str:
    """One line that steers nothing; empty where it is no text."""
    if not isinstance(value, str):
        return ""
    return "".join(c if c.isprintable() else " " for c in value).strip()


# ---- words ----


def headline(v: View) -> str:
    """State and reason, the first line of the menu."""
    words = v.state.replace("-", " ")
    if not v.there:
        return _cut(v.reason or words, _LONGEST_LINE)
    return _cut(f"{words}: {v.reason}" if v.reason else words, _LONGEST_LINE)


def tooltip(v: View) -> str:
    """Text shown where the mouse rests on the icon; short enough for Windows."""
    figures = [] if v.fps is None else [f"{v.fps:.0f} frames/s"]
    if v.recording is not None:
        figures.append("recording")
    tail = "\n" + ", ".join(figures) if v.there and figures else ""
    return _cut(f"spheremouse: {headline(v)}", _LONGEST_TOOLTIP - len(tail)) + tail


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


# ---- the menu ----


@dataclass(frozen=True, slots=True)
class Item:
    """A line of the menu; one without action is grey."""

    text: str
    action: str | None = None
    default: bool = False  # what a click on the icon does where a click opens no menu


SEPARATOR = Item("-")


def menu(v: View, note: str = "") -> tuple[Item, ...]:
    """The menu; `note` is what became of what was asked for last."""

    def asks(action: str) -> str | None:
        return action if v.there else None

    items = [Item(headline(v))]
    if _text(note):
        items.append(Item(_cut(_text(note), _LONGEST_LINE)))
    items += [SEPARATOR, Item("Re-initialise camera pose", asks("reinit"), default=True)]
    items.append(Item("Resume", asks("resume")) if v.paused else Item("Pause", asks("pause")))
    if v.recording is None:
        items.append(Item("Record a minute for a bug report", asks("record")))
    else:
        items.append(Item("End the recording", asks("end-record")))
    if v.page is not None:
        items.append(Item("Open live page", "page"))
    return (*items, SEPARATOR, Item("Quit tray", "quit"))


# ---- notices ----


@dataclass(slots=True)
class Notices:
    """Troubles worth a notice: those that last, and each not again for some minutes. Times in s."""

    after: dict[str, float] = field(
        default_factory=lambda: {"no-camera": 5.0, "lost": 15.0, "failed-output": 5.0, NO_DAEMON: 15.0}
    )  # hands and bystanders lose the ball for moments, an upgrade restarts the daemon
    quiet: float = 300.0
    _state: str = ""
    _since: float = 0.0
    _told: dict[str, float] = field(default_factory=dict)
    _open: bool = False  # a trouble was told and its end was not

    def see(self, v: View, now: float) -> str | None:
        """A text where the user is to be told something now."""
        if v.state != self._state:
            self._state, self._since = v.state, now
        if v.state == "tracking":
            if not self._open or now - self._since < 2.0:
                return None
            self._open = False
            return "tracking again"
        if v.state not in self.after or now - self._since < self.after[v.state]:
            return None
        told = self._told.get(v.state)
        if told is not None and (told >= self._since or now - told < self.quiet):
            return None
        self._told[v.state], self._open = now, True
        return headline(v)


# ---- icons ----


@dataclass(frozen=True, slots=True)
class Look:
    """Looks of a state: colour (RGB), outline and sign."""

    colour: tuple[int, int, int]
    outline: str
    sign: str


LOOKS = {
    "starting": Look((86, 180, 233), "disc", "dots"),
    "searching-targets": Look((240, 228, 66), "disc", "target"),
    "tracking": Look((0, 170, 90), "disc", "tick"),
    "lost": Look((240, 150, 0), "diamond", "question"),
    "paused": Look((150, 100, 200), "square", "bars"),
    "no-camera": Look((226, 60, 50), "triangle", "exclamation"),
    "failed-output": Look((226, 60, 50), "octagon", "cross"),
    NO_DAEMON: Look((140, 140, 140), "ring", "dash"),
}
_UNKNOWN = Look((140, 140, 140), "square", "dots")  # a state of a later version


def icon(state: str, size: int = 64) -> Image.Image:
    """The icon of a state, RGBA, `size` px square."""
    look = LOOKS.get(state, _UNKNOWN)
    pen = _Pen(size)
    pen.outline(look.outline, (*look.colour, 255))
    _SIGNS[look.sign](pen)
    return pen.picture.resize((size, size), Image.Resampling.LANCZOS)


class _Pen:
    """Draws in units of the icon: x right, y down, the icon from -1 to 1."""

    def __init__(self, size: int) -> None:
        self.half = size * _FINE / 2.0
        self.picture = Image.new("RGBA", (size * _FINE, size * _FINE), (0, 0, 0, 0))
        self._draw = ImageDraw.Draw(self.picture)

    def outline(self, name: str, colour: tuple[int, int, int, int]) -> None:
        if name in ("disc", "ring"):
            self.disc(0.0, 0.0, 0.97, _INK)
            self.disc(0.0, 0.0, 0.88, colour)
            if name == "ring":
                self.disc(0.0, 0.0, 0.56, _PAPER)
        else:
            corners = _CORNERS[name]
            self.polygon(corners, _INK)
            self.polygon(_inner(corners, 0.10), colour)

    def disc(self, x: float, y: float, radius: float, colour: tuple[int, ...]) -> None:
        self._draw.ellipse([*self._at(x - radius, y - radius), *self._at(x + radius, y + radius)], fill=colour)

    def polygon(self, corners: list[tuple[float, float]], colour: tuple[int, ...]) -> None:
        self._draw.polygon([self._at(x, y) for x, y in corners], fill=colour)

    def line(self, corners: list[tuple[float, float]], width: float, colour: tuple[int, ...] = _PAPER) -> None:
        points = [self._at(x, y) for x, y in corners]
        self._draw.line(points, fill=colour, width=round(width * self.half), joint="curve")
        for x, y in (corners[0], corners[-1]):
            self.disc(x, y, width / 2.0, colour)

    def _at(self, x: float, y: float) -> tuple[float, float]:
        return (1.0 + x) * self.half, (1.0 + y) * self.half


def _ring_of(n: int, radius: float, first: float) -> list[tuple[float, float]]:
    turns = [first + 2.0 * math.pi * k / n for k in range(n)]
    return [(radius * math.cos(a), radius * math.sin(a)) for a in turns]


def _inner(corners: list[tuple[float, float]], border: float) -> list[tuple[float, float]]:
    """A convex polygon drawn in: towards its middle by `border` at its nearest side."""
    n = len(corners)
    cx, cy = sum(x for x, _ in corners) / n, sum(y for _, y in corners) / n
    (ax, ay), (bx, by) = corners[-1], corners[0]
    distance = abs((bx - ax) * (ay - cy) - (ax - cx) * (by - ay)) / math.hypot(bx - ax, by - ay)
    k = 1.0 - border / distance
    return [(cx + k * (x - cx), cy + k * (y - cy)) for x, y in corners]


_CORNERS = {
    "square": [(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
    "diamond": _ring_of(4, 1.0, 0.0),
    "octagon": _ring_of(8, 1.0, math.pi / 8.0),
    "triangle": [(0.0, -0.97), (1.0, 0.9), (-1.0, 0.9)],
}


def _dots(pen: _Pen) -> None:
    for x in (-0.52, 0.0, 0.52):
        pen.disc(x, 0.0, 0.21, _INK)


def _target(pen: _Pen) -> None:
    for radius, colour in ((0.62, _INK), (0.42, _PAPER), (0.22, _INK)):
        pen.disc(0.0, 0.0, radius, colour)


def _tick(pen: _Pen) -> None:
    pen.line([(-0.45, 0.05), (-0.12, 0.38), (0.48, -0.36)], 0.26)


def _question(pen: _Pen) -> None:
    bow = [(0.26 * math.cos(a), -0.24 + 0.26 * math.sin(a)) for a in (math.pi * (1.0 + k / 12.0) for k in range(18))]
    pen.line([*bow, (0.0, 0.05), (0.0, 0.16)], 0.19, _INK)
    pen.disc(0.0, 0.5, 0.13, _INK)


def _bars(pen: _Pen) -> None:
    for x in (-0.32, 0.32):
        pen.polygon([(x - 0.17, -0.52), (x + 0.17, -0.52), (x + 0.17, 0.52), (x - 0.17, 0.52)], _PAPER)


def _exclamation(pen: _Pen) -> None:
    pen.line([(0.0, -0.24), (0.0, 0.26)], 0.24)
    pen.disc(0.0, 0.62, 0.14, _PAPER)


def _cross(pen: _Pen) -> None:
    for y in (-0.38, 0.38):
        pen.line([(-0.38, y), (0.38, -y)], 0.26)


def _dash(pen: _Pen) -> None:
    pen.line([(-0.28, 0.0), (0.28, 0.0)], 0.24, _INK)


_SIGNS: dict[str, Callable[[_Pen], None]] = {
    "dots": _dots,
    "target": _target,
    "tick": _tick,
    "question": _question,
    "bars": _bars,
    "exclamation": _exclamation,
    "cross": _cross,
    "dash": _dash,
}
