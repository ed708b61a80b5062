"""`spheremouse firmware`: install the firmware on a board, check a board, simulate one, measure the line."""

import contextlib
import os
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from spheremouse.calibrate.outputs import check_outputs
from spheremouse.commands.calibrate.options import Force
from spheremouse.commands.options import JsonFile
from spheremouse.errors import ConfigurationError, OutputError
from spheremouse.files.safe_files import write_json

app = typer.Typer(no_args_is_help=True, help="The board that is the mouse: install, check, simulate.")

_Drive = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="The board's drive, CIRCUITPY.  [default: the only one there]")
]
_Damage = Annotated[
    float,
    typer.Option(
        metavar="PERCENT", min=0.0, max=50.0, help="Damaged bytes, each way; above 3 a session may never begin."
    ),
]
_Baud = Annotated[int | None, typer.Option(metavar="N", help="Speed of the line.  [default: any]")]


@app.command(epilog="Example: spheremouse firmware install")
def install(
    drive: _Drive = None,
    force: Annotated[bool, typer.Option("--force", help="Replace another program that is on the board.")] = False,
) -> None:
    """Copy the firmware to a board with CircuitPython (Raspberry Pi Pico and other RP2040 boards)."""
    from spheremouse.commands.firmware.board import select_drive, unremovable_file, unsupported_version
    from spheremouse.files.access import service_files
    from spheremouse.output.serial import firmware
    from spheremouse.output.serial.firmware import format_version

    source, board = service_files(firmware.PICO), select_drive(drive)
    if problem := unsupported_version(board):
        raise OutputError(f"{board.path}: {problem}")
    others = firmware.foreign(source, board.path)
    if problem := unremovable_file(board.path, others):
        raise OutputError(problem)
    if others and not force:
        raise OutputError(f"{board.path}: {', '.join(others)} of another program there; save them and use --force")
    new, old = firmware.version_of(source), firmware.version_of(board.path)
    if old is not None and new is not None and old > new and not force:
        raise OutputError(
            f"{board.path}: firmware {format_version(old)} there is newer than {format_version(new)} of this program; "
            "update spheremouse, or go back with --force"
        )
    names = firmware.stale(source, board.path)
    if not names:
        typer.echo(f"{board.path}: {board.board} has firmware {format_version(new)} already")
        return
    firmware.copy(source, board.path, names)
    versions = f"firmware {format_version(new)} in place of {format_version(old)}"
    typer.echo(f"{board.path}: {versions} on {board.board}: {', '.join(names)}")
    if not board.board.startswith("raspberry_pi_pico"):
        typer.echo("this board is no Raspberry Pi Pico: for two computers it must have pins named GP0 and GP1")
    typer.echo("eject the drive, pull the board and plug it in again; then: spheremouse firmware check")


