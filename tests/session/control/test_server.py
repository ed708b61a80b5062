"""The control socket against its description (docs/control.md), and against hostile clients."""

import asyncio
import contextlib
import json
import math
import os
import re
import select
import shutil
import socket
import stat
import subprocess
import sys
import threading
import time
import typing
from dataclasses import fields, is_dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.errors import ControlError
from spheremouse.session.control import protocol, socket_file
from spheremouse.session.control import server as control
from spheremouse.session.control import status as status_module
from spheremouse.session.control.client import Client, NoDaemonError, RefusedError
from spheremouse.session.control.protocol import MAX_LINE, BadRequestError, Request, encode, parse
from spheremouse.session.control.server import ControlServer, Limits
from spheremouse.session.control.socket_file import Peer
from spheremouse.session.control.status import StatusReport
from spheremouse.session.settings import ControlSettings

PAGE = Path(__file__).parents[3] / "docs" / "control.md"
GENEROUS = 20.0  # s, for what takes milliseconds
OTHER = 54321  # a uid that nobody has
pytestmark = pytest.mark.skipif(not hasattr(socket, "SO_PEERCRED"), reason="no peer credentials on this system")
as_root = pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("setpriv"), reason="needs root and setpriv")


def answer(pending):
    """A daemon that tracks."""
    pending.answer({"state": "tracking", "command": pending.request.command})


@pytest.fixture
def path(tmp_path_factory):
    """A short path; those of pytest may be too long for a socket."""
    folder = Path(tmp_path_factory.mktemp("s"))
    return folder / "c"


@pytest.fixture
def serve(path):
    """Makes servers that are closed in the end."""
    with contextlib.ExitStack() as stack:
        yield lambda handle=answer, limits=None, log=None, **options: stack.enter_context(
            ControlServer(path, ControlSettings(**options), handle, ([] if log is None else log).append, limits)
        )


