"""Standard error without waiting: all texts are written if possible, and the others are counted."""

import contextlib
import fcntl
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from spheremouse.session.process.standard_error import MAX_QUEUED_TEXTS, nonblocking_stderr


@contextlib.contextmanager
def a_pipe():
    """Replace standard error by a small pipe, and yield its reading end."""
    reads, writes = os.pipe()
    fcntl.fcntl(writes, fcntl.F_SETPIPE_SZ, 4096)
    with os.fdopen(writes, "w") as stream, contextlib.redirect_stderr(stream):
        yield reads
    os.close(reads)


def read_all(reads, until):
    data = b""
    while until not in data:
        data += os.read(reads, 65536)
    return data.decode()


def test_all_texts_are_written_in_order_and_the_stream_is_restored():
    got = []
    with a_pipe() as pipe:
        before = sys.stderr
        reader = threading.Thread(target=lambda: got.append(read_all(pipe, b"line 999\n")))
        reader.start()
        with nonblocking_stderr():
            assert (sys.stderr.isatty(), sys.stderr.fileno()) == (False, before.fileno())
            for n in range(1000):
                print(f"line {n}", file=sys.stderr)
            reader.join(20.0)
        assert sys.stderr is before
    assert got[0].splitlines() == [f"line {n}" for n in range(1000)]


def test_a_blocked_pipe_delays_nothing_and_dropped_lines_are_counted():
    line = "x" * 99 + "\n"
    lines = 3 * MAX_QUEUED_TEXTS
    with a_pipe() as pipe, nonblocking_stderr():
        begun = time.monotonic()
        for _ in range(lines):
            sys.stderr.write(line)
        assert time.monotonic() - begun < 10.0
        sys.stderr.write("the last\n")
        said = read_all(pipe, b"the last\n").splitlines()
    notes = [text for text in said if text.startswith("spheremouse: ")]
    dropped = sum(int(text.split()[1]) for text in notes)
    assert all(text.endswith(" lines of the log dropped: standard error was blocked") for text in notes)
    assert said.count(line[:-1]) + dropped == lines
    assert dropped > lines / 2


def test_the_end_waits_for_a_limited_time_and_then_discards():
    begun = time.monotonic()
    with a_pipe():
        with nonblocking_stderr():
            sys.stderr.write("x" * 10000)
        assert time.monotonic() - begun < 10.0
        print("discarded", file=sys.stderr, flush=True)  # the original stream would block
        sys.stderr.close()


def test_lines_lost_to_a_full_disk_are_counted(monkeypatch, tmp_path):
    write, full, refused = os.write, [True], []

    def maybe(descriptor, data):
        if full[0] and descriptor == stream.fileno():
            refused.append(data)
            raise OSError(28, "No space left on device")
        return write(descriptor, data)

    with (tmp_path / "log").open("w") as stream, contextlib.redirect_stderr(stream):
        monkeypatch.setattr(os, "write", maybe)
        with nonblocking_stderr():
            for _ in range(3):
                sys.stderr.write("one\n")
            while len(refused) < 3:
                time.sleep(0.001)
            full[0] = False
            sys.stderr.write("two\n")
    text = (tmp_path / "log").read_text().splitlines()
    assert text == ["spheremouse: 3 lines of the log dropped: standard error was blocked", "two"]


def test_a_stream_without_a_descriptor_is_kept(capsys):
    before = sys.stderr
    with nonblocking_stderr():
        assert sys.stderr is before


@pytest.mark.slow
def test_an_error_that_cannot_be_written_has_the_same_exit_code():
    """There is no traceback, and no exit code 120, which Python gives if it cannot flush."""
    words = [sys.executable, "-m", "spheremouse", "run", "--config", "/nonexistent"]
    with Path("/dev/full").open("wb") as full:
        codes = [subprocess.run(words, stderr=where, check=False).returncode for where in (subprocess.DEVNULL, full)]
    assert codes == [2, 2]
