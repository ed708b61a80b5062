"""`spheremouse tray`: show the daemon's state as an icon in the desktop's tray."""

import sys
from typing import Annotated

import typer

from spheremouse.commands.options import Socket


def tray(
    socket: Socket = None,
    at_login: Annotated[
        bool,
        typer.Option(
            "--at-login", help="For the start by a desktop: if there is no tray, print why and end with exit code 0."
        ),
    ] = False,
) -> None:
    """Show the daemon's state in the desktop's tray, with a menu.

    Colour and sign of the icon are the state. The menu estimates the camera pose again, pauses, and records a minute
    for a bug report. If the daemon ends, the tray waits for the next one.
    """
    from spheremouse.commands.tray.icon import Tray, TrayError

    try:
        Tray(socket, _log).run()
    except TrayError as e:
        if not at_login:
            raise
        _log(str(e))


def _log(text: str) -> None:
    print(f"spheremouse tray: {text}", file=sys.stderr, flush=True)