class Wire:
    """A raw connection."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(GENEROUS)
        self.socket.connect(str(path))
        self.lines = self.socket.makefile("rb")

    def close(self):
        self.lines.close()
        self.socket.close()

    def send(self, data):
        self.socket.sendall(data if isinstance(data, bytes) else data.encode())

    def read(self):
        """The next message."""
        return json.loads(self.lines.readline())

    def ask(self, data):
        self.send(data)
        return self.read()

    def ended(self):
        """Whether the server hangs up, sooner or later."""
        try:
            return self.lines.readline() == b""
        except ConnectionResetError:
            return True


STATUS = b'{"command": "status"}\n'
FINE = {"ok": True, "state": "tracking", "command": "status"}


def wait_for(condition):
    end = time.monotonic() + GENEROUS
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.002)


# ---- the description ----


def conversations():
    """Blocks of the page: each a list of (line sent, replies)."""
    blocks = PAGE.read_text(encoding="utf-8").split("```text\n")[1:]
    found = []
    for block in blocks:
        asked = []
        for line in block.partition("\n```")[0].splitlines():
            if line.startswith("> "):
                asked.append((line[2:], []))
            elif line.startswith("< "):
                asked[-1][1].append(json.loads(line[2:]))
        found.append(asked)
    return found


class Daemon:
    """Answers as a daemon in the situations of the page would."""

    def __init__(self):
        self.paused = False
        self.status = next(r[0] for c in conversations() for q, r in c if q == '{"command": "status"}')

    def __call__(self, pending):
        request, reply = pending.request, pending.answer
        folder = "/var/lib/spheremouse/recordings/"
        match request:
            case protocol.Set(assignments=what):
                names = sorted({a.partition(".")[0] for a in what})
                if any(a.startswith("source=") for a in what):
                    words = "source: set on the command line, which overrides it; start again without that option"
                    raise ControlError(words)
                values = {k: [1.0, float(v)] for k, _, v in (a.partition("=") for a in what)}
                told = ", ".join(f"{k} {old} → {new}" for k, (old, new) in values.items())
                words = f"configuration applied: {told}"
                reply({"changed": names, "values": values, "message": words})
            case protocol.Record(stop=True):
                words = f"{folder}bug-1: 512 frames in 8.5 s, 3.1 MB; ended as asked"
                reply({"folder": folder + "bug-1", "frames": 512, "message": words})
            case protocol.Record(seconds=60.0, folder=name, everything=False):
                words = f"{folder}{name}: recording the ball and the targets, 60 s at most"
                reply({"folder": f"{folder}{name}", "seconds": 60.0, "message": words})
            case protocol.Snapshot(file=None):
                raise ControlError("a snapshot is being written already; ask again when it is done")
            case protocol.Snapshot(file=name):
                reply({"file": f"{folder}{name}"})
            case Request(command="status"):
                reply(
                    {"state": "paused", "reason": "by `spheremouse ctl pause`; `resume` ends it"}
                    if self.paused
                    else self.status
                )
            case Request(command="pause"):
                self.paused = True
                reply({"state": "paused"})
            case Request(command="resume"):
                self.paused = False
                reply({"state": "tracking"})
            case Request(command="stop"):
                reply({})
            case Request(command="reinit"):
                raise ControlError("no picture from the camera; plug it in")
            case Request(command="reload"):
                where = "/etc/spheremouse/config.yaml:3: motion.scale_x"
                raise ControlError(f"{where}: must be a number, is 'two'; the default is 1.0")
            case _:
                raise AssertionError(request)


def test_the_examples_of_the_description_are_what_happens(serve, path):
    daemon = Daemon()
    server = serve(daemon)
    played = set()
    for conversation in conversations():
        daemon.paused = '"watch", "interval": 60' in conversation[0][0]
        wire = Wire(path)
        for asked, replies in conversation:
            wire.send(asked + "\n")
            with contextlib.suppress(ValueError, AttributeError):
                played.add(json.loads(asked).get("command"))
            for expected in replies:
                if expected.get("event") == "log":
                    server.publish(expected)
                assert wire.read() == expected
    assert played >= set(protocol.COMMANDS)


def test_the_status_of_the_description_is_as_promised():
    status = {k: v for k, v in Daemon().status.items() if k != "ok"}
    report = StatusReport.model_validate(status)
    assert set(status) == set(StatusReport.model_fields)
    assert report.state in status_module.STATES
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"`{state}`" in text for state in status_module.STATES)


def test_every_test_that_the_security_page_names_is_there():
    here = Path(__file__).parents[2]
    names = set(re.findall(r"`(test_\w+)`", (here.parent / "docs" / "security.md").read_text(encoding="utf-8")))
    tests = "".join(p.read_text(encoding="utf-8") for p in here.rglob("test_*.py"))
    assert len(names) > 20
    assert not {name for name in names if f"def {name}(" not in tests}


# ---- requests and replies ----


@pytest.mark.parametrize(
    ("line", "error"),
    [
        (b"\xff\xfe", "not UTF-8 text; send one JSON object a line"),
        (b'{"command": "status", "command": "stop"}', "not JSON: a key stands twice in one object; send"),
        (b'{"command": "status"} {}', "not JSON: Extra data"),
        (b'"status"', "a request is a JSON object"),
        (b'{"command": 1}', "command: missing"),
        (b'{"command": "status", "id": 1.5}', "id: must be"),
        (b'{"command": "status", "id": "%s"}' % (65 * b"x"), "id: must be"),
        (b'{"command": "status", "id": 9007199254740992}', "id: must be"),
        (b'{"command": "status", "id": "\\ud800"}', "not JSON: half a surrogate pair"),
        (b'{"command": "status", "interval": 1}', "status: interval: unknown key"),
        (b'{"command": "watch", "interval": 0}', "watch: interval: must be at least 0.1, is 0"),
        (b'{"command": "watch", "interval": "1"}', "watch: interval: must be a number, is '1'"),
        (b'{"command": "record", "seconds": 1e999}', "record: seconds: must be a finite number, is inf"),
        (b'{"command": "record", "stop": true, "seconds": 1}', "record: stop goes alone"),
        (b'{"command": "record", "folder": ".."}', "record: folder: must be a name"),
        (b'{"command": "record", "folder": "a\\u0000b"}', "record: folder: must be a name"),
        (b'{"command": "record", "folder": "-rf"}', "record: folder: must be a name"),
        (b'{"command": "snapshot", "file": "config.yaml"}', "snapshot: file: must end in .png or .jpg"),
        (b'{"command": "set"}', "set: assignments: missing"),
        (b'{"command": "set", "assignments": "a=1"}', "set: assignments: must be a list"),
        (b"[" + 4000 * b"1," + b"1]", "not a request: more than 4000 values"),
        (b"[" * 2000 + b"]" * 2000, "not JSON: nested deeper than 20 levels; send one JSON object a line"),
        (b"9" * 60000, "not JSON: a whole number of 60000 digits"),
    ],
)
def test_what_is_no_request_is_one_line_that_helps(line, error):
    with pytest.raises(BadRequestError) as e:
        parse(line)
    assert str(e.value).startswith(error)
    assert len(str(e.value).splitlines()) == 1
    assert len(str(e.value)) < 600


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda v: st.lists(v, max_size=4) | st.dictionaries(st.text(max_size=8), v, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(st.text(max_size=8), values, max_size=5))
def test_any_message_is_one_line_of_json(message):
    line = encode(message)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1

    def finite(v):
        if isinstance(v, float):
            return v if math.isfinite(v) else None
        if isinstance(v, list):
            return [finite(x) for x in v]
        return {k: finite(x) for k, x in v.items()} if isinstance(v, dict) else v

    assert json.loads(line.decode("utf-8")) == finite(message)


def test_what_the_daemon_computes_with_becomes_json():
    class Phase(StrEnum):
        LOST = "lost"

    message = {
        "f": np.float64(1.5), "n": np.int64(3), "b": np.bool_(True), "v": np.array([1.0, np.nan]), "p": Path("/a"),
        "e": Phase.LOST, "t": (1, 2), "bad": float("inf"), "half": "\udcff", 3: None,
    }  # fmt: skip
    expected = {
        "f": 1.5, "n": 3, "b": True, "v": [1.0, None], "p": "/a", "e": "lost", "t": [1, 2], "bad": None,
        "half": "\udcff", "3": None,
    }  # fmt: skip
    assert json.loads(encode(message).decode("utf-8")) == expected
    with pytest.raises(ValueError, match="bytes"):
        encode({"x": MAX_LINE * "x"})


# ---- one client ----


def test_several_requests_in_one_go_are_answered_in_their_order(serve, path):
    later = []

    def handle(pending):
        if pending.request.command == "reinit":
            later.append(pending)
        else:
            pending.answer({"command": pending.request.command})

    serve(handle)
    wire = Wire(path)
    wire.send('{"command": "reinit", "id": 1}\n\n{"command": "pause", "id": 2}\r\n{"command": "stop", "id": 3}\n')
    wait_for(lambda: later)
    thread = threading.Thread(target=later[0].answer, args=({"message": "done"},))
    thread.start()
    thread.join()
    later[0].answer({"message": "twice"})  # an error of the daemon
    assert [wire.read() for _ in range(3)] == [
        {"ok": True, "id": 1, "message": "done"},
        {"ok": True, "id": 2, "command": "pause"},
        {"ok": True, "id": 3, "command": "stop"},
    ]


def test_a_request_in_pieces_is_one_request_and_half_of_one_is_none(serve, path):
    requests = []

    def handle(pending):
        requests.append(pending.request.command)
        answer(pending)

    serve(handle)
    wire = Wire(path)
    for piece in (STATUS[:5], STATUS[5:9], STATUS[9:]):
        wire.send(piece)
        time.sleep(0.01)
    assert wire.read() == FINE
    wire.send(b'{"command": "stop"}')  # no end of line
    wire.socket.shutdown(socket.SHUT_WR)
    assert wire.ended()
    assert requests == ["status"]


def test_a_request_that_the_daemon_does_not_answer_ends_and_a_late_answer_is_dropped(serve, path):
    late = []

    def handle(pending):
        if pending.request.id == 1:
            late.append(pending)
        else:
            late[0].answer({"message": "late"})
            pending.answer({"message": "mine"})

    serve(handle, Limits(answer=0.05))
    wire = Wire(path)
    expected = {"ok": False, "id": 1, "error": "no answer within 0.05 s"}
    assert wire.ask(b'{"command": "status", "id": 1}\n') == expected
    assert late[0].cancelled
    assert wire.ask(b'{"command": "status", "id": 2}\n') == {"ok": True, "id": 2, "message": "mine"}


def test_an_error_of_the_daemon_is_an_error_of_one_request(serve, path):
    lines = []

    def handle(pending):
        if pending.request.command == "reload":
            raise ControlError("a.yaml:1: wrong\na.yaml:2: wrong too")
        if pending.request.command == "snapshot":
            pending.answer({"file": MAX_LINE * "x"})
            return
        raise ZeroDivisionError("a slip")

    serve(handle, log=lines)
    wire = Wire(path)
    assert wire.ask('{"command": "reload"}\n') == {"ok": False, "error": "a.yaml:1: wrong; a.yaml:2: wrong too"}
    expected = "internal error (ZeroDivisionError: a slip); please report it"
    assert wire.ask('{"command": "reinit"}\n') == {"ok": False, "error": expected}
    assert lines == [f"control: reinit: {expected}"]
    reply = wire.ask('{"command": "snapshot", "id": 5}\n')
    assert (reply["ok"], reply["id"]) == (False, 5)
    assert "65536" in reply["error"]


def test_a_client_that_disconnects_cancels_its_requests(serve, path):
    """The one under way is cancelled, and those that it sent after it never begin."""
    pending = []
    serve(pending.append)
    wire = Wire(path)
    wire.send('{"command": "reinit"}\n{"command": "pause"}\n')
    wait_for(lambda: pending)
    assert not pending[0].cancelled
    wire.close()
    wait_for(lambda: pending[0].cancelled)
    pending[0].answer({"message": "to nobody"})
    other = Wire(path)
    other.send('{"command": "resume"}\n')
    wait_for(lambda: len(pending) > 1)
    assert [p.request.command for p in pending] == ["reinit", "resume"]


def test_a_client_that_closes_its_writing_side_still_gets_its_answers(serve, path):
    """As a pipe into socat does. If it then disconnects, its request is cancelled all the same."""
    pending = []
    serve(pending.append)
    wire, other = Wire(path), Wire(path)
    for w in (wire, other):
        w.send('{"command": "reinit"}\n')
        w.socket.shutdown(socket.SHUT_WR)
    wait_for(lambda: len(pending) == 2)
    other.close()
    wait_for(lambda: any(p.cancelled for p in pending))
    (mine,) = [p for p in pending if not p.cancelled]
    mine.answer({"message": "done"})
    assert wire.read() == {"ok": True, "message": "done"}
    assert wire.ended()


# ---- watching ----


def test_a_watcher_gets_status_and_log_and_may_send_requests(serve, path):
    server = serve()
    wire = Wire(path)
    assert wire.ask('{"command": "watch", "interval": 60}\n') == {"ok": True}
    status = {"event": "status", "state": "tracking", "command": "status"}
    assert wire.read() == status
    server.publish({"event": "log", "text": "lost: hands"})
    assert wire.read() == {"event": "log", "text": "lost: hands"}
    assert wire.ask('{"command": "pause"}\n') == {"ok": True, "state": "tracking", "command": "pause"}
    assert wire.ask('{"command": "watch", "interval": 0.1}\n') == {"ok": True}
    wire.socket.shutdown(socket.SHUT_WR)  # it only listens from here on
    assert [wire.read() for _ in range(4)] == 4 * [status]


def test_a_daemon_without_status_is_told_to_the_watcher(serve, path):
    def handle(pending):
        raise ControlError("no status today")

    serve(handle)
    wire = Wire(path)
    assert wire.ask('{"command": "watch"}\n') == {"ok": True}
    assert wire.read() == {"event": "log", "text": "no status: no status today"}


# ---- hostile clients ----


def test_a_watcher_that_never_reads_is_dropped_and_others_are_served(serve, path):
    server = serve(limits=Limits(stalled=0.2))
    deaf = Wire(path)
    assert deaf.ask('{"command": "watch", "interval": 60}\n') == {"ok": True}

    def dropped():
        for _ in range(50):
            server.publish({"event": "log", "text": 2000 * "x"})
        assert Client(path).ask("status")["state"] == "tracking"
        try:
            deaf.send(b"\n")
        except BrokenPipeError:
            return True

    wait_for(dropped)


def test_ten_megabytes_without_an_end_of_line_are_not_kept(serve, path):
    serve()
    wire = Wire(path)
    with contextlib.suppress(ConnectionError):
        wire.send(10_000_000 * b"x")
    assert wire.read() == {"ok": False, "error": "a line of more than 65536 bytes; send one JSON object a line"}
    assert wire.ended()


def test_a_flood_of_requests_waits_in_its_sender_and_others_are_served(serve, path):
    """Many requests of one client, few at a time: memory and the time of the server's thread are bounded."""
    times = []

    def handle(pending):
        times.append(time.monotonic())
        answer(pending)

    limits = Limits(rate=100.0, burst=5.0)
    serve(handle, limits)
    wire = Wire(path)
    wire.socket.settimeout(0.5)
    with pytest.raises(TimeoutError):
        wire.send(400_000 * STATUS)
    assert Client(path).ask("pause")["command"] == "pause"
    assert 10 < len(times) <= limits.burst + 1 + limits.rate * (times[-1] - times[0])


