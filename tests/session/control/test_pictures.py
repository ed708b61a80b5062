"""Live pictures: the shared memory, and the JPEG made of it."""

import fcntl
import mmap
import os
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import simplejpeg

from spheremouse.errors import ControlError
from spheremouse.session.control.jpeg_picture import JpegPicture, mask
from spheremouse.session.control.pictures import LivePicture, PictureReader, PictureRing

PICTURE = LivePicture(1, 12.5, "yuyv", 4, 2, bytes(range(16)), {"sequence": 7, "outline": [[1.25, -2.0]]})
SIZE = 200_000  # bytes of a picture, which take longer to copy than to number


def open_files():
    return len(os.listdir("/proc/self/fd"))


def test_a_reader_gets_each_picture_as_it_was_written():
    ring = PictureRing(200)
    reader = PictureReader(ring.duplicate())
    assert reader.latest() is None
    for number, form in enumerate(("jpeg", "yuyv", "nv12", "grey", "bgr"), 1):
        written = replace(PICTURE, number=number, format=form, annotations=None if form == "grey" else {"n": number})
        assert ring.write(written)
        assert reader.latest(number - 1) == written
        assert reader.latest(number) is None
    ring.write(replace(PICTURE, number=6, pixels=memoryview(b"view")))
    assert reader.latest().pixels == b"view"


def test_every_picture_is_whole_while_another_process_writes_without_rest():
    """With two slots, the writer overwrites the slot that is being read after one picture more."""
    ring = PictureRing(SIZE + 100, slots=2)
    memory = ring.duplicate()
    code = f"""
import time
from spheremouse.session.control.pictures import PictureReader
reader, last, read = PictureReader({memory}), 0, 0
end = time.monotonic() + 60.0
while read < 100 and time.monotonic() < end:
    picture = reader.latest(last)
    if picture is not None:
        number = picture.number
        assert number > last, "numbers rise"
        assert picture.stamp == picture.width == picture.annotations["sequence"] == number
        assert len(picture.pixels) == {SIZE} == picture.pixels.count(number % 251), "one picture's pixels"
        last, read = number, read + 1
print(read)
"""
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, pass_fds=[memory], stdout=subprocess.PIPE) as process:
        number = 0
        while process.poll() is None:
            number += 1
            pixels = SIZE * bytes([number % 251])
            ring.write(LivePicture(number, float(number), "grey", number, 1, pixels, {"sequence": number}))
        assert int(process.stdout.read()) == 100
    os.close(memory)
    assert number > 100


def test_a_picture_that_does_not_fit_is_not_written():
    ring = PictureRing(64)
    reader = PictureReader(ring.duplicate())
    ring.write(replace(PICTURE, annotations=None))
    assert not ring.write(replace(PICTURE, number=2, pixels=65 * b"x", annotations=None))
    assert not ring.write(replace(PICTURE, number=2, pixels=60 * b"x", annotations={"much": "text"}))
    assert reader.latest().number == 1


def test_a_reader_of_a_ring_that_was_closed_keeps_its_last_picture():
    before = open_files()
    ring = PictureRing(100)
    reader = PictureReader(ring.duplicate())
    ring.write(PICTURE)
    ring.close()
    ring.close()
    assert reader.latest() == PICTURE
    with pytest.raises(ControlError, match="ask again"):
        ring.duplicate()
    reader.close()
    assert open_files() == before


def test_a_reader_can_neither_change_the_memory_nor_its_size():
    """A smaller file would end the writer (SIGBUS)."""
    ring = PictureRing(1000)
    memory = ring.duplicate()
    for size in (0, 1 << 20):
        with pytest.raises(PermissionError):
            os.ftruncate(memory, size)
    assert fcntl.fcntl(memory, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SEAL
    with pytest.raises(PermissionError):
        os.pwrite(memory, b"x", 0)
    with pytest.raises(PermissionError):
        mmap.mmap(memory, 0)
    os.close(memory)


@pytest.mark.parametrize("content", [b"", b"x", 64 * b"\0", b"spherem2" + 3 * b"\xff\xff\xff\x7f\0\0\0\0" + 99 * b"\0"])
def test_other_memory_is_refused_and_closed(content):
    before = open_files()
    memory = os.memfd_create("other")
    os.write(memory, content)
    with pytest.raises(ControlError, match=r"^pictures: "):
        PictureReader(memory)
    assert open_files() == before


def test_memory_that_the_system_does_not_have_is_refused_in_one_line():
    before = open_files()
    with pytest.raises(ControlError, match=r"pictures: no shared memory of \d+ bytes"):
        PictureRing(1 << 60)
    assert open_files() == before


WIDTH, HEIGHT = 160, 120


def picture(format_, pixels, annotations=None):
    return LivePicture(1, 0.0, format_, WIDTH, HEIGHT, bytes(pixels), annotations)


def scene():
    """Smooth colours, (h, w, 3) BGR, which JPEG and halved chroma keep."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([x, 2 * y % 240, 255 - x], axis=2).astype(np.uint8)


def raw(image, format_):
    """The bytes of a picture in a camera's format, as OpenCV converts it."""
    if format_ == "grey":
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).tobytes()
    if format_ == "bgr":
        return image.tobytes()
    planes = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)  # full range, as JPEG has it
    y, v, u = (planes[:, :, k] for k in range(3))
    if format_ == "yuyv":
        made = np.empty((HEIGHT, WIDTH, 2), np.uint8)
        made[:, :, 0], made[:, 0::2, 1], made[:, 1::2, 1] = y, u[:, ::2], v[:, ::2]
        return made.tobytes()
    return y.tobytes() + np.stack([u[::2, ::2], v[::2, ::2]], axis=2).tobytes()


