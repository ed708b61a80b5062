"""`spheremouse service`: what is placed, kept and removed below a root of its own, and that systemd and udev accept it.

systemd's own tools judge the unit where they are installed; the others need nothing.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from spheremouse.commands.service import app, check
from spheremouse.commands.service import systemd as service
from spheremouse.commands.service.systemd import Place, under_umask
from spheremouse.errors import ServiceError
from spheremouse.files import config
from spheremouse.files.access import service_files
from spheremouse.session.settings import Configuration

PROGRAM = "/opt/spheremouse/current/bin/spheremouse"
UNIT = "etc/systemd/system/spheremouse.service"
LIMIT = 2.5  # of `systemd-analyze security`: how much is open


def tree(root):
    """Every file and link below a folder, with its text or aim."""
    return {
        str(p.relative_to(root)): os.readlink(p) if p.is_symlink() else p.read_text()
        for p in sorted(root.rglob("*"))
        if p.is_symlink() or p.is_file()
    }


def call(*arguments, root=None):
    """Output of the command; it must not fail."""
    given = [*arguments, *([] if root is None else ["--root", str(root)])]
    result = CliRunner().invoke(app, given, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def root(tmp_path):
    path = tmp_path / "root"
    path.mkdir()
    return path


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home of one's own, where nothing is known of this account's services."""
    path = tmp_path / "home"
    path.mkdir()
    monkeypatch.setenv("HOME", str(path))
    for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME", "XDG_RUNTIME_DIR", "SUDO_USER"):
        monkeypatch.delenv(name, raising=False)
    return path


def test_installing_places_every_file_and_a_second_time_changes_nothing(root):
    call("install", root=root)
    once = tree(root)
    assert {str(p.relative_to(root)) for p in Place(root).files.values()} < set(once)
    for unit in (UNIT, UNIT.replace("spheremouse.", "spheremouse-view.")):
        assert once[f"etc/systemd/system/multi-user.target.wants/{Path(unit).name}"] == f"/{unit}"
    assert (
        f"ExecStart={sys.prefix}/bin/spheremouse run --realtime --config /etc/spheremouse/config.yaml\n"
        in (root / UNIT).read_text()
    )
    assert len([p for p in root.rglob("*") if p.is_file()]) == len(Place(root).files) + 1
    assert not [path for path, text in once.items() if re.search(r"@[A-Z0-9]+@", text)]  # nothing is unfilled
    assert "all files are in place" in call("install", root=root)
    assert tree(root) == once


@pytest.mark.parametrize("umask", [0o077, 0o000])
def test_what_is_placed_may_be_read_by_all_whatever_the_umask_and_what_was_there_stays_as_it_was(root, umask):
    before = root / "etc" / "X11"
    before.mkdir(parents=True)
    before.chmod(0o750)
    with under_umask(umask):
        call("install", root=root)
        assert os.umask(umask) == umask
    placed = {path: path.stat().st_mode & 0o777 for path in root.rglob("*") if not path.is_symlink()}
    assert placed.pop(before) == 0o750
    assert placed.pop(before.parent) & 0o700 == 0o700
    assert {(path.is_dir(), mode) for path, mode in placed.items()} == {(True, 0o755), (False, 0o644)}


def test_uninstalling_leaves_what_somebody_made_or_changed_unless_purged(root):
    (root / "hostname").write_text("cabinet\n")
    call("install", root=root)
    assert "the service is gone" in call("uninstall", root=root)
    assert tree(root) == {"hostname": "cabinet\n"}
    assert "there was no service" in call("uninstall", root=root)
    (root / "hostname").unlink()
    call("install", root=root)
    kept = {
        "etc/spheremouse/config.yaml": "schema: 2\n",
        "etc/spheremouse/rig.yaml": "rig",
        "var/lib/spheremouse/rig.map.yaml": "map",
        "etc/systemd/system/spheremouse.service.d/override.conf": "[Service]\n",  # of `systemctl edit`
    }
    for name, text in kept.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    said = call("uninstall", root=root)
    assert tree(root) == kept
    assert all(str(root / name) in said for name in kept)
    call("uninstall", "--purge", root=root)
    assert tree(root) == {}


