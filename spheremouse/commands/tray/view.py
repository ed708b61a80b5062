"""Turn the daemon's status into icon, tooltip, menu and notices of the tray, without a desktop or a thread."""

import math
import re
from dataclasses import dataclass, field

from PIL import Image, ImageDraw, ImageFont

from spheremouse.session.control.status import STATES as DAEMON_STATES
from spheremouse.session.control.status import StatusReport

NO_DAEMON = "no-daemon"
STATES = (*DAEMON_STATES, NO_DAEMON)

_MAX_TOOLTIP = 127  # characters, limit of Windows
_MAX_MENU_LINE = 90  # characters
_OVERSAMPLING = 4  # for smooth edges
_INK = (24, 26, 28, 255)
_PAPER = (255, 255, 255, 255)


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
    recording = None if status.recording is None else _line(status.recording.folder)
    return View(_line(status.state), _line(status.reason), status.fps, status.paused, recording)


def no_daemon(reason: str) -> View:
    """Return the view without a daemon. Details in brackets are removed, since they fill the menu."""
    return View(NO_DAEMON, re.sub(r"\s*\([^()]*\)", "", _line(reason)))


def _line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text).strip()


def headline(v: View) -> str:
    """Return state and reason, the first line of the menu."""
    words = v.state.replace("-", " ")
    if v.reason:
        words = f"{words}: {v.reason}" if v.connected else v.reason
    return _cut(words, _MAX_MENU_LINE)


def tooltip(v: View) -> str:
    """Return the text that is shown while the mouse is over the icon."""
    figures = [] if v.fps is None else [f"{v.fps:.0f} frames/s"]
    if v.recording is not None:
        figures.append("recording")
    tail = "\n" + ", ".join(figures) if v.connected and figures else ""
    return _cut(f"spheremouse: {headline(v)}", _MAX_TOOLTIP - len(tail)) + tail


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


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


# s; hands and bystanders hide the ball for moments, and an upgrade restarts the daemon
_NOTICE_AFTER_S = {"no-camera": 5.0, "lost": 15.0, "failed-output": 5.0, NO_DAEMON: 15.0}
_MIN_NOTICE_INTERVAL_S = 300.0


@dataclass(slots=True)
class Notices:
    """Decides when to show a notice: for problems that last, and for each at most every five minutes. Times in s."""

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
        if now - self._since < _NOTICE_AFTER_S.get(v.state, math.inf):
            return None
        last = self._shown.get(v.state)
        if last is not None and (last >= self._since or now - last < _MIN_NOTICE_INTERVAL_S):
            return None
        self._shown[v.state], self._unresolved = now, True
        return headline(v)


_TICK = "tick"


@dataclass(frozen=True, slots=True)
class Look:
    """Appearance of a state: colour (RGB), outline, and sign as text or the tick."""

    colour: tuple[int, int, int]
    outline: str
    sign: str


LOOKS = {
    "starting": Look((86, 180, 233), "disc", "..."),
    "searching-targets": Look((240, 228, 66), "disc", "O"),
    "tracking": Look((0, 170, 90), "disc", _TICK),
    "lost": Look((240, 150, 0), "diamond", "?"),
    "paused": Look((150, 100, 200), "square", "II"),
    "no-camera": Look((226, 60, 50), "triangle", "!"),
    "failed-output": Look((226, 60, 50), "octagon", "X"),
    NO_DAEMON: Look((225, 225, 225), "disc", "/"),
}
_UNKNOWN_LOOK = Look((140, 140, 140), "octagon", "i")  # a state of a later version
_OUTLINES = {  # sides, angle (°), radius and height of the centre
    "disc": (72, 0, 0.97, 0.0),
    "square": (4, 0, 1.27, 0.0),
    "diamond": (4, 45, 1.0, 0.0),
    "triangle": (3, 0, 1.25, 0.29),
    "octagon": (8, 22, 1.0, 0.0),
}


def icon(state: str, size: int = 64) -> Image.Image:
    """Draw the icon of a state, RGBA, `size` px square. Lengths are in units of half a side."""
    look, side = LOOKS.get(state, _UNKNOWN_LOOK), size * _OVERSAMPLING
    picture, half = Image.new("RGBA", (side, side)), side / 2.0
    draw = ImageDraw.Draw(picture)
    sides, angle, radius, height = _OUTLINES[look.outline]
    circle = (half, half * (1.0 + height), half * radius)
    draw.regular_polygon(circle, sides, angle, look.colour, _INK, round(0.1 * half))
    ink = _INK if sum(look.colour) > 450 else _PAPER
    if look.sign == _TICK:
        points = [(half * (1.0 + x), half * (1.0 + y)) for x, y in ((-0.48, 0.05), (-0.12, 0.42), (0.52, -0.38))]
        draw.line(points, ink, round(0.36 * half), "curve")
    else:
        sign, font = Image.new("L", picture.size), ImageFont.load_default(1.5 * half)
        ImageDraw.Draw(sign).text((half, half), look.sign, 255, font, "mm", stroke_width=round(0.06 * half))
        sign = sign.crop(sign.getbbox())
        left, top = (side - sign.width) // 2, round(half * (1.0 + 0.4 * height) - sign.height / 2.0)
        picture.paste(ink, (left, top), sign)
    return picture.resize((size, size), Image.Resampling.LANCZOS)
