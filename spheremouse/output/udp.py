"""`udp:HOST:PORT[,format=NAME]`: send each line of a report as a datagram.

`udp:PORT` sends to this computer. HOST may be a broadcast address. Nothing tells whether a receiver exists, so it may
start and stop at any time.
"""

import socket

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, ok, refused
from spheremouse.output import Output, Report
from spheremouse.output.address import parse_host, resolve
from spheremouse.output.lines import LineFormat, parse_address


class Udp(Output):
    """Sends lines as datagrams, each with the end of its line."""

    def __init__(self, name: str, host: str, port: int, form: LineFormat) -> None:
        self._name, self._form, self.paced = name, form, form.paced
        family, self._address = resolve(name, host, port, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, report: Report) -> None:
        """Send the lines. A line that the system's buffer does not hold is lost."""
        for line in self._form.lines(report):
            try:
                self._socket.sendto(line.encode() + b"\n", self._address)
            except BlockingIOError:
                continue
            except OSError as e:
                raise OutputError(f"{self._name}: cannot be sent: {e.strerror or e}") from None

    def describe(self, report: Report) -> str:
        """Return the lines as one."""
        return " | ".join(self._form.lines(report))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def open(argument: str) -> Udp:
    """Open a socket to the receiver."""
    return Udp(f"udp:{argument}", *check(argument))


def check(argument: str) -> tuple[str, int, LineFormat]:
    """Return host, port and format. Raise OutputError if the argument is invalid."""
    address, form = parse_address("udp", argument)
    return *parse_host("udp", address), form


def probe(argument: str) -> list[Finding]:
    """Return whether the host is known. Nothing is sent."""
    host, port, _ = check(argument)
    try:
        _, address = resolve(f"udp:{argument}", host, port, socket.SOCK_DGRAM)
    except OutputError as e:
        return [refused("udp", e)]
    return [ok("udp", f"sends to {address[0]} port {port}")]
