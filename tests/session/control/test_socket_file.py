"""The control socket as a file, and a run without it."""

import contextlib
import json
import os
import shutil
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from control_world import FINE, OTHER, a_group, answer
from invoking import refusal

from spheremouse.commands.service.systemd import under_umask
from spheremouse.errors import ControlError
from spheremouse.session.control import socket_file
from spheremouse.session.control.client import Client, NoDaemonError
from spheremouse.session.control.server import ControlServer, open_endpoints
from spheremouse.session.settings import Configuration, ControlSettings, MetricsSettings

as_root = pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("setpriv"), reason="needs root and setpriv")


@pytest.mark.parametrize("grouped", [False, True])
def test_the_file_is_the_owners_alone_or_the_groups_too_from_the_moment_it_listens(path, monkeypatch, grouped):
    """Whatever the process's umask: the mode is set before anybody can connect."""
    group = a_group() if grouped else None
    modes, listen = [], socket.socket.listen

    def look(self, *backlog):
        modes.append(stat.S_IMODE(path.stat().st_mode))
        listen(self, *backlog)

    monkeypatch.setattr(socket.socket, "listen", look)
    with under_umask(0), ControlServer(path, ControlSettings(group=group and group.gr_name), answer):
        assert set(modes) == {0o660 if group else 0o600}
        assert group is None or path.stat().st_gid == group.gr_gid


ASKER = """
import socket, sys
s = socket.socket(socket.AF_UNIX)
try:
    s.connect(sys.argv[1])
except PermissionError:
    print("permission denied")
else:
    try:
        s.sendall(b'{"command": "status"}\\n')
    except BrokenPipeError:
        pass
    print(s.makefile().readline().strip())
"""


def ask_as(path, uid, gid, *groups):
    extra = ["--groups", ",".join(map(str, groups))] if groups else ["--clear-groups"]
    words = ["setpriv", "--reuid", str(uid), "--regid", str(gid), *extra, sys.executable, "-I", "-c", ASKER, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True, cwd="/")
    return done.stdout.strip()


@pytest.fixture
def open_folder():
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@as_root
def test_another_user_in_fact(open_folder):
    """The file's mode keeps it out; and where somebody has opened that, the credentials do."""
    path = open_folder / "c"
    with ControlServer(path, ControlSettings(), answer):
        assert ask_as(path, OTHER, OTHER) == "permission denied"
        path.chmod(0o666)
        reply = json.loads(ask_as(path, OTHER, OTHER))
        assert reply["error"] == f"user {OTHER} may not control this daemon; its own user, root may"
        assert json.loads(ask_as(path, 0, 0)) == FINE


@as_root
def test_members_of_the_group_in_fact(open_folder):
    path, gid = open_folder / "c", a_group().gr_gid
    with ControlServer(path, ControlSettings(group=a_group().gr_name), answer):
        assert json.loads(ask_as(path, OTHER, gid)) == FINE  # by its first group
        assert json.loads(ask_as(path, OTHER, OTHER, gid)) == FINE  # by another one
        assert ask_as(path, OTHER, OTHER, gid + 1) == "permission denied"


def test_a_path_may_have_107_bytes(tmp_path_factory):
    folder = Path(tmp_path_factory.mktemp("s"))
    longest = folder / ((107 - len(os.fsencode(folder)) - 1) * "x")
    with ControlServer(longest, ControlSettings(), answer):
        assert Client(longest).ask("status")["state"] == "tracking"
    path = folder / (longest.name + "x")
    with pytest.raises(ControlError, match=r"too long for a socket; set control.socket to a path of 107 bytes or less"):
        ControlServer(path, ControlSettings(), answer)
    with pytest.raises(NoDaemonError, match="too long"):
        Client(path).ask("status")


def test_one_daemon_holds_a_path_until_its_end_and_a_killed_one_does_not(path):
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as killed:
        killed.bind(str(path))
    with pytest.raises(NoDaemonError, match="no daemon runs"):
        Client(path).ask("status")
    for _ in range(2):
        with ControlServer(path, ControlSettings(), answer):
            said = refusal(ControlError, ControlServer, path, ControlSettings(), answer)
            assert said.startswith(f"{path}: another daemon listens there (process {os.getpid()}); ")
            assert Client(path).ask("status")["state"] == "tracking"
        assert not path.exists()


def test_another_programs_socket_or_file_is_left_alone(path):
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as other:
        other.bind(str(path))
        other.listen()
        with pytest.raises(ControlError, match="another daemon listens there"):
            ControlServer(path, ControlSettings(), answer)
        assert path.exists()
    path.unlink()
    path.write_text("precious")
    with pytest.raises(ControlError, match="is no socket; move it away"):
        ControlServer(path, ControlSettings(), answer)
    assert path.read_text() == "precious"
    path.unlink()
    target = path.parent / "target"
    target.write_text("precious")
    path.symlink_to(target)
    with pytest.raises(ControlError, match="is no socket"):
        ControlServer(path, ControlSettings(), answer)
    lock = path.with_name(path.name + ".lock")
    path.unlink()
    lock.unlink(missing_ok=True)
    lock.symlink_to(target)
    with pytest.raises(ControlError, match="cannot be made"):
        ControlServer(path, ControlSettings(), answer)
    assert target.read_text() == "precious"


