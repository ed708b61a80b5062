"""What a run consists of, from files, saved settings and the command line, and its changes in words."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from spheremouse.errors import ConfigurationError, ControlError, OutputError
from spheremouse.files import config
from spheremouse.files.rig import rig_text
from spheremouse.files.yaml import dotted
from spheremouse.session.config_reloader import check_read, check_settable, given, settings_in_use
from spheremouse.session.control.protocol import MAX_LINE, encode
from spheremouse.session.run_config import CommandLineOverrides, RunConfig, check_kinds, read_run_config, saved_file
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.scene import default_scene


@pytest.fixture(scope="module")
def rig():
    return default_scene().rig()


@pytest.fixture
def folder(tmp_path, rig):
    (tmp_path / "rig.yaml").write_text(rig_text(rig))
    (tmp_path / "config.yaml").write_text("schema: 2\nsource: v4l2:/dev/video9\noutput: uinput\nrig: rig.yaml\n")
    return tmp_path


def test_the_configuration_says_it_all(folder, rig, monkeypatch):
    monkeypatch.chdir("/")  # its paths are relative to itself
    plan = read_run_config(CommandLineOverrides(folder / "config.yaml"))
    assert (plan.source, plan.outputs) == ("v4l2:/dev/video9", ("uinput",))
    assert (plan.rig_path, plan.map_path) == (folder / "rig.yaml", folder / "rig.map.yaml")
    assert plan.device(None).ball.radius == rig.ball.radius
    assert plan.camera is None


def test_the_command_line_comes_first(folder):
    other = folder / "sub"
    other.mkdir()
    (other / "r.yaml").write_text((folder / "rig.yaml").read_text())
    overrides = CommandLineOverrides(
        folder / "config.yaml",
        ("motion.scale_x=2", "motion.scale_x=3", "source=opencv:0", "output=null", "rig=sub/r.yaml", "map=sub/m.yaml"),
    )
    plan = read_run_config(overrides)
    assert (plan.source, plan.outputs, plan.rig_path, plan.map_path) == (
        "opencv:0", ("null",), other / "r.yaml", other / "m.yaml",
    )  # fmt: skip
    assert plan.configuration.motion.scale_x == 3.0


def test_without_a_file_the_defaults_hold():
    plan = read_run_config(CommandLineOverrides(None, ("source=opencv:0", "output=null")))
    assert plan.configuration == Configuration(source="opencv:0", output="null")
    assert (plan.rig, plan.rig_path, plan.map_path) == (None, None, None)
    with pytest.raises(ConfigurationError, match="--rig FILE"):
        plan.device(None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"file": None, "assignments": ("output=null",)}, "no source: give --source"),
        ({"file": None, "assignments": ("source=opencv:0",)}, "no output: give --output"),
        ({"assignments": ("tracker=ekf1", "map=x")}, "keeps no map"),
        ({"assignments": ("motion.scale_x=many",)}, "motion.scale_x"),
        ({"assignments": ("rig=missing.yaml",)}, "missing.yaml"),
        ({"assignments": ("camera_file=missing.yaml",)}, "missing.yaml"),
        ({"file": Path("missing.yaml")}, "missing.yaml"),
    ],
)
def test_what_is_wrong_is_said(folder, change, message):
    with pytest.raises(ConfigurationError, match=message):
        read_run_config(replace(CommandLineOverrides(folder / "config.yaml"), **change))


def test_one_output_of_a_known_kind_is_enough_to_start_and_each_new_one_must_be_known(folder):
    """A run with a display that is missing is better than none. A change is refused as a whole."""
    plan = read_run_config(CommandLineOverrides(folder / "config.yaml"))
    some, bad = replace(plan, outputs=("null", "nothing:")), replace(plan, outputs=("nothing:", "neither:"))
    check_kinds(some)
    check_kinds(some, before=some)
    for start in ((bad,), (some, plan)):
        with pytest.raises(OutputError, match="nothing"):
            check_kinds(*start)


def test_where_the_map_is_kept(folder, monkeypatch):
    config = folder / "config.yaml"
    assert read_run_config(CommandLineOverrides(config, no_map=True)).map_path is None
    assert read_run_config(CommandLineOverrides(config, ("tracker=ekf2",))).map_path is None
    with_map = CommandLineOverrides(config, ("tracker=ekf2", "map=m.yaml"), no_map=True)
    assert read_run_config(with_map).map_path is None
    assert read_run_config(CommandLineOverrides(config, ("map=../m.yaml",))).map_path == folder / "../m.yaml"
    recordings = read_run_config(CommandLineOverrides(config, ("record.folder=seen",))).configuration.record.folder
    assert recordings == str(folder / "seen")
    state = folder / "state"
    monkeypatch.setenv("STATE_DIRECTORY", f"{state}:/elsewhere")
    # Beside the rig where that may be written
    assert read_run_config(CommandLineOverrides(config)).map_path == folder / "rig.map.yaml"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert read_run_config(CommandLineOverrides(config)).map_path == state / "rig.map.yaml"


def test_saved_settings_come_between_configuration_and_command_line_and_a_broken_file_is_ignored(folder):
    config, saved = folder / "config.yaml", folder / "saved.yaml"
    config.write_text(config.read_text() + "motion: {scale_x: 2, scale_y: 2}\n")
    overrides = CommandLineOverrides(config, ("motion.scale_z=4",), saved=saved)
    assert read_run_config(overrides).saved == ()
    saved.write_text("motion: {scale_x: 3, scale_z: 3}\ndiscs: {masks: [[1, 2, 3, 4]]}\n")
    plan = read_run_config(overrides)
    motion = plan.configuration.motion
    assert (motion.scale_x, motion.scale_y, motion.scale_z) == (3.0, 2.0, 4.0)
    assert (plan.saved, plan.configuration) == (
        ("motion.scale_x=3", "motion.scale_z=3", "discs.masks=[[1, 2, 3, 4]]"), plan.without_changes,
    )  # fmt: skip
    unsaved = read_run_config(replace(overrides, saved=None))
    for text in (
        "motion: {scale_x: many}\n",
        "motion: [",
        "motion.scale_x\n",
        "rig: missing.yaml\n",
        "\xff",
        "x: " * 99,
    ):
        saved.write_text(text, "latin-1")
        plan = read_run_config(overrides)
        assert plan.configuration == unsaved.configuration
        assert plan.notice.startswith("saved settings ignored: ")
        assert "\n" not in plan.notice


def test_a_service_saves_in_its_state_folder_if_it_may_not_write_its_configuration(folder, monkeypatch):
    config = folder / "config.yaml"
    assert saved_file(config) is None
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/s:/elsewhere")
    assert saved_file(config) is None
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert saved_file(config) == Path("/var/lib/s/saved.yaml")
    assert saved_file(None) is None


def test_the_camera_file_takes_the_place_of_the_rigs(folder, rig):
    text = (folder / "rig.yaml").read_text()
    camera = text[text.index("camera:") : text.index("ball:")]
    (folder / "camera.yaml").write_text("schema: 1\n" + camera.replace("width: 640", "width: 641"))
    plan = read_run_config(CommandLineOverrides(folder / "config.yaml", ("camera_file=camera.yaml",)))
    assert isinstance(plan, RunConfig)
    assert plan.device(None).camera.width == 641
    assert plan.device(None).ball.radius == rig.ball.radius


SOURCE = ("source='synthetic:'", "output=null")
SAID = CommandLineOverrides(None, (*SOURCE, "motion.scale_x=2"), no_map=True)


def test_what_the_command_line_said_is_known_by_its_keys():
    assert set(given(SAID)) == {"source", "output", "map", "motion.scale_x"}
    assert given(CommandLineOverrides()) == ()


@pytest.mark.parametrize(
    ("assignment", "why"),
    [
        ("map=a.yaml", "map: this run keeps no map"),
        ("metrics.port=9", "metrics: read at the start only"),
    ],
)
def test_what_is_settled_is_refused_and_all_with_it(assignment, why):
    with pytest.raises(ControlError, match=why):
        check_settable(SAID, ("motion.scale_y=2", assignment))


def plan_of(*assignments):
    overrides = CommandLineOverrides(None, (*SOURCE, *assignments))
    return overrides, read_run_config(overrides)


@pytest.mark.parametrize(
    ("tracker", "read", "unread"),
    [
        ("so3", {"so3.acceleration_sigma", "motion.scale_x"}, {"euler.acceleration_sigma", "wand.particles"}),
        ("ekf1", {"euler.acceleration_sigma", "motion.scale_x"}, {"so3.acceleration_sigma", "wand.particles"}),
        ("wand", {"wand.particles"}, {"motion.scale_x", "so3.acceleration_sigma"}),
    ],
)
def test_the_settings_in_use_are_those_that_set_takes_and_live_those_that_it_changes(tracker, read, unread):
    """Also of those that the command line said."""
    overrides, plan = plan_of(f"tracker={tracker}", "pointer.rate=200")
    settings = {about["key"]: about for about in settings_in_use(overrides, plan)}
    assert len(settings) > 40
    assert settings.keys() >= {"tracker", *read}
    for about in settings.values():
        assignment = f"{about['key']}={config.to_yaml(about['value'])}"
        check_read(plan, (assignment,))
        if about["live"]:
            assert config.override(plan.configuration, assignment) == plan.configuration
            check_settable(overrides, (assignment,))
        else:
            with pytest.raises(ControlError):
                check_settable(overrides, (assignment,))
    source, output = settings["source"], settings["output"]
    assert (source["value"], output["value"], source["live"]) == ("synthetic:", "null", True)
    others = set(map(dotted, dict(config.parameters(plan.configuration)))) - settings.keys()
    assert others >= unread
    for key in others:
        with pytest.raises(ControlError, match=f"{key}: the tracker in use, {tracker}, does not read this setting"):
            check_read(plan, ("pointer.rate=1", f"{key}=1"))


def test_a_setting_is_described_with_value_default_and_bounds_that_hold():
    overrides, plan = plan_of("motion.scale_x=2", "motion.player=left")
    found = {about["key"]: about for about in settings_in_use(overrides, plan)}
    scale, player = found["motion.scale_x"], found["motion.player"]
    assert (scale["group"], scale["type"], scale["value"], scale["default"]) == ("motion", "number", 2.0, 1.0)
    assert (player["type"], player["value"], player["default"]) == ("choice", "left", player["choices"][0])
    for about in found.values():
        for bound, beyond in (("minimum", -1), ("maximum", 1)):
            if about["type"] in ("number", "integer") and about[bound] is not None:
                config.override(plan.configuration, f"{about['key']}={about[bound]}")  # the end of a slider
                with pytest.raises(ConfigurationError):
                    config.override(plan.configuration, f"{about['key']}={about[bound] + beyond}")
    types = {key: found[key]["type"] for key in ("output", "discs.masks", "motion.invert_x", "camera.gain", "source")}
    assert types == {"output": "list", "discs.masks": "list", "motion.invert_x": "flag", "camera.gain": "integer",
                     "source": "list"}  # fmt: skip


def test_the_reply_with_all_settings_is_one_line_of_the_socket():
    for tracker in ("so3", "ekf1", "wand"):
        reply = {"settings": settings_in_use(*plan_of(f"tracker={tracker}")), "changes": 50 * ["motion.scale_x=2"]}
        assert len(encode(reply)) < MAX_LINE / 2
