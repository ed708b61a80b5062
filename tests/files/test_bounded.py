"""Files of strangers: what says that it is huge is refused before memory is taken for it, and nothing hangs."""

import json
import os
import resource
import shutil
import struct
import threading
import zlib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from invoking import refusal

from spheremouse.calibrate.photos import read_photos
from spheremouse.capture import open_source
from spheremouse.commands.options import parse_size
from spheremouse.commands.wand import read_picture
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.files import pictures, tables, validate
from spheremouse.files import yaml as yaml_file
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import is_wand
from spheremouse.files.mouse_log import read_log
from spheremouse.files.rig import load_camera
from spheremouse.session.control.protocol import Request

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"


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


@pytest.fixture
def folder(tmp_path):
    """A dataset of three frames that are still missing."""
    scene = json.loads((CLIP / "scene.json").read_text()) | {"width": 64, "height": 48, "frames": 3}
    made = tmp_path / "set"
    (made / "frames").mkdir(parents=True)
    (made / "scene.json").write_text(json.dumps(scene))
    return made


def saved(path, data):
    path.write_bytes(data)
    return path


@pytest.fixture
def little_memory():
    """600 MB more than there is now; each of the files took 1.6 to 6 GB."""
    before, pages = resource.getrlimit(resource.RLIMIT_AS), Path("/proc/self/statm").read_text().split()[0]
    resource.setrlimit(resource.RLIMIT_AS, (int(pages) * resource.getpagesize() + 600_000_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def test_what_says_that_it_is_huge_is_refused_within_little_memory(folder, tmp_path, little_memory):
    refused = partial(refusal, SpheremouseError)
    dataset = lambda: list(read_frames(open_dataset(folder)))  # noqa: E731
    huge = saved(tmp_path / "huge.png", png(32000, 32000, 1))
    shutil.copy(huge, folder / "frames" / "000000.png")
    words = "is more than 180 megapixels; scale it to at most 35 megapixels"
    assert f"000000.png: {words}" in refused(dataset)
    assert f"huge.png: {words}" in refused(read_picture, huge)
    photo = saved(tmp_path / "photo.png", png(13000, 13000, 1))
    assert "photo.png: is 13000x13000; scale it to at most 67 megapixels" in refused(read_photos, [photo])
    film = saved(tmp_path / "film.mkv", mkv("MPNG", 64, 64, [png(15000, 15000, 1)]))
    assert "film.mkv: frames of 15000x15000; scale the film" in refused(open_source, f"video:{film}")
    shutil.copy(film, folder / "video.mkv")
    assert "video.mkv: frames of 15000x15000" in refused(dataset)
    os.truncate(folder / "scene.json", 10**9)
    assert "scene.json: cannot be read: larger than 1 MB" in refused(dataset)


def test_the_bound_is_that_of_pixels_whatever_the_shape():
    for size in ((100, 50), (50, 100), (5000, 1)):
        assert pictures.read_header(png(*size, 1), 5000).size == size
        with pytest.raises(OSError, match="scale it"):
            pictures.read_header(png(*size, 1), 4999)


def test_the_tiles_of_a_tiff_count_too():
    """A TIFF of 16x16 px in one tile of 16384x16384: it would be decoded whole."""
    entries = [(256, 4, 16), (257, 4, 16), (258, 3, 8), (259, 3, 8), (262, 3, 1), (277, 3, 1)]
    entries += [(322, 4, 16384), (323, 4, 16384), (324, 4, 8), (325, 4, 0)]
    tail = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", t, k, 1, v) for t, k, v in entries)
    data = b"II*\0" + struct.pack("<I", 8) + tail + bytes(4)
    with pytest.raises(OSError, match="tiles of 16384x16384"):
        pictures.read_header(data, pictures.PHOTO_PIXELS)


def test_a_part_of_a_png_that_says_it_is_longer_than_the_file_is_refused():
    """OpenCV would take 3 GB for it."""
    whole = png(16, 12)
    at = whole.index(b"IDAT") - 4
    for length in (0xB9910157, len(whole)):
        with pytest.raises(OSError, match="cut short or damaged"):
            pictures.read_header(whole[:at] + length.to_bytes(4) + whole[at + 4 :], 1000)
    assert pictures.read_header(whole + b"what a camera's maker adds", 1000).size == (16, 12)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.bmp"])
def test_header_and_decoder_agree_on_the_size(name):
    data = cv2.imencode(Path(name).suffix, np.arange(7 * 5 * 3, dtype=np.uint8).reshape(7, 5, 3))[1].tobytes()
    assert pictures.read_header(data, 35, to_the_end=True).size == (5, 7)
    assert pictures.decode(data).shape == (7, 5, 3)


@pytest.mark.parametrize("text", ["8192x8192", "9" * 5000 + "x64"])
def test_nothing_is_simulated_that_could_not_be_read(text):
    assert parse_size("8192x4320", 64, "640x480") == (8192, 4320)
    with pytest.raises(ConfigurationError, match="--size"):
        parse_size(text, 64, "640x480")


def test_no_more_of_a_table_is_read_than_the_scene_has_frames(folder):
    """Of a million rows for three frames, four are looked at: the fifth, which is no row, is not reached."""
    (folder / "stamps.csv").write_text("frame,t,sequence,colour\n" + "0,0,0,0\n" * 4 + "no row\n" * 1_000_000)
    assert "stamps.csv: more than 3 rows, but scene.json has 3 frames" in refusal(DatasetError, open_dataset, folder)


def test_a_table_is_held_in_eight_bytes_a_number(tmp_path, monkeypatch):
    path = tmp_path / "t.csv"
    path.write_text("a,b\n" + "1,2\n" * 10)
    table = tables.read_columns(path, ("b",))
    assert table["b"].nbytes == 80
    monkeypatch.setattr(tables, "MAX_NUMBERS", 19)
    with pytest.raises(DatasetError, match=r"t\.csv: more than 9 rows; shorten the recording"):
        tables.read_columns(path, ("a", "b"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a\n" + "1" * 70_000, "line 2 is longer than 65536 characters"),
        ("a,b\n" + '1,"\n' * 1000, "line 2 has a quote"),
    ],
)
def test_a_table_whose_rows_do_not_end_is_refused(tmp_path, text, words):
    path = tmp_path / "t.csv"
    path.write_text(text)
    assert f"t.csv: cannot be read: {words}" in refusal(DatasetError, tables.read_columns, path, ("a",))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "scene.json: not valid JSON (nested deeper than 20 levels)"),
        ('{"frames": ' + "9" * 5000 + "}", "scene.json: not valid JSON (a whole number of 5000 digits)"),
        ('{"frames": 1, "frames": 2}', "scene.json: not valid JSON (a key stands twice in one object)"),
        ('{"name": "\\ud800"}', "scene.json: not valid JSON (half a surrogate pair)"),
        ('{\n"frames": }', "scene.json, line 2: not valid JSON (Expecting value)"),
    ],
)
def test_json_that_costs_more_than_it_says_is_one_line(folder, text, words):
    (folder / "scene.json").write_text(text)
    assert words in refusal(DatasetError, open_dataset, folder)
    assert not is_wand(folder)


