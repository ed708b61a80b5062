"""What can be set while a run goes, and what the command line has said."""

from pathlib import Path

import pytest

from spheremouse.errors import ControlError
from spheremouse.session.config_reloader import check_read, check_settable, given, told, values
from spheremouse.session.run_config import CommandLineOverrides, read_run_config

SAID = CommandLineOverrides(
    assignments=("motion.scale_x=2",), source="synthetic:", outputs=("null",), no_map=True, balls=(Path("b"),)
)


def test_what_the_command_line_said_is_known_by_its_keys():
    assert set(given(SAID)) == {"source", "output", "map", "wand.balls", "motion.scale_x"}
    assert given(CommandLineOverrides()) == ()


@pytest.mark.parametrize(
    ("assignment", "why"),
    [
        ("source=v4l2:0", "source: set on the command line"),
        ("map=a.yaml", "map: set on the command line"),
        ("metrics.port=9", "metrics: read at the start only"),
        ("realtime=off", "realtime: read at the start only"),
    ],
)
def test_what_is_settled_is_refused_and_all_with_it(assignment, why):
    with pytest.raises(ControlError, match=why):
        check_settable(SAID, ("motion.scale_y=2", assignment))


def test_what_set_may_change_though_the_command_line_said_it():
    """`--set` comes before what is set later."""
    check_settable(SAID, ("motion.scale_x=3", "rig=r.yaml"))


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
    plan = read_run_config(
        CommandLineOverrides(assignments=(f"tracker={tracker}",), source="synthetic:", outputs=("null",))
    )
    check_read(plan, (f"{read}=1", f"tracker={tracker}"))
    with pytest.raises(ControlError, match=f"{unread}: the tracker in use, {tracker}, does not read this setting"):
        check_read(plan, (f"{read}=1", f"{unread}=1"))


def test_values_are_of_what_differs_and_of_what_was_assigned():
    before = read_run_config(CommandLineOverrides(source="synthetic:", outputs=("null",)))
    now = read_run_config(
        CommandLineOverrides(
            assignments=("motion.scale_x=2", "discs.polarity=light"), source="synthetic:", outputs=("null",)
        )
    )
    found = values(before, now, ("motion.scale_y=1",))
    assert found == {"motion.scale_x": (1.0, 2.0), "motion.scale_y": (1.0, 1.0), "discs.polarity": ("auto", "light")}
    assert set(told(found).split(", ")) == {
        "motion.scale_x 1.0 → 2.0", "motion.scale_y 1.0 already", "discs.polarity auto → light",
    }  # fmt: skip
