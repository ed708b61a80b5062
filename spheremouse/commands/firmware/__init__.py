"""`spheremouse firmware`: put the firmware on a board, see how a board fares, do without a board."""

import contextlib
import math
import os
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from spheremouse.calibrate.outputs import check_outputs
from spheremouse.commands.calibrate.options import Force, Json
from spheremouse.errors import ConfigurationError, OutputError
from spheremouse.files.atomic import write_json
from spheremouse.files.service import service_files
from spheremouse.output.serial import BAUD, SLOWEST, Serial, firmware
from spheremouse.output.serial.firmware import Drive, words

app = typer.Typer(no_args_is_help=True, help="The board that is the mouse: install, check, simulate.")

_INTERVAL = 4e-3  # s, of a camera with 250 frames a second
_SHARE = 0.05  # of it, that sending may add
_BAD = 0.01  # share of frames that may come damaged before a line is called bad
_DAMAGE = "Share of bytes that are damaged, each way; above 3 a session may not come to begin."

_DriveOption = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="The board's drive, CIRCUITPY.  [default: the only one there]")
]


@app.command(epilog="Example: spheremouse firmware install")
def install(
    drive: _DriveOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace another program that is on the board.")] = False,
) -> None:
    """Copy the firmware to a board with CircuitPython (Raspberry Pi Pico and other RP2040 boards)."""
    source, board = service_files(firmware.PICO), _drive(drive)
    if too_old := _too_old(board):
        raise OutputError(f"{board.path}: {too_old}")
    others = firmware.foreign(source, board.path)
    if stays := _what_stays(board.path, others):
        raise OutputError(stays)
    if others and not force:
        raise OutputError(f"{board.path}: {', '.join(others)} of another program there; save them and use --force")
    new, old = firmware.version_of(source), firmware.version_of(board.path)
    if old is not None and new is not None and old > new and not force:
        raise OutputError(
            f"{board.path}: firmware {words(old)} there is newer than {words(new)} of this program; "
            "update spheremouse, or go back with --force"
        )
    names = firmware.stale(source, board.path)
    if not names:
        typer.echo(f"{board.path}: {board.board} has firmware {words(new)} already")
        return
    firmware.copy(source, board.path, names)
    typer.echo(f"{board.path}: firmware {words(new)} in place of {words(old)} on {board.board}: {', '.join(names)}")
    if not board.board.startswith("raspberry_pi_pico"):
        typer.echo("this board is no Raspberry Pi Pico: for two computers it must have pins named GP0 and GP1")
    typer.echo("eject the drive, pull the board and plug it in again; then: spheremouse firmware check")


