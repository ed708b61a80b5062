"""Lines to other programs by TCP, UDP and WebSocket."""

import contextlib
import json
import select
import socket
import subprocess
import time
from itertools import count, pairwise

import pytest
from reporting import PATIENCE, free_port, refused, report, until
from websockets import exceptions, frames
from websockets.sync.client import connect

from spheremouse.errors import OutputError
from spheremouse.output import open_output, probe
from spheremouse.output.line_server import LineServer


@pytest.fixture
def port():
    return free_port()


@contextlib.contextmanager
def dialled(port):
    """A client, and its lines."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as client, client.makefile("r") as lines:
        yield client, lines


def send_until_read(output, client):
    """Send reports until a client has its first line: the server accepts in its own thread."""
    numbers = count(1)
    until(lambda: output.send(report(next(numbers))) or select.select([client], [], [], 0.005)[0])


def test_a_shells_client_reads_whole_lines(port):
    """Bash itself connects, in the middle of a run."""
    with open_output(f"tcp:127.0.0.1:{port},format=counts") as output:
        script = f"exec 3<>/dev/tcp/127.0.0.1/{port}; head -n 4 <&3"
        with subprocess.Popen(["bash", "-c", script], stdout=subprocess.PIPE, text=True) as shell:
            sent = []
            while shell.poll() is None:
                sent.append(len(sent))
                output.send(report(sent[-1], stamp=0.5))
                time.sleep(0.002)
            assert shell.stdout is not None
            header, *lines = shell.stdout.read().splitlines()
    assert header == "# stamp dx dy dz (s, counts)"
    first = int(lines[0].split()[1])
    assert lines == [f"0.5 {first + k} 0 0" for k in range(3)]


def test_any_number_of_clients_get_lines_from_their_connection_on(port):
    with open_output(f"tcp:{port}") as output, contextlib.ExitStack() as stack:
        clients = []
        for _ in range(20):
            clients.append(stack.enter_context(dialled(port)))
            send_until_read(output, clients[-1][0])
        output.send(report(-1, -2, -3))
        received = []
        for _, lines in clients:
            counts = []
            while not counts or counts[-1] != [-1, -2, -3]:
                counts.append(json.loads(lines.readline())["counts"])
            received.append(counts)
        assert all(len(now) < len(before) for before, now in pairwise(received))


def test_a_client_that_does_not_read_is_dropped_and_blocks_nobody(port):
    """It gets whole lines without a gap until its buffer was full, and then the end."""
    sent = 6000  # 3 MB
    with open_output(f"tcp:{port}") as output, socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", port))
        send_until_read(output, slow)
        longest = 0.0
        with dialled(port) as (quick, quick_lines):
            send_until_read(output, quick)
            for k in range(sent):
                start = time.monotonic()
                output.send(report(-k))
                longest = max(longest, time.monotonic() - start)
                while json.loads(quick_lines.readline())["counts"][0] != -k:
                    pass
        with slow.makefile("r") as lines:
            *whole, _ = lines.read().split("\n")
    read = [json.loads(line)["counts"][0] for line in whole]
    first = read.index(0)
    assert read[first:] == [-k for k in range(len(read) - first)]
    assert len(read) - first < sent
    assert longest < 1.0  # it never waits for the slow client, which would last for ever


def test_many_clients_need_a_thread(port):
    """The tracker must not wait for the milliseconds that they take."""
    with open_output(f"tcp:{port}") as output:
        for clients, blocks in ((1, False), (20, True), (1, False)):
            with contextlib.ExitStack() as stack:
                for _ in range(clients):
                    stack.enter_context(socket.create_connection(("127.0.0.1", port)))
                until(lambda blocks=blocks: output.send(report(1)) or output.blocks == blocks)


def test_a_client_that_disconnects_or_sends_rubbish_is_no_trouble(port):
    with open_output(f"tcp:{port}") as output:
        for _ in range(30):
            with dialled(port) as (client, _):
                client.sendall(b"\0" * 1000)
                send_until_read(output, client)
            output.send(report(1))
        with dialled(port) as (half, lines):
            half.shutdown(socket.SHUT_WR)  # as a shell's client without input
            send_until_read(output, half)
            assert json.loads(lines.readline())["counts"][1:] == [0, 0]


def test_closing_ends_the_connections_and_frees_the_port(port):
    for _ in range(3):
        output = open_output(f"tcp:{port}")
        with dialled(port) as (client, lines):
            send_until_read(output, client)
            output.close()
            assert lines.read().endswith("\n")


def test_a_port_in_use_is_refused(port):
    with open_output(f"tcp:{port}"):
        hint = "stop the other program, or take another port"
        assert refused(f"tcp:{port}") == f"tcp:{port}: Address already in use; {hint}"
        with pytest.raises(OutputError, match="Address already in use"):
            probe(f"tcp:{port}")
    assert probe(f"tcp:{port}")[0].text == f"port {port} of 127.0.0.1 is free"
    assert refused("tcp:9,origin=x").startswith("tcp:9,origin=x: unknown key origin")
    assert refused("tcp:192.0.2.1:9").endswith("; write an address of this computer, or 0.0.0.0 for all")


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)])
def test_only_an_open_door_is_warned_of(host, warned, capsys, port):
    with open_output(f"tcp:{host}:{port}") as output:
        assert isinstance(output, LineServer)
    assert ("other computers can connect" in capsys.readouterr().err) is warned


def receiver(port=0, family=socket.AF_INET, host="127.0.0.1"):
    bound = socket.socket(family, socket.SOCK_DGRAM)
    bound.settimeout(PATIENCE)
    bound.bind((host, port))
    return bound, bound.getsockname()[1]


def test_each_line_is_a_datagram():
    with receiver()[0] as bound, open_output(f"udp:127.0.0.1:{bound.getsockname()[1]}") as output:
        for k in range(5):
            output.send(report(k, -k, 2))
        lines = [bound.recv(65536) for _ in range(5)]
    assert [json.loads(line)["counts"] for line in lines] == [[k, -k, 2] for k in range(5)]
    assert all(line.endswith(b"\n") and line.count(b"\n") == 1 for line in lines)


def test_a_receiver_may_start_late_and_again():
    bound, port = receiver()
    bound.close()
    with open_output(f"udp:{port}") as output:
        for _ in range(3):
            for _ in range(3):
                output.send(report(1))  # to nobody
            bound, _ = receiver(port)
            with bound:
                output.send(report(2))
                assert json.loads(bound.recv(65536))["counts"] == [2, 0, 0]


def test_a_receiver_that_does_not_read_loses_lines_alone():
    bound, port = receiver()
    with bound, open_output(f"udp:{port}") as output:
        for k in range(2000):
            output.send(report(k))
        assert json.loads(bound.recv(65536))["counts"] == [0, 0, 0]


def test_ipv6():
    bound, port = receiver(family=socket.AF_INET6, host="::1")
    with bound, open_output(f"udp:[::1]:{port},format=counts") as output:
        output.send(report(1, 2, 3, stamp=0.5))
        assert bound.recv(100) == b"0.5 1 2 3\n"


def test_where_it_sends_is_known_beforehand():
    assert probe("udp:localhost:9")[0].text == "sends to 127.0.0.1 port 9"
    with pytest.raises(OutputError, match="unknown host"):
        probe("udp:nowhere.invalid:9")


def first_message(output, client):
    """Send reports until a client has a message, and return that."""

    def received():
        output.send(report(1, 2, 3))
        with contextlib.suppress(TimeoutError):
            return client.recv(0.005)

    return until(received)


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


@pytest.mark.parametrize("length", [0, 125, 126, 65_535, 65_536])
def test_a_message_of_any_length_is_the_frame_of_the_library(length, port):
    text = length * b"a"
    with open_output(f"ws:{port}") as output:
        assert output.encode(text + b"\n") == frames.Frame(frames.Opcode.TEXT, text).serialize(mask=False)


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
