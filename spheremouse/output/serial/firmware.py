"""The firmware's files, their version, and the USB drive of a board with CircuitPython."""

import re
from glob import glob
from pathlib import Path

from spheremouse.errors import OutputError, os_errors_as
from spheremouse.files.access import service_files
from spheremouse.files.safe_files import replace

PICO = "firmware/pico"  # in `service/`
# `code.py` is the last, because the board runs it when it changes
FILES = ("boot.py", "mouse.py", "frames.py", "protocol.py", "code.py")
DRIVES = ("/media/*/CIRCUITPY", "/run/media/*/CIRCUITPY", "/Volumes/CIRCUITPY")  # where systems mount it
_FIRST_LINE = b"# spheremouse firmware"
_EXAMPLES = (b'print("Hello World!")', b"import board")  # of CircuitPython
_OVERRIDING_FILES = ("code.txt", "boot.txt")  # CircuitPython runs them in place of code.py and boot.py
_MIN_CIRCUITPYTHON = 9
_CIRCUITPYTHON = re.compile(rb"CircuitPython (\d+)\.")
_VERSION = re.compile(r"^FIRMWARE = \((\d+), (\d+), (\d+)\)", re.M)

Version = tuple[int, int, int]


def version_of(path: Path) -> Version | None:
    """Return the version of a folder's protocol.py; None if there is none."""
    found = _VERSION.search((_bytes(path / "protocol.py") or b"").decode("utf-8", "replace"))
    return None if found is None else (int(found[1]), int(found[2]), int(found[3]))


def own_version() -> Version:
    """Return the version of this program's firmware."""
    version = version_of(service_files(PICO))
    assert version is not None, "protocol.py states it"
    return version


def format_version(version: Version | None) -> str:
    """Return a version as in 1.2.3."""
    return "none" if version is None else ".".join(map(str, version))


def find_drive() -> Path:
    """Return the only drive CIRCUITPY that is mounted. Raises OutputError if there is none, or several."""
    found = [Path(path) for pattern in DRIVES for path in glob(pattern)]
    if len(found) != 1:
        several = ", ".join(map(str, found))
        raise OutputError(
            f"several boards: {several}" if found else "no drive CIRCUITPY is mounted",
            "name one with --drive"
            if found
            else "mount the board's and name it with --drive (docs/microcontroller.md)",
        )
    return found[0]


def install(drive: Path, force: bool) -> list[str]:
    """Copy the files that are missing on a board or differ; return their names.

    OutputError without CircuitPython or with one that is too old, and for files of another program; `force` removes
    those.
    """
    says = _CIRCUITPYTHON.search(_bytes(drive / "boot_out.txt") or b"")
    if says is None or int(says[1]) < _MIN_CIRCUITPYTHON:
        problem = f"has CircuitPython {int(says[1])}" if says else "no boot_out.txt in it that names CircuitPython"
        hint = f"install CircuitPython {_MIN_CIRCUITPYTHON} or newer first (docs/microcontroller.md)"
        raise OutputError(f"{drive}: {problem}", hint)
    files = {name: (service_files(PICO) / name).read_bytes() for name in FILES}
    others = [name for name in _OVERRIDING_FILES if (drive / name).exists()]
    others += [name for name, data in files.items() if not _is_ours(_bytes(drive / name) or b"", data)]
    if others and not force:
        raise OutputError(f"{drive}: {', '.join(others)} of another program there", "save them and use --force")
    stale = [name for name, data in files.items() if _bytes(drive / name) != data]
    hint = "see that the drive is neither full nor write-protected, pull the board, plug it in again and repeat"
    with os_errors_as(OutputError, f"{drive}: cannot be written", hint):
        for name in _OVERRIDING_FILES:
            (drive / name).unlink(missing_ok=True)
        for name in stale:
            replace(drive / name, files[name])
    return stale


def _is_ours(present: bytes, own: bytes) -> bool:
    """Return True for any version of a file, for a copy that was cut short, and for CircuitPython's examples."""
    return present.startswith(_FIRST_LINE) or own.startswith(present.rstrip(b"\0")) or present.strip() in _EXAMPLES


def _bytes(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None  # reading a pipe would never end
    except OSError:
        return None