def test_connections_beyond_the_limit_of_a_user_are_refused_and_other_users_are_served(serve, path, monkeypatch):
    group = a_group()
    serve(limits=Limits(rate=5000.0), clients=2, group=group.gr_name)
    as_peer(monkeypatch, OTHER)
    wires = [Wire(path) for _ in range(2)]
    assert [wire.ask(STATUS) for wire in wires] == [FINE, FINE]
    late = [Wire(path) for _ in range(50)][-1]
    expected = f"busy: user {OTHER} has 2 connections already; close one and try again"
    assert late.read() == {"ok": False, "error": expected}
    assert late.ended()
    as_peer(monkeypatch, os.geteuid())
    assert Wire(path).ask(STATUS) == FINE
    as_peer(monkeypatch, OTHER)
    wires[0].close()

    def free():
        with contextlib.suppress(ConnectionError):
            return Wire(path).ask(STATUS) == FINE

    wait_for(free)


@pytest.mark.parametrize("piece", [b"", b"x"])
def test_a_client_without_a_request_is_dropped(serve, path, piece):
    """Silent ones, and those that send byte by byte."""
    serve(limits=Limits(idle=0.1))
    wire = Wire(path)

    def dropped():
        time.sleep(0.01)
        try:
            wire.send(piece)
            return bool(select.select([wire.socket], [], [], 0)[0]) and wire.ended()
        except ConnectionError:
            return True

    wait_for(dropped)


