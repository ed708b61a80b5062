"""What a configuration names: what is not so is told with the line of its key; what may come is a warning."""

import os

import pytest
from typer.testing import CliRunner

from spheremouse.commands import config as cli_config
from spheremouse.files import config
from spheremouse.files.rig import rig_text, save_camera
from spheremouse.files.yaml import read_document
from spheremouse.output import uinput
from spheremouse.session import config_check
from spheremouse.session.config_check import validate
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.scene import default_scene
from tests.files.test_registry import OUTPUT, installed  # noqa: F401  a fixture


@pytest.fixture
def checked(tmp_path, monkeypatch):
    """`config check` of a file with these lines after its schema, beside a rig of 640x480: exit code, lines."""
    monkeypatch.chdir(tmp_path)
    rig = default_scene().rig()
    (tmp_path / "rig.yaml").write_text(rig_text(rig))
    save_camera(tmp_path / "camera.yaml", rig.camera)
    (tmp_path / "uinput").touch()
    monkeypatch.setattr(uinput, "NODE", tmp_path / "uinput")

    def run(*lines):
        (tmp_path / "c.yaml").write_text("\n".join(["schema: 2", *lines, ""]))
        done = CliRunner().invoke(cli_config.app, ["check", "c.yaml"])
        assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
        return done.exit_code, [*done.stdout.splitlines(), *done.stderr.splitlines()]

    return run


def test_what_is_as_it_is_named_is_ok(checked):
    lines = ("source: synthetic:seconds=1", "output: uinput:third=wheel", "rig: rig.yaml", "camera_file: camera.yaml")
    assert checked(*lines, "map: rig.map.yaml", "record: {folder: recordings}") == (0, ["c.yaml: ok"])
    assert checked() == (0, ["c.yaml: ok"])


@pytest.mark.parametrize("calibration", ["rig: rig.yaml", "camera_file: camera.yaml"])
def test_a_size_that_the_camera_was_not_calibrated_at_is_wrong(checked, calibration):
    code, lines = checked(calibration, "camera: {size: 333x222}")
    assert code == 2
    assert lines == ["c.yaml:3: camera.size: 333x222: the camera was calibrated at 640x480; set that size"]
    assert checked(calibration, "camera: {size: 640x480}")[0] == 0
    assert checked("camera: {size: 333x222}")[0] == 0


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("source: v4l3:/dev/video0", "source: unknown source 'v4l3:/dev/video0'; did you mean v4l2?"),
        ("source: v4l2:0,width=640", "source: v4l2:0,width=640: width and height go together; give both"),
        ("source: synthetic:motion=dance", "source: synthetic: motion"),
        ("source: opencv:front", "source: opencv:front: needs the number of a camera"),
        ("source: dataset:/nowhere/roll", "source: /nowhere/roll: not there; check the path"),
        ("output: [null:, uinput, uinput]", "output: uinput is given twice; leave one out"),
        ("source: [synthetic, synthetic]", "source: synthetic is given twice; name another camera"),
        ("output: uimput", "output: unknown output 'uimput'; "),
        ("output: uinput:third=whel", "output: uinput: third=whel; write third= with one of none, wheel, rz"),
        ("output: 'serial:auto,baud=1'", "output: serial: baud=1: must be from 38400"),
        ("output: text:rig.yaml", "output: rig.yaml: exists and is no log in this format"),
        ("output: text:/nowhere/log", "output: /nowhere: no such folder"),
        ("rig: rigg.yaml", "rig: rigg.yaml: no such file; calibrate (`spheremouse calibrate next`)"),
        ("camera_file: cam.yaml", "camera_file: cam.yaml: no such file; check the path"),
        ("map: maps/rig.map.yaml", "map: maps: no such folder; make it"),
        ("wand: {balls: [one.yaml]}", "wand.balls[0]: one.yaml: no such file"),
        ("record: {folder: rig.yaml}", "record.folder: rig.yaml: is no folder"),
        ("map: rig.map.yaml\ntracker: ekf1", "map: tracker ekf1 keeps no map"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(checked, line, told):
    code, (said,) = checked("# the first line", line)
    assert code == 2
    assert said.startswith(f"c.yaml:3: {told}"), said


def test_a_file_that_is_there_and_broken_says_its_own_line(checked, tmp_path):
    (tmp_path / "rig.yaml").write_text((tmp_path / "rig.yaml").read_text() + "nonsense: 1\n")
    last = len((tmp_path / "rig.yaml").read_text().splitlines())
    code, (said,) = checked("rig: rig.yaml")
    assert code == 2
    assert said.startswith(f"rig.yaml:{last}: nonsense: unknown key")


def test_what_may_be_missing_only_now_is_a_warning(checked, tmp_path):
    (tmp_path / "uinput").unlink()
    code, said = checked("source: v4l2:/dev/video97", "output: uinput", "rig: rig.yaml")
    assert (code, said[0]) == (0, "c.yaml: ok")
    assert said[1].startswith("c.yaml:2: source: warning: /dev/video97 does not exist")
    assert said[2].startswith("c.yaml:3: output: warning: ")
    assert said[2].endswith("uinput does not exist; as root: modprobe uinput")
    code, said = checked("source: dataset:demo/none", "output: serial:/dev/ttyACM97")
    assert code == 0
    assert [line.partition("warning: ")[2].partition(";")[0] for line in said[1:]] == [
        "demo/none: does not exist in this folder",
        "/dev/ttyACM97 does not exist",
    ]


def test_a_map_of_another_ball_is_told(checked, tmp_path, monkeypatch):
    def other(*_):
        raise config_check.ConfigurationError("rig.map.yaml: was made with a ball of radius 1 m")

    (tmp_path / "rig.map.yaml").write_text("schema: 1\n")
    monkeypatch.setattr(config_check, "load_map", lambda path: path)
    monkeypatch.setattr(config_check, "check_fits", other)
    assert checked("rig: rig.yaml", "map: rig.map.yaml") == (
        2,
        ["c.yaml:3: map: rig.map.yaml: was made with a ball of radius 1 m"],
    )


def test_a_plug_in_is_found_and_may_look_at_its_argument(checked, installed):  # noqa: F811
    installed(
        "spheremouse.output",
        OUTPUT + "\nfrom spheremouse.errors import OutputError\n"
        "def check(argument):\n    if argument != 'red': raise OutputError(f'lamp: no {argument} light')\n",
    )
    assert checked("output: lamp:red") == (0, ["c.yaml: ok"])
    assert checked("output: lamp:blue") == (2, ["c.yaml:2: output: lamp: no blue light"])


def test_nothing_is_opened_that_a_run_opens(checked, tmp_path, monkeypatch):
    """No device, and no file begun anew."""
    log = tmp_path / "log"
    log.write_text("# stamp dx dy dz\n0 1 2 3\n")
    before = log.read_bytes(), sorted(os.listdir(tmp_path))
    assert checked("output: 'text:log,format=counts'")[0] == 0
    assert (log.read_bytes(), sorted({*os.listdir(tmp_path)} - {"c.yaml"})) == before


def test_it_looks_where_a_run_would(checked, tmp_path, monkeypatch):
    """Paths are relative to the file, as in `session.run_config`."""
    checked("rig: rig.yaml")
    monkeypatch.chdir("/")
    file = tmp_path / "c.yaml"
    found = validate(file, config.loads(read_document(file), Configuration))
    assert (found.wrong, found.now, found.elsewhere) == ([], [], [])