def test_a_folder_where_anybody_may_write_is_refused(path):
    path.parent.chmod(0o777)
    with pytest.raises(ControlError, match="anybody may write there"):
        ControlServer(path, ControlSettings(), answer)
    path.parent.chmod(0o1777)  # as /tmp
    ControlServer(path, ControlSettings(), answer).close()


@pytest.mark.parametrize(
    ("options", "place", "message"),
    [
        ({}, "missing/c", "cannot be made: No such file or directory; set control.socket"),
        ({"group": "no-such-group-here"}, "c", "control.group: no group 'no-such-group-here' on this machine"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(path, options, place, message):
    assert message in refusal(ControlError, ControlServer, path.parent / place, ControlSettings(**options), answer)


@pytest.fixture
def bare(monkeypatch, tmp_path_factory):
    """No daemon of this machine, and a user's folders of our own."""
    for name in ("SPHEREMOUSE_SOCKET", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    folder = Path(tmp_path_factory.mktemp("p"))
    monkeypatch.setattr(socket_file, "_SYSTEM", folder / "run")
    monkeypatch.setattr(socket_file.tempfile, "gettempdir", lambda: str(folder))
    monkeypatch.setattr(socket_file, "_uid", lambda: os.geteuid() or 0)
    return folder


def test_the_daemons_folder_is_systemds_else_the_systems_else_the_users(bare, monkeypatch):
    monkeypatch.setattr(socket_file, "_uid", lambda: 0)
    assert socket_file.socket_path(None) == bare / "run" / "control.sock"
    assert stat.S_IMODE((bare / "run").stat().st_mode) == 0o755
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/a:/run/b")
    assert socket_file.socket_path(None) == Path("/run/a/control.sock")
    assert socket_file.socket_path("/run/c/my.sock") == Path("/run/c/my.sock")


def test_a_user_without_a_runtime_folder_has_one_of_its_own_and_no_other(bare, monkeypatch):
    mine = os.geteuid() or 1000
    monkeypatch.setattr(socket_file, "_uid", lambda: mine)
    path = bare / f"spheremouse-{mine}"
    assert socket_file.runtime_folder() == path
    assert stat.S_IMODE(path.stat().st_mode) == 0o700
    path.chmod(0o770)  # as somebody else would make it to get in
    with pytest.raises(ControlError, match="another user's, or others may write there"):
        socket_file.runtime_folder()
    assert path / "control.sock" not in list(socket_file.candidates())
    path.rmdir()
    elsewhere = bare / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    path.symlink_to(elsewhere)
    with pytest.raises(ControlError, match="another user's"):
        socket_file.runtime_folder()
    elsewhere.rmdir()  # somebody else can make it again at any time
    assert path / "control.sock" not in list(socket_file.candidates())
    elsewhere.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(bare))
    assert socket_file.runtime_folder() == bare / "spheremouse"


def test_a_client_finds_the_daemon_that_answers(bare, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(bare))
    user, system = bare / "spheremouse" / "control.sock", bare / "run" / "control.sock"
    for p in (user, system):
        p.parent.mkdir(mode=0o755)
    assert socket_file.find_socket() == user
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as dead:
        dead.bind(str(user))  # what a user's daemon that was killed left
    assert socket_file.find_socket() == user
    with ControlServer(system, ControlSettings(), answer):
        assert socket_file.find_socket() == system
        assert Client().ask("status")["state"] == "tracking"
        with ControlServer(user, ControlSettings(), answer):
            assert socket_file.find_socket() == user
        monkeypatch.setenv("SPHEREMOUSE_SOCKET", "/elsewhere")
        assert socket_file.find_socket() == Path("/elsewhere")


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """(log, **configuration) -> the control server of a run."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    with contextlib.ExitStack() as stack:
        yield lambda log, **c: open_endpoints(stack, Configuration(**c), answer, dict, log.append, lambda: None)


def test_a_run_goes_on_without_the_usual_socket_that_another_run_holds_but_not_without_its_own(opened):
    log = []
    first = opened(log)
    assert log == []
    assert opened(log) is None
    (line,) = log
    assert "another daemon listens there" in line
    assert "cannot ask this run" in line
    with pytest.raises(ControlError, match="another daemon listens there"):
        opened(log, control=ControlSettings(socket=str(first.path)))


def test_a_run_goes_on_without_metrics_that_cannot_be_served(opened):
    log = []
    server = opened(log, metrics=MetricsSettings(port=9999, address="nonsense"))
    assert Client(server.path).ask("pause")
    assert len(log) == 1
    assert log[0].endswith("going on without")
