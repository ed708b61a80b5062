"""`spheremouse ctl` as an operator meets it: words in; the two streams and the exit code out."""

import contextlib
import io
import json
import os
import socket
import threading
import time
from pathlib import Path

import pytest
import typer
from control_world import Daemon, a_status, reply_to
from rich.console import Console
from typer.testing import CliRunner

from spheremouse.commands import ctl as cli_ctl
from spheremouse.commands.ctl import words as said_of
from spheremouse.errors import ConfigurationError
from spheremouse.files.exchange import import_settings
from spheremouse.files.yaml import parse_document
from spheremouse.session.control import client as client_module
from spheremouse.session.control import protocol
from spheremouse.session.control.client import Client, NoDaemonError
from spheremouse.session.control.server import ControlServer
from spheremouse.session.control.status import StatusReport
from spheremouse.session.settings import ControlSettings


class Recorder(Daemon):
    """The daemon of docs/control.md, which also keeps what it was asked."""

    def __init__(self):
        super().__init__()
        self.asked = []

    def __call__(self, pending):
        self.asked.append(pending.request)
        super().__call__(pending)

    def says(self, **status):
        self.status = {**self.status, **status}


@pytest.fixture
def path(tmp_path_factory):
    return Path(tmp_path_factory.mktemp("s")) / "c"


@pytest.fixture
def daemon(path):
    made = Recorder()
    with ControlServer(path, ControlSettings(), made):
        yield made


@pytest.fixture
def ctl(path, monkeypatch):
    """Runs a command: (*words) -> exit code, standard output, standard error."""
    monkeypatch.setenv("SPHEREMOUSE_SOCKET", str(path))

    def run(*words):
        done = CliRunner().invoke(
            cli_ctl.app, list(words), prog_name="spheremouse ctl", terminal_width=100, catch_exceptions=False
        )
        return done.exit_code, done.stdout, done.stderr

    return run


def shown(width=80, **change):
    console = Console(width=width, highlight=False, record=True, file=io.StringIO())
    console.print(said_of.status_table(StatusReport.read(a_status(**change))))
    return console.export_text()


def test_there_is_a_command_for_every_request():
    own, of_programs = {"reset", "export", "import"}, {"picture", "scene"}
    assert set(typer.main.get_group(cli_ctl.app).commands) == {*protocol.COMMANDS, *own} - of_programs


def test_the_status_is_a_short_table_and_as_json_the_plain_dict(ctl, daemon):
    code, out, err = ctl("status")
    assert (code, err) == (0, "")
    for words in (
        "● tracking for 70 min",
        "19 discs in view",
        "59.9/s, 252630 in all, 12 skipped, 3 dropped, 1 damaged",
        "median 2.9 ms, 99 % 6.4 ms, longest 11.2 ms",
        "17 used, 19 seen, 26 known",
        "3 h old, within 3.3 mm (1 sigma)",
        "uinput:third=wheel, 810344 reports, not sent: +0 -12 +0 counts",
        "/dev/video0: MJPG 640x480, 60 frames/s",
        "1.4 s of 3 h, lost 2 times",
    ):
        assert words in out
    assert len(out.splitlines()) <= 14
    assert max(map(len, out.splitlines())) <= 80
    assert json.loads(ctl("status", "--json")[1]) == daemon.status


def test_a_status_shows_what_is_known():
    failed = {**a_status()["outputs"][0], "failed": "/dev/uinput: permission denied"}
    text = shown(state="starting", reason="", since_s=0.2, latency_ms=None, pose=None, motion=None, outputs=[failed])
    assert "● starting for 0.2 s" in text
    assert text.count("not known") == 2
    assert "/dev/uinput: permission denied" in text
    assert "no-camera for 3.0 s, and paused" in shown(state="no-camera", since_s=3.0, paused=True)
    for change in ({"state": "paused", "paused": True}, {"state": "lost", "paused": False}):
        assert "and paused" not in shown(since_s=3.0, **change)
    assert "12 mm from its place: worn bearings, or an inexact rig" in shown(centre_shift_mm=12.4)
    for shift in (0.4, None):
        assert "from its place" not in shown(centre_shift_mm=shift)