@app.command(epilog="Example: spheremouse firmware check --port /dev/ttyACM1")
def check(
    drive: _DriveOption = None,
    port: Annotated[
        str, typer.Option(metavar="PORT", help="Serial port; auto finds the board, none asks no port.")
    ] = "auto",
    baud: Annotated[int, typer.Option(metavar="N", min=SLOWEST, help="Of a plain serial line.")] = BAUD,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Compare the firmware on the board's drive, the one that runs, and the one that belongs here."""
    if not port:
        raise OutputError("--port: is empty; write a port's name, auto or none")
    check_outputs([json_file], [drive], force)
    ours = firmware.version_of(service_files(firmware.PICO))
    found: dict[str, Any] = {"here": words(ours)}
    lines, wrong = [f"here: firmware {words(ours)}"], []
    with contextlib.suppress(_NoDriveError):
        found["drive"], line, wrong = _look(_drive(drive), ours)
        lines.append(line)
    if port != "none":
        try:
            identity, found["port"], faults = _ask(port, baud)
        except OutputError as e:
            if "drive" not in found:
                raise
            wrong.append(f"{e}; if the firmware has just been copied, pull the board and plug it in again")
        else:
            lines.append(f"{found['port']['port']}: {identity}; {found['port']['state']}")
            wrong += faults
            if ours is not None and identity.firmware != ours:
                wrong.append(_wrong_version(identity.firmware, ours, identity.kind))
    if len(found) == 1:
        raise OutputError(f"no board: no drive CIRCUITPY and no port asked; {_how()}")
    found["wrong"] = wrong
    printed = json_file is not None and write_json(json_file, found)
    if not printed:
        for line in [*lines, *wrong]:
            typer.echo(line)
    if wrong:
        raise typer.Exit(1)
    if not printed and port == "none":
        typer.echo("the drive is as it should be; whether it runs was not asked; next: spheremouse firmware check")
    elif not printed:
        typer.echo(f"all is well; next: spheremouse run --source ... --output serial:{port}")


@app.command(epilog="Example: spheremouse firmware simulate --link board --seconds 60")
def simulate(
    link: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Make a symbolic link to the port, to have a steady name.")
    ] = None,
    damage: Annotated[float, typer.Option(metavar="PERCENT", min=0.0, max=50.0, help=_DAMAGE)] = 0.0,
    baud: Annotated[
        int | None, typer.Option(metavar="N", min=SLOWEST, help="Speed of the line.  [default: any]")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="End after so long.  [default: Ctrl-C ends it]")
    ] = None,
) -> None:
    """A board without a board: a serial port on which the firmware answers; prints what its mouse does."""
    from spheremouse.capture.stopping import Stopping
    from spheremouse.output.serial.simulator import Simulator

    if link is not None:
        if not link.parent.is_dir():
            raise ConfigurationError(f"--link: there is no folder {link.parent}; make it, or choose another name")
        ours = link.is_symlink() and os.readlink(link).startswith(("/dev/pts/", "/dev/tty"))
        if os.path.lexists(link) and not ours:
            raise ConfigurationError(f"--link: {link} is there and is no link to a port; choose another name")
    with Stopping() as stopping, Simulator(damage / 100.0, baud=baud) as board:
        if link is not None:
            link.unlink(missing_ok=True)
            os.symlink(board.port, link)
        typer.echo(f"{link or board.port}: a simulated board; try: spheremouse demo, then")
        typer.echo(f"  spheremouse run --source dataset:demo/roll --output serial:{link or board.port}")
        try:
            before: tuple[Any, ...] = ()
            until = None if seconds is None else time.monotonic() + seconds
            while not stopping.asked and (until is None or time.monotonic() < until):
                state = (*board.moved, board.buttons, board.device.running)
                if state != before:
                    x, y, wheel, pan, buttons, running = before = state
                    typer.echo(
                        f"X {x:+d} Y {y:+d} wheel {wheel:+d} pan {pan:+d} buttons {buttons:05b} "
                        f"{'session' if running else 'waits'}"
                    )
                time.sleep(0.2 if until is None else min(0.2, max(0.0, until - time.monotonic())))
        finally:
            if link is not None:
                link.unlink(missing_ok=True)
    x, y, wheel, pan = board.moved
    typer.echo(f"in all: X {x:+d} Y {y:+d} wheel {wheel:+d} pan {pan:+d} in {board.reports} reports")


