"""Whole files: what they replace, what mode they get, and what a kill leaves of them."""

import os
import signal
import subprocess
import sys
import time

import pytest

from spheremouse.ball.warm import _RIG
from spheremouse.files import safe_files
from spheremouse.files.safe_files import NewFolder, clear_left_folders, write_atomically
from spheremouse.session.ball.map_keeper import MapKeeper
from spheremouse.session.record.places import tidy

posix = pytest.mark.skipif(os.name != "posix", reason="modes and links are others there")
KILLED = """
import os, signal, sys
from pathlib import Path
from spheremouse.files.safe_files import write_atomically
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
write_atomically(Path(sys.argv[1]), "half")
"""


def aged(path, seconds=2 * safe_files.OLD):
    """As if nobody had touched it for so long."""
    then = time.time() - seconds
    os.utime(path, (then, then), follow_symlinks=False)
    return path


@posix
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


@posix
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


# ---- what a kill leaves ----


@pytest.fixture
def left(tmp_path):
    """The temporary of a process that was killed while it wrote rig.map.yaml."""
    path = tmp_path / "rig.map.yaml"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
    (there,) = tmp_path.iterdir()
    assert there.name.startswith(".rig.map.yaml.")
    return there


@posix
def test_what_a_killed_writer_left_is_removed_once_it_is_old(left):
    assert safe_files.clear_left(left.parent) == 0
    assert left.exists()
    aged(left)
    assert safe_files.clear_left(left.parent) == 1
    assert not left.exists()


@posix
@pytest.mark.parametrize("start", ["map", "recordings", "next writing"])
def test_it_is_removed_by_the_next_start(left, start):
    aged(left)
    if start == "map":
        MapKeeper(left.parent / "rig.map.yaml", _RIG, lambda _: None)
    elif start == "recordings":
        assert tidy(left.parent) == 1
    else:
        write_atomically(left.parent / "rig.map.yaml", "")
    assert not left.exists()


def test_what_is_not_ours_or_is_being_written_stays(tmp_path):
    kept = [tmp_path / n for n in (".x.new", ".x.abcdefgh", "x.abcdefgh.new", ".x.abcdefg.new", ".x.ABCDEFGH.new")]
    for path in kept:
        path.write_text("")
    folder, link = tmp_path / ".x.abcdefg0.new", tmp_path / ".x.abcdefg1.new"
    folder.mkdir()
    link.symlink_to(kept[0])
    first = tmp_path / ".x.abcdefg2.new"
    first.write_text("")
    os.link(first, tmp_path / "second")
    kept += [folder, link, first]
    if os.geteuid() == 0:
        kept.append(tmp_path / ".x.abcdefg3.new")
        kept[-1].write_text("")
        os.chown(kept[-1], 65534, 65534)
    with safe_files.NewFile(tmp_path / "y") as new:
        new.file.write(b"whole")
        new.file.flush()
        for path in tmp_path.iterdir():
            aged(path)
        assert safe_files.clear_left(tmp_path) == 0
    assert (tmp_path / "y").read_text() == "whole"
    assert {*kept, tmp_path / "y", tmp_path / "second"} == set(tmp_path.iterdir())


@posix
def test_empty_folders_of_killed_recordings_are_removed_once_they_are_old(tmp_path):
    """By the pattern of `begin_folder`, and only what holds nothing."""
    gone, young, full = (tmp_path / f".r.abcdefg{k}" for k in range(3))
    others = [tmp_path / n for n in (".r", ".config", "r.abcdefgh", ".r.abcdefghi")]
    for path in (gone, young, full, *others):
        path.mkdir()
    (full / "video.mkv").write_text("")
    (tmp_path / ".r.abcdefg9").symlink_to(full)
    for path in tmp_path.iterdir():
        aged(path, 0 if path == young else 2 * safe_files.OLD)
    assert tidy(tmp_path) == 1
    assert {young, full, *others, tmp_path / ".r.abcdefg9"} == set(tmp_path.iterdir())
    assert clear_left_folders(tmp_path / "nowhere") == 0


@posix
def test_the_names_that_are_removed_are_the_names_that_are_made(tmp_path):
    from spheremouse.errors import DatasetError

    NewFolder(tmp_path / "r.1", DatasetError).make()
    (made,) = tmp_path.iterdir()
    aged(made)
    assert clear_left_folders(tmp_path) == 1
    assert not made.exists()
