"""Root writes into no folder that another user, played by `nobody`, may change.

Each test has a folder of its own that both can reach. Only root can give folders away, so other users skip these tests.
"""

import contextlib
import os
import pwd
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from spheremouse.commands.service import app
from spheremouse.errors import ConfigurationError, ControlError, ServiceError, SpheremouseError
from spheremouse.files import safe_files
from spheremouse.files.safe_files import write_atomically
from spheremouse.output import text
from spheremouse.session.control import socket_file
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.simulate.ball.film import SimulationOptions, prepare
from spheremouse.simulate.to_dataset import write_simulation

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or os.geteuid() != 0, reason="only root can be lured, and give folders away"
)
SECRET = "root's alone\n"


@pytest.fixture(autouse=True)
def no_sudo(monkeypatch):
    for name in ("SUDO_UID", "SUDO_GID"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def nobody():
    return pwd.getpwnam("nobody")


@pytest.fixture
def root():
    path = Path(tempfile.mkdtemp(prefix="spheremouse-root-"))
    path.chmod(0o755)
    yield path
    shutil.rmtree(path)


@pytest.fixture
def state(root, nobody):
    path = root / "var/lib/spheremouse"
    path.mkdir(parents=True)
    os.chown(path, nobody.pw_uid, nobody.pw_gid)
    return path


@pytest.fixture
def secret(root):
    path = root / "secret"
    path.write_text(SECRET)
    path.chmod(0o600)
    return path


@pytest.fixture
def own(nobody):
    return lambda path: os.chown(path, nobody.pw_uid, nobody.pw_gid, follow_symlinks=False)


@pytest.fixture
def planted(own):

    def plant(path, content):
        path.write_text(content)
        own(path)
        return path

    return plant


@pytest.fixture
def linked(own):

    def link(path, target):
        path.symlink_to(target)
        own(path)
        return path

    return link


def install(root):
    """What `service install` says; it must come to an end, and well."""
    with limited(30):
        result = CliRunner().invoke(app, ["install", "--root", str(root)])
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


@contextlib.contextmanager
def limited(seconds):

    def late(number, frame):
        pytest.fail("it waits for ever")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def as_user(user, work):
    """Do it as another user, in a process of its own; whether it went well."""
    child = os.fork()
    if child == 0:
        done = 1
        with contextlib.suppress(BaseException):
            os.setgroups([])
            os.setresgid(user.pw_gid, user.pw_gid, user.pw_gid)
            os.setresuid(user.pw_uid, user.pw_uid, user.pw_uid)
            work()
            done = 0
        os._exit(done)
    return os.waitpid(child, 0)[1] == 0


def test_the_installation_leaves_the_folders_of_the_services_user_alone(root, state, own, secret, linked):
    os.mkfifo(state / "x.yaml")
    own(state / "x.yaml")
    linked(state / "y.yaml", secret)
    before = {path: path.lstat() for path in state.iterdir()}
    install(root)
    assert {path: path.lstat() for path in state.iterdir()} == before


def test_purging_removes_links_and_not_what_they_lead_to(root, state, linked):
    kept = root / "kept"
    kept.mkdir()
    (kept / "file").write_text("")
    install(root)
    linked(state / "recordings", kept)
    assert shutil.rmtree.avoids_symlink_attacks  # nor what is exchanged meanwhile
    assert CliRunner().invoke(app, ["uninstall", "--purge", "--root", str(root)]).exit_code == 0
    assert not state.exists()
    assert [p.name for p in kept.iterdir()] == ["file"]


@pytest.mark.parametrize("folder", [".", "etc", "etc/systemd/system", "etc/spheremouse", "var/lib"])
@pytest.mark.parametrize("way", ["owner", "group", "link"])
def test_a_folder_that_others_may_change_is_refused(root, own, nobody, folder, way):
    path = root / "image" / folder
    path.mkdir(parents=True)
    if way == "owner":
        own(path)
    elif way == "group":
        os.chown(path, 0, nobody.pw_gid)
        path.chmod(0o775)
    else:
        outside = root / "outside"
        path.rename(outside)
        path.symlink_to(outside)
        own(path.parent)
    before = sorted(root.rglob("*"))
    for command in (["install"], ["uninstall", "--purge"]):
        with pytest.raises(ServiceError, match=r"users other than root can change|leads out of"):
            CliRunner().invoke(app, [*command, "--root", str(root / "image")], catch_exceptions=False)
    assert sorted(root.rglob("*")) == before


def test_a_link_out_of_the_image_is_refused_even_if_root_made_it(root):
    image, outside = root / "image", root / "outside"
    for path in (image, outside / "spheremouse"):
        path.mkdir(parents=True)
    (image / "etc").symlink_to(outside)
    for command in (["install"], ["uninstall", "--purge"]):
        with pytest.raises(ServiceError, match=r"image/etc.*: leads out of .*image; make it a folder there"):
            CliRunner().invoke(app, [*command, "--root", str(image)], catch_exceptions=False)
    assert list(outside.rglob("*")) == [outside / "spheremouse"]


def test_names_that_a_user_gave_do_not_steer_roots_terminal(root, state, planted):
    planted(state / "\x1b[2Jnothing\nshadow", "")
    said = install(root) + CliRunner().invoke(app, ["uninstall", "--root", str(root)]).output
    assert "\x1b" not in said
    assert "\nshadow" not in said


def append(path):
    with text.open(f"{path},format=counts"):
        pass


def film(path):
    with OverlayFile(path, 30.0) as video:
        video.show(lambda: np.zeros((48, 64, 3), np.uint8))


def write_dataset(path):
    simulation = prepare(SimulationOptions(motion="roll", seconds=0.05, size=(160, 120)))
    assert len(list(write_simulation(path, simulation))) == 2


@pytest.mark.parametrize("way", ["folder", "link"])
@pytest.mark.parametrize("write", [lambda path: write_atomically(path, "ours"), append, film, write_dataset])
def test_a_writer_refuses_a_folder_that_others_may_change(root, state, linked, monkeypatch, nobody, way, write):
    """Itself, or by a link that another user may exchange. The user who has called sudo is no other user."""
    kept = root / "kept"
    kept.mkdir()
    folder = state if way == "folder" else linked(state / "sub", kept)
    before = sorted(state.iterdir())
    with pytest.raises(SpheremouseError, match="root does not write into a folder that others may change"):
        write(folder / "x.mkv")
    assert sorted(state.iterdir()) == before
    assert list(kept.iterdir()) == []
    monkeypatch.setenv("SUDO_UID", str(nobody.pw_uid))
    write(folder / "x.mkv")
    (root / "way").symlink_to(kept)
    write(root / "way" / "y.mkv")
    assert list(kept.iterdir())


def test_a_pipe_is_written_to_by_its_user_and_by_root_only_in_a_folder_of_roots(root, state, own, nobody):
    (root / "pipes").mkdir()
    for folder in (state, root / "pipes"):
        os.mkfifo(folder / "pipe")
    own(state / "pipe")
    for folder, writer, allowed in ((state, None, False), (state, nobody, True), (root / "pipes", None, True)):
        reader = os.open(folder / "pipe", os.O_RDONLY | os.O_NONBLOCK)
        try:
            if writer is not None:
                assert as_user(writer, lambda: write_atomically(state / "pipe", "words"))
            elif allowed:
                write_atomically(folder / "pipe", "words")
            else:
                with pytest.raises(ConfigurationError, match="others may change"):
                    write_atomically(folder / "pipe", "words")
            assert os.read(reader, 100) == (b"words" if allowed else b"")
        finally:
            os.close(reader)
        assert stat.S_ISFIFO((folder / "pipe").stat().st_mode)


def test_a_file_that_root_replaces_stays_its_owners(state, planted, nobody, monkeypatch):
    monkeypatch.setenv("SUDO_UID", str(nobody.pw_uid))
    file = planted(state / "x.yaml", "old")
    file.chmod(0o640)
    write_atomically(file, "new")
    found = file.stat()
    assert (found.st_uid, found.st_gid, found.st_mode & 0o777) == (nobody.pw_uid, nobody.pw_gid, 0o640)


def test_a_socket_is_made_by_root_in_no_folder_of_another_user(state):
    with pytest.raises(ControlError, match="is another user's"), socket_file.listening(state / "socket", None):
        pass
    assert list(state.iterdir()) == []


def test_the_path_of_a_stream_is_the_stream_and_never_replaced(root):
    """/dev/stdout and /dev/fd/N, when they are files too: for root, /dev/stdout itself could be replaced."""
    out = root / "out"
    code = "from pathlib import Path; from spheremouse.files.safe_files import write_atomically as w; print('one'); "
    code += "w(Path('/dev/fd/1'), 'two\\n'); print('three')"
    with out.open("w") as file:
        subprocess.run([sys.executable, "-c", code], stdout=file, check=True, timeout=60)
    assert out.read_text() == "one\ntwo\nthree\n"


def test_a_folder_may_be_changed_by_its_group_and_by_the_owner_of_a_link_to_it(root, own, nobody, no_sudo):
    place = root / "place"
    place.mkdir()
    assert not safe_files.others_may_change(place)
    os.chown(place, 0, nobody.pw_gid)
    place.chmod(0o775)
    assert safe_files.others_may_change(place)
    place.chmod(0o1775)  # with the sticky bit nobody moves what is another's
    assert not safe_files.others_may_change(place)
    place.chmod(0o755)
    theirs = root / "theirs"
    theirs.mkdir()
    (theirs / "link").symlink_to(place)
    (root / "first").symlink_to(theirs / "link")
    assert not safe_files.others_may_change(root / "first")
    own(theirs)
    assert safe_files.others_may_change(theirs / "link")
    assert safe_files.others_may_change(root / "first")  # by a link of root's to a link of another's
