"""Files and folders that are written whole or not at all."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from spheremouse.commands.service.systemd import under_umask
from spheremouse.errors import ConfigurationError, ControlError, DatasetError
from spheremouse.files import safe_files
from spheremouse.files.safe_files import NewFolder, replace, write_atomically
from spheremouse.files.token import own_token, read_token
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.options import SimulationOptions
from spheremouse.simulate.to_dataset import write_simulation, write_wand
from spheremouse.simulate.wand.film import prepare_wand
from spheremouse.simulate.wand.options import WandOptions

KILLED = """
import os, signal, sys
from pathlib import Path
from spheremouse.files.safe_files import write_atomically
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
write_atomically(Path(sys.argv[1]), "half")
"""


def test_a_new_file_has_the_mode_of_the_umask_and_an_old_one_keeps_its_own(tmp_path):
    with under_umask(0o027):
        for mode, expected in ((None, 0o640), (0o604, 0o604)):
            path = tmp_path / str(mode)
            safe_files.replace(path, b"one", mode)
            assert path.stat().st_mode & 0o777 == expected
            path.chmod(0o600)
            safe_files.replace(path, b"two")
            assert path.stat().st_mode & 0o777 == 0o600


def test_a_pipe_or_device_is_never_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="device or pipe"):
        replace(pipe, b"")
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


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
        with safe_files.new_file(tmp_path / "x") as file:
            file.write(b"half")
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
    for age, there in ((0.0, {path, left, other}), (2 * safe_files.MIN_LEFTOVER_AGE_S, {path, other})):
        then = time.time() - age
        os.utime(left, (then, then))
        os.utime(other, (then, then))
        write_atomically(path, "whole")
        assert set(tmp_path.iterdir()) == there
    assert path.read_text() == "whole"


@contextmanager
def interrupted_at(step, within):
    """Raise SystemExit before instruction `step` of the module's functions `within`; yields whether it came."""
    left, done = [step], []

    def trace(frame, event, _):
        if frame.f_code.co_filename != safe_files.__file__ or frame.f_code.co_name not in within:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            if left[0] == 0:
                sys.settrace(None)
                done.append(True)
                raise SystemExit
            left[0] -= 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield done
    except SystemExit:
        pass
    finally:
        sys.settrace(before)


def test_a_folder_that_is_interrupted_at_any_step_of_its_making_is_removed(tmp_path):
    for step in range(1000):
        with interrupted_at(step, ("make",)) as done:
            new = NewFolder(tmp_path / "new", DatasetError)
            try:
                new.make()
            finally:
                new.discard()
        assert list(tmp_path.iterdir()) == [], step
        if not done:
            break
    assert 20 < step < 1000


def test_a_folder_that_is_interrupted_while_it_replaces_another_leaves_one_of_them_whole(tmp_path):
    place, content = tmp_path / "film", []
    for step in range(1000):
        place.mkdir(exist_ok=True)
        (place / "which").write_text("old")
        with interrupted_at(step, ("finish",)) as done:
            new = NewFolder(place, DatasetError)
            try:
                (new.make() / "which").write_text("new")
                new.finish()
            finally:
                new.discard()
        assert list(tmp_path.iterdir()) == [place], step
        content.append((place / "which").read_text())
        if not done:
            break
    assert step < 1000
    assert sorted(content, reverse=True) == content  # old up to some step, new from there on
    assert set(content) == {"old", "new"}


@contextmanager
def sigterm_as_the_folder_is_made(parent):
    """SIGTERM arrives as soon as there is a hidden folder in `parent`; the program unwinds, as `main` has it."""

    def profile(_, event, called):
        if event == "c_return" and called is os.mkdir and any(p.name.startswith(".") for p in parent.iterdir()):
            sys.setprofile(None)
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    sys.setprofile(profile)
    try:
        with pytest.raises(SystemExit):
            yield
    finally:
        sys.setprofile(None)
        signal.signal(signal.SIGTERM, before)


def simulated(path):
    list(write_simulation(path, prepare(SimulationOptions(seconds=0.1))))


def simulated_wand(path):
    list(write_wand(path, prepare_wand(WandOptions(seconds=0.1))))


def overlaid(path):
    with OverlayFile(path.with_suffix(".mp4"), 30.0):
        pass


@pytest.mark.parametrize("write", [simulated, simulated_wand, overlaid])
def test_sigterm_at_the_moment_at_which_the_hidden_folder_is_made_leaves_nothing(tmp_path, write):
    with sigterm_as_the_folder_is_made(tmp_path):
        write(tmp_path / "film")
    assert list(tmp_path.iterdir()) == []


def test_a_token_is_made_once_and_only_owner_and_group_read_it(tmp_path):
    path = tmp_path / "new" / "view.token"
    token = own_token(path)
    assert own_token(path) == read_token(path) == token
    assert len(token) > 32
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_file_without_a_token_is_refused_with_the_remedy(tmp_path):
    path = tmp_path / "view.token"
    with pytest.raises(ControlError, match="start `spheremouse view` first"):
        read_token(path)
    for text in ("", "short\n", "x" * 5000):
        path.write_text(text)
        with pytest.raises(ControlError, match=f"{path}: "):
            read_token(path)
    (tmp_path / "file").touch()
    with pytest.raises(ControlError, match="--token-file"):
        own_token(tmp_path / "file" / "view.token")
