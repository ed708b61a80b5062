"""Remove names of people and computers, and serial numbers, from a report for others."""

import contextlib
import getpass
import os
import platform
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

_USB = Path("/sys/bus/usb/devices")
_BY_ID = re.compile(r"(/by-id/[^\s,;)]*_)([^\s,;)_]{4,}?)((?:-[a-z]+-index|-if)\d+)")  # ..._SERIAL-video-index0
_HOMES = re.compile(r"(?<![\w/])/(?:home|Users)/[^/\s,;:)']+")
_NOBODY = {"root", "spheremouse", "video", "input", "nobody"}  # names that every computer has
_SERIAL_CHARACTERS_KEPT = 2  # characters of a serial number


def redactor(
    home: str | None = None, user: str | None = None, host: str | None = None, serials: Iterable[str] | None = None
) -> Callable[[Any], Any]:
    """Return a function that replaces these words in a text, or in the values of dicts and lists, nested.

    The words are those of this computer by default. Tuples become lists; keys and other values stay.
    """
    home = os.path.expanduser("~") if home is None else home
    users = _users() if user is None else [user]
    host = platform.node() if host is None else host
    numbers = sorted(set(_serials() if serials is None else serials), key=len, reverse=True)

    def text(words: str) -> str:
        if len(home) > 1 and home != "/root":
            words = re.sub(re.escape(home.rstrip("/")) + r"(?=[/\s,;:)'\"]|$)", "~", words)
        words = _HOMES.sub("~", words)
        for number in numbers:
            words = words.replace(number, _short(number))
        words = _BY_ID.sub(lambda m: m[1] + _short(m[2]) + m[3], words)
        named = [(user, "USER") for user in users]
        for secret, stands in (*named, (host, "HOST"), (host.partition(".")[0], "HOST")):
            if len(secret) > 1 and secret not in _NOBODY:
                words = re.sub(rf"(?<![\w]){re.escape(secret)}(?![\w])", stands, words)
        return words

    def everything(value: Any) -> Any:
        if isinstance(value, str):
            return text(value)
        if isinstance(value, dict):
            return {k: everything(v) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [everything(v) for v in value]
        return value

    return everything


def _short(number: str) -> str:
    return number if number.endswith("…") else number[:_SERIAL_CHARACTERS_KEPT] + "…"


def _users() -> list[str]:
    asked = os.environ.get("SUDO_USER", "")
    try:
        return [getpass.getuser(), asked]
    except (OSError, KeyError, ImportError):
        return [asked]


def _serials() -> list[str]:
    """Return serial numbers of USB devices, without those of root hubs, which contain colons."""
    found = list[str]()
    with contextlib.suppress(OSError):
        for path in _USB.glob("*/serial"):
            found.append(path.read_text(encoding="utf-8", errors="replace").strip())
    return [number for number in found if len(number) >= 4 and ":" not in number]
