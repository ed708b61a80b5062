"""Messages to the control socket, and bytes in pieces to a server."""

import contextlib
import json
import socket
from functools import cache
from pathlib import Path

from hypothesis import strategies as st

from spheremouse.session.control.client import Client
from spheremouse.session.control.protocol import COMMANDS, BadRequestError, encode
from spheremouse.session.control.protocol import parse as parse_request
from spheremouse.session.control.protocol import refused as refused_reply
from spheremouse.session.control.server import ControlServer, Limits
from spheremouse.session.settings import ControlSettings
from tests.fuzz.fuzzing import fuzz
from tests.fuzz.strategies import mutated, mutated_json, words

MESSAGES = (
    '{"command": "status", "id": 7}',
    '{"command": "set", "id": "a", "assignments": ["motion.scale_x=2", "so3.acceleration_sigma=0.5"]}',
    '{"command": "record", "seconds": 60.0, "folder": "bug-1", "everything": false}',
    '{"command": "record", "stop": true}',
    '{"command": "snapshot", "file": "a.png"}',
    '{"command": "watch", "interval": 0.5}',
)


@fuzz(
    lambda: st.one_of(
        st.binary(max_size=60),
        st.sampled_from(MESSAGES).flatmap(lambda m: mutated_json(json.loads(m)).map(json.dumps)),
        st.sampled_from(MESSAGES).flatmap(mutated),
        st.builds("{}{}{}".format, st.sampled_from(["[", '{"a":', '{"command":']), words, st.just("]" * 3)),
        st.builds(
            lambda part, n: part * n, st.sampled_from(["[", '{"a":', "9", "\\", '"', "[[],"]), st.integers(1, 60000)
        ),
    ),
)
def test_message(content: str | bytes) -> None:
    line = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    try:
        request = parse_request(line)
    except BadRequestError as e:
        reply = refused_reply(str(e), e.id)
    else:
        assert request.command in COMMANDS
        for name in (getattr(request, "folder", None), getattr(request, "file", None)):
            assert name is None or Path("/x", name).resolve().parent == Path("/x"), "a name that leads elsewhere"
        return
    assert encode(reply).count(b"\n") == 1, "a message of several lines"
    assert reply["error"]


@fuzz(
    lambda: st.lists(
        st.one_of(
            st.binary(max_size=30),
            st.sampled_from([b"\n", b'{"command": "status"}\n', b'{"command": "sta', b"[", b"\xff", b"\x00" * 5000]),
            st.sampled_from(MESSAGES).flatmap(mutated).map(lambda m: m.encode("utf-8", "surrogatepass") + b"\n"),
        ),
        max_size=10,
    ),
)
def test_socket(chunks: list[bytes]) -> None:
    """Whatever one client sends, in whatever pieces, the next one is answered."""
    server = _control_server()
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as hostile:
        hostile.settimeout(10.0)
        hostile.connect(str(server.path))
        with contextlib.suppress(ConnectionError):
            for chunk in chunks:
                hostile.sendall(chunk)
        with Client(server.path) as client:
            assert client.ask("status") == {"state": "tracking"}
    assert not _SAID, _SAID


_SAID: list[str] = []


@cache
def _control_server() -> ControlServer:
    return ControlServer(
        Path("control.sock").absolute(),
        ControlSettings(),
        lambda pending: pending.answer({"state": "tracking"}),
        _SAID.append,
        Limits(rate=1e6),
    )
