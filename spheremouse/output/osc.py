"""`osc:HOST:PORT`: send an OSC bundle a ball and frame by UDP, for Unity, Godot, TouchDesigner and Max.

`osc:PORT` sends to this computer. The time tag of a bundle is the wall clock of the exposure, or *immediately* for a
recording. All vectors are in `obj`, and in `cam` for a hand-held ball. docs/outputs.md lists the addresses.
"""

import struct
from functools import cache
from math import isfinite, sqrt

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
_NUMBERS = {"counts": "iii", "quaternion": "ffff", "rate": "fff", "sigma": "fff", "position": "fff"}


class Osc(DatagramOutput):
    """Sends bundles."""

    def datagrams(self, report: Report) -> list[bytes]:
        """Return a bundle for each ball of a frame."""
        return [encode(sample, counts) for sample, counts in report.counted]


def encode(sample: Sample, counts: Counts) -> bytes:
    """Return the bundle of a sample: status and counts, and each other vector if the ball is tracked and it is finite.

    Only the numbers are packed for each sample. The builders of python-osc take ten times as long.
    """
    estimate = sample.estimate
    tag = _IMMEDIATELY if sample.wall is None else round((sample.wall + _NTP_EPOCH) * 2**32) % 2**64
    bundle = [_BUNDLE.pack(b"#bundle", tag), _status(sample.ball, str(estimate.status))]
    vectors = [[max(-_MAX_COUNT, min(_MAX_COUNT, n)) for n in counts]]
    if estimate.status is Status.TRACKING:
        variances = estimate.covariance.diagonal().tolist()[:3]
        vectors += [
            to_quaternion(estimate.rotation),
            estimate.rate.tolist()[:3],
            [sqrt(max(v, 0.0)) for v in variances],
        ]
        if sample.coordinates == "cam":
            vectors.append(estimate.position.tolist())
    for (head, numbers), values in zip(_layout(sample.ball), vectors, strict=False):
        if isfinite(sum(values)):
            bundle += head, numbers.pack(*values)
    return b"".join(bundle)


@cache
def _status(ball: int, text: str) -> bytes:
    """Return the message of a status."""
    from pythonosc.parsing import osc_types

    message = b"".join(map(osc_types.write_string, (f"/spheremouse/{ball}/status", ",s", text)))
    return osc_types.write_int(len(message)) + message


@cache
def _layout(ball: int) -> list[tuple[bytes, struct.Struct]]:
    """Return size, address and types of each message of numbers, and the form of its numbers."""
    from pythonosc.parsing import osc_types

    layout = []
    for name, types in _NUMBERS.items():
        head = b"".join(map(osc_types.write_string, (f"/spheremouse/{ball}/{name}", f",{types}")))
        numbers = struct.Struct(f">{types}")
        layout.append((osc_types.write_int(len(head) + numbers.size) + head, numbers))
    return layout


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