def test_an_internal_error_of_the_server_costs_one_client(serve, path, monkeypatch):
    lines = []
    serve(log=lines)

    def slip(line):
        raise KeyError("unthought of")

    wire = Wire(path)
    with monkeypatch.context() as m:
        m.setattr(control, "parse", slip)
        wire.send(STATUS)
        assert wire.ended()
    assert lines == ["control: a client dropped: internal error (KeyError: 'unthought of')"]
    assert Wire(path).ask(STATUS) == FINE


def test_the_server_goes_on_after_it_had_no_file_descriptor_for_a_client(serve, path, monkeypatch):
    lines, accept = [], asyncio.SelectorEventLoop.sock_accept
    errors = [OSError(24, "Too many open files")]

    async def accept_or_fail(self, listener):
        if errors:
            raise errors.pop()
        return await accept(self, listener)

    monkeypatch.setattr(asyncio.SelectorEventLoop, "sock_accept", accept_or_fail)
    serve(log=lines)
    assert Wire(path).ask(STATUS) == FINE
    assert lines == ["control: no client can be accepted: Too many open files"]


# ---- permissions ----


def as_peer(monkeypatch, uid):
    """Replace the kernel's credentials."""
    monkeypatch.setattr(socket_file, "peer_of", lambda connection: Peer(4711, uid, uid))


