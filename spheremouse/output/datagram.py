"""Send reports as datagrams, to a receiver that may start and stop at any time."""

import socket

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, ok, refused
from spheremouse.output import Output, Report
from spheremouse.output.address import resolve


class DatagramOutput(Output):
    """Sends datagrams. Derive an output from it and override `datagrams`."""

    blocks = False

    def __init__(self, name: str, host: str, port: int) -> None:
        """Open a socket. The host may be a broadcast address; `name` begins each message of an error."""
        self._name = name
        family, self._address = resolve(name, host, port, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)  # noqa: FBT003  the parameter has no name
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def datagrams(self, report: Report) -> list[bytes]:
        """Return the datagrams of a report."""
        raise NotImplementedError

    def send(self, report: Report) -> None:
        """Send the datagrams. One that the system's buffer does not hold is lost."""
        for datagram in self.datagrams(report):
            try:
                self._socket.sendto(datagram, self._address)
            except BlockingIOError:
                continue
            except OSError as e:
                raise OutputError(f"{self._name}: cannot be sent: {e.strerror or e}") from None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def probe_receiver(kind: str, name: str, host: str, port: int) -> list[Finding]:
    """Return whether the host is known. Nothing is sent."""
    try:
        _, address = resolve(name, host, port, socket.SOCK_DGRAM)
    except OutputError as e:
        return [refused(kind, e)]
    return [ok(kind, f"sends to {address[0]} port {port}")]
