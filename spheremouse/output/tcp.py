"""`tcp:HOST:PORT[,format=NAME]`: a server that sends reports as lines to any number of clients.

`tcp:PORT` listens on this computer alone. A client gets whole lines from its connection on. The server ignores what a
client sends. A client that does not read is dropped when its buffer is full.
"""

from spheremouse.finding import Finding
from spheremouse.output.line_server import LineServer
from spheremouse.output.lines import LineFormat, parse_address
from spheremouse.output.network import parse_host, probe_port


def open(argument: str) -> LineServer:
    host, port, form = check(argument)
    return LineServer(f"tcp:{argument}", host, port, form)


def check(argument: str) -> tuple[str, int, LineFormat]:
    address, form = parse_address("tcp", argument)
    return *parse_host("tcp", address), form


def probe(argument: str) -> list[Finding]:
    host, port, _ = check(argument)
    return probe_port("tcp", host, port)
