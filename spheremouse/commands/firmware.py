"""`spheremouse firmware`: install the firmware on a board, or check a board."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.calibrate.outputs import check_outputs
from spheremouse.commands.options import Force, JsonFile
from spheremouse.errors import OutputError
from spheremouse.files.safe_files import write_json

if TYPE_CHECKING:
    from spheremouse.output.serial.firmware import Version
    from spheremouse.output.serial.messages import Status

_MAX_DAMAGED = 0.01  # fraction of damaged frames on a good line

app = typer.Typer(no_args_is_help=True, help="The board that is the mouse: install, check.")


@app.command(epilog="Example: spheremouse firmware install")
def install(
    drive: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="The board's drive, CIRCUITPY.  [default: the only one there]")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace another program that is on the board.")] = False,
) -> None:
    """Copy the firmware to a board with CircuitPython (Raspberry Pi Pico and other RP2040 boards)."""
    from spheremouse.output.serial import firmware

    board = drive or firmware.find_drive()
    new, old = firmware.format_version(firmware.own_version()), firmware.format_version(firmware.version_of(board))
    names = firmware.install(board, force)
    if not names:
        typer.echo(f"{board}: has firmware {new} already")
        return
    typer.echo(f"{board}: firmware {new} in place of {old}: {', '.join(names)}")
    typer.echo("eject the drive, pull the board and plug it in again; then: spheremouse firmware check")


@app.command(epilog="Example: spheremouse firmware check --port /dev/ttyACM1")
def check(
    port: Annotated[str, typer.Option(metavar="PORT", help="Serial port; auto finds the board.")] = "auto",
    baud: Annotated[
        int | None, typer.Option(metavar="N", help="Speed of a serial adapter; USB ignores it.  [default: 115200]")
    ] = None,
    json_file: JsonFile = None,
    force: Force = False,
) -> None:
    """Print a board's firmware version, whether a computer uses its mouse, and its damaged frames.

    The exit code is 1 if the version is not this program's, no computer uses the mouse, or many frames are damaged.
    """
    from spheremouse.output.serial import BAUD, Serial, firmware, validate_baud
    from spheremouse.output.serial.ports import find_board

    speed = BAUD if baud is None else validate_baud(baud, "--baud")
    if not port:
        raise OutputError("--port: is empty", "write a port's name, or auto")
    check_outputs([json_file], [], force=force)
    name = find_board() if port == "auto" else port
    output = Serial(lambda: name, speed, "none", lambda _: None)
    try:
        identity, status = output.link.identity, output.status()
    finally:
        output.close()
    if identity is None or status is None:
        problem = f"serial: {name}: the board answered the greeting, but not the request for its status"
        raise OutputError(problem, "plug it in again; with an adapter, use shorter wires and connect GND")
    ours = firmware.own_version()
    wrong = [*_version_problems(identity.firmware, ours, identity.kind), *_line_problems(status)]
    found = {
        "here": firmware.format_version(ours),
        "port": {
            "port": name,
            "firmware": firmware.format_version(identity.firmware),
            "board": identity.board,
            "kind": identity.kind,
            "state": str(status),
        },
        "wrong": wrong,
    }
    if json_file is None or not write_json(json_file, found):
        typer.echo(f"here: firmware {found['here']}\n{name}: {identity}; {status}")
        spec = f"serial:{port}" if baud is None else f"serial:{port},baud={speed}"
        for line in wrong or [f"all is well; next: spheremouse run --source ... --output {spec}"]:
            typer.echo(line)
    if wrong:
        raise typer.Exit(1)


def _version_problems(runs: "Version", ours: "Version", kind: int) -> list[str]:
    if runs == ours:
        return []
    version = ".".join(map(str, runs))
    if runs > ours:
        return [f"firmware {version} runs, which is newer than this program; update spheremouse"]
    remedy = {
        1: "run `spheremouse firmware install`, pull the board and plug it in again",
        2: "load the new one (make upload; docs/microcontroller.md, ATmega32U4)",
    }.get(kind, "start it again")
    return [f"firmware {version} runs; {remedy}"]


def _line_problems(status: "Status") -> list[str]:
    wrong: list[str] = []
    if not status.usb_ready:
        wrong.append("no computer takes its mouse; plug the board into the game's computer, or wake that up")
    if status.damaged > _MAX_DAMAGED * (status.frames + status.damaged) + 2:  # the first frames may be damaged
        wrong.append(
            f"{status.damaged} damaged frames beside {status.frames} whole ones; use shorter wires, see that GND is "
            "connected, and plug the board in again to reset the count"
        )
    return wrong
