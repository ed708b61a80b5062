"""One daemon to a camera: a lock that names its holder and outlives nobody."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from spheremouse.capture import lock
from spheremouse.capture.lock import holder, locked, locked_camera
from spheremouse.errors import SourceError

HOLD = """
import sys, time
from pathlib import Path
from spheremouse.capture.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def other(tmp_path):
    """A node, on the kind of file system that devices are on, and another process that holds it."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=memory if os.access(memory, os.W_OK) else tmp_path))
    node = folder / "video0"
    node.touch()
    with subprocess.Popen([sys.executable, "-c", HOLD, str(node)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield node, process
        process.kill()
    shutil.rmtree(folder)


def test_the_second_is_refused_with_the_first_ones_number(other):
    node, process = other
    with pytest.raises(SourceError) as e, locked(node):
        pass
    assert str(e.value) == (
        f"{node}: in use by another spheremouse (process {process.pid}); end that one first, or ask it: "
        "spheremouse ctl status"
    )


def test_without_a_word_from_the_kernel_it_is_refused_all_the_same(other, monkeypatch):
    monkeypatch.setattr(lock, "holder", lambda _: None)
    with pytest.raises(SourceError, match="in use by another spheremouse; end that one"), locked(other[0]):
        pass


def test_a_holder_that_is_killed_leaves_nothing_behind(other):
    node, process = other
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert holder(node) is None
    for _ in range(2):
        with locked(node):
            assert holder(node) == os.getpid()
        assert holder(node) is None


def test_an_error_within_gives_it_back_and_a_missing_node_is_not_our_matter(tmp_path):
    node = tmp_path / "video0"
    with locked(node):
        assert not node.exists()
    node.touch()
    with pytest.raises(KeyError), locked(node):
        raise KeyError
    with locked(node):
        pass


@contextlib.contextmanager
def camera(log, fails=False):
    if fails:
        raise SourceError("no")
    log.append("open")
    yield "a camera"
    log.append("closed")


def test_a_camera_holds_its_node_while_it_is_open(tmp_path):
    node, log = tmp_path / "video0", []
    node.touch()
    with locked_camera(node, lambda: camera(log)) as opened:
        assert opened == "a camera"
        with pytest.raises(SourceError, match="in use"), locked(node):
            pass
    assert log == ["open", "closed"]
    with pytest.raises(SourceError, match=r"^no$"), locked_camera(node, lambda: camera(log, fails=True)):
        pass
    with locked(node):
        pass


def test_another_way_to_open_a_camera_that_is_open_is_no_second_daemon(tmp_path, monkeypatch):
    """A reload that changes its exposure must not meet our own lock."""
    from spheremouse.session.cameras import refuse_if_taken
    from spheremouse.session.run_config import CommandLineOverrides, read_run_config
    from spheremouse.session.setup import opener

    node, log = tmp_path / "video0", []
    node.touch()
    monkeypatch.setattr("spheremouse.capture.v4l2.open_camera", lambda argument, settings: camera(log))
    source = f"v4l2:{node},fps=30"
    plan = read_run_config(CommandLineOverrides(None, (f"source='{source}'", "output=null")))
    refuse_if_taken(source)
    with opener(plan)():
        with pytest.raises(SourceError, match=f"process {os.getpid()}|in use by another"):
            refuse_if_taken(source)
        changed = opener(plan)  # nothing is opened, and nothing refused, yet
    with changed():
        assert log == ["open", "closed", "open"]