def test_a_service_that_was_disabled_stays_disabled(root):
    call("install", root=root)
    Place(root).link.unlink()
    (root / UNIT).write_text("[Service]\nExecStart=/bin/true\n")
    call("install", root=root)
    assert not Place(root).link.is_symlink()


def test_a_dry_run_says_all_and_does_nothing(root):
    for command in ("install", "uninstall"):
        before = tree(root)
        said = call(command, "--dry-run", root=root)
        assert tree(root) == before
        assert all(str(path) in said for path in Place(root).files.values())
        call("install", root=root)


def test_a_users_own_service_goes_to_the_home_alone_in_folders_closed_to_others_whatever_the_umask(root, home):
    below = root / home.relative_to("/")
    below.mkdir(parents=True)
    with under_umask(0o000):
        call("install", "--user", root=root)
    assert {p.stat().st_mode & 0o777 for p in below.rglob("*") if p.is_dir()} == {0o700}
    assert all(p.is_relative_to(below) or below.is_relative_to(p) for p in root.rglob("*"))
    unit = below / ".config/systemd/user/spheremouse.service"
    assert "run --realtime --config %E/spheremouse/config.yaml" in unit.read_text()
    assert os.readlink(unit.parent / "default.target.wants" / unit.name) == f"{home}/.config/systemd/user/{unit.name}"
    assert f"rig: {home}/.config/spheremouse/rig.yaml\n" in (below / ".config/spheremouse/config.yaml").read_text()
    film = below / ".local/state/spheremouse/recordings/1/video.mkv"
    film.parent.mkdir(parents=True)
    film.write_text("")
    assert str(film) in call("uninstall", "--user", root=root)
    assert film.exists()
    call("uninstall", "--user", "--purge", root=root)
    assert tree(root) == {}


