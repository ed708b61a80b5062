"""Frames of the serial protocol (docs/protocol.md): bytes in and out."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from enum import IntFlag
from typing import NamedTuple

from cobs import cobs

VERSION = 1
HELLO, MOTION, ASK_STATUS, STOP = 0x01, 0x02, 0x03, 0x04
IDENTITY, ACK, STATUS = 0x81, 0x82, 0x83
BODY_BYTES = {HELLO: 4, MOTION: 9, ASK_STATUS: 0, STOP: 0, IDENTITY: 44, ACK: 15, STATUS: 26}
MAX_CONTENT_BYTES = 64
FIRMWARE_KINDS = {1: "CircuitPython", 2: "AVR", 3: "simulator"}
_HEADER, _CRC = struct.Struct("<BBH"), struct.Struct("<I")
_MOTION, _ACK = struct.Struct("<4HB"), struct.Struct("<H4HBHH")
_IDENTITY, _STATUS = struct.Struct("<II4HIHH3BB16s"), struct.Struct("<IIIHHHIHBB")

Counters = tuple[int, ...]  # x, y, wheel, pan, modulo 2^16


class Flags(IntFlag):
    """Flags of ACK and STATUS."""

    RUNNING = 0x01
    TOO_LARGE = 0x02
    USB_READY = 0x04
    WHEEL_FINE = 0x08
    PAN_FINE = 0x10


class Frame(NamedTuple):
    """An undamaged frame."""

    version: int
    type: int
    number: int
    body: bytes


class Identity(NamedTuple):
    """A device's kind, version and sessions."""

    session: int
    last: int  # session that ended before; 0: none
    counters: Counters  # passed on in the last session
    first: int  # session since the device's start
    step: int  # counts
    silence: int  # ms
    firmware: tuple[int, int, int]
    kind: int
    board: str

    def __str__(self) -> str:
        version = ".".join(map(str, self.firmware))
        return f"firmware {version} ({FIRMWARE_KINDS.get(self.kind, f'kind {self.kind}')}) on {self.board}"


class Ack(NamedTuple):
    """A device's counters: the counts that it has passed on."""

    number: int
    counters: Counters
    flags: Flags
    refused: int
    lost: int


class Status(NamedTuple):
    """A device's condition and totals."""

    session: int
    uptime: int  # s
    frames: int
    damaged: int
    refused: int
    lost: int
    reports: int
    usb_errors: int
    flags: Flags
    buttons: int

    @property
    def usb_ready(self) -> bool:
        """Return whether a computer takes the device's mouse."""
        return bool(self.flags & Flags.USB_READY)

    def __str__(self) -> str:
        return (
            f"up {self.uptime} s, its mouse is {'taken' if self.usb_ready else 'not taken'}; {self.frames} frames, "
            f"{self.damaged} damaged, {self.refused} refused, {self.lost} lost; {self.reports} reports, "
            f"{self.usb_errors} USB errors"
        )


def encode(kind: int, number: int, body: bytes = b"", version: int = VERSION) -> bytes:
    """Return a frame's bytes on the line, with the 0x00 at its end."""
    content = _HEADER.pack(version, kind, number & 0xFFFF) + body
    return cobs.encode(content + _CRC.pack(zlib.crc32(content))) + b"\0"


def hello(number: int, session: int) -> bytes:
    """Return a HELLO."""
    return encode(HELLO, number, _CRC.pack(session))


def motion(number: int, counters: Sequence[int], buttons: int) -> bytes:
    """Return a MOTION; `counters` are any whole numbers."""
    return encode(MOTION, number, _MOTION.pack(*(c & 0xFFFF for c in counters), buttons))


def decode(coded: bytes) -> Frame | None:
    """Return the frame of the bytes between two 0x00; None if it is damaged.

    A frame of this version is damaged also if its type is unknown or its body has another length. One of another
    version may have any type, and any length up to the maximum. `Splitter` passes on no empty piece.
    """
    try:
        content = cobs.decode(coded)
    except cobs.DecodeError:
        return None
    if not _HEADER.size + _CRC.size <= len(content) <= MAX_CONTENT_BYTES:
        return None
    content, crc = content[: -_CRC.size], content[-_CRC.size :]
    version, kind, number = _HEADER.unpack_from(content)
    body = content[_HEADER.size :]
    if _CRC.unpack(crc)[0] != zlib.crc32(content) or (version == VERSION and BODY_BYTES.get(kind) != len(body)):
        return None
    return Frame(version, kind, number, body)


def parse(frame: Frame) -> Identity | Ack | Status | None:
    """Return the message of a device; None if the frame is no such message."""
    if frame.version != VERSION:
        return None
    if frame.type == ACK:
        number, *counters, flags, refused, lost = _ACK.unpack(frame.body)
        return Ack(number, tuple(counters), Flags(flags), refused, lost)
    if frame.type == IDENTITY:
        session, last, *fields = _IDENTITY.unpack(frame.body)
        name = "".join(c if c.isprintable() else "?" for c in fields[-1].rstrip(b"\0").decode("ascii", "replace"))
        groups = tuple(fields[:4]), *fields[4:7], tuple(fields[7:10])
        return Identity._make((session, last, *groups, fields[10], name))
    if frame.type == STATUS:
        *figures, flags, buttons = _STATUS.unpack(frame.body)
        return Status._make((*figures, Flags(flags), buttons))
    return None


class Splitter:
    """Splits received bytes at each 0x00. It keeps the bytes of one frame at most."""

    def __init__(self) -> None:
        self.damaged = 0
        self._rest, self._too_long = b"", False

    def take(self, data: bytes) -> Iterator[Frame]:
        """Yield the undamaged frames that end in `data`."""
        *ends, rest = (self._rest + data).split(b"\0")
        for coded in ends:
            if not coded and not self._too_long:
                continue
            frame = None if self._too_long else decode(coded)
            self._too_long = False
            if frame is None:
                self.damaged += 1
            else:
                yield frame
        self._too_long = self._too_long or len(rest) > MAX_CONTENT_BYTES + 1
        self._rest = b"" if self._too_long else rest


def to_signed(difference: int) -> int:
    """Return a difference modulo 2^16 as a number from -32768 to 32767."""
    return (difference + 0x8000 & 0xFFFF) - 0x8000
