"""What root does where another user has laid traps: that user, played by `nobody`, gets nothing that was not theirs.

Each test has a folder of its own that both can reach; only root can give folders away, so the others are skipped.
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
from spheremouse.commands.service import systemd as service
from spheremouse.errors import ConfigurationError, ControlError, DatasetError, OutputError, ServiceError
from spheremouse.files import lookup
from spheremouse.files.atomic import write_atomically
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.folders import NewFolder
from spheremouse.files.service import service_files
from spheremouse.output import text
from spheremouse.output.serial import firmware
from spheremouse.session.control import socket as control_socket
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.simulate.ball.film import SimulationOptions, prepare
from spheremouse.simulate.to_dataset import write_simulation

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or os.geteuid() != 0, reason="only root can be lured, and give folders away"
)
OLD, NEW = "schema: 1\nso3: {sigma: 1.0e-05}  # as measured\n", "schema: 2\n"
SECRET = "schema: 1\nsecret: yes\n"


@pytest.fixture(autouse=True)
def no_sudo(monkeypatch):
    for name in ("SUDO_UID", "SUDO_GID"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def nobody():
    return pwd.getpwnam("nobody")


@pytest.fixture
def root():
    """A system below a root of its own."""
    path = Path(tempfile.mkdtemp(prefix="spheremouse-root-"))
    path.chmod(0o755)
    yield path
    shutil.rmtree(path)


@pytest.fixture
def state(root, nobody):
    """The folder that belongs to the service's user."""
    path = root / "var/lib/spheremouse"
    path.mkdir(parents=True)
    os.chown(path, nobody.pw_uid, nobody.pw_gid)
    return path


@pytest.fixture
def secret(root):
    """A file of root's that nobody else may read."""
    path = root / "secret"
    path.write_text(SECRET)
    path.chmod(0o600)
    return path


@pytest.fixture
def own(nobody):
    """Give a path to the other user."""
    return lambda path: os.chown(path, nobody.pw_uid, nobody.pw_gid, follow_symlinks=False)


@pytest.fixture
def planted(own):
    """A file, made by the other user."""

    def plant(path, content):
        path.write_text(content)
        own(path)
        return path

    return plant


@pytest.fixture
def linked(own):
    """A link, made by the other user."""

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
    """No waiting for ever."""

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


# ---- `service install` ----


def test_a_temporary_exchanged_before_it_gets_its_mode_gives_no_file_away(root, state, secret, planted, monkeypatch):
    """The exchange takes place between writing and chmod."""
    file = planted(state / "x.yaml", NEW)
    file.chmod(0o666)
    real, swapped = os.fsync, root / "swapped"

    def exchanged(descriptor):
        real(descriptor)
        for there in state.glob(".*.new"):
            there.rename(state / f"{there.name}.gone")
            there.symlink_to(secret)
            swapped.write_text("yes")

    monkeypatch.setattr(os, "fsync", exchanged)
    write_atomically(file, "schema: 1\n")
    assert swapped.read_text() == "yes"
    assert secret.stat().st_mode & 0o777 == 0o600
    assert secret.stat().st_uid == 0


def test_the_installation_leaves_the_folders_of_the_services_user_alone(root, state, own, secret, linked):
    os.mkfifo(state / "x.yaml")
    own(state / "x.yaml")
    linked(state / "y.yaml", secret)
    before = {path: path.lstat() for path in state.iterdir()}
    install(root)
    assert {path: path.lstat() for path in state.iterdir()} == before


def test_an_edited_unit_is_kept_beside_a_link_not_where_it_leads(root, secret):
    install(root)
    unit = service.Place(root).unit
    unit.write_text("# mine\n")
    unit.with_name(f"{unit.name}.bak").symlink_to(root / "not there")
    install(root)
    assert not (root / "not there").exists()
    assert unit.with_name(f"{unit.name}.bak1").read_text() == "# mine\n"


# ---- `service uninstall` ----


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