def test_what_the_daemon_quotes_does_not_steer_the_terminal():
    bad = "\x1b[2J\x1b]0;owned\x07[bold]x[/bold]"
    output = {**a_status()["outputs"][0], "spec": bad, "failed": bad}
    text = shown(200, state=bad, reason=bad, outputs=[output], source={"spec": bad, "description": bad})
    assert "\x1b" not in text
    assert "\x07" not in text
    assert text.count("[bold]x[/bold]") >= 4  # and is no markup
    event = said_of.event_line(bad, "12:00:00")
    assert "\x1b" not in event.plain


@pytest.mark.parametrize(
    ("words", "request_", "said"),
    [
        (["pause"], {"command": "pause"}, "paused; go on with: spheremouse ctl resume"),
        (["resume"], {"command": "resume"}, "resumed: tracking"),
        (["stop"], {"command": "stop"}, "the daemon ends"),
        (["set", "motion.scale_x=2", "motion.scale_y=2"],
         {"command": "set", "assignments": ("motion.scale_x=2", "motion.scale_y=2")},
         "configuration applied: motion.scale_x 1.0 → 2.0, motion.scale_y 1.0 → 2.0"),
        (["record", "bug-1", "--seconds", "60"], {"command": "record", "folder": "bug-1", "seconds": 60.0},
         "/var/lib/spheremouse/recordings/bug-1: recording the ball and the targets, 60 s at most"),
        (["record", "--stop"], {"command": "record", "stop": True},
         "/var/lib/spheremouse/recordings/bug-1: 512 frames in 8.5 s, 3.1 MB; ended as asked"),
        (["snapshot", "bug-1.png"], {"command": "snapshot", "file": "bug-1.png"},
         "/var/lib/spheremouse/recordings/bug-1.png: written"),
    ],
)  # fmt: skip
def test_a_command_is_passed_on_and_says_what_was_done(ctl, daemon, words, request_, said):
    code, out, err = ctl(*words)
    assert (code, out, err) == (0, said + "\n", "")
    assert daemon.asked[-1].model_dump(exclude_unset=True) == request_
    code, out, _ = ctl(*words, "--json")
    assert code == 0
    assert json.loads(out) == reply_to(request_)


def test_settings_are_a_table_with_their_ranges(ctl, daemon):
    code, out, _ = ctl("settings")
    assert code == 0
    assert [line.split() for line in out.splitlines()] == [
        ["key", "value", "default", "unit", "range"],
        ["motion.scale_x", "2.0", "1.0", "0.001", "to", "1000"],
    ]
    assert json.loads(ctl("settings", "--json")[1]) == reply_to({"command": "settings"})


def test_what_the_daemon_refuses_is_its_line_and_exit_code_1(ctl, daemon):
    assert ctl("reload") == (1, "", f"spheremouse: {reply_to({'command': 'reload'})['error']}\n")
    assert ctl("reinit", "--json") == (1, "", "spheremouse: no picture from the camera; plug it in\n")
    code, _, err = ctl("record", "../x")
    assert (code, err.startswith("spheremouse: record: folder: must be a name")) == (1, True)


def test_wrong_usage_is_exit_code_2(ctl, daemon):
    for words in (["statsu"], ["set"], ["record", "--stop", "--seconds", "3"], ["watch", "--interval", "x"], []):
        assert ctl(*words)[0] == 2
    assert daemon.asked == []


def test_no_daemon_is_exit_code_3_and_says_how_to_start_one(ctl, path):
    code, out, err = ctl("status")
    assert (code, out) == (3, "")
    assert err.startswith(
        f"spheremouse: no daemon runs (no daemon listens at {path}); start one with `spheremouse run`"
    )
    code, _, err = ctl("pause", "--socket", "/nowhere/at/all")
    assert (code, "/nowhere/at/all" in err) == (3, True)


def test_an_event_is_a_line():
    def line(event):
        return said_of.event_line(StatusReport.read(event) if isinstance(event, dict) else event, "12:00:00").plain

    status = Daemon().status
    figures = "59.9 frames/s  latency 2.9, 99 % 6.4 ms  17/26 points  towards you 32 °/s"
    assert line(status) == f"12:00:00  ● tracking            {figures}"
    assert line({**status, "state": "lost", "reason": "hands"}).endswith("  hands")
    bare = {"fps": 0.0, "latency_ms": None, "discs": None, "discs_known": None, "motion": None}
    told = "12:00:00  ● no-camera            0.0 frames/s  no latency  -/- points  unplugged"
    assert line({**status, **bare, "state": "no-camera", "reason": "unplugged"}) == told
    assert line("lost: hands") == "12:00:00  lost: hands"