def test_what_is_left_to_do_is_said_where_all_is_placed_and_it_does_not_run(home, monkeypatch):
    """Before the calibration to calibrate, then to start it; not to install what is there."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(home / "nowhere"))  # systemd does not run
    call("install", "--user")
    monkeypatch.setattr(check.subprocess, "run", lambda *_, **__: SimpleNamespace(stdout="ActiveState=inactive"))
    rig = home / ".config/spheremouse/rig.yaml"
    for expected, absent in (("calibrate", "journalctl"), ("systemctl --user start", "calibrate")):
        said = status(1, "--user")
        assert expected in said
        assert absent not in said
        assert "service install" not in said
        rig.write_text("")


def status(code, *words):
    result = CliRunner().invoke(app, ["status", *map(str, words)], env={"COLUMNS": "400"})
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def test_status_tells_what_is_missing_or_differs(root):
    status(1, "--root", root)
    call("install", root=root)
    assert "edited" not in status(0, "--root", root)
    text = (root / UNIT).read_text()
    (root / UNIT).write_text(text + "# more\n")
    assert f"edited, or of another version: {root / UNIT}" in status(1, "--root", root)
    (root / UNIT).unlink()
    assert f"missing: {root / UNIT}" in status(1, "--root", root)


def test_without_rights_the_command_to_repeat_is_said(root, monkeypatch):
    monkeypatch.setattr(service, "may", lambda place: False)
    with pytest.raises(ServiceError, match=r"sudo .*spheremouse service install"):
        call("install", root=root)
    assert tree(root) == {}


NETWORK = f"{UNIT}.d/spheremouse-network.conf"


def test_allowed_addresses_are_in_a_file_beside_the_unit_until_others_are_given(root):
    call("install", root=root)
    before = tree(root)
    call("install", "--allow", "192.168.1.7", "--allow", "2001:db8::/32", "--allow", "multicast", root=root)
    lines = (root / NETWORK).read_text().splitlines()
    assert lines[2:] == ["[Service]", *(f"IPAddressAllow={a}" for a in ("192.168.1.7", "2001:db8::/32", "multicast"))]
    assert "all files are in place" in call("install", root=root)
    call("install", "--allow", "10.0.0.0/8", root=root)
    assert (root / NETWORK).read_text().splitlines()[2:] == ["[Service]", "IPAddressAllow=10.0.0.0/8"]
    call("uninstall", "--purge", root=root)
    assert tree(root) == {}
    call("install", root=root)
    assert tree(root) == before


def test_another_address_is_refused_and_nothing_is_placed(root, home):
    lines = ("10.0.0.1\n", "10.0.0.1\nDeviceAllow=/dev/mem", "fe80::1%1\nDeviceAllow=/dev/mem")
    for address in ("192.168.1.300", "192.168.1.7/24", "cabinet.local", "", *lines):
        with pytest.raises(ServiceError) as e:
            call("install", "--allow", "10.0.0.1", "--allow", address, root=root)
        why = "has bits after its prefix" if "/24" in address else "is neither an IP address nor a network"
        assert e.value.problem == f"--allow {address}: {why}"
        assert e.value.hint == "write for example 192.168.1.7, 192.168.1.0/24 or multicast"
    with pytest.raises(ServiceError, match="has no filter of addresses; leave --allow out"):
        call("install", "--user", "--allow", "10.0.0.1", root=root)
    assert tree(root) == {}


def test_the_unit_starts_the_version_in_use_by_the_link_that_upgrades_move(tmp_path, monkeypatch):
    for version in ("1.0", "2.0"):
        (tmp_path / version / "bin").mkdir(parents=True)
        (tmp_path / version / "bin" / "spheremouse").write_text("")
    (tmp_path / "current").symlink_to("2.0")
    place = Place(tmp_path)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "2.0"))
    assert service.executable(place) == ("/current/bin/spheremouse", "")
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "1.0"))
    assert service.executable(place) == ("/1.0/bin/spheremouse", "")


@pytest.mark.parametrize(
    ("folder", "python", "how"),
    [
        *((folder, "/usr/bin/python3", "sudo bash service/install.sh") for folder in ("/home/a", "/root", "/tmp/venv")),
        ("/home/a/.local/share/pipx/venvs/spheremouse", "/usr/bin/python3", "PIPX_HOME=/opt/pipx"),
        # of pyenv or uv: systemd would say 203/EXEC
        ("/opt/venv", "/home/a/python3.12", "cannot read the Python of /opt/venv/bin, /home/a/python3.12; make"),
    ],
)
def test_a_program_that_the_service_cannot_reach_is_told_and_how_to_install_it_for_all(
    folder, python, how, monkeypatch
):
    monkeypatch.setattr(sys, "prefix", folder)
    monkeypatch.setattr(sys, "executable", python)
    monkeypatch.setattr(Path, "exists", lambda path: True)
    path, why = service.executable(Place())
    assert path == f"{folder}/bin/spheremouse"
    assert "own user cannot read" in why
    assert how in why
    assert why.endswith("make it your own service: spheremouse service install --user")
    assert service.executable(Place(user=True)) == (path, "")


def test_a_folder_closed_to_others_is_told(monkeypatch, tmp_path):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "spheremouse").write_text("")
    tmp_path.chmod(0o750)
    monkeypatch.setattr(service, "_UNREACHABLE", ())  # which this folder may be in
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert "own user cannot read" in service.executable(Place())[1]


def test_status_and_dry_run_work_wherever_the_program_lies(root, monkeypatch):
    """The files are judged by themselves, what would be done is listed, and then why it would be refused."""
    call("install", root=root)
    monkeypatch.setattr(service, "executable", lambda place: ("/home/a/bin/spheremouse", "not there; move it"))
    status(0, "--root", root)  # as another program of ours placed it
    dry = CliRunner().invoke(app, ["install", "--dry-run", "--root", str(root)])
    assert f"would update {root / UNIT}\n" in dry.output
    assert str(dry.exception) == "it would be refused: not there; move it"
    before = tree(root)
    with pytest.raises(ServiceError, match=r"^not there; move it$"):
        call("install", root=root)
    assert tree(root) == before
    (root / UNIT).unlink()
    assert "not there; move it" in status(1, "--root", root)


def test_a_path_that_systemd_would_read_otherwise_is_refused(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    monkeypatch.setattr(Path, "exists", lambda path: True)
    for folder in ("/opt/my venv", "/opt/100%", '/opt/a"b', "/opt/a\nb"):
        monkeypatch.setattr(sys, "prefix", folder)
        assert "without spaces" in service.executable(Place())[1]
    monkeypatch.setattr(sys, "prefix", "/opt/venv")
    assert service.executable(Place()) == ("/opt/venv/bin/spheremouse", "")


def unit(name="systemd/spheremouse.service"):
    return service.render_file(name, "/bin/true")


@pytest.mark.parametrize("name", ["systemd/spheremouse.service", "systemd/spheremouse-user.service"])
def test_before_the_calibration_nothing_is_started_again_and_again(name):
    """And what is started is the daemon whatever the source: without --realtime a recording's run is never ready."""
    (folder,) = re.findall(r"--config (\S+)/config\.yaml$", unit(name), re.M)
    assert f"\nAssertPathExists={folder}/rig.yaml\n" in unit(name).partition("[Service]")[0]
    assert re.search(r"^ExecStart=\S+ run --realtime ", unit(name), re.M)