def test_an_image_of_another_user_does_not_lead_out_of_itself(root, own, linked, monkeypatch, nobody):
    """With a link where a folder of the system is to be. Not even if that user may call sudo."""
    image, outside = root / "image", root / "outside"
    for path in (image, outside / "spheremouse"):
        path.mkdir(parents=True)
    (outside / "spheremouse/rig.yaml").write_text("rig")
    own(image)
    linked(image / "etc", outside)
    reasons = (None, "another user may change"), (str(nobody.pw_uid), "root does not follow etc, a link that another")
    for caller, reason in reasons:
        if caller is not None:
            monkeypatch.setenv("SUDO_UID", caller)
        for command in (["install"], ["uninstall", "--purge"]):
            with pytest.raises(ServiceError, match=reason):
                CliRunner().invoke(app, [*command, "--root", str(image)], catch_exceptions=False)
    assert [p.name for p in outside.rglob("*") if p.is_file()] == ["rig.yaml"]


def test_names_that_a_user_gave_do_not_steer_roots_terminal(root, state, planted):
    planted(state / "\x1b[2Jnothing\nshadow", "")
    said = install(root) + CliRunner().invoke(app, ["uninstall", "--root", str(root)]).output
    assert "\x1b" not in said
    assert "\nshadow" not in said


# ---- every writer ----


@pytest.mark.parametrize(
    "write", [lambda p: write_atomically(p, "ours"), lambda p: text.begin(str(p), "# ours")[0].close()]
)
def test_root_goes_through_no_link_of_another_user(root, state, secret, linked, write):
    """Neither at the end of a path nor on the way; its own links it follows."""
    kept = root / "kept"
    kept.mkdir()
    linked(state / "sub", kept)
    with pytest.raises((ConfigurationError, OutputError), match="root does not follow sub, a link that another"):
        write(state / "sub" / "x")
    linked(state / "x", kept / "new")
    with contextlib.suppress(OutputError):  # replaced, or refused
        write(state / "x")
    assert list(kept.iterdir()) == []
    (root / "way").symlink_to(kept)
    write(root / "way" / "x")
    assert [p.name for p in kept.iterdir()] == ["x"]


def test_what_is_no_file_is_written_through_by_its_user_and_by_root_only_in_a_folder_of_roots(root, state, own, nobody):
    (root / "pipes").mkdir()
    for folder in (state, root / "pipes"):
        os.mkfifo(folder / "pipe")
    own(state / "pipe")
    for folder, writer, well in ((state, None, False), (state, nobody, True), (root / "pipes", None, True)):
        reader = os.open(folder / "pipe", os.O_RDONLY | os.O_NONBLOCK)
        try:
            if writer is not None:
                assert as_user(writer, lambda: write_atomically(state / "pipe", "words"))
            elif well:
                write_atomically(folder / "pipe", "words")
            else:
                with pytest.raises(ConfigurationError, match="another user may write beside it"):
                    write_atomically(folder / "pipe", "words")
            assert os.read(reader, 100) == (b"words" if well else b"")
        finally:
            os.close(reader)
        assert stat.S_ISFIFO((folder / "pipe").stat().st_mode)


def test_a_file_that_root_replaces_stays_its_owners(state, planted, nobody):
    file = planted(state / "x.yaml", NEW)
    file.chmod(0o640)
    write_atomically(file, OLD)
    found = file.stat()
    assert (found.st_uid, found.st_gid, found.st_mode & 0o777) == (nobody.pw_uid, nobody.pw_gid, 0o640)


def test_root_reads_no_file_with_a_second_name_where_others_write(state, secret):
    os.link(secret, state / "x")
    with pytest.raises(OSError, match="has a second name"):
        lookup.open_to_read(state / "x")


def test_a_recording_that_another_user_exchanges_goes_where_root_began_it(root, state, linked):
    """The folder under its hidden name is moved away, and a link to a folder of root's is put there."""
    kept = root / "kept"
    kept.mkdir()
    new = NewFolder(state / "r", DatasetError)
    new.make()
    (hidden,) = state.iterdir()
    hidden.rename(state / "moved")
    linked(hidden, kept)
    (new.path / "stamps.csv").write_text("rows")
    assert list(kept.iterdir()) == []
    assert (state / "moved/stamps.csv").read_text() == "rows"
    new.discard()
    assert kept.is_dir()


