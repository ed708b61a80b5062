"""Whole files: what they replace, what mode they get, and what a kill leaves of them."""

import os
import signal
import subprocess
import sys
import time

import pytest

from spheremouse.errors import ConfigurationError
from spheremouse.files import safe_files
from spheremouse.files.safe_files import write_atomically

KILLED = """
import os, signal, sys
from pathlib import Path
from spheremouse.files.safe_files import write_atomically
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
write_atomically(Path(sys.argv[1]), "half")
"""


def test_a_new_file_has_the_mode_of_the_umask_and_an_old_one_keeps_its_own(tmp_path):
    before = os.umask(0o027)
    try:
        for mode, expected in ((None, 0o640), (0o604, 0o604)):
            path = tmp_path / str(mode)
            safe_files.replace(path, b"one", mode)
            assert path.stat().st_mode & 0o777 == expected
            path.chmod(0o600)
            safe_files.replace(path, b"two")
            assert path.stat().st_mode & 0o777 == 0o600
    finally:
        os.umask(before)


def test_a_link_is_replaced_and_what_it_led_to_stays(tmp_path):
    (tmp_path / "aim").write_text("aim")
    (tmp_path / "link").symlink_to("aim")
    os.link(tmp_path / "aim", tmp_path / "second")
    for name in ("link", "second"):
        safe_files.replace(tmp_path / name, b"new")
        assert not (tmp_path / name).is_symlink()
        assert (tmp_path / name).read_text() == "new"
    assert (tmp_path / "aim").read_text() == "aim"


def test_a_file_that_is_given_up_leaves_nothing(tmp_path):
    def give_up():
        with safe_files.NewFile(tmp_path / "x") as new:
            new.file.write(b"half")
            assert len(list(tmp_path.iterdir())) == 1
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        give_up()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConfigurationError, match="cannot be written"):
        write_atomically(tmp_path / "no" / "a.yaml", "x")


def test_what_a_killed_writer_left_is_removed_by_the_next_writing_once_it_is_old(tmp_path):
    path, other = tmp_path / "rig.map.yaml", tmp_path / ".rig.map.yml.01234567.new"
    other.write_text("")
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
    (left,) = (p for p in tmp_path.iterdir() if p != other)
    for age, there in ((0.0, {path, left, other}), (2 * safe_files.OLD, {path, other})):
        then = time.time() - age
        os.utime(left, (then, then))
        os.utime(other, (then, then))
        write_atomically(path, "whole")
        assert set(tmp_path.iterdir()) == there
    assert path.read_text() == "whole"
