"""Can motion be sent? Looked at, not opened: a mouse that comes and goes, or a board that begins anew, is noticed."""

import importlib.util
import os
from pathlib import Path

from spheremouse.commands.doctor.access import refusal
from spheremouse.commands.doctor.finding import Finding, Verdict, ok, refused, unchecked, warning, wrong
from spheremouse.errors import OutputError
from spheremouse.output.third_axis import left_out, sent_as

UINPUT = Path("/dev/uinput")


def check(spec: str) -> list[Finding]:
    """A line for the output in use, for `auto` one for each that it may take; then what becomes of the third axis."""
    return [*_ways(spec), *_third(spec)]


def _third(spec: str) -> list[Finding]:
    missing, sent = left_out(spec), sent_as(spec)
    if missing:
        return [ok("third axis", *missing.split("; "))]
    return [ok("third axis", f"the ball's spin is sent as {sent}")] if sent else []


def _ways(spec: str) -> list[Finding]:
    kind, _, argument = spec.partition(":")
    if kind == "auto":
        return _auto()
    if kind == "uinput":
        return [uinput()]
    if kind == "serial":
        return [serial(argument)]
    if kind == "desktop":
        return [desktop()]
    if kind == "text":
        return [_text(argument)]
    if kind == "null":
        return [warning("output", "null: motion goes nowhere", "name one: uinput, serial:auto, desktop")]
    from spheremouse import output

    return [wrong("output", f"{kind} is none", f"outputs are {', '.join(output.KINDS)}")]


def uinput(node: Path = UINPUT) -> Finding:
    """The kernel's own mice."""
    if importlib.util.find_spec("evdev") is None:
        return wrong("uinput", "needs Linux and the Python package evdev", "use another output: desktop, serial:auto")
    if not node.exists():
        return wrong("uinput", f"{node} is not there", "as root: modprobe uinput")
    said = refusal(node)
    if said is not None:
        return wrong("uinput", said[0], said[1])
    return ok("uinput", f"{node} may be written")


def serial(argument: str) -> Finding:
    """The board, by what it says of itself, and its port."""
    from spheremouse.output.serial.ports import find_board

    name, _, rest = argument.partition(",")
    identifier = next((p.partition("=")[2] for p in rest.split(",") if p.startswith("id=")), None)
    port = name
    if name in ("", "auto"):
        try:
            port = find_board(identifier)
        except OutputError as e:
            return refused("serial board", e)
    path = Path(port)
    if os.name == "posix" and not path.exists():
        return wrong("serial board", f"{port} is not there", "plug the board in, or name its port: serial:auto")
    said = refusal(path) if os.name == "posix" else None
    if said is not None:
        return wrong("serial board", said[0], said[1])
    return ok("serial board", f"at {port}; `spheremouse firmware check` asks it")


def desktop() -> Finding:
    """The pointer of the desktop."""
    from spheremouse.output import desktop as pointer

    try:
        with pointer.open(""):
            pass
    except OutputError as e:
        return refused("desktop", OutputError(str(e).removeprefix("desktop: ")))
    return ok("desktop", "its pointer can be moved; games that read the mouse itself see nothing of it")


def _auto() -> list[Finding]:
    """The output that `auto` would take; the others are said, and do not matter."""
    tried = [uinput(), _own_board(), desktop()]
    taken = next((f for f in tried if f.verdict is Verdict.OK), None)
    if taken is None:
        first = wrong("output", "auto finds none", "mend one of these; uinput is the usual one")
        return [first, *(warning(f.name, f.text, f.advice) for f in tried)]
    others = [f if f is taken else unchecked(f.name, f"not needed: {f.text}") for f in tried]
    return [ok("output", f"auto takes {taken.name}"), *others]


def _own_board() -> Finding:
    """A board that says it is ours; an adapter may be anything."""
    from serial.tools import list_ports

    from spheremouse.output.serial.ports import PRODUCT

    try:
        ours = [p for p in list_ports.comports() if PRODUCT in f"{p.product} {p.serial_number}".lower()]
    except (TypeError, ValueError, OSError):  # a board that is just being unplugged
        ours = []
    if not ours:
        return wrong(
            "serial board", "none of ours is plugged in", "for a game on another computer: docs/microcontroller.md"
        )
    return serial("auto")


def _text(argument: str) -> Finding:
    if argument in ("", "-"):
        return ok("output", "text to standard output")
    from spheremouse.output.text import NAMES

    path = Path(argument)
    if path.is_file() and path.stat().st_size > 0 and not _begins_with(path, NAMES.encode()):
        return wrong("output", f"{path} is there and is no log of motions", "choose another name or remove it")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        return wrong("output", f"{argument} may not be written", "name a file elsewhere")
    return ok("output", f"text to {argument}")


def _begins_with(path: Path, words: bytes) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(words)) == words
    except OSError:
        return False
