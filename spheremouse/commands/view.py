"""`spheremouse view`: serve the live page of the running daemon."""

import errno
import hmac
import secrets
from collections.abc import Sequence
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.options import Socket
from spheremouse.errors import ControlError
from spheremouse.files.token import own_token, read_token, token_files, token_path
from spheremouse.view.access import ADDRESS, PORT, PROOF, Access

if TYPE_CHECKING:
    from starlette.applications import Starlette

_ANSWER_S = 2.0  # s in which a page must prove its token
_PROOF_BYTES = 64


def view(
    address: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Network address of the page. From other computers it needs the token; it is not encrypted.",
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
    socket: Socket = None,
    cabinet: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder of the calibration, for the guide.  [default: cabinet]"),
    ] = None,
    source: Annotated[
        str | None, typer.Option(metavar="KIND:ARG", help="Camera for the guide.  [default: the first camera]")
    ] = None,
    url: Annotated[bool, typer.Option("--url", help="Print the owner's address of the page, and exit.")] = False,
) -> None:
    """Serve the live page: picture, motion, settings, log and doctor of the running daemon, in a browser.

    It is a process of its own. The daemon need not run yet. Without the token in the address, others on this
    computer see a masked picture, motion, settings and log, and can change nothing.
    """
    if url:
        print(page_address(address, port, [token_file] if token_file else token_files()))
    else:
        from spheremouse.view.guide import GuideOptions
        from spheremouse.view.server import application

        token = own_token(token_file or token_path())
        app = application(socket, Access(token, port, names or []), GuideOptions(cabinet, source))
        _serve(app, address, port, token)


def page_address(address: str, port: int, files: Sequence[Path]) -> str:
    """Return the owner's address of the page that runs at a port, or without one, with the token of the first file.

    The page proves which token it has. Raises ControlError if it is in none of the files, or a file cannot be read.
    """
    nonce = secrets.token_hex(16)
    proof = _proof(address, port, nonce)
    if proof is None:
        return _with_token(address, port, read_token(files[0]))
    trouble = ControlError(f"{address}:{port}: the page that runs there has another token", "give its --token-file")
    for file in files:
        try:
            token = read_token(file)
        except ControlError as e:
            trouble = e
            continue
        if hmac.compare_digest(proof, Access(token, port).proof(nonce).encode()):
            return _with_token(address, port, token)
    raise trouble


def _with_token(address: str, port: int, token: str) -> str:
    host = "localhost" if address in ("0.0.0.0", "::") else f"[{address}]" if ":" in address else address
    return f"http://{host}:{port}/?token={token}"


def _proof(address: str, port: int, nonce: str) -> bytes | None:
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(address, address)
    try:
        connection = HTTPConnection(host, port, timeout=_ANSWER_S)
        connection.request("GET", f"{PROOF}?nonce={nonce}")
        with connection.getresponse() as answer:
            return answer.read(_PROOF_BYTES) if answer.status == HTTPStatus.OK else None
    except (OSError, HTTPException):
        return None


def _serve(app: "Starlette", address: str, port: int, token: str) -> None:
    import socket as sockets

    from spheremouse.view.server import server

    try:
        listener = sockets.create_server(
            (address, port), family=sockets.AF_INET6 if ":" in address else sockets.AF_INET, backlog=64
        )
    except OSError as e:
        hint = "choose another --port" if e.errno == errno.EADDRINUSE else "choose another --address"
        reason = str(e.strerror).partition(" (while")[0]
        raise ControlError(f"{address}:{port}: cannot be opened ({reason})", hint) from None
    with listener:
        typer.echo(f"live page: {_with_token(address, port, token)}", err=True)
        server(app, address, port).run([listener])