def test_watching_as_json_prints_samples_and_in_the_end_the_number_of_dropped_ones(ctl, monkeypatch):
    samples = [{"ball": 1, "counts": [1, 2, 3]}, {"ball": 2, "counts": None}]

    def until_ctrl_c(client, *_, **__):
        yield from ({"event": "sample", "sample": sample, "dropped": 7} for sample in samples)
        raise KeyboardInterrupt

    monkeypatch.setattr(Client, "events", until_ctrl_c)
    code, out, err = ctl("watch", "--json")
    assert [json.loads(line) for line in out.splitlines()] == samples
    assert (code, err) == (0, "spheremouse: 7 samples dropped, because their reader was too slow\n")


def test_watching_a_daemon_that_ends_is_exit_code_3(ctl, path):
    daemon = Recorder()

    def handle(pending):
        daemon(pending)
        if len(daemon.asked) == 2:
            threading.Thread(target=server.close).start()

    server = ControlServer(path, ControlSettings(), handle)
    code, out, err = ctl("watch", "--interval", "0.1")
    assert code == 3
    assert "● tracking" in out
    assert "the daemon has ended" in err


def test_a_profile_is_used_by_its_name_and_all_are_listed_without_one(ctl, daemon):
    assert ctl("profile") == (0, "doom: motion.scale_x=2\nmenu: motion.scale_x=1\n", "")
    assert ctl("profile", "doom") == (0, "configuration applied: motion.scale_x 1.0 → 2.0\n", "")
    assert json.loads(ctl("profile", "--json")[1])["profiles"]["menu"] == ["motion.scale_x=1"]


def test_export_import_and_reset_set_what_differs(ctl, daemon, tmp_path):
    assert ctl("export") == (0, "schema: 2\nmotion:\n  scale_x: 2.0\n", "")
    file = tmp_path / "settings.yaml"
    file.write_text("motion: {scale_x: 2.0}\n")
    assert ctl("import", str(file))[:2] == (0, "nothing differs\n")
    file.write_text("motion: {scale_x: 3.0}\n")
    for words, value in ((("import", str(file)), 3.0), (("reset", "motion.scale_x"), 1.0)):
        assert ctl(*words) == (0, f"configuration applied: motion.scale_x 1.0 → {value}\n", "")
        assert daemon.asked[-1].assignments == (f"motion.scale_x={value}",)
    daemon.asked.clear()
    file.write_text("motion: [\n")
    for words, reason in ((("import", str(file)), "settings.yaml:2"), (("reset", "motion.x"), "unknown setting")):
        with pytest.raises(ConfigurationError, match=reason):
            ctl(*words)
    assert {request.command for request in daemon.asked} == {"settings"}


def test_an_import_sets_no_list_that_is_in_force():
    """A member of the group may not set `output`."""
    document = parse_document("output: [uinput, 'text:-']\n", "settings.yaml")
    assert import_settings([{"key": "output", "value": ["uinput", "text:-"]}], document) == {}
    assert import_settings([{"key": "output", "value": ["uinput"]}], document) == {"output": ("uinput", "text:-")}


