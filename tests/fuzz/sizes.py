"""Oversized headers: pictures, films, tables, JSON and YAML that are huge, or say that they are.

Each is refused in one line or read, and the process stays below a gigabyte.
"""

import contextlib
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from hypothesis import strategies as st

from spheremouse import config
from spheremouse.calibrate.photos import image, read_photos
from spheremouse.cli_wand import _image
from spheremouse.files import plain_json
from spheremouse.mouse_log import read_log
from spheremouse.recording import open_dataset, read_frames
from spheremouse.rig_file import load_camera
from spheremouse.source import open_source
from spheremouse.track import Settings
from spheremouse.wand_recording import is_wand, open_wand
from tests.fuzz.targets import file, refused, target

MOST_MEMORY = 1_000_000_000  # bytes, the program with them
CLIP = Path(__file__).parents[1] / "data" / "far26_clip"
sides = st.one_of(st.sampled_from([1, 64, 4096, 8192, 13000, 32000, 65500]), st.integers(1, 2**31 - 1))


# ---- files that say more than they are ----


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


# ---- the target ----

_PICTURES: dict[str, Callable[[int, int], bytes]] = {
    "png": lambda w, h: png(min(w, 65500), min(h, 65500), 1),
    "whole.png": lambda w, h: png(min(w, 13000), min(h, 13000)),
    "jpg": jpeg,
    "bmp": bmp,
    "tif": tiff,
    "tiles.tif": lambda w, h: tiff(16, 16, (w, h)),
}
_TEXTS = st.one_of(
    st.integers(1, 300_000).map(lambda n: "[" * n),
    st.integers(1, 300_000).map(lambda n: '{"a":' * n),
    st.integers(1, 300_000).map(lambda n: "schema: " + "9" * n),
    st.integers(1, 300_000).map(lambda n: "[" + "1," * n + "1]"),
    st.integers(1, 60_000).map(lambda n: "".join(f"key_{i}: 1\n" for i in range(n))),
    st.integers(1, 300_000).map(lambda n: "a: " * n),
    st.integers(1, 300_000).map(lambda n: "t,dx,dy,frame,sequence,colour\n" + "0,0,0,0,0,0\n" * n),
    st.integers(1, 300_000).map(lambda n: "t,dx,dy\n" + "1" * n),
    st.integers(1, 300_000).map(lambda n: "t,dx,dy\n" + '"\n' * n),
    st.integers(1, 2**40),  # as a file of so many zeros
)


@target(
    "oversized headers",
    lambda: st.one_of(
        st.tuples(st.just("picture"), st.sampled_from(list(_PICTURES)), sides, sides),
        st.tuples(st.just("film"), st.sampled_from(["MPNG", "MJPG", "FFV1", "HFYU", "    "]), sides, sides),
        st.tuples(st.just("scene"), st.sampled_from(["width", "height", "frames", "fps"]), sides, st.just(0)),
        st.tuples(
            st.just("text"),
            st.sampled_from(["scene.json", "truth.csv", "discs.csv", "stamps.csv", "rig.yaml"]),
            _TEXTS,
            st.just(0),
        ),
    ),
)
def check_sizes(drawn: tuple[str, str, int | str, int]) -> None:
    kind, name, first, second = drawn
    if kind == "text":
        _text(name, first)
    elif isinstance(first, int):
        {"picture": _picture, "film": _film, "scene": _scene}[kind](name, first, second)
    assert _peak() < MOST_MEMORY, f"{_peak() / 1e6:.0f} MB"


def _picture(name: str, width: int, height: int) -> None:
    path = file(_PICTURES[name](width, height), f"picture.{name}")
    photos = refused(lambda: read_photos([path], lambda _: None))
    if photos:
        refused(lambda: image(photos[0]))
    refused(lambda: _image(path))
    folder = _dataset({})
    file(path.read_bytes(), str(folder / "frames" / "000000.png"))
    recording = refused(lambda: open_dataset(folder))
    refused(lambda: list(read_frames(recording)))


def _film(codec: str, width: int, height: int) -> None:
    """The container says one size, and the pictures in it another."""
    frame = jpeg(width, height) if codec == "MJPG" else png(min(width, 15000), min(height, 15000), 1)
    path = file(mkv(codec, 64, 64, [frame]), "film.mkv")
    refused(lambda: _all(path))
    refused(lambda: _all(file(mkv(codec, width, height, [frame]), "film.mkv")))


def _all(path: Path) -> None:
    with open_source(f"video:{path}") as frames:
        for _ in frames:
            pass


def _scene(key: str, value: int, _: int) -> None:
    folder = _dataset({key: value})
    refused(lambda: list(read_frames(open_dataset(folder))))


def _text(name: str, content: int | str) -> None:
    folder = _dataset({})
    path = folder / name
    _ = file(content, str(path)) if isinstance(content, str) else sparse(path, content)
    refused(lambda: open_dataset(folder))
    refused(lambda: open_wand(folder))
    is_wand(folder)
    refused(lambda: config.load(path, Settings))
    refused(lambda: load_camera(path))
    refused(lambda: read_log(path))
    if isinstance(content, str):
        with contextlib.suppress(ValueError):
            plain_json.loads(content)


def _dataset(changed: dict[str, int]) -> Path:
    folder = Path("sized")
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for name in ("truth.csv", "discs.csv", "stamps.csv", "rig.yaml"):
        (folder / name).unlink(missing_ok=True)
    scene = json.loads((CLIP / "scene.json").read_text(encoding="utf-8"))
    file(json.dumps(scene | {"width": 64, "height": 64, "frames": 3} | changed), str(folder / "scene.json"))
    file(png(64, 64), str(folder / "frames" / "000000.png"))
    return folder


def _peak() -> int:
    """Bytes that this process has had at most."""
    try:
        import resource
    except ImportError:  # not on every system
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
