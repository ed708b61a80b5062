"""The firmware's files, their version, and the USB drive of a board with CircuitPython.

CircuitPython appears as a drive with a file boot_out.txt. Its first line has the version and the board.
"""

import contextlib
import importlib.util
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from spheremouse.errors import OutputError, printable
from spheremouse.files.access import service_files
from spheremouse.files.safe_files import replace

PICO = "firmware/pico"  # in `service/`
FILES = ("boot.py", "mouse.py", "protocol.py", "code.py")  # code.py last, because the board runs it when it changes
MIN_CIRCUITPYTHON = (9, 0)
_BOOT_OUT = "boot_out.txt"
_BOOT_LOADER_INFO = "INFO_UF2.TXT"
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


def load_protocol() -> ModuleType:
    """Return the board's protocol.py as a module, because it runs in CPython too."""
    spec = importlib.util.spec_from_file_location("spheremouse_firmware_protocol", service_files(PICO) / "protocol.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def version_of(path: Path) -> Version | None:
    """Return the version of a folder's protocol.py; None if there is none."""
    found = _VERSION.search((_bytes(path / "protocol.py") or b"").decode("utf-8", "replace"))
    return None if found is None else (int(found[1]), int(found[2]), int(found[3]))


def format_version(version: Version | None) -> str:
    """Return a version as in 1.2.3."""
    return "none" if version is None else ".".join(map(str, version))


# ---- drives ----


def read_drive(path: Path) -> Drive:
    """Return the board of a drive, from the drive's files."""
    boot_out = _bytes(path / _BOOT_OUT)
    if boot_out is None:
        if (path / _BOOT_LOADER_INFO).exists():
            raise OutputError(
                f"{path}: this is the boot loader; copy CircuitPython's .uf2 file for your board there "
                "(https://circuitpython.org/downloads), and name the drive CIRCUITPY that comes then"
            )
        raise OutputError(
            f"{path}: no {_BOOT_OUT} in it, so this is no board with CircuitPython; name the drive called CIRCUITPY"
        )
    text = "\n".join(map(printable, boot_out.decode("utf-8", "replace").splitlines()))
    found = _IDENTITY.search(text)
    if found is None:
        raise OutputError(f"{path / _BOOT_OUT}: does not name CircuitPython; install CircuitPython on the board first")
    board = _BOARD.search(text)
    return Drive(path, (int(found[1]), int(found[2])), board[1] if board else found[3].strip())


def drives() -> tuple[list[Drive], list[Path]]:
    """Return the mounted drives of boards with CircuitPython, and those of boards that wait in their boot loader."""
    found, waiting = list[Drive](), list[Path]()
    for path in mounted_folders():
        with contextlib.suppress(OutputError, OSError):
            if (path / _BOOT_OUT).is_file():
                found.append(read_drive(path))
            elif (path / _BOOT_LOADER_INFO).is_file():
                waiting.append(path)
    return found, waiting


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


def stale(source: Path, target: Path) -> list[str]:
    """Return the files that are missing on the drive or differ."""
    return [name for name in FILES if _bytes(target / name) != (source / name).read_bytes()]


def foreign(source: Path, target: Path) -> list[str]:
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
    """Copy files atomically, and read them back."""
    for name in names:
        data = (source / name).read_bytes()
        try:
            replace(target / name, data)
            _sync(target)
        except OSError as e:
            raise OutputError(
                f"{target / name}: cannot be written: {e.strerror or e}; see that the drive is neither full nor "
                "write-protected, pull the board, plug it in again and repeat"
            ) from None
        if _bytes(target / name) != data:
            raise OutputError(
                f"{target / name}: differs from the written data; unplug the board, plug it in again and repeat"
            )


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
