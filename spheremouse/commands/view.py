"""`spheremouse view`: serve the live page of the running daemon."""

from pathlib import Path
from typing import Annotated

import typer

from spheremouse.errors import ControlError
from spheremouse.view.access import (
    ADDRESS,
    PORT,
    Access,
    own_token,
    owners_address,
    present_token,
    read_token,
    token_path,
)


def view(
    address: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Network address of the page. Only its owner may open one beyond this computer; it is not encrypted.",
        ),
    ] = ADDRESS,
    port: Annotated[int, typer.Option(min=1, max=65535, help="TCP port.")] = PORT,
    names: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="HOST", help="A name of this computer in browsers, besides its own. Repeats."),
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File with the token of the owner; made if missing.  [default: view.token in the state folder]",
        ),
    ] = None,
    socket: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="The daemon's socket.  [default: $SPHEREMOUSE_SOCKET, else where one answers]"
        ),
    ] = None,
    url: Annotated[bool, typer.Option("--url", help="Print the owner's address of the page, and exit.")] = False,
) -> None:
    """Serve the live page: picture, motion, settings, log and doctor of the running daemon, in a browser.

    It is a process of its own. The daemon need not run yet. Without the token in its address, the page
    shows the ball and the targets alone, and can change nothing.
    """
    if url:
        print(owners_address(address, port, read_token(token_file or present_token())))
    else:
        _serve(address, port, names or [], own_token(token_file or token_path()), socket)


def _serve(address: str, port: int, names: list[str], token: str, socket: Path | None) -> None:
    import socket as sockets

    from spheremouse.view.server import application, server

    try:
        listener = sockets.create_server(
            (address, port), family=sockets.AF_INET6 if ":" in address else sockets.AF_INET, backlog=64
        )
    except OSError as e:
        hint = "choose another --port" if e.errno == 98 else "choose another --address"
        reason = str(e.strerror).partition(" (while")[0]
        raise ControlError(f"{address}:{port}: cannot be opened ({reason})", hint) from None
    with listener:
        typer.echo(f"live page: {owners_address(address, port, token)}", err=True)
        server(application(socket, Access(token, port, names)), address, port).run([listener])
