"""`spheremouse firmware`: put the firmware on a board, see how a board fares, do without a board."""

import contextlib
import os
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from spheremouse.calibrate.outputs import check_outputs
from spheremouse.commands.calibrate.options import Force, Json
from spheremouse.errors import ConfigurationError, OutputError
from spheremouse.files.atomic import write_json

app = typer.Typer(no_args_is_help=True, help="The board that is the mouse: install, check, simulate.")

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
    from spheremouse.commands.firmware.board import board_at, too_old, what_stays
    from spheremouse.files.service import service_files
    from spheremouse.output.serial import firmware
    from spheremouse.output.serial.firmware import words

    source, board = service_files(firmware.PICO), board_at(drive)
    if fault := too_old(board):
        raise OutputError(f"{board.path}: {fault}")
    others = firmware.foreign(source, board.path)
    if stays := what_stays(board.path, others):
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
    baud: Annotated[
        int | None, typer.Option(metavar="N", help="Speed of a plain serial line.  [default: 115200]")
    ] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Compare the firmware on the board's drive, the one that runs, and the one that belongs here."""
    from spheremouse.commands.firmware.board import NoDriveError, ask, board_at, how, look, wrong_version
    from spheremouse.files.service import service_files
    from spheremouse.output.serial import BAUD, check_speed, firmware
    from spheremouse.output.serial.firmware import words

    speed = BAUD if baud is None else check_speed(baud, "--baud")
    if not port:
        raise OutputError("--port: is empty; write a port's name, auto or none")
    check_outputs([json_file], [drive], force)
    ours = firmware.version_of(service_files(firmware.PICO))
    found: dict[str, Any] = {"here": words(ours)}
    lines, wrong = [f"here: firmware {words(ours)}"], []
    with contextlib.suppress(NoDriveError):
        found["drive"], line, wrong = look(board_at(drive), ours)
        lines.append(line)
    if port != "none":
        try:
            identity, found["port"], faults = ask(port, speed)
        except OutputError as e:
            if "drive" not in found:
                raise
            wrong.append(f"{e}; if the firmware has just been copied, pull the board and plug it in again")
        else:
            lines.append(f"{found['port']['port']}: {identity}; {found['port']['state']}")
            wrong += faults
            if ours is not None and identity.firmware != ours:
                wrong.append(wrong_version(identity.firmware, ours, identity.kind))
    if len(found) == 1:
        raise OutputError(f"no board: no drive CIRCUITPY and no port asked; {how()}")
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
    baud: Annotated[int | None, typer.Option(metavar="N", help="Speed of the line.  [default: any]")] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="End after so long.  [default: Ctrl-C ends it]")
    ] = None,
) -> None:
    """A board without a board: a serial port on which the firmware answers; prints what its mouse does."""
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.output.serial import check_speed
    from spheremouse.output.serial.simulator import Simulator

    if baud is not None:
        check_speed(baud, "--baud")
    if link is not None:
        if not link.parent.is_dir():
            raise ConfigurationError(f"--link: there is no folder {link.parent}; make it, or choose another name")
        ours = link.is_symlink() and os.readlink(link).startswith(("/dev/pts/", "/dev/tty"))
        if os.path.lexists(link) and not ours:
            raise ConfigurationError(f"--link: {link} is there and is no link to a port; choose another name")
    with SignalHandler() as stopping, Simulator(damage / 100.0, baud=baud) as board:
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
    baud: Annotated[int | None, typer.Option(metavar="N", help="Speed of the line.  [default: any]")] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Measure what sending costs, against a simulated board in a process of its own, whose times are in it."""
    from spheremouse.commands.firmware.figures import figures, print_figures
    from spheremouse.output.serial import check_speed
    from spheremouse.output.serial.benchmark import measure as measured

    if baud is not None:
        check_speed(baud, "--baud")
    check_outputs([json_file], [], force)
    m = measured(rate, max(2, int(rate * seconds)), damage / 100.0, baud)
    found = figures(m, damage / 100.0, baud)
    printed = json_file is not None and write_json(json_file, found)
    if not printed:
        print_figures(found)
        typer.echo(f"line: {m.line}")
    if not m.exact:
        raise typer.Exit(1)