def test_what_was_set_is_saved_into_the_daemons_file_and_its_comments_stay(ctl, daemon, tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text("schema: 2\n# of the hall\nmotion: {scale_y: 3}  # steep\n")
    daemon.says(saved=None, config=str(file), changes=["motion.scale_x=2", "pointer.rate = 500"])
    assert ctl("save") == (0, f"{file}: saved: motion.scale_x=2, pointer.rate = 500\n", "")
    assert file.read_text() == (
        "schema: 2\n# of the hall\nmotion: {scale_x: 2.0, scale_y: 3}  # steep\npointer:\n  rate: 500.0\n"
    )
    daemon.says(changes=[])
    before = file.read_text()
    assert ctl("save")[:2] == (0, f"{file}: nothing was set that is not in it\n")
    assert file.read_text() == before


def test_a_daemon_with_a_file_of_its_own_saves_there_itself(ctl, daemon, monkeypatch):
    monkeypatch.setattr(Client, "is_trusted", property(lambda client: False))
    daemon.says(changes=["motion.scale_x=2"], saved=[])
    for words in (("save",), ("save", "--forget"), ("set", "motion.scale_x=2", "--save")):
        code, out, err = ctl(*words)
        assert (code, err) == (0, "")
        assert out.endswith("saved.yaml: saved: motion.scale_x=2\n")
    asked = [(r.keys, r.forget) for r in daemon.asked if r.command == "save"]
    assert asked == [(None, False), (None, True), (("motion.scale_x",), False)]


def test_a_server_of_another_user_chooses_neither_the_file_nor_the_settings(ctl, daemon, tmp_path, monkeypatch):
    """A hostile server once put five settings into root's configuration."""
    theirs, ours = tmp_path / "theirs.yaml", tmp_path / "ours.yaml"
    theirs.write_text("schema: 2\n")
    ours.write_text("schema: 2\n")
    daemon.says(saved=None, config=str(theirs), changes=["motion.scale_y=9"])
    monkeypatch.setattr(Client, "is_trusted", property(lambda client: False))
    for words in (("save",), ("save", "--config", str(ours)), ("set", "motion.scale_x=2", "--save")):
        code, out, err = ctl(*words)
        assert (code, out) == (1, "")
        assert "another user runs the daemon" in err
    assert "set" not in [request.command for request in daemon.asked]
    code, out, _ = ctl("set", "motion.scale_x=2", "--save", "--config", str(ours))
    assert code == 0
    assert ours.read_text() == "schema: 2\nmotion:\n  scale_x: 2.0\n"
    assert theirs.read_text() == "schema: 2\n"


def test_the_kernel_says_who_runs_the_server(path, daemon, monkeypatch):
    with Client(path) as client:
        assert client.is_trusted
        monkeypatch.setattr("os.geteuid", lambda: os.getuid() + 1)
        assert client.is_trusted == (os.getuid() == 0)  # a server of root is trusted by all


def test_without_a_file_there_is_nowhere_to_save(ctl, daemon):
    for config, reason in (
        (None, "the daemon has no configuration file; start it with --config FILE to have one"),
        ("/nowhere/config.yaml", "/nowhere/config.yaml: there is no such file; put it back, and save again"),
    ):
        daemon.says(saved=None, config=config)
        assert ctl("save") == (1, "", f"spheremouse: {reason}\n")


def test_set_and_save_in_one_and_what_the_command_line_said_is_refused_before_it_is_set(ctl, daemon, tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text("schema: 2\n# of the hall\n")
    daemon.says(saved=None, config=str(file), changes=["motion.scale_x=2"], given=["motion.scale_y"])
    said = f"configuration applied: motion.scale_x 1.0 → 2.0\n{file}: saved: motion.scale_x=2\n"
    assert ctl("set", "motion.scale_x=2", "--save") == (0, said, "")
    assert file.read_text() == "schema: 2\n# of the hall\nmotion:\n  scale_x: 2.0\n"
    assert json.loads(ctl("set", "motion.scale_x=2", "--save", "--json")[1])["saved"] == ["motion.scale_x=2"]
    daemon.asked.clear()
    code, out, err = ctl("set", "motion.scale_y=2", "--save")
    assert (code, out) == (1, "")
    assert err.startswith("spheremouse: motion.scale_y: set on the daemon's command line, which overrides the file")
    assert [request.command for request in daemon.asked] == ["status"]


def test_a_server_that_sends_a_byte_now_and_then_is_left_in_time(path, monkeypatch):
    """One deadline holds for the whole reply."""
    monkeypatch.setitem(client_module._TIMEOUTS_S, "status", 0.3)

    def drip(listener):
        with contextlib.suppress(OSError), listener.accept()[0] as connection:
            for _ in range(100):
                connection.sendall(b" ")
                time.sleep(0.1)

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        threading.Thread(target=drip, args=(listener,), daemon=True).start()
        began = time.monotonic()
        with pytest.raises(NoDaemonError, match=r"no answer within 0\.3 s"), Client(path) as client:
            client.status()
        assert time.monotonic() - began < 5.0
