"""Examine a board: the files on its drive, and its answers at the serial port."""

from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.access import service_files
from spheremouse.output.serial import Serial, firmware
from spheremouse.output.serial.firmware import Drive, format_version
from spheremouse.output.serial.messages import Flags
from spheremouse.output.serial.ports import find_board

_MAX_DAMAGED = 0.01  # fraction of damaged frames on a good line
BOOTSEL_STEPS = (
    "hold BOOTSEL down while you plug the board in, copy CircuitPython's .uf2 file for your board "
    "(https://circuitpython.org/downloads) to the drive RPI-RP2 or RP2350 that appears, and wait for the drive "
    "CIRCUITPY"
)


class NoDriveError(OutputError):
    """No board's drive is mounted."""


def select_drive(path: Path | None) -> Drive:
    """Return the board with its drive at a path, or the only board. Raise OutputError if there is none."""
    if path is not None:
        return firmware.read_drive(path)
    found, waiting = firmware.drives()
    if len(found) == 1:
        return found[0]
    if found:
        raise OutputError(f"several boards: {', '.join(str(d.path) for d in found)}; name one with --drive")
    if waiting:
        raise NoDriveError(
            f"{waiting[0]}: a board without CircuitPython; copy its .uf2 file there "
            "(https://circuitpython.org/downloads), wait until the drive is called CIRCUITPY, and repeat"
        )
    raise NoDriveError(
        "no drive CIRCUITPY is mounted; if the board has CircuitPython, mount its drive and name it with --drive, or "
        f"take the jumper off pins 28 and 29 and plug it in again; if not, {BOOTSEL_STEPS}"
    )


def unsupported_version(board: Drive) -> str | None:
    """Return the problem of a CircuitPython that cannot run the firmware; None if it can."""
    if board.circuitpython >= firmware.MIN_CIRCUITPYTHON:
        return None
    version, minimum = (".".join(map(str, v)) for v in (board.circuitpython, firmware.MIN_CIRCUITPYTHON))
    return f"CircuitPython {version} is too old; install {minimum} or newer: {BOOTSEL_STEPS}"


def unremovable_file(path: Path, others: list[str]) -> str | None:
    """Return the problem of a file that `--force` does not replace; None if there is none."""
    for name in others:
        if (path / name).is_dir():
            return f"{path / name}: is a folder, where a file has to be; move it away"
        if name not in firmware.FILES:
            return f"{path / name}: CircuitPython runs it in place of our program; move it away"
    return None


def examine_drive(board: Drive, ours: firmware.Version | None) -> tuple[dict[str, Any], str, list[str]]:
    """Return the contents of a board's drive as figures and as a line, and its problems."""
    there, circuitpython = firmware.version_of(board.path), ".".join(map(str, board.circuitpython))
    found = {
        "path": str(board.path),
        "board": board.board,
        "circuitpython": circuitpython,
        "version": format_version(there),
        "stale": firmware.stale(service_files(firmware.PICO), board.path),
    }
    line = f"drive {board.path}: {board.board}, CircuitPython {circuitpython}, firmware {format_version(there)}"
    return found, line, _drive_problems(board, there, ours)


def _drive_problems(board: Drive, there: firmware.Version | None, ours: firmware.Version | None) -> list[str]:
    source = service_files(firmware.PICO)
    if problem := unsupported_version(board):
        return [problem]
    if others := firmware.foreign(source, board.path):
        return [
            unremovable_file(board.path, others)
            or f"{', '.join(others)} on the drive belong to another program; save them and run "
            "`spheremouse firmware install --force`"
        ]
    if there is not None and ours is not None and there > ours:
        return [f"firmware {format_version(there)} on the drive is newer than this program; update spheremouse"]
    stale = firmware.stale(source, board.path)
    return [f"{', '.join(stale)} on the drive differ; run `spheremouse firmware install`"] if stale else []


def other_version(runs: firmware.Version, ours: firmware.Version, kind: int) -> str:
    """Return the problem and remedy of a board that runs another version of the firmware."""
    if runs > ours:
        return f"firmware {format_version(runs)} runs, which is newer than this program; update spheremouse"
    remedy = {
        1: "pull the board and plug it in again, or run `spheremouse firmware install`",
        2: "load the new one (make upload; docs/microcontroller.md, ATmega32U4)",
    }.get(kind, "start it again")
    return f"firmware {format_version(runs)} runs; {remedy}"


def examine_port(port: str, baud: int) -> tuple[Any, dict[str, Any], list[str]]:
    """Return the identity of the board that answers, its condition as figures, and its problems."""
    name = find_board() if port == "auto" else port
    output = Serial(lambda: name, baud, "none", lambda _: None)
    try:
        identity, status = output.identity, output.status()
    finally:
        output.close()
    if identity is None or status is None:
        raise OutputError(
            f"serial: {name}: answers HELLO, but not STATUS?: the line damages frames; use shorter wires, "
            "and see that GND is connected"
        )
    wrong, takes = [], bool(status.flags & Flags.USB_READY)
    if not takes:
        wrong.append("no computer takes its mouse; plug the board into the game's computer, or wake that up")
    if (
        status.damaged > _MAX_DAMAGED * (status.frames + status.damaged) + 2
    ):  # the first frames on a line may be damaged
        wrong.append(
            f"{status.damaged} damaged frames beside {status.frames} whole ones; use shorter wires, see that GND is "
            "connected, and plug the board in again to reset the count"
        )
    state = (
        f"up {status.uptime} s, its mouse is {'taken' if takes else 'not taken'}; "
        f"{status.frames} frames, {status.damaged} damaged, {status.refused} refused, "
        f"{status.lost} lost; {status.reports} reports, {status.usb_errors} USB errors"
    )
    found = {
        "port": name,
        "firmware": format_version(identity.firmware),
        "board": identity.board,
        "kind": identity.kind,
        "state": state,
    }
    return identity, found, wrong
