"""Files that say more than they are: pictures and films as bytes, and files of zeros that take no room."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np


def png(width: int, height: int, rows: int | None = None) -> bytes:
    """A black picture in colour, of which so many rows are there: a thousandth of a byte a pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    deflate = zlib.compressobj(9)
    row = bytes(1 + 3 * width)
    rows = height if rows is None else rows
    data = b"".join(deflate.compress(row) for _ in range(rows)) + deflate.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def jpeg(width: int, height: int) -> bytes:
    """A small JPEG whose header says another size."""
    data = bytearray(cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8))[1].tobytes())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", min(height, 65535), min(width, 65535))
    return bytes(data)


def bmp(width: int, height: int) -> bytes:
    """A BMP without pixels, or with some."""
    return (
        b"BM" + struct.pack("<IHHIIiiHHIIiiII", 154, 0, 0, 54, 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0) + bytes(100)
    )


def tiff(width: int, height: int, tile: tuple[int, int] | None = None) -> bytes:
    """A TIFF of one empty strip, or of tiles."""
    tags = [(256, width), (257, height), (258, 8), (259, 8), (262, 1), (277, 1)]
    tags += [(273, 8), (278, height), (279, 20)] if tile is None else []
    tags += [] if tile is None else [(322, tile[0]), (323, tile[1]), (324, 8), (325, 20)]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(tags))
    return b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(tags)) + entries + bytes(4)


def mkv(codec: str, width: int, height: int, frames: list[bytes]) -> bytes:
    """A film of pictures in a container that says its own size: Matroska, RFC 9559."""

    def element(name: str, data: bytes) -> bytes:
        return bytes.fromhex(name) + (len(data) | 1 << 56).to_bytes(8) + data

    def number(name: str, value: int) -> bytes:
        return element(name, value.to_bytes(8))

    format_ = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 24, codec.encode(), 0, 0, 0, 0, 0)
    video = element("e0", number("b0", width) + number("ba", height))
    track = number("d7", 1) + number("73c5", 1) + number("83", 1) + element("86", b"V_MS/VFW/FOURCC")
    blocks = b"".join(element("a3", b"\x81" + struct.pack(">h", 33 * i) + b"\x80" + f) for i, f in enumerate(frames))
    return element("1a45dfa3", element("4282", b"matroska") + number("4287", 4) + number("4285", 2)) + element(
        "18538067",
        element("1549a966", number("2ad7b1", 1_000_000))
        + element("1654ae6b", element("ae", track + element("63a2", format_) + video))
        + element("1f43b675", number("e7", 0) + blocks),
    )


def sparse(path: Path, size: int) -> Path:
    """A file of zeros that takes no room."""
    with path.open("wb") as made:
        made.truncate(size)
    return path
