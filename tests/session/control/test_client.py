"""The client, and the messages that are none."""

import contextlib
import json
import math
import socket
import threading
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest
from control_world import a_status, answer
from hypothesis import given
from hypothesis import strategies as st
from invoking import refusal

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client, NoDaemonError, RefusedError
from spheremouse.session.control.protocol import MAX_LINE, BadRequestError, encode, parse
from spheremouse.session.control.server import ControlServer
from spheremouse.session.control.status import StatusReport
from spheremouse.session.settings import ControlSettings

PICTURE = {"stamp": 12.5, "format": "grey", "width": 1000, "height": 900, "annotations": {"sequence": 7}}


def test_the_client_says_what_is_wrong(path):
    with pytest.raises(NoDaemonError, match=rf"no daemon runs \(no daemon listens at {path}\); start one with"):
        Client(path).ask("status")
    with ControlServer(path, ControlSettings(), answer), Client(path) as client:
        with pytest.raises(RefusedError, match="did you mean status"):
            client.ask("statsu")
        assert client.ask("status") == {"state": "tracking", "command": "status"}
        with pytest.raises(RefusedError, match="at most 65536 are allowed"):
            client.ask("set", assignments=[70000 * "x"])


@pytest.fixture
def stranger(path):
    """A client of a program that is no daemon, by what that answers to the first request."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    threads = []

    def connect(said):
        def serve():
            with listener.accept()[0] as connection, contextlib.suppress(OSError):
                connection.recv(1000)
                connection.sendall(said)

        threads.append(threading.Thread(target=serve))
        threads[0].start()
        return Client(path)

    with listener:
        yield connect
        threads[0].join()


def test_a_file_whose_name_is_no_text_is_in_a_status(path):
    """Half a surrogate pair, as Python calls such a byte."""
    with ControlServer(path, ControlSettings(), lambda p: p.answer(a_status(config="caf\udce9.yaml"))):
        assert Client(path).status().config == "caf\udce9.yaml"


def test_the_client_sees_the_daemon_end(path):
    server = ControlServer(path, ControlSettings(), lambda p: p.answer(a_status()))
    with Client(path) as client:
        events = client.watch(0.1)
        assert next(events) == StatusReport.read(a_status())
        server.close()
        with pytest.raises(NoDaemonError, match="the daemon has ended"):
            for _ in events:
                pass


def test_a_picture_follows_its_line_and_the_connection_goes_on(path):
    """Larger than the system's buffer; samples of the same client wait meanwhile."""
    pixels = bytes(range(250)) * 3600

    def handle(pending):
        picture = pending.request.command == "picture"
        pending.answer(PICTURE | {"bytes": len(pixels), "pixels": pixels} if picture else a_status())

    with ControlServer(path, ControlSettings(), handle), Client(path) as client:
        for _ in range(2):
            assert client.picture().model_dump() == PICTURE | {"pixels": pixels}
            assert client.status() == StatusReport.read(a_status())


@pytest.mark.parametrize("wrong", [{"bytes": None}, {"bytes": 1 << 40}, {"width": "wide"}, {"format": "gif"}])
def test_what_is_no_picture_is_refused(stranger, wrong):
    said = json.dumps(PICTURE | {"ok": True, "bytes": 3} | wrong).encode() + b"\nabc"
    with stranger(said) as client, pytest.raises(NoDaemonError, match="the answer is no picture"):
        client.picture()


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
        (b'{"ok": true, "discs": 1.5}\n', r"is not a status of spheremouse \(discs: Input should be a valid integer"),
        (b'{"ok": true, "frames": ' + b"9" * 5000 + b"}\n", "is no daemon of spheremouse"),
    ],
)
def test_the_client_believes_no_stranger(stranger, said, message):
    """Whatever answers at the path: an error in words, and nothing that steers the terminal."""
    with pytest.raises(ControlError, match=message):
        stranger(said).status()


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
        (b'{"command": "record", "seconds": 1e999}', "not JSON: 1e999 exceeds the largest number"),
        (b'{"command": "record", "stop": true, "seconds": 1}', "record: stop goes alone"),
        (b'{"command": "record", "folder": ".."}', "record: folder: must be a name"),
        (b'{"command": "record", "folder": "a\\u0000b"}', "record: folder: must be a name"),
        (b'{"command": "record", "folder": "-rf"}', "record: folder: must be a name"),
        (b'{"command": "snapshot", "file": "config.yaml"}', "snapshot: file: must end in .png or .jpg"),
        (b'{"command": "replay", "speed": 0.0}', "replay: speed: must be"),
        (b'{"command": "replay", "begin": -1.0}', "replay: begin: must be"),
        (b'{"command": "replay", "end": "late"}', "replay: end: must be"),
        (b'{"command": "replay", "step": 1}', "replay: step: must be"),
        (b'{"command": "set"}', "set: assignments: missing"),
        (b'{"command": "set", "assignments": "a=1"}', "set: assignments: must be a list"),
        (b"[" + 4000 * b"1," + b"1]", "not a request: more than 500 values"),
        (b"[" * 200 + b"]" * 200, "not JSON: nested deeper than 20 levels; send one JSON object a line"),
        (b"9" * 60000, "not JSON: a whole number of 60000 digits"),
    ],
)
def test_what_is_no_request_is_one_line_that_helps(line, error):
    text = refusal(BadRequestError, parse, line)
    assert text.startswith(error)
    assert len(text) < 600


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
