"""Turn the daemon's status into icon, tooltip, menu and notices of the tray. No desktop and no thread is needed.

Each state has a colour, an outline and a sign, so colour-blind people can see the state too.
"""

import math
import re
from dataclasses import dataclass, field

from PIL import Image, ImageDraw

from spheremouse.session.control.status import STATES as DAEMON_STATES
from spheremouse.session.control.status import StatusReport

NO_DAEMON = "no-daemon"
STATES = (*DAEMON_STATES, NO_DAEMON)

_MAX_TOOLTIP = 127  # characters, limit of Windows
_MAX_MENU_LINE = 90  # characters
_OVERSAMPLING = 4  # for smooth edges
_INK = (24, 26, 28, 255)
_PAPER = (255, 255, 255, 255)


# ---- status ----


@dataclass(frozen=True, slots=True)
class View:
    """The parts of a status that the tray needs."""

    state: str
    reason: str = ""
    fps: float | None = None  # frames/s
    paused: bool = False
    recording: str | None = None  # folder of the recording that runs

    @property
    def connected(self) -> bool:
        """True if a daemon answers."""
        return self.state != NO_DAEMON


def view(status: StatusReport) -> View:
    """Convert a status."""
    state, recording = _line(status.state or "") or "unknown", status.recording
    return View(
        state=state,
        reason=_line(status.reason or ""),
        fps=status.fps,
        paused=state == "paused" if status.paused is None else status.paused,
        recording=None if recording is None else _line(recording.folder or "") or "?",
    )


def no_daemon(reason: str) -> View:
    """Return the view without a daemon. Details in brackets are removed, since they fill the menu."""
    return View(NO_DAEMON, re.sub(r"\s*\([^()]*\)", "", _line(reason)))


def _line(text: str) -> str:
    """Return printable text in one line."""
    return "".join(c if c.isprintable() else " " for c in text).strip()


# ---- words ----


def headline(v: View) -> str:
    """Return state and reason, the first line of the menu."""
    words = v.state.replace("-", " ")
    if not v.connected:
        return _cut(v.reason or words, _MAX_MENU_LINE)
    return _cut(f"{words}: {v.reason}" if v.reason else words, _MAX_MENU_LINE)


def tooltip(v: View) -> str:
    """Return the text that is shown while the mouse is over the icon."""
    figures = [] if v.fps is None else [f"{v.fps:.0f} frames/s"]
    if v.recording is not None:
        figures.append("recording")
    tail = "\n" + ", ".join(figures) if v.connected and figures else ""
    return _cut(f"spheremouse: {headline(v)}", _MAX_TOOLTIP - len(tail)) + tail


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


# ---- the menu ----


@dataclass(frozen=True, slots=True)
class Item:
    """A line of the menu. Without an action it is grey."""

    text: str
    action: str | None = None
    default: bool = False  # action of a click on the icon if it does not open the menu


SEPARATOR = Item("-")


def menu(v: View, note: str = "") -> tuple[Item, ...]:
    """Return the menu; `note` is the result of the last action."""

    def if_connected(action: str) -> str | None:
        return action if v.connected else None

    items = [Item(headline(v))]
    if _line(note):
        items.append(Item(_cut(_line(note), _MAX_MENU_LINE)))
    items += [SEPARATOR, Item("Re-initialise camera pose", if_connected("reinit"), default=True)]
    items.append(Item("Resume", if_connected("resume")) if v.paused else Item("Pause", if_connected("pause")))
    if v.recording is None:
        items.append(Item("Record a minute for a bug report", if_connected("record")))
    else:
        items.append(Item("End the recording", if_connected("end-record")))
    return (*items, Item("Open live page", "page"), SEPARATOR, Item("Quit tray", "quit"))


# ---- notices ----


@dataclass(slots=True)
class Notices:
    """Decides when to show a notice: for problems that last, and for each at most every five minutes. Times in s."""

    after: dict[str, float] = field(
        default_factory=lambda: {"no-camera": 5.0, "lost": 15.0, "failed-output": 5.0, NO_DAEMON: 15.0}
    )  # hands and bystanders hide the ball for moments, and an upgrade restarts the daemon
    min_interval: float = 300.0  # s
    _state: str = ""
    _since: float = 0.0
    _shown: dict[str, float] = field(default_factory=dict)  # time of the last notice of each state
    _unresolved: bool = False  # a problem was shown, and its end was not

    def update(self, v: View, now: float) -> str | None:
        """Return the text of the notice that is due at `now` (s), or None."""
        if v.state != self._state:
            self._state, self._since = v.state, now
        if v.state == "tracking":
            if not self._unresolved or now - self._since < 2.0:
                return None
            self._unresolved = False
            return "tracking again"
        if v.state not in self.after or now - self._since < self.after[v.state]:
            return None
        last = self._shown.get(v.state)
        if last is not None and (last >= self._since or now - last < self.min_interval):
            return None
        self._shown[v.state], self._unresolved = now, True
        return headline(v)


