"""The firmware's files, their version, and the USB drive of a board with CircuitPython.

CircuitPython appears as a drive with a file boot_out.txt. Its first line has the version and the board.
"""

import contextlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from spheremouse.errors import OutputError, printable
from spheremouse.files.access import service_files
from spheremouse.files.safe_files import replace

PICO = "firmware/pico"  # in `service/`
FILES = ("boot.py", "mouse.py", "protocol.py", "code.py")  # code.py last, because the board runs it when it changes
MIN_CIRCUITPYTHON = (9, 0)
_BOOT_OUT = "boot_out.txt"
_BOOT_LOADER_INFO = "INFO_UF2.TXT"
_DOWNLOADS = "https://circuitpython.org/downloads"
_BOOTSEL_STEPS = (
    f"hold BOOTSEL down while you plug the board in, copy CircuitPython's .uf2 file for your board ({_DOWNLOADS}) to "
    "the drive RPI-RP2 or RP2350 that appears, and wait for the drive CIRCUITPY"
)
_FIRST_LINE = b"# spheremouse firmware"
_ALTERNATIVES = ("code.txt", "boot.txt")  # CircuitPython may run them in place of code.py and boot.py
_IDENTITY = re.compile(r"CircuitPython (\d+)\.(\d+)\S* on [^;]*; (.+)")
_BOARD = re.compile(r"^Board ID:(\S+)", re.M)
_VERSION = re.compile(r"^FIRMWARE = \((\d+), (\d+), (\d+)\)", re.M)

Version = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Drive:
    """A board's drive."""

    path: Path
    circuitpython: tuple[int, int]
    board: str


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


# ---- drives ----


def read_drive(path: Path) -> Drive:
    """Return the board of a drive, from the drive's files. Raises OutputError unless CircuitPython runs on it."""
    boot_out = _bytes(path / _BOOT_OUT)
    if boot_out is None:
        if (path / _BOOT_LOADER_INFO).exists():
            raise OutputError(
                f"{path}: this is the boot loader",
                f"copy CircuitPython's .uf2 file for your board there ({_DOWNLOADS}), and name the drive CIRCUITPY "
                "that comes then",
            )
        problem = f"{path}: no {_BOOT_OUT} in it, so this is no board with CircuitPython"
        raise OutputError(problem, "name the drive called CIRCUITPY")
    text = "\n".join(map(printable, boot_out.decode("utf-8", "replace").splitlines()))
    found = _IDENTITY.search(text)
    if found is None:
        problem = f"{path / _BOOT_OUT}: does not name CircuitPython"
        raise OutputError(problem, "install CircuitPython on the board first")
    board = _BOARD.search(text)
    return Drive(path, (int(found[1]), int(found[2])), board[1] if board else found[3].strip())


def select_drive(path: Path | None = None) -> Drive:
    """Return the board with its drive at a path, or the only board. Raise OutputError if there is none."""
    if path is not None:
        return read_drive(path)
    found, waiting = list[Drive](), list[Path]()
    for folder in mounted_folders():
        with contextlib.suppress(OutputError, OSError):
            if (folder / _BOOT_OUT).is_file():
                found.append(read_drive(folder))
            elif (folder / _BOOT_LOADER_INFO).is_file():
                waiting.append(folder)
    if len(found) == 1:
        return found[0]
    if found:
        raise OutputError(f"several boards: {', '.join(str(d.path) for d in found)}", "name one with --drive")
    if waiting:
        hint = f"copy its .uf2 file there ({_DOWNLOADS}), wait until the drive is called CIRCUITPY, and repeat"
        raise OutputError(f"{waiting[0]}: a board without CircuitPython", hint)
    raise OutputError(
        "no drive CIRCUITPY is mounted",
        "if the board has CircuitPython, mount its drive and name it with --drive, or take the jumper off pins 28 "
        f"and 29 and plug it in again; if not, {_BOOTSEL_STEPS}",
    )


