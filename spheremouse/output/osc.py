"""`osc:HOST:PORT`: send an OSC bundle a ball and frame by UDP, for Unity, Godot, TouchDesigner and Max.

The time tag of a bundle is the wall clock of the exposure, or *immediately* for a recording. All vectors are in `obj`,
and in `cam` for a hand-held ball. docs/outputs.md lists the addresses with their types.
"""

import importlib.util
import socket
from typing import Any

import numpy as np

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, ok, refused
from spheremouse.output import Counts, Output, Report
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status

_MAX_COUNT = 2**31 - 1  # an OSC integer is signed and has 32 bits
Message = tuple[str, str, list[Any]]  # address, types, values


def messages(sample: Sample, counts: Counts) -> list[Message]:
    """Return the messages of a sample: status and counts, and the others if the ball is tracked and they are finite."""
    place = f"/spheremouse/{sample.ball}"
    whole = [max(-_MAX_COUNT, min(_MAX_COUNT, n)) for n in counts]
    made: list[Message] = [(f"{place}/status", "s", [str(sample.status)]), (f"{place}/counts", "iii", whole)]
    if sample.status is not Status.TRACKING:
        return made
    values = {"quaternion": sample.quaternion, "rate": sample.rate, "sigma": sample.sigma}
    if sample.coordinates == "cam":
        values["position"] = sample.position
    return made + [(f"{place}/{name}", "f" * len(v), v.tolist()) for name, v in values.items() if np.isfinite(v).all()]


def _pairs(report: Report) -> list[tuple[Sample, Counts]]:
    return [(s, report.counts if k == report.pointing else (0, 0, 0)) for k, s in enumerate(report.samples)]


class Osc(Output):
    """Sends bundles."""

    def __init__(self, host: str, port: int) -> None:
        family, self._address = _resolve(host, port)
        self._name, self._socket = f"osc:{host}:{port}", socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, report: Report) -> None:
        """Send a bundle for each ball of a frame. A bundle that the system's buffer does not hold is lost."""
        for sample, counts in _pairs(report):
            try:
                self._socket.sendto(encode(sample, counts), self._address)
            except BlockingIOError:
                continue
            except OSError as e:
                raise OutputError(f"{self._name}: cannot be sent: {e.strerror or e}") from None

    def describe(self, report: Report) -> str:
        """Return the messages as text, as in `/spheremouse/1/status tracking | /spheremouse/1/counts 3 -2 0`."""
        made = [message for sample, counts in _pairs(report) for message in messages(sample, counts)]
        return " | ".join(" ".join(map(str, [address, *values])) for address, _, values in made)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def encode(sample: Sample, counts: Counts) -> bytes:
    """Return the bundle of a sample. The builders of python-osc parse each message again: four times the work."""
    from pythonosc.parsing import osc_types

    write = {"s": osc_types.write_string, "i": osc_types.write_int, "f": osc_types.write_float}
    bundle = [b"#bundle\0", osc_types.write_date(osc_types.IMMEDIATELY if sample.wall is None else sample.wall)]
    for address, types, values in messages(sample, counts):
        parts = [
            write["s"](address),
            write["s"]("," + types),
            *(write[t](v) for t, v in zip(types, values, strict=True)),
        ]
        message = b"".join(parts)
        bundle += [osc_types.write_int(len(message)), message]
    return b"".join(bundle)


def _resolve(host: str, port: int) -> tuple[socket.AddressFamily, Any]:
    """Return the family and the numeric address of a receiver, so that no later call waits for a name server."""
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as e:
        raise OutputError(f"osc:{host}:{port}: unknown host: {getattr(e, 'strerror', None) or e}") from None
    return family, address


def open(argument: str) -> Osc:
    """Open a socket to the receiver."""
    return Osc(*check(argument))


def check(argument: str) -> tuple[str, int]:
    """Return host and port. Raise OutputError if the argument is invalid or python-osc is missing."""
    host, _, port = argument.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise OutputError(f"osc:{argument}: is not HOST:PORT", "write for example osc:127.0.0.1:9000")
    if importlib.util.find_spec("pythonosc") is None:
        raise OutputError("osc: needs the package python-osc", "pip install 'spheremouse[network]'")
    return host.removeprefix("[").removesuffix("]"), int(port)


def probe(argument: str) -> list[Finding]:
    """Return whether the host is known. Nothing is sent."""
    host, port = check(argument)
    try:
        return [ok("osc", f"sends to {_resolve(host, port)[1][0]} port {port}")]
    except OutputError as e:
        return [refused("osc", e)]
