"""One client's connection, over a pair of sockets, without a server."""

import contextlib
import json
import select
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.session.control.connection import Connection
from spheremouse.session.control.limits import Limits, Pace
from spheremouse.session.control.line import MAX_LINE
from spheremouse.session.control.reply import Reply

pytestmark = pytest.mark.skipif(not hasattr(select, "poll"), reason="no poll on this system")


@contextlib.contextmanager
def connected(limits=None):
    """A connection, and the client's end of it."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        theirs.setblocking(False)
        yield Connection(ours, True, Pace(1e6, 1e6), limits or Limits()), theirs


def lines(client):
    """What it has sent, whole lines."""
    while client.has_request:
        yield client.take_line()


@given(st.lists(st.binary(max_size=20).map(lambda line: line.replace(b"\n", b" ")), max_size=5), st.data())
def test_lines_are_the_same_in_whatever_pieces_they_come(sent, data):
    rest, got = b"".join(line + b"\n" for line in sent), []
    with connected() as (client, theirs):
        while rest:
            size = data.draw(st.integers(1, len(rest)))
            theirs.sendall(rest[:size])
            rest = rest[size:]
            client.transfer(select.POLLIN)
            got += lines(client)
        assert got == sent
        assert client.silent


def test_a_line_may_be_just_as_long_as_promised():
    line = b"{}".ljust(MAX_LINE - 1)
    with connected() as (client, _):
        client.received += line + b"\n" + line + b" \n"
        assert list(lines(client)) == [line, b""]
        assert client.closing


def test_how_long_is_waited_is_said_by_what_is_under_way():
    limits = Limits(stalled=5.0, idle=30.0, answer=60.0)
    with connected(limits) as (client, theirs):
        assert client.next_turn(0.0) == client.heard + limits.idle
        client.tend(client.heard + 29.0)
        with pytest.raises(TimeoutError):
            client.tend(client.heard + 30.0)
        reply = client.reply = Reply()
        client.asked = client.heard
        client.tend(client.asked + 59.0)
        assert not reply.gone
        client.tend(client.asked + 60.0)
        assert reply.gone  # and what was asked is not wanted any more
        assert json.loads(theirs.recv(MAX_LINE)) == {"ok": False, "error": "no answer within 60 s"}
        while not client.unsent:
            client.send_line(10000 * b"x")
        client.tend(client.sent + 4.0)
        with pytest.raises(TimeoutError):
            client.tend(client.sent + 5.0)


def test_what_nobody_reads_is_bounded():
    limits = Limits()
    with connected(limits) as (client, _):
        while len(client.unsent) + 10000 <= limits.unsent:
            client.send_line(10000 * b"x")
        with pytest.raises(TimeoutError):
            client.send_line(10000 * b"x")
