"""Requests and replies of the control socket as lines of JSON."""

import json
import math
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.session.control.protocol import MAX_LINE, BadRequestError, encode, parse


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
        (b"[" + 4000 * b"1," + b"1]", "not a request: more than 500 values"),
        (b"[" * 200 + b"]" * 200, "not JSON: nested deeper than 20 levels; send one JSON object a line"),
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