def mounted_folders() -> Iterator[Path]:
    """Yield the folders of mounted drives, on each system."""
    if os.name == "nt":
        yield from (Path(f"{letter}:\\") for letter in "DEFGHIJKLMNOPQRSTUVWXYZ")
        return
    table = Path("/proc/mounts")
    if table.exists():
        for line in table.read_text(encoding="utf-8", errors="replace").splitlines():
            fields = line.split(" ")
            if len(fields) > 2 and fields[2] in ("vfat", "msdos", "fuseblk"):
                yield Path(re.sub(r"\\(\d{3})", lambda m: chr(int(m[1], 8)), fields[1]))
        return
    volumes = Path("/Volumes")
    if volumes.is_dir():
        yield from sorted(volumes.iterdir())


# ---- files ----


def install(board: Drive, force: bool) -> list[str]:
    """Copy the files that are missing on a board or differ; return their names.

    OutputError for CircuitPython that is too old, and for files of another program. Without `force` also for a newer
    firmware.
    """
    source, path = service_files(PICO), board.path
    if board.circuitpython < MIN_CIRCUITPYTHON:
        version, minimum = (".".join(map(str, v)) for v in (board.circuitpython, MIN_CIRCUITPYTHON))
        hint = f"install {minimum} or newer: {_BOOTSEL_STEPS}"
        raise OutputError(f"{path}: CircuitPython {version} is too old", hint)
    others = _foreign(source, path)
    for name in others:
        if (path / name).is_dir():
            raise OutputError(f"{path / name}: is a folder, where a file has to be", "move it away")
        if name not in FILES:
            raise OutputError(f"{path / name}: CircuitPython runs it in place of our program", "move it away")
    if others and not force:
        raise OutputError(f"{path}: {', '.join(others)} of another program there", "save them and use --force")
    new, old = own_version(), version_of(path)
    if old is not None and old > new and not force:
        problem = f"{path}: firmware {format_version(old)} there is newer than {format_version(new)} of this program"
        raise OutputError(problem, "update spheremouse, or go back with --force")
    stale = [name for name in FILES if _bytes(path / name) != (source / name).read_bytes()]
    copy(source, path, stale)
    return stale


def _foreign(source: Path, target: Path) -> list[str]:
    """Return files of another program that an installation would replace, or that would run in its place."""
    others = [name for name in _ALTERNATIVES if (target / name).exists()]
    for name in FILES:
        there = _bytes(target / name)
        if (target / name).is_dir() or (there is not None and not _is_ours(there, (source / name).read_bytes())):
            others.append(name)
    return others


def _is_ours(there: bytes, here: bytes) -> bool:
    """Return True for any version of a file, for a copy that was cut short, and for CircuitPython's examples."""
    fresh = (b'print("Hello World!")', b"import board")
    return there.startswith(_FIRST_LINE) or here.startswith(there.rstrip(b"\0")) or there.strip() in fresh


def copy(source: Path, target: Path, names: list[str]) -> None:
    """Copy files atomically, and read them back. Raises OutputError if one cannot be written, or differs."""
    for name in names:
        data = (source / name).read_bytes()
        try:
            replace(target / name, data)
            _sync(target)
        except OSError as e:
            raise OutputError(
                f"{target / name}: cannot be written: {e.strerror or e}",
                "see that the drive is neither full nor write-protected, pull the board, plug it in again and repeat",
            ) from None
        if _bytes(target / name) != data:
            problem = f"{target / name}: differs from the written data"
            raise OutputError(problem, "unplug the board, plug it in again and repeat")


def _sync(path: Path) -> None:
    """Write a new name to the disk; Windows does it by itself."""
    if os.name == "posix":
        handle = os.open(path, os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):  # some file systems cannot
                os.fsync(handle)
        finally:
            os.close(handle)


def _bytes(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None  # reading a pipe would never end
    except OSError:
        return None