def test_frames_beyond_what_can_be_recorded_are_refused(folder):
    scene = json.loads((folder / "scene.json").read_text())
    for changed, words in (({"frames": 10**8}, "frames: "), ({"width": 10**6, "height": 10**6}, "8K")):
        (folder / "scene.json").write_text(json.dumps(scene | changed))
        assert words in refusal(DatasetError, open_dataset, folder)


def readers(path):
    return {
        "configuration": lambda: yaml_file.read_document(path), "camera": lambda: load_camera(path),
        "photo": lambda: read_photos([path]), "picture": lambda: read_picture(path), "log": lambda: read_log(path),
        "table": lambda: tables.read_columns(path, ("a",)), "film": lambda: open_source(f"video:{path}")
    }  # fmt: skip


@pytest.mark.parametrize("kind", list(readers(Path())))
def test_a_fifo_that_nobody_writes_to_is_not_waited_for(tmp_path, kind):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    ended = threading.Event()

    def rescue():
        if not ended.wait(30.0):
            os.close(os.open(path, os.O_WRONLY))  # so that the test fails and does not hang

    threading.Thread(target=rescue, daemon=True).start()
    said = refusal(SpheremouseError, readers(path)[kind])
    hung = ended.is_set()
    ended.set()
    assert not hung
    assert "pipe" in said
    assert any(words in said for words in ("is not a file", "is no file", "no such"))


def test_few_of_many_problems_are_looked_up_and_the_rest_counted(monkeypatch):
    """60,000 unknown keys took over a minute of difflib."""
    looked_up = set()
    true = validate.difflib.get_close_matches
    monkeypatch.setattr(
        validate.difflib, "get_close_matches", lambda word, *a, **k: looked_up.add(word) or true(word, *a, **k)
    )
    text = "command: status\n" + "".join(f"key_{i}: 1\n" for i in range(3000))
    document = yaml_file.parse_document(text, "x.yaml")
    with pytest.raises(ConfigurationError) as e:
        validate.validate(document, Request)
    lines = str(e.value).splitlines()
    assert len(looked_up) == yaml_file.MAX_PROBLEMS
    assert lines[0].startswith("x.yaml:2: key_0: unknown key; ")
    assert lines[-1] == "x.yaml:21: and 2980 more problems from here on"
    assert len(lines) == yaml_file.MAX_PROBLEMS + 1


def test_a_yaml_file_of_more_values_than_any_is_refused_while_it_is_parsed(monkeypatch):
    composed = []
    monkeypatch.setattr(yaml_file.YAML, "compose", lambda *_: composed.append(1))
    text = "schema: 1\nrow: [" + ",".join("1" for _ in range(yaml_file.MAX_NODES)) + "]\n"
    with pytest.raises(ConfigurationError, match=r"^x.yaml:2: more than 20000 values; this is not a file of"):
        yaml_file.parse_document(text, "x.yaml")
    assert not composed


@pytest.mark.parametrize("number", ["9" * 5000, "0x" + "f" * 5000, "-0b" + "1" * 20_000])
def test_a_number_that_python_would_not_show_is_one_line(number):
    said = refusal(ConfigurationError, yaml_file.parse_document, f"schema: {number}\n", "x.yaml")
    assert said.startswith("x.yaml:1: schema: ")
    assert "is not a number that can be read" in said
