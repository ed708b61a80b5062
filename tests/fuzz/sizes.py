"""Oversized headers: pictures, films, tables, JSON and YAML that are huge, or say that they are.

Each is refused in one line or read, and the process stays below a gigabyte.
"""

import contextlib
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from hypothesis import strategies as st

from spheremouse.ball.settings import Settings
from spheremouse.calibrate.photos import image, read_photos
from spheremouse.capture import open_source
from spheremouse.commands.wand.picture import read_picture
from spheremouse.files import config, plain_json
from spheremouse.files.dataset.ball import open_dataset, read_frames
from spheremouse.files.dataset.wand import is_wand, open_wand
from spheremouse.files.mouse_log import read_log
from spheremouse.files.rig import load_camera
from tests.fuzz.strategies import mutated_bytes
from tests.fuzz.targets import file, refused, target
from tests.oversized import bmp, jpeg, mkv, png, sparse, tiff

MOST_MEMORY = 1_000_000_000  # bytes, besides those of the program
CLIP = Path(__file__).parents[1] / "data" / "far26_clip"
sides = st.one_of(st.sampled_from([1, 64, 4096, 8192, 13000, 32000, 65500]), st.integers(1, 2**31 - 1))


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
    _forget()
    before = _memory("VmRSS")
    if kind == "text":
        _text(name, first)
    elif isinstance(first, int):
        {"picture": _picture, "film": _film, "scene": _scene}[kind](name, first, second)
    taken = _memory("VmHWM") - before
    assert taken < MOST_MEMORY, f"{taken / 1e6:.0f} MB"


@cache
def _whole(kind: str) -> bytes:
    """A picture of noise, 40 by 30."""
    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    return bytes(cv2.imencode(f".{kind}", image)[1])


@target(
    "damaged pictures",
    lambda: st.sampled_from(["png", "jpg", "bmp", "tif"]).flatmap(
        lambda kind: st.tuples(st.just(kind), st.one_of(mutated_bytes(_whole(kind)), mutated_bytes(_whole(kind)[:200])))
    ),
)
def check_damaged(drawn: tuple[str, bytes]) -> None:
    kind, data = drawn
    _forget()
    before = _memory("VmRSS")
    _shown(file(data, f"picture.{kind}"))
    taken = _memory("VmHWM") - before
    assert taken < MOST_MEMORY, f"{taken / 1e6:.0f} MB"


def _picture(name: str, width: int, height: int) -> None:
    _shown(file(_PICTURES[name](width, height), f"picture.{name}"))


def _shown(path: Path) -> None:
    """A file as a photo, to the wand's colour picker, and as a frame of a dataset."""
    photos = refused(lambda: read_photos([path], lambda _: None))
    if photos:
        refused(lambda: image(photos[0]))
    refused(lambda: read_picture(path))
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


def _memory(which: str) -> int:
    """Bytes that this process has (VmRSS), or had at most since `_forget` (VmHWM)."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:  # not on every system
        return 0
    return 1024 * int(status.partition(f"{which}:")[2].split()[0])


def _forget() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
