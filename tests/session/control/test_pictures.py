"""Pictures in shared memory, with the writer and the readers in different processes."""

import fcntl
import mmap
import os
import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from spheremouse.errors import ControlError
from spheremouse.session.control.pictures import LivePicture, PictureReader, PictureRing

PICTURE = LivePicture(1, 12.5, "yuyv", 4, 2, bytes(range(16)), {"sequence": 7, "outline": [[1.25, -2.0]]})
SIZE = 200_000  # bytes of a picture, which take longer to copy than to number


def numbered(number, size=SIZE):
    return LivePicture(number, float(number), "grey", number, 1, size * bytes([number % 251]), {"sequence": number})


def in_process(code, *files):
    """Run code in another process, which gets these descriptors as `files`."""
    words = f"import os, sys, time\nfiles = {[*files]}\n{code}"
    return subprocess.Popen([sys.executable, "-c", words], pass_fds=files, stdout=subprocess.PIPE)


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
    code = f"""
from spheremouse.session.control.pictures import PictureReader
reader, last, read = PictureReader(files[0]), 0, 0
end = time.monotonic() + 60.0
while read < 200 and time.monotonic() < end:
    picture = reader.latest(last)
    if picture is not None:
        number = picture.number
        assert number > last, "numbers rise"
        assert picture.stamp == picture.width == picture.annotations["sequence"] == number
        assert len(picture.pixels) == {SIZE} == picture.pixels.count(number % 251), "one picture's pixels"
        last, read = number, read + 1
print(read)
"""
    memory = ring.duplicate()
    with in_process(code, memory) as process:
        number = 0
        while process.poll() is None:
            number += 1
            ring.write(numbered(number))
        assert int(process.stdout.read()) == 200
    os.close(memory)
    assert number > 200


def test_a_reader_that_is_killed_leaves_the_ring_as_it_was():
    ring, reader_code = PictureRing(SIZE + 100), "from spheremouse.session.control import pictures as p\n"
    memory = ring.duplicate()
    code = f"{reader_code}r = p.PictureReader(files[0])\nprint(1, flush=True)\nwhile True: r.latest()"
    with in_process(code, memory) as process:
        process.stdout.readline()
        ring.write(numbered(1))
        process.send_signal(signal.SIGKILL)
    reader = PictureReader(memory)
    for number in range(2, 9):
        assert ring.write(numbered(number))
        assert reader.latest() == numbered(number)


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
