"""Frames of the serial protocol: bytes in and out."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntFlag

from cobs import cobs

VERSION = 1
HELLO, MOTION, ASK_STATUS, STOP = 0x01, 0x02, 0x03, 0x04
IDENTITY, ACK, STATUS = 0x81, 0x82, 0x83
MOST = 64  # bytes of a frame's content
KINDS = {1: "CircuitPython", 2: "AVR", 3: "simulator"}
_HEADER, _CRC = struct.Struct("<BBH"), struct.Struct("<I")
_MOTION, _ACK = struct.Struct("<4HB"), struct.Struct("<H4HBHH")
_IDENTITY, _STATUS = struct.Struct("<II4HIHH3BB16s"), struct.Struct("<IIIHHHIHBB")
_BODY = {HELLO: 4, MOTION: 9, ASK_STATUS: 0, STOP: 0, IDENTITY: 44, ACK: 15, STATUS: 26}


class Flags(IntFlag):
    """Of ACK and STATUS."""

    RUNNING = 0x01
    TOO_LARGE = 0x02
    USB_READY = 0x04
    WHEEL_FINE = 0x08
    PAN_FINE = 0x10


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame that came whole."""

    version: int
    type: int
    number: int
    body: bytes


@dataclass(frozen=True, slots=True)
class Identity:
    """A device's answer on its kind, version and number."""

    session: int
    last: int  # session that ended before; 0: none
    counters: tuple[int, int, int, int]  # passed on in it, modulo 2^16
    first: int  # session since the device was started
    step: int  # counts
    silence: int  # ms
    firmware: tuple[int, int, int]
    kind: int
    board: str

    def __str__(self) -> str:
        version = ".".join(map(str, self.firmware))
        return f"firmware {version} ({KINDS.get(self.kind, f'kind {self.kind}')}) on {self.board}"


@dataclass(frozen=True, slots=True)
class Ack:
    """A device's account of the counts it has passed on."""

    number: int
    counters: tuple[int, int, int, int]  # modulo 2^16
    flags: Flags
    refused: int
    lost: int


@dataclass(frozen=True, slots=True)
class Status:
    """A device's condition and counters."""

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


def encode(kind: int, number: int, body: bytes = b"", version: int = VERSION) -> bytes:
    """A frame as it goes over the line, with the 0x00 at its end."""
    content = _HEADER.pack(version, kind, number & 0xFFFF) + body
    return cobs.encode(content + _CRC.pack(zlib.crc32(content))) + b"\0"


def hello(number: int, session: int) -> bytes:
    """HELLO."""
    return encode(HELLO, number, _CRC.pack(session))


def motion(number: int, counters: Sequence[int], buttons: int) -> bytes:
    """MOTION; counters may be any whole numbers."""
    return encode(MOTION, number, _MOTION.pack(*(c & 0xFFFF for c in counters), buttons))


def decode(coded: bytes) -> Frame | None:
    """The frame that stands between two 0x00; None where it is damaged. Another version's length is not judged."""
    try:
        content = cobs.decode(coded)
    except cobs.DecodeError:
        return None
    if not _HEADER.size + _CRC.size <= len(content) <= MOST:
        return None
    content, crc = content[: -_CRC.size], content[-_CRC.size :]
    version, kind, number = _HEADER.unpack_from(content)
    body = content[_HEADER.size :]
    if _CRC.unpack(crc)[0] != zlib.crc32(content) or (version == VERSION and _BODY.get(kind) != len(body)):
        return None
    return Frame(version, kind, number, body)


def parse(frame: Frame) -> Identity | Ack | Status | None:
    """The body of what a device sends; None for all else."""
    if frame.version != VERSION:
        return None
    if frame.type == ACK:
        number, *counters, flags, refused, lost = _ACK.unpack(frame.body)
        return Ack(number, _four(counters), Flags(flags), refused, lost)
    if frame.type == IDENTITY:
        session, last, *counters, first, step, silence, a, b, c, kind, board = _IDENTITY.unpack(frame.body)
        name = "".join(c if c.isprintable() else "?" for c in board.rstrip(b"\0").decode("ascii", "replace"))
        return Identity(session, last, _four(counters), first, step, silence, (a, b, c), kind, name)
    if frame.type == STATUS:
        session, uptime, whole, damaged, refused, lost, reports, errors, flags, buttons = _STATUS.unpack(frame.body)
        return Status(session, uptime, whole, damaged, refused, lost, reports, errors, Flags(flags), buttons)
    return None


class Splitter:
    """Cuts what comes in at each 0x00; keeps no more than one frame."""

    def __init__(self) -> None:
        self.damaged = 0
        self._rest, self._too_long = b"", False

    def take(self, data: bytes) -> Iterator[Frame]:
        """Frames that are whole now."""
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
        self._too_long = self._too_long or len(rest) > MOST + 1
        self._rest = b"" if self._too_long else rest


def signed(difference: int) -> int:
    """A difference modulo 2^16 as a number from -32768 to 32767."""
    return (difference + 0x8000 & 0xFFFF) - 0x8000


def _four(values: Sequence[int]) -> tuple[int, int, int, int]:
    a, b, c, d = values
    return a, b, c, d