@pytest.mark.parametrize("format_", ["bgr", "grey", "yuyv", "nv12"])
def test_a_raw_picture_becomes_a_jpeg_of_the_same_colours(format_):
    image = scene()
    seen = simplejpeg.decode_jpeg(JpegPicture(picture(format_, raw(image, format_))).whole, colorspace="BGR")
    true = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR) if format_ == "grey" else image
    assert np.sqrt(np.mean((seen.astype(float) - true) ** 2)) < 4.0


def test_a_jpeg_is_passed_on_as_it_is_and_made_once():
    jpeg = simplejpeg.encode_jpeg(scene(), colorspace="BGR")
    shown = JpegPicture(picture("jpeg", jpeg))
    assert shown.whole == jpeg
    assert shown.whole is shown.whole


@pytest.mark.parametrize(("x", "y", "radius"), [(80.0, 60.0, 40.0), (10.0, 110.0, 50.0), (80.0, 60.0, 300.0)])
def test_the_mask_of_an_outline_is_its_inside(x, y, radius):
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    outline = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)
    keep = mask(np.ones((HEIGHT, WIDTH, 1), np.uint8), {"outline": outline.tolist()})[:, :, 0] == 1
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    distance = np.hypot(u - x, v - y)
    assert keep[distance < radius - 1.0].all()
    assert not keep[distance > radius + 1.0].any()


@pytest.mark.parametrize("format_", ["bgr", "yuyv"])
def test_a_masked_picture_shows_ball_and_targets_alone(format_):
    marks = {
        "outline": [[40, 40], [80, 40], [80, 80], [40, 80]],
        "targets": [{"code": "CMY", "x": 130.0, "y": 30.0, "shape": [25.0, 0.0, 9.0]}],
    }
    white = np.full((HEIGHT, WIDTH, 3), 250, np.uint8)
    jpeg = JpegPicture(picture(format_, raw(white, format_), marks)).masked
    seen = simplejpeg.decode_jpeg(jpeg, colorspace="GRAY")[:, :, 0]
    assert seen[45:75, 45:75].min() > 200
    assert seen[25:36, 125:136].min() > 200
    seen[32:88, 32:88] = seen[12:48, 112:148] = 0
    assert seen.max() < 60


def test_a_mask_follows_the_ball_and_the_targets():
    """Successive pictures share the mask while neither has moved."""
    target = {"x": 20.0, "y": 90.0, "shape": [25.0, 0.0, 9.0]}
    ball = [[40, 40], [80, 40], [80, 80], [40, 80]]
    moved = [[x + 60, y] for x, y in ball]
    for outline, x in ((ball, 20.0), (ball, 20.0), (moved, 20.0), (moved, 140.0), (ball, 20.0)):
        marks = {"outline": outline, "targets": [{**target, "x": x}]}
        keep = mask(np.ones((HEIGHT, WIDTH, 3), np.uint8), marks).all(axis=2)
        assert [keep[60, 50], keep[60, 130]] == [outline is ball, outline is moved]
        assert [keep[90, 20], keep[90, 140]] == [x == 20.0, x == 140.0]


def test_without_a_known_pose_a_masked_picture_is_black():
    seen = simplejpeg.decode_jpeg(JpegPicture(picture("bgr", scene().tobytes())).masked)
    assert seen.max() < 10


def test_a_damaged_picture_is_not_shown_masked():
    jpeg = simplejpeg.encode_jpeg(scene(), colorspace="BGR")
    assert JpegPicture(picture("jpeg", b"\xff\xd8" + bytes(len(jpeg)), {})).masked == b""
