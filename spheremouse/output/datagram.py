"""Send reports as datagrams, to a receiver that may start and stop at any time."""

import contextlib
import socket
from collections.abc import Callable

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, ok, refused
from spheremouse.output import Output, Report
from spheremouse.output.address import resolve


class DatagramOutput(Output):
    """Sends datagrams."""

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
    """Return whether the host is known. Nothing is sent."""
    try:
        _, address = resolve(name, host, port, socket.SOCK_DGRAM)
    except OutputError as e:
        return [refused(kind, e)]
    return [ok(kind, f"sends to {address[0]} port {port}")]
