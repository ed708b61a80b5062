"""Lines by WebSocket, read by the client of `websockets`."""

import json
import socket
import threading
import time

import pytest
from reporting import PATIENCE, report

from spheremouse.output import open_output

connect = pytest.importorskip("websockets.sync.client").connect
exceptions = pytest.importorskip("websockets.exceptions")


@pytest.fixture
def port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def send_while(output, condition):
    """Send reports of counts 1, 2, 3 and so on while it is so."""
    end, k = time.monotonic() + 3 * PATIENCE, 0
    while condition():
        assert time.monotonic() < end, "no answer"
        output.send(report(k := k + 1, 2, 3))
        time.sleep(0.005)


def first_message(output, client):
    messages = []
    thread = threading.Thread(target=lambda: messages.append(client.recv(PATIENCE)))
    thread.start()
    send_while(output, thread.is_alive)
    return messages[0]


@pytest.mark.parametrize(
    ("option", "origin", "admitted"),
    [
        ("", None, True),
        ("", "http://localhost:8000", True),
        ("", "https://[::1]", True),
        ("", "null", False),
        ("", "https://example.org", False),
        ("", "http://localhost.example.org", False),
        (",origin=https://example.org", "https://example.org", True),
        (",origin=https://example.org", "https://example.com", False),
        (",origin=null", "null", True),
        (",origin=*", "https://example.com", True),
    ],
)
def test_only_pages_of_this_computer_or_of_the_named_origin_may_connect(option, origin, admitted, port):
    with open_output(f"ws:{port}{option}") as output:
        if admitted:
            with connect(f"ws://127.0.0.1:{port}", origin=origin) as client:
                assert json.loads(first_message(output, client))["counts"][1:] == [2, 3]
        else:
            with pytest.raises(exceptions.InvalidStatus) as e:
                connect(f"ws://127.0.0.1:{port}", origin=origin)
            assert e.value.response.status_code == 403


def test_the_header_of_a_format_is_the_first_message_and_pings_are_answered(port):
    with open_output(f"ws:{port},format=counts") as output, connect(f"ws://127.0.0.1:{port}") as client:
        assert client.ping().wait(PATIENCE)
        assert client.recv(PATIENCE) == "# stamp dx dy dz (s, counts)"
        output.send(report(1, 2, 3, stamp=0.5))
        assert client.recv(PATIENCE) == "0.5 1 2 3"


def test_closing_says_so(port):
    with open_output(f"ws:{port}") as output, connect(f"ws://127.0.0.1:{port}") as client:
        assert client.ping().wait(PATIENCE)
        output.close()
        with pytest.raises(exceptions.ConnectionClosed) as e:
            client.recv(PATIENCE)
    assert e.value.rcvd.code == 1001


def test_a_client_that_speaks_no_websocket_is_no_trouble(port):
    with open_output(f"ws:{port}") as output:
        for words in (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\0" * 70_000, b"", b"GET / HTTP/1.1\r\n"):
            with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as rude:
                try:
                    rude.sendall(words)
                    rude.shutdown(socket.SHUT_WR)
                    while rude.recv(65536):
                        pass
                except OSError:  # it was reset
                    continue
        with connect(f"ws://127.0.0.1:{port}") as client:
            assert json.loads(first_message(output, client))["counts"][1:] == [2, 3]
