"""Addresses `HOST:PORT` of outputs to a network, and datagrams. `PORT` alone is a port of this computer."""

import contextlib
import errno
import os
import socket
from collections.abc import Callable
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, ok
from spheremouse.output import Output, Report

LOOPBACK = "127.0.0.1"
_HINTS = {  # by the number of the system's error
    errno.EADDRNOTAVAIL: "write an address of this computer, or 0.0.0.0 for all",
    errno.EACCES: "take a port above 1023",
}
_BUFFER_BYTES = 1 << 20  # unread data of a client; the system may allow less


def parse_host(kind: str, address: str) -> tuple[str, int]:
    """Return host and port of `HOST:PORT`, or loopback and port of `PORT`. Raise OutputError otherwise."""
    host, _, port = address.rpartition(":")
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise OutputError(f"{kind}:{address}: is not HOST:PORT", f"write for example {kind}:{LOOPBACK}:9000")
    return host.removeprefix("[").removesuffix("]") or LOOPBACK, int(port)


def resolve(name: str, host: str, port: int, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Any]:
    """Return family and numeric address of a host. Raise OutputError if it is unknown; `name` begins the message."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind)[0]
    except (OSError, UnicodeError) as e:
        raise OutputError(f"{name}: unknown host: {getattr(e, 'strerror', None) or e}") from None
    return family, address


def probe_port(kind: str, host: str, port: int) -> list[Finding]:
    """Bind a port for a moment, and return that it is free. Raise OutputError if it is not."""
    bind(f"{kind}:{host}:{port}", host, port).close()
    return [ok(kind, f"port {port} of {host} is free")]


def bind(name: str, host: str, port: int) -> socket.socket:
    """Return a socket that listens on a port. Raise OutputError if that fails; `name` begins the message."""
    family, address = resolve(name, host, port, socket.SOCK_STREAM)
    try:
        listener = socket.create_server(address[:2], family=family)
        # each connection inherits both
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        return listener
    except OSError as e:
        hint = _HINTS.get(e.errno or 0, "stop the other program, or take another port")
        raise OutputError(f"{name}: {os.strerror(e.errno or 0)}", hint) from None


class DatagramOutput(Output):
    """Sends datagrams to a receiver that may start and stop at any time."""

    blocks = False

    def __init__(
        self, name: str, host: str, port: int, datagrams: Callable[[Report], list[bytes]], *, paced: bool = False
    ) -> None:
        """Open a socket to send the `datagrams` of each report.

        The host may be a broadcast address; `name` begins each message of an error.
        """
        self._name, self._datagrams, self.paced = name, datagrams, paced
        family, address = resolve(name, host, port, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)  # noqa: FBT003  the parameter has no name
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        try:  # so the system finds the route once, not for each datagram
            self._socket.connect(address)
        except OSError as e:
            self._socket.close()
            raise self._error(e) from None

    def send(self, report: Report) -> None:
        """Send the datagrams. One that the system's buffer does not hold is lost."""
        for datagram in self._datagrams(report):
            try:
                self._send(datagram)
            except BlockingIOError:
                continue
            except OSError as e:
                raise self._error(e) from None

    def _send(self, datagram: bytes) -> None:
        """Send a datagram. If the system reports that it could not deliver an earlier one, send again."""
        try:
            self._socket.send(datagram)
        except ConnectionError:
            with contextlib.suppress(ConnectionError):
                self._socket.send(datagram)

    def _error(self, error: OSError) -> OutputError:
        return OutputError(f"{self._name}: cannot be sent: {error.strerror or error}")

    def close(self) -> None:
        self._socket.close()


def probe_receiver(kind: str, name: str, host: str, port: int) -> list[Finding]:
    """Return the address of the host. Nothing is sent. Raise OutputError if it is unknown."""
    _, address = resolve(name, host, port, socket.SOCK_DGRAM)
    return [ok(kind, f"sends to {address[0]} port {port}")]