@app.command(epilog="Example: spheremouse firmware check --port /dev/ttyACM1")
def check(
    drive: _Drive = None,
    port: Annotated[
        str, typer.Option(metavar="PORT", help="Serial port; auto finds the board, none skips this check.")
    ] = "auto",
    baud: Annotated[
        int | None, typer.Option(metavar="N", help="Speed of a plain serial line.  [default: 115200]")
    ] = None,
    json_file: JsonFile = None,
    force: Force = False,
) -> None:
    """Compare the firmware on the board's drive, the one that runs, and the one of this program."""
    from spheremouse.commands.firmware.board import (
        BOOTSEL_STEPS,
        NoDriveError,
        examine_drive,
        examine_port,
        other_version,
        select_drive,
    )
    from spheremouse.files.access import service_files
    from spheremouse.output.serial import BAUD, firmware, validate_baud
    from spheremouse.output.serial.firmware import format_version

    speed = BAUD if baud is None else validate_baud(baud, "--baud")
    if not port:
        raise OutputError("--port: is empty; write a port's name, auto or none")
    check_outputs([json_file], [drive], force)
    ours = firmware.version_of(service_files(firmware.PICO))
    found: dict[str, Any] = {"here": format_version(ours)}
    lines, wrong = [f"here: firmware {format_version(ours)}"], []
    with contextlib.suppress(NoDriveError):
        found["drive"], line, wrong = examine_drive(select_drive(drive), ours)
        lines.append(line)
    if port != "none":
        try:
            identity, found["port"], problems = examine_port(port, speed)
        except OutputError as e:
            if "drive" not in found:
                raise
            wrong.append(f"{e}; if the firmware has just been copied, pull the board and plug it in again")
        else:
            lines.append(f"{found['port']['port']}: {identity}; {found['port']['state']}")
            wrong += problems
            if ours is not None and identity.firmware != ours:
                wrong.append(other_version(identity.firmware, ours, identity.kind))
    if len(found) == 1:
        raise OutputError(f"no board: no drive CIRCUITPY, and --port none; {BOOTSEL_STEPS}")
    found["wrong"] = wrong
    printed = json_file is not None and write_json(json_file, found)
    if not printed:
        for line in [*lines, *wrong]:
            typer.echo(line)
    if wrong:
        raise typer.Exit(1)
    if not printed and port == "none":
        typer.echo("the drive is up to date; to check the running firmware: spheremouse firmware check")
    elif not printed:
        typer.echo(f"all is well; next: spheremouse run --source ... --output serial:{port}")


@app.command(epilog="Example: spheremouse firmware simulate --link board --seconds 60")
def simulate(
    link: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Make a symbolic link to the port, as a constant name.")
    ] = None,
    damage: _Damage = 0.0,
    baud: _Baud = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="End after this time.  [default: at Ctrl-C]")
    ] = None,
) -> None:
    """Simulate a board: open a serial port on which the firmware answers, and print the motion of its mouse."""
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.output.serial import validate_baud
    from spheremouse.output.serial.simulator import Simulator

    if baud is not None:
        validate_baud(baud, "--baud")
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
            printed: tuple[Any, ...] = ()
            end = None if seconds is None else time.monotonic() + seconds
            while not stopping.asked and (end is None or time.monotonic() < end):
                state = (*board.moved, board.buttons, board.device.running)
                if state != printed:
                    x, y, wheel, pan, buttons, running = printed = state
                    typer.echo(
                        f"X {x:+d} Y {y:+d} wheel {wheel:+d} pan {pan:+d} buttons {buttons:05b} "
                        f"{'session' if running else 'waits'}"
                    )
                time.sleep(0.2 if end is None else min(0.2, max(0.0, end - time.monotonic())))
        finally:
            if link is not None:
                link.unlink(missing_ok=True)
    x, y, wheel, pan = board.moved
    typer.echo(f"in all: X {x:+d} Y {y:+d} wheel {wheel:+d} pan {pan:+d} in {board.reports} reports")


@app.command(epilog="Example: spheremouse firmware measure --rate 1000 --seconds 20")
def measure(
    rate: Annotated[float, typer.Option(metavar="HZ", min=1.0, max=2000.0, help="Motions per second.")] = 1000.0,
    seconds: Annotated[float, typer.Option(metavar="S", min=0.1, max=3600.0, help="Duration.")] = 10.0,
    damage: _Damage = 0.0,
    baud: _Baud = None,
    json_file: JsonFile = None,
    force: Force = False,
) -> None:
    """Measure the time of sending to a simulated board, which runs in its own process. The time includes it."""
    from spheremouse.output.serial import validate_baud
    from spheremouse.output.serial.benchmark import measure as run_benchmark

    if baud is not None:
        validate_baud(baud, "--baud")
    check_outputs([json_file], [], force)
    measured = run_benchmark(rate, max(2, int(rate * seconds)), damage / 100.0, baud)
    if json_file is None or not write_json(json_file, measured.figures(damage / 100.0, baud)):
        for line in measured.lines():
            typer.echo(line)
    if not measured.exact:
        raise typer.Exit(1)
