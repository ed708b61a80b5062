"""The board: its drive, what is on it, and what it answers at its port."""

from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.files.service import service_files
from spheremouse.output.serial import Serial, firmware
from spheremouse.output.serial.firmware import Drive, words
from spheremouse.output.serial.messages import Flags
from spheremouse.output.serial.ports import find_board

_BAD = 0.01  # share of frames that may come damaged before a line is called bad


class NoDriveError(OutputError):
    """No board's drive is mounted."""


def board_at(path: Path | None) -> Drive:
    """The board whose drive is at a path, or the only one there is; an OutputError says what to do where none is."""
    if path is not None:
        return firmware.read_drive(path)
    found = firmware.drives()
    if len(found) == 1:
        return found[0]
    if found:
        raise OutputError(f"several boards: {', '.join(str(d.path) for d in found)}; name one with --drive")
    waiting = firmware.in_boot_loader()
    if waiting:
        raise NoDriveError(
            f"{waiting[0]}: a board without CircuitPython; copy its .uf2 file there "
            "(https://circuitpython.org/downloads), wait until the drive is called CIRCUITPY, and repeat"
        )
    raise NoDriveError(
        "no drive CIRCUITPY is mounted; if the board has CircuitPython, mount its drive and name it with --drive, or "
        f"take the jumper off pins 28 and 29 and plug it in again; if not, {how()}"
    )


def how() -> str:
    """Put CircuitPython on a board, in words."""
    return (
        "hold BOOTSEL down while you plug the board in, copy CircuitPython's .uf2 file for your board "
        "(https://circuitpython.org/downloads) to the drive RPI-RP2 or RP2350 that appears, and wait for the drive "
        "CIRCUITPY"
    )


def too_old(board: Drive) -> str | None:
    """The fault of a CircuitPython that does not run our program; None: it does."""
    if board.circuitpython >= firmware.OLDEST:
        return None
    found, least = (".".join(map(str, v)) for v in (board.circuitpython, firmware.OLDEST))
    return f"CircuitPython {found} is too old; install {least} or newer: {how()}"


def what_stays(path: Path, others: list[str]) -> str | None:
    """The fault that `--force` cannot mend; None: there is none."""
    for name in others:
        if (path / name).is_dir():
            return f"{path / name}: is a folder, where a file has to be; move it away"
        if name not in firmware.FILES:
            return f"{path / name}: CircuitPython runs it in place of our program; move it away"
    return None


def look(board: Drive, ours: firmware.Version | None) -> tuple[dict[str, Any], str, list[str]]:
    """What is on a board's drive, as figures and as a line, and what is wrong with that."""
    there, circuitpython = firmware.version_of(board.path), ".".join(map(str, board.circuitpython))
    found = {
        "path": str(board.path),
        "board": board.board,
        "circuitpython": circuitpython,
        "version": words(there),
        "stale": firmware.stale(service_files(firmware.PICO), board.path),
    }
    line = f"drive {board.path}: {board.board}, CircuitPython {circuitpython}, firmware {words(there)}"
    return found, line, _wrong_with_drive(board, there, ours)


def _wrong_with_drive(board: Drive, there: firmware.Version | None, ours: firmware.Version | None) -> list[str]:
    source = service_files(firmware.PICO)
    if fault := too_old(board):
        return [fault]
    if others := firmware.foreign(source, board.path):
        stays = what_stays(board.path, others)
        return [
            stays
            or f"{', '.join(others)} on the drive belong to another program; save them and run "
            "`spheremouse firmware install --force`"
        ]
    if there is not None and ours is not None and there > ours:
        return [f"firmware {words(there)} on the drive is newer than this program; update spheremouse"]
    stale = firmware.stale(source, board.path)
    return [f"{', '.join(stale)} on the drive differ; run `spheremouse firmware install`"] if stale else []


def wrong_version(runs: firmware.Version, ours: firmware.Version, kind: int) -> str:
    """That another firmware runs than ours, and what to do on a board of that kind."""
    if runs > ours:
        return f"firmware {words(runs)} runs, which is newer than this program; update spheremouse"
    how = {
        1: "pull the board and plug it in again, or run `spheremouse firmware install`",
        2: "load the new one as docs/microcontroller.md says for the ATmega32U4 (make upload)",
    }.get(kind, "start it again")
    return f"firmware {words(runs)} runs; {how}"


def ask(port: str, baud: int) -> tuple[Any, dict[str, Any], list[str]]:
    """Identity of the board that answers, how it fares, and what is wrong with that."""
    name = find_board() if port == "auto" else port
    output = Serial(lambda: name, baud, "none", lambda _: None)
    try:
        identity, status = output.identity, output.status()
    finally:
        output.close()
    if identity is None or status is None:
        raise OutputError(
            f"serial: {name}: answers, but does not say how it fares: the line damages frames; use shorter wires, "
            "and see that GND is connected"
        )
    wrong, takes = [], bool(status.flags & Flags.USB_READY)
    if not takes:
        wrong.append("no computer takes its mouse; plug the board into the game's computer, or wake that up")
    if status.damaged > _BAD * (status.frames + status.damaged) + 2:  # the first on a line may be
        wrong.append(
            f"{status.damaged} damaged frames beside {status.frames} whole ones; use shorter wires, see that GND is "
            "connected, and plug the board in again to count anew"
        )
    state = (
        f"up {status.uptime} s, its mouse is {'taken' if takes else 'not taken'}; "
        f"{status.frames} frames, {status.damaged} damaged, {status.refused} refused, "
        f"{status.lost} lost; {status.reports} reports, {status.usb_errors} USB errors"
    )
    found = {
        "port": name,
        "firmware": words(identity.firmware),
        "board": identity.board,
        "kind": identity.kind,
        "state": state,
    }
    return identity, found, wrong
