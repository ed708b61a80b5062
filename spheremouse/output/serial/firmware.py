"""The firmware of boards that are the mouse: where its files are, what version they have, and a board's USB drive.

CircuitPython shows itself as a drive with a file boot_out.txt, whose first line names version and board.
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
from spheremouse.files.atomic import replace
from spheremouse.files.service import service_files

PICO = "firmware/pico"  # in `service/`
FILES = ("boot.py", "mouse.py", "protocol.py", "code.py")  # code.py last: the board runs it when it changes
MARK = "boot_out.txt"
BOOT_LOADER = "INFO_UF2.TXT"
OLDEST = (9, 0)  # CircuitPython
_FIRST = b"# spheremouse firmware"  # of each of our files
_INSTEAD = ("code.txt", "boot.txt")  # that CircuitPython runs, or may run, in place of ours
_IDENTITY = re.compile(r"CircuitPython (\d+)\.(\d+)\S* on [^;]*; (.+)")
_BOARD = re.compile(r"^Board ID:(\S+)", re.M)
_UID = re.compile(r"^UID:(\S+)", re.M)
_VERSION = re.compile(r"^FIRMWARE = \((\d+), (\d+), (\d+)\)", re.M)

Version = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Drive:
    """A board's drive."""

    path: Path
    circuitpython: tuple[int, int]
    board: str
    serial_number: str | None  # as USB tells it, where boot_out.txt does


def load_protocol() -> ModuleType:
    """The board's own protocol.py as a module; it runs here too."""
    spec = importlib.util.spec_from_file_location("spheremouse_firmware_protocol", service_files(PICO) / "protocol.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def version_of(path: Path) -> Version | None:
    """The version that a folder's protocol.py has; None where there is none."""
    found = _VERSION.search((_bytes(path / "protocol.py") or b"").decode("utf-8", "replace"))
    return None if found is None else (int(found[1]), int(found[2]), int(found[3]))


def words(version: Version | None) -> str:
    """1.2.3."""
    return "none" if version is None else ".".join(map(str, version))


# ---- drives ----


def read_drive(path: Path) -> Drive:
    """The board of a drive, as the drive's files tell."""
    told = _bytes(path / MARK)
    if told is None:
        if (path / BOOT_LOADER).exists():
            raise OutputError(
                f"{path}: this is the boot loader; copy CircuitPython's .uf2 file for your board there "
                "(https://circuitpython.org/downloads), and name the drive CIRCUITPY that comes then"
            )
        raise OutputError(
            f"{path}: no {MARK} in it, so this is no board with CircuitPython; name the drive called CIRCUITPY"
        )
    text = "\n".join(map(printable, told.decode("utf-8", "replace").splitlines()))
    found = _IDENTITY.search(text)
    if found is None:
        raise OutputError(f"{path / MARK}: says nothing of CircuitPython; install CircuitPython on the board first")
    board, uid = _BOARD.search(text), _UID.search(text)
    return Drive(path, (int(found[1]), int(found[2])), board[1] if board else found[3].strip(), uid[1] if uid else None)


def drives() -> list[Drive]:
    """Boards' drives that this system has mounted."""
    found = []
    for path in _mounts():
        with contextlib.suppress(OutputError, OSError):
            if (path / MARK).is_file():
                found.append(read_drive(path))
    return found


def in_boot_loader() -> list[Path]:
    """Drives of boards that wait for an operating system: RP2040's boot loader shows INFO_UF2.TXT."""
    found = []
    for path in _mounts():
        with contextlib.suppress(OSError):
            if (path / BOOT_LOADER).is_file() and not (path / MARK).exists():
                found.append(path)
    return found


def _mounts() -> Iterator[Path]:
    """Folders below which drives are mounted, on each system."""
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
    """Files that are missing on the drive or differ."""
    return [name for name in FILES if _bytes(target / name) != (source / name).read_bytes()]


def foreign(source: Path, target: Path) -> list[str]:
    """Programs of somebody else that installing would replace, or that would run in its place."""
    others = [name for name in _INSTEAD if (target / name).exists()]
    for name in FILES:
        there = _bytes(target / name)
        if (target / name).is_dir() or (there is not None and not _is_ours(there, (source / name).read_bytes())):
            others.append(name)
    return others


def _is_ours(there: bytes, here: bytes) -> bool:
    """Of any version, or cut short when it was copied; or what nobody misses."""
    fresh = (b'print("Hello World!")', b"import board")  # what CircuitPython brings
    return there.startswith(_FIRST) or here.startswith(there.rstrip(b"\0")) or there.strip() in fresh


def copy(source: Path, target: Path, names: list[str]) -> None:
    """Copy files so that each is the old or the new one, never half; read back what arrived."""
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
            raise OutputError(f"{target / name}: not what was written; pull the board, plug it in again and repeat")


def _sync(path: Path) -> None:
    """Make a new name last; Windows does so by itself."""
    if os.name == "posix":
        handle = os.open(path, os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):  # not every file system can
                os.fsync(handle)
        finally:
            os.close(handle)


def _bytes(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None  # a pipe on a drive would never end
    except OSError:
        return None
