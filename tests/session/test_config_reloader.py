"""The configuration read again: what counts as a change, how often it is read, and what is said of saved settings."""

import os
import time
from types import SimpleNamespace

from spheremouse.files import exchange
from spheremouse.session.config_reloader import ConfigReloader
from spheremouse.session.control.protocol import Request, Set
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.run_config import CommandLineOverrides, read_run_config


def reloader_of(file, prepare=lambda plan, changed: lambda: False, saved=None, log=lambda line: None):
    file.write_text('schema: 2\nsource: dataset:film\noutput: "null"\n')
    overrides = CommandLineOverrides(file, saved=saved)
    setup, workers = SimpleNamespace(planned=lambda plan: plan), SimpleNamespace(submit=lambda kind, work: work())
    plan = read_run_config(overrides)
    return ConfigReloader(overrides, plan, setup, prepare, workers=workers, call=lambda f: f(), log=log)


def reloaded(reloader):
    replies = []
    reloader.reload(PendingRequest(Request(command="reload"), replies.append))
    assert [list(reply) for reply in replies] == [["changed", "values", "message"]]


def test_what_was_set_is_told_with_its_values_and_not_again_as_a_file(tmp_path):
    replies = []
    reloader = reloader_of(tmp_path / "config.yaml")
    pending = PendingRequest(Set(command="set", assignments=("map=m.yaml",)), replies.append)
    reloader.set(("map=m.yaml",), pending)
    assert replies[0]["message"] == "configuration applied: map null → 'm.yaml'"


def test_a_file_written_after_it_was_read_is_a_change_also_while_it_is_applied(tmp_path):
    file, writes = tmp_path / "config.yaml", [True, False]

    def prepare(plan, changed):
        if writes.pop(0):
            os.utime(file, (1.0, 1.0))
        return lambda: False

    reloader = reloader_of(file, prepare)
    assert not reloader.outdated
    os.utime(file, (2.0, 2.0))
    assert reloader.outdated
    reloaded(reloader)
    assert reloader.outdated
    reloaded(reloader)
    assert not reloader.outdated


def test_a_client_that_reloads_without_end_leaves_the_interpreter_to_the_tracker(tmp_path):
    reloader, begun = reloader_of(tmp_path / "config.yaml"), time.monotonic()
    for _ in range(3):
        reloaded(reloader)
    assert time.monotonic() - begun > 0.2


def test_saved_settings_are_told_when_they_change_and_not_when_they_are_gone(tmp_path):
    saved, said = tmp_path / "saved.yaml", []
    exchange.save(saved, ("motion.scale_x=2",))
    reloader = reloader_of(tmp_path / "config.yaml", saved=saved, log=said.append)
    reloaded(reloader)
    assert said == ["configuration applied: nothing has changed"]  # the start has told them
    exchange.save(saved, ("motion.scale_x=3",))
    reloaded(reloader)
    assert said[1] == f"{saved}: in place of the configuration file: motion.scale_x=3"
    saved.unlink()
    reloaded(reloader)
    assert "" not in said
