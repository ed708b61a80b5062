"""Standard error that nobody waits for: all of it is written where that goes, and what does not go is left out."""

import contextlib
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from spheremouse.session.process.standard_error import _MOST, unhurried

fcntl = pytest.importorskip("fcntl")


@contextlib.contextmanager
def a_pipe():
    """A small pipe in place of standard error; its reading end."""
    reads, writes = os.pipe()
    fcntl.fcntl(writes, fcntl.F_SETPIPE_SZ, 4096)
    with os.fdopen(writes, "w") as stream, contextlib.redirect_stderr(stream):
        yield reads
    os.close(reads)


def read_all(reads, until):
    """What comes until some text has."""
    data = b""
    while until not in data:
        data += os.read(reads, 65536)
    return data.decode()


def test_all_is_written_in_its_order_and_the_stream_is_given_back():
    got = []
    with a_pipe() as pipe:
        before = sys.stderr
        reader = threading.Thread(target=lambda: got.append(read_all(pipe, b"line 999\n")))
        reader.start()
        with unhurried():
            assert (sys.stderr.isatty(), sys.stderr.fileno()) == (False, before.fileno())
            for n in range(1000):
                print(f"line {n}", file=sys.stderr)
            reader.join(20.0)
        assert sys.stderr is before
    assert got[0].splitlines() == [f"line {n}" for n in range(1000)]


def test_who_does_not_read_keeps_nobody_and_is_told_how_much_was_left_out():
    line = "x" * 99 + "\n"
    lines = 3 * _MOST // len(line)
    with a_pipe() as pipe, unhurried():
        begun = time.monotonic()
        for _ in range(lines):
            sys.stderr.write(line)
        assert time.monotonic() - begun < 10.0
        sys.stderr.write("the last\n")
        said = read_all(pipe, b"the last\n").splitlines()
    told = [text for text in said if text.startswith("spheremouse: ")]
    left_out = sum(int(text.split()[1]) for text in told)
    assert all(text.endswith(" lines of the log left out: nobody took them") for text in told)
    assert said.count(line[:-1]) + left_out == lines
    assert left_out > lines / 2


def test_the_end_is_not_waited_for_for_ever_and_nothing_is_said_after_it():
    begun = time.monotonic()
    with a_pipe():
        with unhurried():
            sys.stderr.write("x" * 10000)
        assert time.monotonic() - begun < 10.0
        print("to nobody", file=sys.stderr, flush=True)  # what it was would block now
        sys.stderr.close()


def test_a_full_disk_is_survived_and_counted(monkeypatch, tmp_path):
    write, full = os.write, [True]

    def maybe(descriptor, data):
        if full[0] and descriptor == stream.fileno():
            raise OSError(28, "No space left on device")
        return write(descriptor, data)

    with (tmp_path / "log").open("w") as stream, contextlib.redirect_stderr(stream):
        monkeypatch.setattr(os, "write", maybe)
        with unhurried():
            made = sys.stderr
            for _ in range(3):
                sys.stderr.write("one\n")
            while not (made.failed and not made._texts):
                time.sleep(0.001)
            full[0] = False
            sys.stderr.write("two\n")
    text = (tmp_path / "log").read_text().splitlines()
    assert text == ["spheremouse: 3 lines of the log left out: nobody took them", "two"]


def test_a_stream_that_is_no_file_is_left_as_it_is(capsys):
    before = sys.stderr
    with unhurried():
        assert sys.stderr is before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_complaint_that_nobody_can_hear_ends_as_one_that_is_heard():
    """With the exit code of what was wrong: no traceback in its place, nor Python's 120 for what was not flushed."""
    words = [sys.executable, "-m", "spheremouse", "run", "--config", "/nonexistent"]
    with Path("/dev/full").open("wb") as full:
        codes = [subprocess.run(words, stderr=where, check=False).returncode for where in (subprocess.DEVNULL, full)]
    assert codes == [2, 2]