# ---- icons ----


@dataclass(frozen=True, slots=True)
class Look:
    """Appearance of a state: colour (RGB), outline and sign."""

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
    """Draw the icon of a state, RGBA, `size` px square."""
    look = LOOKS.get(state, _UNKNOWN)
    pen = _Pen(size)
    pen.outline(look.outline, (*look.colour, 255))
    for points, width, colour in _SIGNS[look.sign]:
        pen.stroke(points, width, colour)
    return pen.picture.resize((size, size), Image.Resampling.LANCZOS)


class _Pen:
    """Draws in units of the icon, which is from -1 to 1; x right, y down."""

    def __init__(self, size: int) -> None:
        self.half = size * _OVERSAMPLING / 2.0
        self.picture = Image.new("RGBA", (size * _OVERSAMPLING, size * _OVERSAMPLING), (0, 0, 0, 0))
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

    def stroke(self, points: list[tuple[float, float]], width: float | None, colour: tuple[int, ...]) -> None:
        """Draw a line with round ends, a disc for one point, or without a width the polygon of the points."""
        if width is None:
            self.polygon(points, colour)
            return
        self._draw.line([self._at(x, y) for x, y in points], fill=colour, width=round(width * self.half), joint="curve")
        for x, y in (points[0], points[-1]):
            self.disc(x, y, width / 2.0, colour)

    def _at(self, x: float, y: float) -> tuple[float, float]:
        return (1.0 + x) * self.half, (1.0 + y) * self.half


def _regular_polygon(n: int, radius: float, first: float) -> list[tuple[float, float]]:
    turns = [first + 2.0 * math.pi * k / n for k in range(n)]
    return [(radius * math.cos(a), radius * math.sin(a)) for a in turns]


def _inner(corners: list[tuple[float, float]], border: float) -> list[tuple[float, float]]:
    """Shrink a convex polygon towards its middle, so that its nearest side moves by `border`."""
    n = len(corners)
    cx, cy = sum(x for x, _ in corners) / n, sum(y for _, y in corners) / n
    (ax, ay), (bx, by) = corners[-1], corners[0]
    distance = abs((bx - ax) * (ay - cy) - (ax - cx) * (by - ay)) / math.hypot(bx - ax, by - ay)
    k = 1.0 - border / distance
    return [(cx + k * (x - cx), cy + k * (y - cy)) for x, y in corners]


_CORNERS = {
    "square": [(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
    "diamond": _regular_polygon(4, 1.0, 0.0),
    "octagon": _regular_polygon(8, 1.0, math.pi / 8.0),
    "triangle": [(0.0, -0.97), (1.0, 0.9), (-1.0, 0.9)],
}


_BOW = [(0.26 * math.cos(a), -0.24 + 0.26 * math.sin(a)) for a in (math.pi * (1.0 + k / 12.0) for k in range(18))]
_BARS = [[(x - 0.17, -0.52), (x + 0.17, -0.52), (x + 0.17, 0.52), (x - 0.17, 0.52)] for x in (-0.32, 0.32)]
_SIGNS: dict[str, list[tuple[list[tuple[float, float]], float | None, tuple[int, ...]]]] = {  # points, width, colour
    "dots": [([(x, 0.0)], 0.42, _INK) for x in (-0.52, 0.0, 0.52)],
    "target": [([(0.0, 0.0)], width, colour) for width, colour in ((1.24, _INK), (0.84, _PAPER), (0.44, _INK))],
    "tick": [([(-0.45, 0.05), (-0.12, 0.38), (0.48, -0.36)], 0.26, _PAPER)],
    "question": [([*_BOW, (0.0, 0.05), (0.0, 0.16)], 0.19, _INK), ([(0.0, 0.5)], 0.26, _INK)],
    "bars": [(bar, None, _PAPER) for bar in _BARS],
    "exclamation": [([(0.0, -0.24), (0.0, 0.26)], 0.24, _PAPER), ([(0.0, 0.62)], 0.28, _PAPER)],
    "cross": [([(-0.38, y), (0.38, -y)], 0.26, _PAPER) for y in (-0.38, 0.38)],
    "dash": [([(-0.28, 0.0), (0.28, 0.0)], 0.24, _INK)],
}
