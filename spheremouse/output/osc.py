"""`osc:HOST:PORT`: send an OSC bundle a ball and frame by UDP, for Unity, Godot, TouchDesigner and Max.

`osc:PORT` sends to this computer. The time tag of a bundle is the wall clock of the exposure, or *immediately* for a
recording. All vectors are in `obj`, and in `cam` for a hand-held ball. docs/outputs.md lists the addresses.
"""

import struct
from functools import cache
from math import isfinite, sqrt
from typing import Any

from spheremouse.finding import Finding
from spheremouse.output import Counts, Report
from spheremouse.output.address import parse_host
from spheremouse.output.datagram import DatagramOutput, probe_receiver
from spheremouse.output.extras import import_extra
from spheremouse.output.sample import Sample, to_quaternion
from spheremouse.tracker import Status

_MAX_COUNT = 2**31 - 1  # an OSC integer is signed and has 32 bits
_BUNDLE = struct.Struct(">8sQ")  # name and time tag, in 2**-32 s since 1900
_IMMEDIATELY, _NTP_EPOCH = 1, 2208988800  # s from 1900 to 1970 (RFC 5905)
Message = tuple[str, str, list[Any]]  # address, types, values


def messages(sample: Sample, counts: Counts) -> list[Message]:
    """Return the messages of a sample: status and counts, and the others if the ball is tracked and they are finite."""
    estimate, place = sample.estimate, f"/spheremouse/{sample.ball}"
    whole = [max(-_MAX_COUNT, min(_MAX_COUNT, n)) for n in counts]
    made: list[Message] = [(f"{place}/status", "s", [str(estimate.status)]), (f"{place}/counts", "iii", whole)]
    if estimate.status is not Status.TRACKING:
        return made
    variances = estimate.covariance.diagonal().tolist()[:3]
    values = [
        ("quaternion", "ffff", to_quaternion(estimate.rotation)),
        ("rate", "fff", estimate.rate.tolist()[:3]),
        ("sigma", "fff", [sqrt(max(v, 0.0)) for v in variances]),
    ]
    if sample.coordinates == "cam":
        values.append(("position", "fff", estimate.position.tolist()))
    return made + [(f"{place}/{name}", types, v) for name, types, v in values if isfinite(sum(v))]


class Osc(DatagramOutput):
    """Sends bundles."""

    def datagrams(self, report: Report) -> list[bytes]:
        """Return a bundle for each ball of a frame."""
        return [encode(sample, counts) for sample, counts in report.counted]


def encode(sample: Sample, counts: Counts) -> bytes:
    """Return the bundle of a sample. Only its numbers are new; the builders of python-osc take ten times as long."""
    tag = _IMMEDIATELY if sample.wall is None else round((sample.wall + _NTP_EPOCH) * 2**32) % 2**64
    bundle = [_BUNDLE.pack(b"#bundle", tag)]
    for address, types, values in messages(sample, counts):
        if types == "s":
            bundle.append(_text_message(address, values[0]))
        else:
            head, numbers = _layout(address, types)
            bundle += [head, numbers.pack(*values)]
    return b"".join(bundle)


@cache
def _text_message(address: str, text: str) -> bytes:
    from pythonosc.parsing import osc_types

    message = b"".join(map(osc_types.write_string, (address, ",s", text)))
    return osc_types.write_int(len(message)) + message


@cache
def _layout(address: str, types: str) -> tuple[bytes, struct.Struct]:
    """Return size, address and types of a message of numbers, and the form of its numbers."""
    from pythonosc.parsing import osc_types

    head, numbers = b"".join(map(osc_types.write_string, (address, f",{types}"))), struct.Struct(f">{types}")
    return osc_types.write_int(len(head) + numbers.size) + head, numbers


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
