"""`udp:HOST:PORT[,format=NAME]`: send each line of a report as a datagram.

`udp:PORT` sends to this computer. HOST may be a broadcast address. Nothing tells whether a receiver exists, so it may
start and stop at any time.
"""

from spheremouse.finding import Finding
from spheremouse.output.lines import LineFormat, parse_address
from spheremouse.output.network import DatagramOutput, parse_host, probe_receiver


def open(argument: str) -> DatagramOutput:
    """Open a socket to the receiver, which gets each line as a datagram with the end of the line."""
    host, port, form = check(argument)
    return DatagramOutput(f"udp:{argument}", host, port, form.lines, paced=form.paced)


def check(argument: str) -> tuple[str, int, LineFormat]:
    address, form = parse_address("udp", argument)
    return *parse_host("udp", address), form


def probe(argument: str) -> list[Finding]:
    host, port, _ = check(argument)
    return probe_receiver("udp", f"udp:{argument}", host, port)
