"""`osc:HOST:PORT`: send an OSC bundle a ball and frame by UDP, for Unity, Godot, TouchDesigner and Max.

`osc:PORT` sends to this computer. The time tag of a bundle is the wall clock of the exposure, or *immediately* for a
recording. All vectors are in `obj`, and in `cam` for a hand-held ball. docs/outputs.md lists the addresses.
"""

import struct
from collections.abc import Sequence
from functools import cache
from math import isfinite, sqrt

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.finding import Finding
from spheremouse.output import Counts, Report
from spheremouse.output.network import DatagramOutput, parse_host, probe_receiver
from spheremouse.output.response import KEYS
from spheremouse.output.sample import Sample, to_quaternion
from spheremouse.tracker import Status

_MAX_COUNT = 2**31 - 1  # an OSC integer is signed and has 32 bits
_IMMEDIATELY, _NTP_EPOCH = 1, 2208988800  # time tag in 2**-32 s; s from 1900 to 1970 (RFC 5905)
_ZEROS = (0.0, 0.0, 0.0)
_NUMBERS = {"counts": "iii", "quaternion": "ffff", "rate": "fff", "sigma": "fff", "position": "fff"}


def bundles(report: Report) -> list[bytes]:
    """Return a bundle for each ball of a frame."""
    return [encode(sample, counts) for sample, counts in report.counted]


def encode(sample: Sample, counts: Counts) -> bytes:
    """Return the bundle of a sample: status, counts, and the other vectors if tracked and all of them finite."""
    estimate = sample.estimate
    tag = _IMMEDIATELY if sample.wall is None else round((sample.wall + _NTP_EPOCH) * 2**32) % 2**64
    vectors: list[Sequence[float]] = [counts if max(map(abs, counts)) <= _MAX_COUNT else _clip(counts)]
    if estimate.status is Status.TRACKING:
        variances = map(max, estimate.covariance.diagonal()[:3].tolist(), _ZEROS)
        vectors += [to_quaternion(estimate.rotation), estimate.rate[:3].tolist(), list(map(sqrt, variances))]
        if sample.coordinates == "cam":
            vectors.append(estimate.position.tolist())
        if not isfinite(sum(map(sum, vectors))):
            vectors = vectors[:1]
    form, heads = _layout(sample.ball, estimate.status, len(vectors))
    values: list[bytes | float] = [b"#bundle", tag]
    for head, vector in zip(heads, vectors, strict=True):
        values += (head, *vector)
    return form.pack(*values)


def _clip(counts: Counts) -> list[int]:
    return [max(-_MAX_COUNT, min(_MAX_COUNT, n)) for n in counts]


@cache
def _layout(ball: int, status: str, vectors: int) -> tuple[struct.Struct, list[bytes]]:
    """Return the form of a bundle, and the constant bytes before each vector, of which the first have the status."""

    def text(*strings: str) -> bytes:  # each ends with a zero, and zeros up to a multiple of 4 bytes
        return b"".join(s.encode() + bytes(4 - len(s) % 4) for s in strings)

    form, heads, message = ">8sQ", list[bytes](), text(f"/spheremouse/{ball}/status", ",s", status)
    before = len(message).to_bytes(4) + message
    for name, types in list(_NUMBERS.items())[:vectors]:
        head = text(f"/spheremouse/{ball}/{name}", f",{types}")
        heads.append(before + (len(head) + 4 * len(types)).to_bytes(4) + head)
        form, before = f"{form}{len(heads[-1])}s{types}", b""
    return struct.Struct(form), heads


def open(argument: str) -> DatagramOutput:
    return DatagramOutput(f"osc:{argument}", *check(argument), bundles)


def check(argument: str) -> tuple[str, int]:
    address, _, rest = argument.partition(",")
    options(rest, dict(KEYS), f"osc:{argument}", OutputError)
    return parse_host("osc", address)


def probe(argument: str) -> list[Finding]:
    return probe_receiver("osc", f"osc:{argument}", *check(argument))
