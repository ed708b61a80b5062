"""`spheremouse tray`: the daemon's state as an icon beside the desktop's clock."""

import sys
from pathlib import Path
from typing import Annotated

import typer


def tray(
    socket: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="The daemon's socket.  [default: $SPHEREMOUSE_SOCKET, else where one answers]"
        ),
    ] = None,
    at_login: Annotated[
        bool,
        typer.Option(
            "--at-login", help="As a desktop starts it: where no tray can be had, say so and end, exit code 0."
        ),
    ] = False,
) -> None:
    """Show the daemon's state in the desktop's tray, with a menu.

    Colour and sign of the icon are the state; the menu re-initialises the camera pose, pauses, and records a minute for
    a bug report. It goes on when the daemon ends and waits for the next.
    """
    from spheremouse.commands.tray.icon import Tray, TrayError

    try:
        Tray(socket, _say).run()
    except TrayError as e:
        if not at_login:
            raise
        _say(str(e))


def _say(text: str) -> None:
    print(f"spheremouse tray: {text}", file=sys.stderr, flush=True)
