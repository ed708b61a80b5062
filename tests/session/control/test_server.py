"""The control socket against its description (docs/control.md), and against hostile clients."""

import contextlib
import json
import os
import re
import select
import socket
import threading
import time
import typing
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
from control_world import FINE, OTHER, PAGE, STATUS, Daemon, Wire, a_group, a_status, answer, conversations
from reporting import PATIENCE, until
from scipy.spatial.transform import Rotation

from spheremouse.errors import ControlError
from spheremouse.output import Report
from spheremouse.output.lines import json_lines
from spheremouse.output.sample import Sample
from spheremouse.session.control import protocol, socket_file
from spheremouse.session.control import server as control
from spheremouse.session.control.client import Client
from spheremouse.session.control.protocol import MAX_LINE
from spheremouse.session.control.server import ControlServer, Limits
from spheremouse.session.control.socket_file import Peer
from spheremouse.session.control.status import STATES, StatusReport
from spheremouse.session.settings import Configuration, ControlSettings
from spheremouse.tracker import Status, unknown


@pytest.fixture
def serve(path):
    with contextlib.ExitStack() as stack:
        yield lambda handle=answer, limits=None, log=None, **options: stack.enter_context(
            ControlServer(path, ControlSettings(**options), handle, ([] if log is None else log).append, limits)
        )


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
                wire.lines.read(expected.get("bytes", 0))  # of a picture
    assert played >= set(protocol.COMMANDS)


def test_the_status_of_the_description_is_as_promised():
    status = a_status()
    report = StatusReport.model_validate(status)
    assert set(status) == set(StatusReport.model_fields)
    assert report.state in STATES
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"`{state}`" in text for state in STATES)


def test_every_test_that_the_security_page_names_is_there():
    here = Path(__file__).parents[2]
    names = set(re.findall(r"`(test_\w+)`", (here.parent / "docs" / "security.md").read_text(encoding="utf-8")))
    tests = "".join(p.read_text(encoding="utf-8") for p in here.rglob("test_*.py"))
    assert len(names) > 20
    assert not {name for name in names if f"def {name}(" not in tests}


def test_the_thread_that_answers_claims_its_priority_before_it_answers(path):
    threads = []
    claim = lambda: threads.append(threading.current_thread().name)  # noqa: E731
    with ControlServer(path, ControlSettings(), answer, claim=claim):
        assert Wire(path).ask(STATUS) == FINE
        assert threads == ["control"]


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
    until(lambda: later)
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
        if pending.request.command == "pause":
            raise OSError("no disk")
        if pending.request.command == "snapshot":
            pending.answer({"file": MAX_LINE * "x"})
            return
        raise ZeroDivisionError("a slip")

    serve(handle, log=lines)
    wire = Wire(path)
    assert wire.ask('{"command": "reload"}\n') == {"ok": False, "error": "a.yaml:1: wrong; a.yaml:2: wrong too"}
    assert wire.ask('{"command": "pause"}\n') == {"ok": False, "error": "no disk"}
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
    until(lambda: pending)
    assert not pending[0].cancelled
    wire.close()
    until(lambda: pending[0].cancelled)
    pending[0].answer({"message": "to nobody"})
    other = Wire(path)
    other.send('{"command": "resume"}\n')
    until(lambda: len(pending) > 1)
    assert [p.request.command for p in pending] == ["reinit", "resume"]


def test_a_client_that_closes_its_writing_side_still_gets_its_answers(serve, path):
    """As a pipe into socat does. If it then disconnects, its request is cancelled all the same."""
    pending = []
    serve(pending.append)
    wire, other = Wire(path), Wire(path)
    for w in (wire, other):
        w.send('{"command": "reinit"}\n')
        w.socket.shutdown(socket.SHUT_WR)
    until(lambda: len(pending) == 2)
    other.close()
    until(lambda: any(p.cancelled for p in pending))
    (mine,) = [p for p in pending if not p.cancelled]
    mine.answer({"message": "done"})
    assert wire.read() == {"ok": True, "message": "done"}
    assert wire.ended()


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

    until(dropped)


def turning(sequence):
    """A report of one ball, with another attitude at each frame."""
    attitude = Rotation.from_rotvec([0.01 * sequence, 0.2, 0.3]).as_matrix()
    estimate = unknown(sequence / 60, sequence, Status.TRACKING)._replace(rotation=attitude)
    return Report((sequence, 0, 0), None, estimate.stamp, (Sample(estimate),))


def subscribed(path):
    wire = Wire(path)
    assert wire.ask('{"command": "watch", "interval": 60, "samples": true}\n') == {"ok": True}
    assert wire.read()["event"] == "status"
    return wire


