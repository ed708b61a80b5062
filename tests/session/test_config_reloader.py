"""The configuration read again: what counts as a change, how often it is read, profiles, and saved settings."""

import os
import time
from types import SimpleNamespace

import pytest

from spheremouse.errors import ControlError
from spheremouse.files import exchange
from spheremouse.session.config_reloader import ConfigReloader
from spheremouse.session.control.protocol import Request, Save
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.run_config import CommandLineOverrides, read_run_config


@pytest.fixture
def file(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text('schema: 2\nsource: dataset:film\noutput: "null"\n')
    return file


def reloader_of(file, *assignments, prepare=lambda plan, changed: lambda: False, saved=None, log=lambda line: None):
    overrides = CommandLineOverrides(file, assignments, saved=saved)
    setup, workers = SimpleNamespace(planned=lambda plan: plan), SimpleNamespace(submit=lambda kind, work: work())
    plan = read_run_config(overrides)
    return ConfigReloader(overrides, plan, setup, prepare, workers=workers, call=lambda f: f(), log=log)


def reply_to(method, *arguments, cancelled=False):
    """The one reply to a request; every thread of these tests is this one."""
    replies = []
    pending = PendingRequest(Request(command="reload"), replies.append)
    pending.cancelled = cancelled
    method(*arguments, pending)
    (reply,) = replies
    return reply


def test_what_was_set_is_told_with_its_values_and_not_again_as_a_file(file):
    reloader = reloader_of(file)
    for told in ("map null → 'm.yaml'", "map 'm.yaml' already"):
        assert reply_to(reloader.set, ("map=m.yaml",))["message"] == f"configuration applied: {told}"


@pytest.mark.parametrize("assignment", ["motion.scale_y=4", "record.folder=a"])  # the latter names a file
def test_a_set_whose_client_has_disconnected_is_not_applied(file, assignment):
    reloader = reloader_of(file)
    plan = reloader.plan
    assert not reply_to(reloader.set, (assignment,), cancelled=True)["ok"]
    assert reloader.plan is plan
    assert reloader.overrides.changes == ()


def test_a_file_written_after_it_was_read_is_a_change_also_while_it_is_applied(file):
    writes = [True, False]

    def prepare(plan, changed):
        if writes.pop(0):
            os.utime(file, (1.0, 1.0))
        return lambda: False

    reloader = reloader_of(file, prepare=prepare)
    assert not reloader.outdated
    os.utime(file, (2.0, 2.0))
    assert reloader.outdated
    reply_to(reloader.reload)
    assert reloader.outdated
    reply_to(reloader.reload)
    assert not reloader.outdated


def test_a_broken_file_is_refused_once_with_its_line_and_changes_nothing(file):
    said, good = [], file.read_text()
    reloader = reloader_of(file, log=said.append)
    plan = reloader.plan
    file.write_text(good + "motion:\n  scale_x: many\n")
    error = reply_to(reloader.reload)["error"]
    assert f"config.yaml:{good.count(chr(10)) + 2}: motion.scale_x" in error
    assert said == [f"configuration not applied: {error}"]
    assert not reloader.outdated  # or it would be read once a second
    assert reloader.plan is plan
    file.write_text(good)
    assert reply_to(reloader.reload)["message"] == "configuration applied: nothing has changed"


def test_a_client_that_reloads_without_end_leaves_the_interpreter_to_the_tracker(file):
    reloader, begun = reloader_of(file), time.monotonic()
    for _ in range(3):
        reply_to(reloader.reload)
    assert time.monotonic() - begun > 0.2


def test_a_profile_replaces_what_was_set_and_another_profile(file):
    reloader = reloader_of(file)
    assert reply_to(reloader.profile, None) == {"profiles": {}}
    with pytest.raises(ControlError, match="there is no profile 'doom'; write `profiles:` into"):
        reply_to(reloader.profile, "doom")
    text = "profiles: {doom: {motion.scale_x: 2, map: m.yaml}, menu: {motion.scale_y: 3}, late: {realtime: auto}}\n"
    file.write_text(file.read_text() + text)
    reply_to(reloader.reload)
    assert list(reply_to(reloader.profile, None)["profiles"]) == ["doom", "menu", "late"]
    reply_to(reloader.set, ("motion.invert_x=true",))
    values = reply_to(reloader.profile, "doom")["values"]
    assert values == {"motion.scale_x": (1.0, 2.0), "motion.invert_x": (True, False), "map": (None, "m.yaml")}
    assert reloader.overrides.changes == ("motion.scale_x=2", "map='m.yaml'")
    reply_to(reloader.profile, "menu")
    motion = reloader.plan.configuration.motion
    assert (motion.scale_x, motion.scale_y, reloader.plan.map_path) == (1.0, 3.0, None)
    for name, problem in (("menus", r"did you mean menu\?"), ("late", "realtime: read at the start only")):
        with pytest.raises(ControlError, match=problem):
            reply_to(reloader.profile, name)
    assert reloader.overrides.changes == ("motion.scale_y=3",)
    reply_to(reloader.reload)
    assert reloader.overrides.changes == ()


def test_saved_settings_are_told_when_they_change_and_not_when_they_are_gone(file):
    saved, said = file.with_name("saved.yaml"), []
    exchange.save(saved, ("motion.scale_x=2",))
    reloader = reloader_of(file, saved=saved, log=said.append)
    reply_to(reloader.reload)
    assert said == ["configuration applied: nothing has changed"]  # the start has told them
    exchange.save(saved, ("motion.scale_x=3",))
    reply_to(reloader.reload)
    assert said[1] == f"{saved}: in place of the configuration file: motion.scale_x=3"
    saved.unlink()
    reply_to(reloader.reload)
    assert "" not in said


def test_a_service_saves_in_a_file_of_its_own_and_forgets_it(file):
    saved, before = file.with_name("saved.yaml"), file.read_text()
    reloader = reloader_of(file, "motion.scale_z=5", saved=saved)

    def save(*keys, forget=False):
        return reply_to(reloader.save, Save(command="save", keys=keys or None, forget=forget))

    reply_to(reloader.set, ("motion.scale_x=2", "motion.scale_y=3"))
    assert save("motion.scale_x")["saved"] == ["motion.scale_x=2"]
    assert (reloader.overrides.changes, reloader.plan.saved) == (("motion.scale_y=3",), ("motion.scale_x=2",))
    save()
    reply_to(reloader.set, ("motion.scale_x=2.5", "motion.scale_z=2"))
    with pytest.raises(ControlError, match=r"motion\.scale_z: set on the command line"):
        save()
    save("motion.scale_x")
    assert not reloader.outdated  # its own writing is no change to be read
    assert read_run_config(reloader.overrides).saved == ("motion.scale_x=2.5", "motion.scale_y=3")
    saved.write_text("motion: {scale_x: 4}\n")  # as if by hand
    assert reloader.outdated
    reply_to(reloader.reload)
    assert reloader.plan.saved == ("motion.scale_x=4",)
    assert save(forget=True)["values"] == {"motion.scale_x": (4.0, 1.0)}
    assert (saved.exists(), reloader.plan.saved, file.read_text()) == (False, (), before)