def test_another_user_gets_one_line_and_nothing_else(serve, path, monkeypatch):
    lines, requests = [], []
    serve(requests.append, log=lines)
    as_peer(monkeypatch, OTHER)
    wire = Wire(path)
    with contextlib.suppress(ConnectionError):
        wire.send(STATUS)
    expected = f"user {OTHER} may not control this daemon; its own user, root may"
    assert wire.read() == {"ok": False, "error": expected}
    assert wire.ended()
    assert requests == []
    assert lines == [f"control: refused user {OTHER} (process 4711)"]


def a_group():
    """A group of this machine that this process may give files to."""
    import grp

    for entry in grp.getgrall():
        if entry.gr_gid and (os.geteuid() == 0 or entry.gr_gid in os.getgroups()):
            return entry
    pytest.skip("no group to give the socket to")


def test_members_may_set_parameters_but_not_what_the_daemon_opens(serve, path, monkeypatch):
    group = a_group()
    asked = []

    def handle(pending):
        asked.append(pending.request.assignments)
        pending.answer({})

    serve(handle, group=group.gr_name)
    as_peer(monkeypatch, OTHER)
    wire = Wire(path)
    assert wire.ask('{"command": "set", "assignments": ["motion.scale_x=2"]}\n') == {"ok": True}
    for assignment in (
        "output=text:/etc/passwd",
        " control.group = users",
        "metrics.address=0.0.0.0",
        "record.x=1",
        "camera.controls=[a=1]",
    ):
        reply = wire.ask(json.dumps({"command": "set", "assignments": ["motion.scale_x=3", assignment]}) + "\n")
        key = assignment.partition("=")[0].strip()
        assert (
            reply["error"]
            == f"set: {key} names a file or device that the daemon opens; only its own user and root may set it"
        )
    assert asked == [("motion.scale_x=2",)]
    as_peer(monkeypatch, os.geteuid())
    assert Wire(path).ask('{"command": "set", "assignments": ["output=null"]}\n') == {"ok": True}