def test_root_records_and_films_in_another_users_folder_too(state):
    write_dataset(state / "r")
    assert open_dataset(state / "r").frames == 2
    with OverlayFile(state / "film.mkv", 30.0) as film:
        for _ in range(3):
            film.show(lambda: np.zeros((48, 64, 3), np.uint8))
    assert film.written
    assert sorted(p.name for p in state.iterdir()) == ["film.mkv", "r"]


def write_dataset(path):
    film = prepare(SimulationOptions(motion="roll", seconds=0.05))
    assert len(list(write_simulation(path, film))) == 2


def test_a_socket_is_made_by_root_in_no_folder_of_another_user(state):
    with pytest.raises(ControlError, match="is another user's"):
        control_socket.lock(state / "socket")
    assert list(state.iterdir()) == []


def test_installing_the_firmware_writes_through_nothing_on_the_drive(root, state, secret, linked):
    source = service_files(firmware.PICO)
    for ending in ("", ".part"):
        linked(state / f"code.py{ending}", secret)
    os.mkfifo(state / "boot.py")
    with limited(30):
        assert firmware.stale(source, state) == list(firmware.FILES)
        firmware.copy(source, state, list(firmware.FILES))
        assert firmware.stale(source, state) == []
    assert secret.read_text() == SECRET


def test_the_path_of_a_stream_is_the_stream_and_never_replaced(root):
    """/dev/stdout and /dev/fd/N, when they are files too: for root, /dev/stdout itself could be replaced."""
    out = root / "out"
    code = "from pathlib import Path; from spheremouse.files.atomic import write_atomically as w; print('one'); "
    code += "w(Path('/dev/fd/1'), 'two\\n'); print('three')"
    with out.open("w") as file:
        subprocess.run([sys.executable, "-c", code], stdout=file, check=True, timeout=60)
    assert out.read_text() == "one\ntwo\nthree\n"


# ---- folders that another can exchange, or fill ----


def test_a_folder_is_exchangeable_where_a_group_or_a_links_owner_has_a_say(root, own, nobody, no_sudo):
    place = root / "place"
    place.mkdir()
    assert not lookup.exchangeable(place)
    os.chown(place, 0, nobody.pw_gid)
    place.chmod(0o775)
    assert lookup.exchangeable(place)
    place.chmod(0o1775)  # with the sticky bit nobody moves what is another's
    assert not lookup.exchangeable(place)
    place.chmod(0o755)
    theirs = root / "theirs"
    theirs.mkdir()
    (theirs / "link").symlink_to(place)
    (root / "first").symlink_to(theirs / "link")
    assert not lookup.exchangeable(root / "first")
    own(theirs)
    assert lookup.exchangeable(theirs / "link")
    assert lookup.exchangeable(root / "first")  # by a link of root's to a link of another's


def test_folders_too_deep_for_a_recursion_are_removed(root, state, secret):
    at = os.open(state, os.O_RDONLY)
    for _ in range(2500):  # more than Python recurses, and than descriptors may be open
        os.mkdir("d", dir_fd=at)
        os.symlink(secret, "link", dir_fd=at)
        down = os.open("d", os.O_RDONLY, dir_fd=at)
        os.close(at)
        at = down
    os.close(at)
    with limited(60):
        lookup.remove_tree(state)
    assert not state.exists()
    assert secret.read_text() == SECRET


def test_a_board_that_is_none_does_not_steer_roots_terminal(tmp_path):
    (tmp_path / "boot_out.txt").write_text(
        "Adafruit CircuitPython 9.1.0 on 2024-07-10; \x1b[31mx\nBoard ID:\x1b]52;c;A\x07b\n"
    )
    assert firmware.read_drive(tmp_path).board.isprintable()