def test_the_kernel_knows_every_driver_of_the_device_list_before_the_service_starts():
    """A `char-` line whose name is not in /proc/devices then is skipped, and what is plugged in later stays closed."""
    modules = {"video4linux": "videodev", "usb_device": "usbcore", "ttyACM": "cdc_acm", "ttyUSB": "usbserial"}
    loaded = (service_files() / "systemd/modules-load.conf").read_text().split("\n")
    listed = re.findall(r"^DeviceAllow=char-(\S+) rw$", unit(), re.M)
    assert set(listed) == set(modules)
    assert {modules[name] for name in listed} | {"uinput"} <= set(loaded)
    assert "After=systemd-modules-load.service" in unit()


def test_names_agree_with_the_code():
    from spheremouse.output import uinput

    xorg = (service_files() / "desktop/90-spheremouse-xorg.conf").read_text()
    assert f'MatchProduct "{uinput.NAME}"' in xorg
    assert 'Option "AccelProfile" "flat"' in xorg
    rules = (service_files() / "udev/70-spheremouse.rules").read_text()
    boot = (service_files() / "firmware/pico/boot.py").read_text()
    (product,) = re.findall(r'set_usb_identification\("\w+", "(\w+)"\)', boot)
    assert f'ENV{{ID_MODEL}}!="{product}*"' in rules


def test_the_configuration_to_begin_with_is_one_that_the_program_reads(root):
    call("install", root=root)
    given = config.load(root / "etc/spheremouse/config.yaml", Configuration)
    assert (given.source, given.output) == ("v4l2:/dev/video0", "auto")
    assert (given.rig, given.map) == ("/etc/spheremouse/rig.yaml", "/var/lib/spheremouse/rig.map.yaml")


def judged(*command):
    """Output of a tool that must find nothing wrong; skips where it is missing."""
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return result.returncode, result.stdout + result.stderr


@pytest.mark.parametrize("user", [False, True])
def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path, monkeypatch, user):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "spheremouse.service"
    path.write_text(unit("systemd/spheremouse-user.service" if user else "systemd/spheremouse.service"))
    if not user:
        path.with_name(f"{path.name}.d").mkdir()
        text = service.network_text(["192.168.1.7", "10.0.0.0/8", "2001:db8::/32", "link-local", "multicast"])
        (path.with_name(f"{path.name}.d") / "spheremouse-network.conf").write_text(text)
    code, said = judged("systemd-analyze", "verify", *(["--user"] if user else []), str(path))
    if "Failed to initialize manager" in said or "Operation not permitted" in said:
        pytest.skip(f"systemd-analyze verify does not work here: {said.strip()}")
    assert [line for line in said.splitlines() if "spheremouse" in line] == []
    assert code == 0


