"""`osc:HOST:PORT`: send an OSC bundle a ball and frame by UDP, for Unity, Godot, TouchDesigner and Max.

`osc:PORT` sends to this computer. The time tag of a bundle is the wall clock of the exposure, or *immediately* for a
recording. All vectors are in `obj`, and in `cam` for a hand-held ball. docs/outputs.md lists the addresses.
"""

from typing import Any

import numpy as np

from spheremouse.finding import Finding
from spheremouse.output import Counts, Report
from spheremouse.output.address import parse_host
from spheremouse.output.datagram import DatagramOutput, probe_receiver
from spheremouse.output.extras import import_extra
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


class Osc(DatagramOutput):
    """Sends bundles."""

    def datagrams(self, report: Report) -> list[bytes]:
        """Return a bundle for each ball of a frame."""
        return [encode(sample, counts) for sample, counts in report.counted]

    def describe(self, report: Report) -> str:
        """Return the messages as text, as in `/spheremouse/1/status tracking | /spheremouse/1/counts 3 -2 0`."""
        made = [message for sample, counts in report.counted for message in messages(sample, counts)]
        return " | ".join(" ".join(map(str, [address, *values])) for address, _, values in made)


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


def open(argument: str) -> Osc:
    """Open a socket to the receiver."""
    return Osc(f"osc:{argument}", *check(argument))


def check(argument: str) -> tuple[str, int]:
    """Return host and port. Raise OutputError if the argument is invalid or python-osc is missing."""
    host, port = parse_host("osc", argument)
    import_extra("osc", "python-osc", "network", "pythonosc")
    return host, port


def probe(argument: str) -> list[Finding]:
    """Return whether the host is known. Nothing is sent."""
    return probe_receiver("osc", f"osc:{argument}", *check(argument))
