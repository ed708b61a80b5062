"""`udp:HOST:PORT[,format=NAME]`: send each line of a report as a datagram.

`udp:PORT` sends to this computer. HOST may be a broadcast address. Nothing tells whether a receiver exists, so it may
start and stop at any time.
"""

from spheremouse.finding import Finding
from spheremouse.output import Report
from spheremouse.output.address import parse_host
from spheremouse.output.datagram import DatagramOutput, probe_receiver
from spheremouse.output.lines import LineFormat, parse_address


class Udp(DatagramOutput):
    """Sends lines as datagrams, each with the end of its line."""

    def __init__(self, name: str, host: str, port: int, form: LineFormat) -> None:
        super().__init__(name, host, port)
        self._form, self.paced = form, form.paced

    def datagrams(self, report: Report) -> list[bytes]:
        """Return the lines."""
        return self._form.lines(report)


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
    return probe_receiver("udp", f"udp:{argument}", host, port)
