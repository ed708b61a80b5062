"""`spheremouse firmware`: put the firmware on a board, see how a board fares, do without a board."""

import contextlib
import json
import os
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from spheremouse import firmware
from spheremouse.errors import ConfigurationError, OutputError
from spheremouse.firmware import Drive, words

app = typer.Typer(no_args_is_help=True, help="The board that is the mouse: install, check, simulate.")

_INTERVAL = 4e-3  # s, of a camera with 250 frames a second
_SHARE = 0.05  # of it, that sending may add

_DriveOption = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="The board's drive, CIRCUITPY.  [default: the only one there]")
]


@app.command(epilog="Example: spheremouse firmware install")
def install(
    drive: _DriveOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace another program that is on the board.")] = False,
) -> None:
    """Copy the firmware to a board with CircuitPython (Raspberry Pi Pico and other RP2040 boards)."""
    source, board = firmware.folder(), _drive(drive)
    if board.circuitpython < firmware.OLDEST:
        found, least = (".".join(map(str, v)) for v in (board.circuitpython, firmware.OLDEST))
        raise OutputError(f"{board.path}: CircuitPython {found} is too old; install {least} or newer: {_how()}")
    others = firmware.foreign(source, board.path)
    if others and not force:
        raise OutputError(f"{board.path}: {', '.join(others)} of another program there; save them and use --force")
    new, old = firmware.version_of(source), firmware.version_of(board.path)
    names = firmware.stale(source, board.path)
    if not names:
        typer.echo(f"{board.path}: {board.board} has firmware {words(new)} already")
        return
    firmware.copy(source, board.path, names)
    typer.echo(f"{board.path}: firmware {words(new)} in place of {words(old)} on {board.board}: {', '.join(names)}")
    typer.echo("eject the drive, pull the board and plug it in again; then: spheremouse firmware check")


@app.command(epilog="Example: spheremouse firmware check --port /dev/ttyACM1")
def check(
    drive: _DriveOption = None,
    port: Annotated[
        str, typer.Option(metavar="PORT", help="Serial port; auto finds the board, none asks no port.")
    ] = "auto",
    baud: Annotated[int, typer.Option(metavar="N", help="Of a plain serial line.")] = 115200,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write what was found; - prints.")
    ] = None,
) -> None:
    """Compare the firmware on the board's drive, the one that runs, and the one that belongs here."""
    source = firmware.folder()
    ours = firmware.version_of(source)
    found: dict[str, Any] = {"here": words(ours)}
    wrong: list[str] = []
    lines = [f"here: firmware {words(ours)}"]
    with contextlib.suppress(_NoDriveError):
        board = _drive(drive)
        stale = firmware.stale(source, board.path)
        there = firmware.version_of(board.path)
        found["drive"] = {"path": str(board.path), "board": board.board, "version": words(there), "stale": stale}
        lines.append(f"drive {board.path}: {board.board}, firmware {words(there)}")
        if stale:
            wrong.append(f"{', '.join(stale)} on the drive differ; run `spheremouse firmware install`")
    identity = None
    if port != "none":
        try:
            identity, text = _ask(port, baud)
        except OutputError as e:
            if "drive" not in found:
                raise
            wrong.append(f"{e}; if the firmware has just been copied, pull the board and plug it in again")
        else:
            found["port"] = text
            lines.append(f"{text['port']}: {identity}; {text['state']}")
    if identity is not None and identity.firmware != ours and identity.kind == 1:
        wrong.append(
            f"firmware {words(identity.firmware)} runs; pull the board and plug it in again, "
            "or run `spheremouse firmware install`"
        )
    if len(found) == 1:
        raise OutputError(f"no board: no drive CIRCUITPY and no port asked; {_how()}")
    found["wrong"] = wrong
    if json_file == Path("-"):
        typer.echo(json.dumps(found, indent=1))
    else:
        for line in [*lines, *wrong]:
            typer.echo(line)
        if json_file is not None:
            from spheremouse.yaml_file import write_atomically

            write_atomically(json_file, json.dumps(found, indent=1) + "\n")
    if wrong:
        raise typer.Exit(1)
    if json_file != Path("-"):
        typer.echo(f"all is well; next: spheremouse run --source ... --output serial:{port}")