def test_every_subscriber_gets_all_samples_and_other_watchers_get_none(serve, path):
    server = serve()
    wires = [subscribed(path) for _ in range(10)]
    watcher = Wire(path)
    assert watcher.ask('{"command": "watch", "interval": 60}\n') == {"ok": True}
    assert watcher.read()["event"] == "status"
    reports = [turning(k) for k in range(100)]
    for report in reports:
        server.submit(report)
    expected = [{"event": "sample", "dropped": 0, "sample": json.loads(json_lines(r)[0])} for r in reports]
    for wire in wires:
        assert [wire.read() for _ in reports] == expected
    server.publish({"event": "log", "text": "after them"})
    assert watcher.read() == {"event": "log", "text": "after them"}
    assert wires[0].ask('{"command": "watch", "interval": 60}\n')["event"] == "log"
    assert wires[0].read() == {"ok": True}
    assert wires[0].read()["event"] == "status"
    server.submit(turning(100))
    server.publish({"event": "log", "text": "no sample before this"})
    assert wires[0].read() == {"event": "log", "text": "no sample before this"}


def test_samples_do_not_wait_for_the_thread_that_answers_requests(serve, path):
    begun, may_end = threading.Event(), threading.Event()

    def handle(pending):
        if pending.request.command == "pause":
            begun.set()
            may_end.wait(PATIENCE)
        answer(pending)

    server = serve(handle)
    wire, other = subscribed(path), Wire(path)
    other.send('{"command": "pause"}\n')
    assert begun.wait(PATIENCE)
    for k in range(3):
        server.submit(turning(k))
        assert wire.read()["sample"]["sequence"] == k
    may_end.set()
    assert other.read()["command"] == "pause"


def test_the_end_is_no_error_of_a_watcher(serve, path):
    log = []
    server, _wire = serve(log=log), subscribed(path)
    server.close()
    assert log == []


def test_a_subscriber_that_stops_reading_loses_its_own_samples_and_gets_their_number(serve, path):
    """It stays connected, others get every sample, and its next samples are the latest ones."""
    limits = Limits(stalled=0.05, samples=20)
    server = serve(limits=limits)
    deaf, other = subscribed(path), subscribed(path)
    count = 600  # more than the system's buffer of the socket
    for k in range(count):
        server.submit(turning(k))
        event = other.read()
        assert (event["dropped"], event["sample"]["sequence"]) == (0, k)
    events = [deaf.read()]
    while events[-1]["sample"]["sequence"] < count - 1:
        events.append(deaf.read())
    sequences = [event["sample"]["sequence"] for event in events]
    assert sequences == sorted(set(sequences))
    assert sequences[-limits.samples :] == list(range(count - limits.samples, count))
    assert events[-1]["dropped"] == count - len(events) > 0


def test_ten_megabytes_without_an_end_of_line_are_not_kept(serve, path):
    serve()
    wire = Wire(path)
    with contextlib.suppress(ConnectionError):
        wire.send(10_000_000 * b"x")
    assert wire.read() == {"ok": False, "error": "a line of more than 65536 bytes; send one JSON object a line"}
    assert wire.ended()


def test_a_flood_of_requests_waits_in_its_sender_and_others_are_served(serve, path):
    """All clients together begin a request every `interval`, so memory and time of the server's thread are bounded."""
    times = []

    def handle(pending):
        times.append(time.monotonic())
        answer(pending)

    limits = Limits(interval=0.01)
    serve(handle, limits)
    wire = Wire(path)
    wire.socket.settimeout(0.5)
    with pytest.raises(TimeoutError):
        wire.send(400_000 * STATUS)
    assert Client(path).ask("pause")["command"] == "pause"
    assert 10 < len(times) <= 2 + (times[-1] - times[0]) / limits.interval


def test_connections_beyond_the_limit_of_a_user_are_refused_and_other_users_are_served(serve, path, monkeypatch):
    group = a_group()
    serve(clients=2, group=group.gr_name)
    as_peer(monkeypatch, OTHER)
    wires = [Wire(path) for _ in range(2)]
    assert [wire.ask(STATUS) for wire in wires] == [FINE, FINE]
    late = [Wire(path) for _ in range(5)][-1]
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

    until(free)


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

    until(dropped)


def as_peer(monkeypatch, uid):
    monkeypatch.setattr(socket_file, "peer_of", lambda connection: Peer(4711, uid))


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
    reply = wire.ask('{"command": "save"}\n')
    assert reply["error"] == "save: only the daemon's own user and root may"
    assert asked == [("motion.scale_x=2",)]
    as_peer(monkeypatch, os.geteuid())
    assert Wire(path).ask('{"command": "set", "assignments": ["output=null"]}\n') == {"ok": True}


def test_every_parameter_that_is_text_is_among_what_members_may_not_set():
    """Text is what can be a path, a device or an address; a new one must be thought about here."""

    def texts(cls, prefix=""):
        hints = typing.get_type_hints(cls)
        for f in fields(cls):
            hint = hints[f.name]
            if is_dataclass(hint):
                yield from texts(hint, f"{prefix}{f.name}.")
            elif f.metadata and (hint is str or str in typing.get_args(hint)):  # without: no setting
                yield prefix + f.name

    found = list(texts(Configuration))
    assert "control.socket" in found
    for key in found:
        assert any(key == place or key.startswith(place + ".") for place in control.PLACES), key


def test_closing_answers_who_waits_removes_the_socket_and_spares_anothers(path):
    replies = []
    server = ControlServer(path, ControlSettings(), replies.append)
    wire = Wire(path)
    wire.send('{"command": "stop"}\n')
    until(lambda: replies)
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
