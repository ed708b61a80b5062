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
) -> None:
    """Show the daemon's state in the desktop's tray, with a menu.

    Colour and sign of the icon are the state; the menu re-initialises the camera pose, pauses, and records a minute for
    a bug report. It goes on when the daemon ends and waits for the next. It needs pystray: pip install
    'spheremouse[tray]'.
    """
    from spheremouse.commands.tray.icon import Tray

    Tray(socket, lambda text: print(f"spheremouse tray: {text}", file=sys.stderr, flush=True)).run()