def test_every_parameter_that_is_text_is_among_what_members_may_not_set():
    """Text is what can be a path, a device or an address; a new one must be thought about here."""
    settings_module = pytest.importorskip("spheremouse.session.settings")

    def texts(cls, prefix=""):
        hints = typing.get_type_hints(cls)
        for f in fields(cls):
            hint = hints[f.name]
            if is_dataclass(hint):
                yield from texts(hint, f"{prefix}{f.name}.")
            elif hint is str or str in typing.get_args(hint):
                yield prefix + f.name

    found = list(texts(settings_module.Configuration))
    assert "control.socket" in found
    for key in found:
        assert any(key == place or key.startswith(place + ".") for place in control.PLACES), key


@pytest.mark.parametrize("grouped", [False, True])
def test_the_file_is_the_owners_alone_or_the_groups_too_from_the_moment_it_listens(path, monkeypatch, grouped):
    """Whatever the process's umask: the mode is set before anybody can connect."""
    group = a_group() if grouped else None
    modes, listen = [], socket.socket.listen

    def look(self, *backlog):
        modes.append(stat.S_IMODE(path.stat().st_mode))
        listen(self, *backlog)

    monkeypatch.setattr(socket.socket, "listen", look)
    before = os.umask(0)
    try:
        with ControlServer(path, ControlSettings(group=group and group.gr_name), answer):
            assert modes == [0o660 if group else 0o600]
            assert group is None or path.stat().st_gid == group.gr_gid
    finally:
        os.umask(before)


ASKER = """
import socket, sys
s = socket.socket(socket.AF_UNIX)
try:
    s.connect(sys.argv[1])
except PermissionError:
    print("permission denied")
else:
    try:
        s.sendall(b'{"command": "status"}\\n')
    except BrokenPipeError:
        pass
    print(s.makefile().readline().strip())
"""


def ask_as(path, uid, gid, *groups):
    """What a process of another user reads from the socket."""
    extra = ["--groups", ",".join(map(str, groups))] if groups else ["--clear-groups"]
    words = ["setpriv", "--reuid", str(uid), "--regid", str(gid), *extra, sys.executable, "-I", "-c", ASKER, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True, cwd="/")
    return done.stdout.strip()


@pytest.fixture
def open_folder():
    """A folder that other users may enter."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@as_root
def test_another_user_in_fact(open_folder):
    """The file's mode keeps it out; and where somebody has opened that, the credentials do."""
    path = open_folder / "c"
    with ControlServer(path, ControlSettings(), answer):
        assert ask_as(path, OTHER, OTHER) == "permission denied"
        path.chmod(0o666)
        reply = json.loads(ask_as(path, OTHER, OTHER))
        assert reply["error"] == f"user {OTHER} may not control this daemon; its own user, root may"
        assert json.loads(ask_as(path, 0, 0)) == FINE


@as_root
def test_members_of_the_group_in_fact(open_folder):
    path, gid = open_folder / "c", a_group().gr_gid
    with ControlServer(path, ControlSettings(group=a_group().gr_name), answer):
        assert json.loads(ask_as(path, OTHER, gid)) == FINE  # by its first group
        assert json.loads(ask_as(path, OTHER, OTHER, gid)) == FINE  # by another one
        assert ask_as(path, OTHER, OTHER, gid + 1) == "permission denied"


# ---- the path ----


def test_a_path_may_have_107_bytes(tmp_path_factory):
    folder = Path(tmp_path_factory.mktemp("s"))
    longest = folder / ((107 - len(os.fsencode(folder)) - 1) * "x")
    with ControlServer(longest, ControlSettings(), answer):
        assert Client(longest).ask("status")["state"] == "tracking"
    path = folder / (longest.name + "x")
    with pytest.raises(ControlError, match=r"too long for a socket; set control.socket to a path of 107 bytes or less"):
        ControlServer(path, ControlSettings(), answer)
    with pytest.raises(NoDaemonError, match="too long"):
        Client(path).ask("status")