@app.command(epilog="Example: spheremouse firmware simulate --link board --seconds 60")
def simulate(
    link: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Make a symbolic link to the port, to have a steady name.")
    ] = None,
    damage: Annotated[
        float, typer.Option(metavar="PERCENT", min=0.0, max=50.0, help="Share of bytes that are damaged, each way.")
    ] = 0.0,
    baud: Annotated[int | None, typer.Option(metavar="N", min=1200, help="Speed of the line.  [default: any]")] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="End after so long.  [default: Ctrl-C ends it]")
    ] = None,
) -> None:
    """A board without a board: a serial port on which the firmware answers; prints what its mouse does."""
    from spheremouse.output._serial_simulator import Simulator
    from spheremouse.stopping import Stopping

    if link is not None and (link.exists() and not link.is_symlink()):
        raise ConfigurationError(f"--link: {link} is there and is no link; choose another name")
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
    damage: Annotated[
        float, typer.Option(metavar="PERCENT", min=0.0, max=50.0, help="Share of bytes that are damaged, each way.")
    ] = 0.0,
    baud: Annotated[int | None, typer.Option(metavar="N", min=1200, help="Speed of the line.  [default: any]")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
) -> None:
    """Measure what sending costs, against a simulated board in a process of its own, whose times are in it."""
    from spheremouse.output._serial_benchmark import measure as measured
    from spheremouse.yaml_file import write_atomically

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
        "round_trip_us": {"median": 1e6 * m.line.round_trip[0], "p99": 1e6 * m.line.round_trip[1]},
        "call_share_of_250_Hz": float(np.median(m.call)) / _INTERVAL,
        "latency_share_of_250_Hz": float(np.median(m.latency)) / _INTERVAL,
    }
    if json_file == Path("-"):
        typer.echo(json.dumps(figures, indent=1))
        return
    if json_file is not None:
        write_atomically(json_file, json.dumps(figures, indent=1) + "\n")
    exact = "exact" if m.exact else "OFF"
    typer.echo(f"{len(m.call)} motions at {m.rate:.1f}/s, {m.reports} reports; the sum is {exact}")
    for name, key in (("in send()", "call_us"), ("to the board's report", "latency_us")):
        q = figures[key]
        typer.echo(f"{name:22} median {q['median']:.0f} µs, 99 % {q['p99']:.0f} µs, worst {q['max']:.0f} µs")
    share = figures["latency_share_of_250_Hz"]
    typer.echo(f"median latency {100 * share:.1f} % of a 250 Hz interval (asked for: {100 * _SHARE:.0f} % at most)")
    typer.echo(f"line: {m.line}")


# ---- within ----


class _NoDriveError(OutputError):
    """No board's drive is mounted."""


def _quantiles(seconds: Any) -> dict[str, float]:
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
    raise _NoDriveError(f"no drive CIRCUITPY is mounted; {_how()}")


def _how() -> str:
    return (
        "hold BOOTSEL down while you plug the board in, copy CircuitPython's .uf2 file for your board "
        "(https://circuitpython.org/downloads) to the drive RPI-RP2 that appears, and wait for the drive CIRCUITPY"
    )


def _ask(port: str, baud: int) -> tuple[Any, dict[str, Any]]:
    """Identity of the board that answers, and how it fares."""
    from spheremouse.output.serial import Serial, find_board

    name = find_board() if port == "auto" else port
    output = Serial(lambda: name, baud, "none", lambda _: None)
    try:
        identity, status = output.identity, output.status()
    finally:
        output.close()
    if identity is None or status is None:
        raise OutputError(f"serial: {name}: answers, but does not say how it fares; pull the board, plug it in again")
    ready = "its computer takes the mouse" if status.flags & 0x04 else "its computer sleeps or is not connected"
    state = (
        f"up {status.uptime} s, {ready}; {status.frames} frames, {status.damaged} damaged, {status.refused} refused, "
        f"{status.lost} lost; {status.reports} reports, {status.usb_errors} USB errors"
    )
    return identity, {
        "port": name,
        "firmware": words(identity.firmware),
        "board": identity.board,
        "kind": identity.kind,
        "state": state,
    }
