"""`ws:HOST:PORT[,format=NAME][,origin=URL]`: a WebSocket server that sends each line as a message, for browsers.

`ws:PORT` listens on this computer alone. A page may connect if a server on loopback gave it to the browser.
`origin=https://example.org` admits the pages of another server, `origin=null` pages from files, and `origin=*` all.
Pages from files are not admitted without it, because a sandboxed frame of any page has the origin null, too. A program
that is no browser names no origin, and may connect. A client that does not read is dropped when its buffer is full.
"""

import re
from functools import partial
from typing import Any

from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from spheremouse.finding import Finding
from spheremouse.output.line_server import Client, LineServer
from spheremouse.output.lines import LineFormat, parse_target
from spheremouse.output.network import parse_host, probe_port

_LOCAL_PAGE = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
_GOING_AWAY = 1001
_TEXT = b"\x81"  # first byte of a final text frame


class _Client(Client):
    """WebSocket, RFC 6455, without input or output."""

    ready = False

    def __init__(self, protocol: ServerProtocol) -> None:
        self._protocol = protocol

    def receive(self, data: bytes) -> tuple[bytes, bool]:
        self._protocol.receive_data(data) if data else self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if isinstance(event, Request):
                self._protocol.send_response(self._protocol.accept(event))
        self.ready = self._protocol.state is State.OPEN
        parts = self._protocol.data_to_send()
        over = b"" in parts or not data
        return b"".join(parts), not over

    def last_bytes(self) -> bytes:
        if self.ready:
            self._protocol.send_close(_GOING_AWAY)
        return b"".join(self._protocol.data_to_send())


class WebSocket(LineServer):
    """Sends lines as messages to the clients of a WebSocket server."""

    def __init__(self, name: str, host: str, port: int, form: LineFormat, origin: str) -> None:
        """`origin` is admitted besides local pages; `*` admits all."""
        origins: list[Any] | None = None if origin == "*" else [None, _LOCAL_PAGE, origin or None]
        connect = partial(ServerProtocol, origins=origins, max_size=4096)
        super().__init__(name, host, port, form, lambda: _Client(connect()))

    def encode(self, line: bytes) -> bytes:
        """Return the line as a text frame (RFC 6455, section 5.2); the library's takes 20 times as long."""
        n = len(line) - 1  # without its end
        size = n.to_bytes(1) if n < 126 else b"\x7e" + n.to_bytes(2) if n < 1 << 16 else b"\x7f" + n.to_bytes(8)
        return _TEXT + size + line[:-1]


def open(argument: str) -> WebSocket:
    return WebSocket(f"ws:{argument}", *check(argument))


def check(argument: str) -> tuple[str, int, LineFormat, str]:
    """Return host, port, format and origin, which is empty if not given. Raise OutputError if one is invalid."""
    address, form, options = parse_target("ws", argument, {"origin": str})
    return *parse_host("ws", address), form, str(options.get("origin", ""))


def probe(argument: str) -> list[Finding]:
    host, port, *_ = check(argument)
    return probe_port("ws", host, port)