def test_one_daemon_holds_a_path_until_its_end_and_a_killed_one_does_not(path):
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as killed:
        killed.bind(str(path))
    with pytest.raises(NoDaemonError, match="no daemon runs"):
        Client(path).ask("status")
    for _ in range(2):
        with ControlServer(path, ControlSettings(), answer):
            with pytest.raises(ControlError) as e:
                ControlServer(path, ControlSettings(), answer)
            assert str(e.value).startswith(f"{path}: another daemon listens there (process {os.getpid()}); ")
            assert Client(path).ask("status")["state"] == "tracking"
        assert not path.exists()


def test_another_programs_socket_or_file_is_left_alone(path):
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as other:
        other.bind(str(path))
        other.listen()
        with pytest.raises(ControlError, match="another daemon listens there"):
            ControlServer(path, ControlSettings(), answer)
        assert path.exists()
    path.unlink()
    path.write_text("precious")
    with pytest.raises(ControlError, match="is no socket; move it away"):
        ControlServer(path, ControlSettings(), answer)
    assert path.read_text() == "precious"
    path.unlink()
    target = path.parent / "target"
    target.write_text("precious")
    path.symlink_to(target)
    with pytest.raises(ControlError, match="is no socket"):
        ControlServer(path, ControlSettings(), answer)
    lock = path.with_name(path.name + ".lock")
    path.unlink()
    lock.unlink(missing_ok=True)
    lock.symlink_to(target)
    with pytest.raises(ControlError, match="cannot be made"):
        ControlServer(path, ControlSettings(), answer)
    assert target.read_text() == "precious"


def test_a_folder_where_anybody_may_write_is_refused(path):
    path.parent.chmod(0o777)
    with pytest.raises(ControlError, match="anybody may write there"):
        ControlServer(path, ControlSettings(), answer)
    path.parent.chmod(0o1777)  # as /tmp
    ControlServer(path, ControlSettings(), answer).close()