@app.command(epilog="Example: spheremouse firmware measure --rate 1000 --seconds 20")
def measure(
    rate: Annotated[float, typer.Option(metavar="HZ", min=1.0, max=2000.0, help="Motions per second.")] = 1000.0,
    seconds: Annotated[float, typer.Option(metavar="S", min=0.1, max=3600.0, help="For how long.")] = 10.0,
    damage: Annotated[float, typer.Option(metavar="PERCENT", min=0.0, max=50.0, help=_DAMAGE)] = 0.0,
    baud: Annotated[
        int | None, typer.Option(metavar="N", min=SLOWEST, help="Speed of the line.  [default: any]")
    ] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Measure what sending costs, against a simulated board in a process of its own, whose times are in it."""
    from spheremouse.output.serial.benchmark import measure as measured

    check_outputs([json_file], [], force)
    m = measured(rate, max(2, int(rate * seconds)), damage / 100.0, baud)
    figures = {
        "rate": m.rate,
        "motions": len(m.call),
        "reports": m.reports,
        "exact": m.exact,
        "damage": damage / 100.0,
        "baud": baud,
        "call_us": _quantiles(m.call),
        "latency_us": _quantiles(m.latency),
        "round_trip_us": {"median": _us(m.line.round_trip[0]), "p99": _us(m.line.round_trip[1])},
        "call_share_of_250_Hz": float(np.median(m.call)) / _INTERVAL,
        "latency_share_of_250_Hz": float(np.median(m.latency)) / _INTERVAL if len(m.latency) else None,
    }
    printed = json_file is not None and write_json(json_file, figures)
    if not printed:
        _print(figures)
        typer.echo(f"line: {m.line}")
    if not m.exact:
        raise typer.Exit(1)


# ---- within ----


class _NoDriveError(OutputError):
    """No board's drive is mounted."""


def _print(figures: dict[str, Any]) -> None:
    exact = "exact" if figures["exact"] else "OFF"
    typer.echo(
        f"{figures['motions']} motions at {figures['rate']:.1f}/s, {figures['reports']} reports; the sum is {exact}"
    )
    for name, key in (("in send()", "call_us"), ("to the board's report", "latency_us")):
        q = figures[key]
        if q is None:
            typer.echo(f"{name:22} none arrived")
        else:
            typer.echo(f"{name:22} median {q['median']:.0f} µs, 99 % {q['p99']:.0f} µs, worst {q['max']:.0f} µs")
    if (share := figures["latency_share_of_250_Hz"]) is not None:
        typer.echo(f"median latency {100 * share:.1f} % of a 250 Hz interval (asked for: {100 * _SHARE:.0f} % at most)")


def _us(seconds: float) -> float | None:
    """As JSON can hold it."""
    return None if math.isnan(seconds) else 1e6 * seconds


def _quantiles(seconds: Any) -> dict[str, float] | None:
    if not len(seconds):
        return None
    return {
        "median": 1e6 * float(np.median(seconds)),
        "p99": 1e6 * float(np.quantile(seconds, 0.99)),
        "max": 1e6 * float(np.max(seconds)),
    }


def _drive(path: Path | None) -> Drive:
    if path is not None:
        return firmware.read_drive(path)
    found = firmware.drives()
    if len(found) == 1:
        return found[0]
    if found:
        raise OutputError(f"several boards: {', '.join(str(d.path) for d in found)}; name one with --drive")
    waiting = firmware.in_boot_loader()
    if waiting:
        raise _NoDriveError(
            f"{waiting[0]}: a board without CircuitPython; copy its .uf2 file there "
            "(https://circuitpython.org/downloads), wait until the drive is called CIRCUITPY, and repeat"
        )
    raise _NoDriveError(
        "no drive CIRCUITPY is mounted; if the board has CircuitPython, mount its drive and name it with --drive, or "
        f"take the jumper off pins 28 and 29 and plug it in again; if not, {_how()}"
    )


def _how() -> str:
    return (
        "hold BOOTSEL down while you plug the board in, copy CircuitPython's .uf2 file for your board "
        "(https://circuitpython.org/downloads) to the drive RPI-RP2 or RP2350 that appears, and wait for the drive "
        "CIRCUITPY"
    )


def _too_old(board: Drive) -> str | None:
    if board.circuitpython >= firmware.OLDEST:
        return None
    found, least = (".".join(map(str, v)) for v in (board.circuitpython, firmware.OLDEST))
    return f"CircuitPython {found} is too old; install {least} or newer: {_how()}"


def _what_stays(path: Path, others: list[str]) -> str | None:
    """The fault that `--force` cannot mend; None: there is none."""
    for name in others:
        if (path / name).is_dir():
            return f"{path / name}: is a folder, where a file has to be; move it away"
        if name not in firmware.FILES:
            return f"{path / name}: CircuitPython runs it in place of our program; move it away"
    return None


def _look(board: Drive, ours: firmware.Version | None) -> tuple[dict[str, Any], str, list[str]]:
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
    if too_old := _too_old(board):
        return [too_old]
    if others := firmware.foreign(source, board.path):
        stays = _what_stays(board.path, others)
        return [
            stays
            or f"{', '.join(others)} on the drive belong to another program; save them and run "
            "`spheremouse firmware install --force`"
        ]
    if there is not None and ours is not None and there > ours:
        return [f"firmware {words(there)} on the drive is newer than this program; update spheremouse"]
    stale = firmware.stale(source, board.path)
    return [f"{', '.join(stale)} on the drive differ; run `spheremouse firmware install`"] if stale else []


def _wrong_version(runs: firmware.Version, ours: firmware.Version, kind: int) -> str:
    if runs > ours:
        return f"firmware {words(runs)} runs, which is newer than this program; update spheremouse"
    how = {
        1: "pull the board and plug it in again, or run `spheremouse firmware install`",
        2: "load the new one as docs/microcontroller.md says for the ATmega32U4 (make upload)",
    }.get(kind, "start it again")
    return f"firmware {words(runs)} runs; {how}"


def _ask(port: str, baud: int) -> tuple[Any, dict[str, Any], list[str]]:
    """Identity of the board that answers, how it fares, and what is wrong with that."""
    from spheremouse.output.serial.messages import Flags
    from spheremouse.output.serial.ports import find_board

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