def test_system_calls_of_the_daemon_are_allowed_and_mightier_ones_are_not():
    """By systemd's own lists, line after line, as systemd.exec(5) has it."""
    allowed: set[str] = set()
    for first, words in re.findall(r"^SystemCallFilter=(~?)(.+)$", unit(), re.M):
        for word in words.split():
            allowed = allowed - calls(word) if first else allowed | calls(word)
    socket_and_files = {"chown", "lchown", "fchownat", "fchmodat", "flock", "bind", "renameat2", "fsync"}
    scheduling = {"sched_setscheduler", "setpriority", "mlockall", "madvise"}
    assert socket_and_files | scheduling <= allowed
    assert allowed.isdisjoint({"mount", "ptrace", "reboot", "bpf", "setuid", "init_module", "keyctl"})


def calls(name):
    """The system calls of a group of systemd's, and of the groups in it."""
    if not name.startswith("@"):
        return {name}
    code, said = judged("systemd-analyze", "syscall-filter", "--no-pager", name)
    assert code == 0, said
    words = [line.strip() for line in said.splitlines()[1:]]
    return set().union(*(calls(word) for word in words if word and not word.startswith("#")))


def test_the_unit_is_closed(tmp_path):
    path = tmp_path / "spheremouse.service"
    path.write_text(unit())
    code, said = judged("systemd-analyze", "security", "--offline=true", f"--threshold={10 * LIMIT:.0f}", str(path))
    if "offline" in said and "nrecognized" in said:
        pytest.skip("this systemd-analyze has no --offline")
    (exposure,) = re.findall(r"Overall exposure level for \S+: ([\d.]+)", said)
    assert (float(exposure) <= LIMIT, code) == (True, 0)


def test_udev_finds_nothing_wrong_with_the_rules():
    if "verify" not in judged("udevadm", "--help")[1]:
        pytest.skip("udevadm verify came with systemd 254")
    code, said = judged("udevadm", "verify", str(service_files() / "udev/70-spheremouse.rules"))
    assert code == 0, said


def test_sysusers_and_tmpfiles_are_what_systemd_makes_of_them(tmp_path):
    """The user with its groups, and folders that are its own, below another root."""
    if os.geteuid() != 0:
        pytest.skip("only root can make users and give folders away")
    (tmp_path / "etc").mkdir()
    folder = service_files() / "systemd"
    code, said = judged("systemd-sysusers", f"--root={tmp_path}", str(folder / "sysusers.conf"))
    assert code == 0, said
    (uid,) = re.findall(r"^spheremouse:[^:]*:(\d+):", (tmp_path / "etc/passwd").read_text(), re.M)
    groups = (tmp_path / "etc/group").read_text()
    for group in ("video", "input", "dialout"):
        assert re.search(rf"^{group}:[^:]*:\d+:spheremouse$", groups, re.M), groups
    code, said = judged("systemd-tmpfiles", "--create", f"--root={tmp_path}", str(folder / "tmpfiles.conf"))
    assert code == 0, said
    state = (tmp_path / "var/lib/spheremouse").stat()
    assert (state.st_uid, state.st_mode & 0o777) == (int(uid), 0o750)


def test_the_tray_starts_with_a_desktop(tmp_path):
    path = tmp_path / "spheremouse-tray.desktop"
    path.write_text(service.render_file("desktop/spheremouse-tray.desktop", "/bin/true"))
    code, said = judged("desktop-file-validate", str(path))
    assert (code, said) == (0, "")


def test_the_installer_is_a_script_that_bash_reads_and_refuses_what_it_does_not_know():
    script = str(service_files() / "install.sh")
    assert judged("bash", "-n", script) == (0, "")
    code, said = judged("bash", script, "--backwards")
    assert code == 1
    assert said == "install.sh: --backwards: unknown; see --help\n"