@pytest.mark.parametrize(
    ("options", "place", "message"),
    [
        ({}, "missing/c", "cannot be made (No such file or directory); set control.socket"),
        ({"group": "no-such-group-here"}, "c", "control.group: no group 'no-such-group-here' on this machine"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(path, options, place, message):
    with pytest.raises(ControlError) as e:
        ControlServer(path.parent / place, ControlSettings(**options), answer)
    assert message in str(e.value)


def test_closing_answers_who_waits_removes_the_socket_and_spares_anothers(path):
    replies = []
    server = ControlServer(path, ControlSettings(), replies.append)
    wire = Wire(path)
    wire.send('{"command": "stop"}\n')
    wait_for(lambda: replies)
    ending = threading.Thread(target=server.close)
    ending.start()
    replies[0].answer({"message": "the daemon ends"})
    assert wire.read() == {"ok": True, "message": "the daemon ends"}
    assert wire.ended()
    ending.join()
    server.close()  # twice is once
    server.publish({"event": "log", "text": "to nobody"})
    replies[0].answer({})
    assert not path.exists()
    server = ControlServer(path, ControlSettings(), answer)
    path.unlink()
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as other:
        other.bind(str(path))
        server.close()
        assert path.exists()


# ---- where it is ----


@pytest.fixture
def bare(monkeypatch, tmp_path_factory):
    """No daemon of this machine, and a user's folders of our own."""
    for name in ("SPHEREMOUSE_SOCKET", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    folder = Path(tmp_path_factory.mktemp("p"))
    monkeypatch.setattr(socket_file, "_SYSTEM", folder / "run")
    monkeypatch.setattr(socket_file.tempfile, "gettempdir", lambda: str(folder))
    monkeypatch.setattr(socket_file, "_uid", lambda: os.geteuid() or 0)
    return folder


def test_the_daemons_folder_is_systemds_else_the_systems_else_the_users(bare, monkeypatch):
    monkeypatch.setattr(socket_file, "_uid", lambda: 0)
    assert socket_file.socket_path(None) == bare / "run" / "control.sock"
    assert stat.S_IMODE((bare / "run").stat().st_mode) == 0o755
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/a:/run/b")
    assert socket_file.socket_path(None) == Path("/run/a/control.sock")
    assert socket_file.socket_path("/run/c/my.sock") == Path("/run/c/my.sock")


def test_a_user_without_a_runtime_folder_has_one_of_its_own_and_no_other(bare, monkeypatch):
    mine = os.geteuid() or 1000
    monkeypatch.setattr(socket_file, "_uid", lambda: mine)
    path = bare / f"spheremouse-{mine}"
    assert socket_file.runtime_folder() == path
    assert stat.S_IMODE(path.stat().st_mode) == 0o700
    path.chmod(0o770)  # as somebody else would make it to get in
    with pytest.raises(ControlError, match="another user's, or others may write there"):
        socket_file.runtime_folder()
    assert path / "control.sock" not in list(socket_file.candidates())
    path.rmdir()
    elsewhere = bare / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    path.symlink_to(elsewhere)
    with pytest.raises(ControlError, match="another user's"):
        socket_file.runtime_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(bare))
    assert socket_file.runtime_folder() == bare / "spheremouse"


def test_a_client_finds_the_daemon_that_answers(bare, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(bare))
    user, system = bare / "spheremouse" / "control.sock", bare / "run" / "control.sock"
    for p in (user, system):
        p.parent.mkdir(mode=0o755)
    assert socket_file.find_socket() == user
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as dead:
        dead.bind(str(user))  # what a user's daemon that was killed left
    assert socket_file.find_socket() == user
    with ControlServer(system, ControlSettings(), answer):
        assert socket_file.find_socket() == system
        assert Client().ask("status")["state"] == "tracking"
        with ControlServer(user, ControlSettings(), answer):
            assert socket_file.find_socket() == user
        monkeypatch.setenv("SPHEREMOUSE_SOCKET", "/elsewhere")
        assert socket_file.find_socket() == Path("/elsewhere")


def test_a_socket_in_a_closed_folder_is_one_that_is_there(monkeypatch, tmp_path):
    """Another user's: asking there is refused in words."""
    closed = tmp_path / "closed" / "control.sock"
    lstat = Path.lstat

    def refuse(self):
        if self == closed:
            raise PermissionError(13, "Permission denied")
        return lstat(self)

    monkeypatch.delenv("SPHEREMOUSE_SOCKET", raising=False)
    monkeypatch.setattr(socket_file, "candidates", lambda: iter([tmp_path / "none", closed]))
    monkeypatch.setattr(Path, "lstat", refuse)
    assert socket_file.find_socket() == closed


# ---- the client ----


def test_the_client_says_what_is_wrong(path, serve):
    with pytest.raises(NoDaemonError, match=rf"no daemon runs \(no daemon listens at {path}\); start one with"):
        Client(path).ask("status")
    serve()
    with Client(path) as client:
        with pytest.raises(RefusedError, match="did you mean status"):
            client.ask("statsu")
        assert client.ask("status") == {"state": "tracking", "command": "status"}
        with pytest.raises(RefusedError, match="at most 65536 are allowed"):
            client.ask("set", assignments=[70000 * "x"])


def test_a_file_whose_name_is_no_text_is_in_a_status(path):
    """Half a surrogate pair, as Python calls such a byte."""
    with ControlServer(path, ControlSettings(), lambda p: p.answer({"config": "caf\udce9.yaml"})):
        assert Client(path).status().config == "caf\udce9.yaml"


def test_the_client_sees_the_daemon_end(path):
    server = ControlServer(path, ControlSettings(), answer)
    with Client(path) as client:
        events = client.watch(0.1)
        assert next(events) == StatusReport.read({"state": "tracking", "command": "status"})
        server.close()
        with pytest.raises(NoDaemonError, match="the daemon has ended"):
            for _ in events:
                pass


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "is no daemon of spheremouse"),
        (b"[1]\n", "is no daemon of spheremouse"),
        (200_000 * b"x", "is no daemon of spheremouse"),
        (b"\xff\n", "is no daemon of spheremouse"),
        (b"[" * 60000 + b"\n", "is no daemon of spheremouse"),
        (b"", "has ended or disconnected"),
        (b'{"ok": true', "has ended or disconnected"),
        (b'{"ok": false, "error": "\\u001b[2Jgone"}\n', "\N{REPLACEMENT CHARACTER}\\[2Jgone"),
        (b'{"ok": 1}\n', "refuses without a reason"),
        (b'{"ok": true, "discs": 1.5}\n', r"is no status of spheremouse \(discs: Input should be a valid integer"),
        (b'{"ok": true, "frames": ' + b"9" * 5000 + b"}\n", "is no daemon of spheremouse"),
    ],
)
def test_the_client_believes_no_stranger(path, said, message):
    """Whatever answers at the path: an error in words, and nothing that steers the terminal."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()

    def stranger():
        with contextlib.closing(listener.accept()[0]) as s, contextlib.suppress(OSError):
            s.recv(100)
            s.sendall(said)

    thread = threading.Thread(target=stranger)
    thread.start()
    with listener, pytest.raises(ControlError, match=message):
        Client(path).status()
    thread.join()
