"""What can be set while a run goes, and what the command line has said."""

import pytest

from spheremouse.errors import ConfigurationError, ControlError
from spheremouse.files import config
from spheremouse.files.yaml import dotted
from spheremouse.session.config_reloader import (
    check_read,
    check_settable,
    describe_changes,
    given,
    settings_in_use,
    values,
)
from spheremouse.session.control.protocol import MAX_LINE, encode
from spheremouse.session.run_config import CommandLineOverrides, read_run_config

SOURCE = ("source='synthetic:'", "output=null")
SAID = CommandLineOverrides(None, (*SOURCE, "motion.scale_x=2"), no_map=True)


def test_what_the_command_line_said_is_known_by_its_keys():
    assert set(given(SAID)) == {"source", "output", "map", "motion.scale_x"}
    assert given(CommandLineOverrides()) == ()


@pytest.mark.parametrize(
    ("assignment", "why"),
    [
        ("map=a.yaml", "map: this run keeps none"),
        ("metrics.port=9", "metrics: read at the start only"),
        ("realtime=off", "realtime: read at the start only"),
    ],
)
def test_what_is_settled_is_refused_and_all_with_it(assignment, why):
    with pytest.raises(ControlError, match=why):
        check_settable(SAID, ("motion.scale_y=2", assignment))


def test_what_set_may_change_though_the_command_line_said_it():
    check_settable(SAID, ("motion.scale_x=3", "rig=r.yaml", "source=v4l2:0"))


@pytest.mark.parametrize(
    ("tracker", "unread", "read"),
    [
        ("so3", "euler.acceleration_sigma", "so3.acceleration_sigma"),
        ("ekf1", "so3.acceleration_sigma", "euler.acceleration_sigma"),
        ("so3", "wand.particles", "motion.scale_x"),
        ("wand", "motion.scale_x", "wand.particles"),
    ],
)
def test_what_nothing_reads_is_refused(tracker, unread, read):
    _, plan = plan_of(f"tracker={tracker}")
    check_read(plan, (f"{read}=1", f"tracker={tracker}"))
    with pytest.raises(ControlError, match=f"{unread}: the tracker in use, {tracker}, does not read this setting"):
        check_read(plan, (f"{read}=1", f"{unread}=1"))


def test_values_are_of_what_differs_and_of_what_was_assigned():
    (_, before), (_, now) = plan_of(), plan_of("motion.scale_x=2", "discs.polarity=light")
    found = values(before, now, ("motion.scale_y=1",))
    assert found == {"motion.scale_x": (1.0, 2.0), "motion.scale_y": (1.0, 1.0), "discs.polarity": ("auto", "light")}
    assert set(describe_changes(found).split(", ")) == {
        "motion.scale_x 1.0 → 2.0", "motion.scale_y 1.0 already", "discs.polarity auto → light",
    }  # fmt: skip


def plan_of(*assignments):
    overrides = CommandLineOverrides(None, (*SOURCE, *assignments))
    return overrides, read_run_config(overrides)


@pytest.mark.parametrize("tracker", ["so3", "ekf1", "wand"])
def test_the_settings_in_use_are_those_that_set_takes_and_live_those_that_it_changes(tracker):
    overrides, plan = plan_of(f"tracker={tracker}", "pointer.rate=200")
    keys = {about["key"] for about in settings_in_use(overrides, plan)}
    assert len(keys) > 40
    assert "tracker" in keys
    for about in settings_in_use(overrides, plan):
        assignment = f"{about['key']}={config.to_yaml(about['value'])}"
        check_read(plan, (assignment,))
        if about["live"]:
            assert config.override(plan.configuration, assignment) == plan.configuration
            check_settable(overrides, (assignment,))
        else:
            with pytest.raises(ControlError):
                check_settable(overrides, (assignment,))
    values = {about["key"]: about["value"] for about in settings_in_use(overrides, plan)}
    assert (values["source"], values["output"]) == ("synthetic:", "null")
    unread = {key for key in map(dotted, dict(config.parameters(plan.configuration))) if key not in keys}
    for key in unread:
        with pytest.raises(ControlError, match="does not read this setting"):
            check_read(plan, (f"{key}=1",))


def test_a_setting_is_described_with_value_default_and_bounds_that_hold():
    overrides, plan = plan_of("motion.scale_x=2", "motion.player=left")
    found = {about["key"]: about for about in settings_in_use(overrides, plan)}
    scale, player = found["motion.scale_x"], found["motion.player"]
    assert (scale["group"], scale["type"], scale["value"], scale["default"]) == ("motion", "number", 2.0, 1.0)
    assert (player["type"], player["value"], player["default"]) == ("choice", "left", player["choices"][0])
    for about in found.values():
        for bound, beyond in (("minimum", -1), ("maximum", 1)):
            if about["type"] in ("number", "integer") and about[bound] is not None:
                with pytest.raises(ConfigurationError):
                    config.override(plan.configuration, f"{about['key']}={about[bound] + beyond}")
    types = {key: found[key]["type"] for key in ("output", "discs.masks", "motion.invert_x", "camera.gain", "source")}
    assert types == {"output": "list", "discs.masks": "list", "motion.invert_x": "flag", "camera.gain": "integer",
                     "source": "text"}  # fmt: skip


def test_the_reply_with_all_settings_is_one_line_of_the_socket():
    for tracker in ("so3", "ekf1", "wand"):
        reply = {"settings": settings_in_use(*plan_of(f"tracker={tracker}")), "changes": 50 * ["motion.scale_x=2"]}
        assert len(encode(reply)) < MAX_LINE / 2
