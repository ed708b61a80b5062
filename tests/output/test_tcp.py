"""Lines by TCP: each client reads whole lines from its connection on, and none delays another."""

import json
import socket
import subprocess
import time
from itertools import pairwise

import pytest
from reporting import PATIENCE, refused, report

from spheremouse.output import open_output, probe
from spheremouse.output.line_server import LineServer


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def dial(port):
    client = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
    return client, client.makefile("r")


def send_until_read(output, client):
    """Send reports until a client has its first line: the server accepts in its own thread."""
    client.setblocking(False)
    numbers = iter(range(1, 10_000))
    while True:
        output.send(report(next(numbers)))
        try:
            client.recv(1, socket.MSG_PEEK)
            client.settimeout(PATIENCE)
            return
        except BlockingIOError:
            time.sleep(0.005)


def test_a_shells_client_reads_whole_lines(tmp_path):
    """Bash itself connects, in the middle of a run."""
    port = free_port()
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


def test_any_number_of_clients_get_lines_from_their_connection_on():
    port = free_port()
    with open_output(f"tcp:{port}") as output:
        clients = []
        for _ in range(20):
            clients.append(dial(port))
            send_until_read(output, clients[-1][0])
        output.send(report(-1, -2, -3))
        received = []
        for _, lines in clients:
            counts = []
            while not counts or counts[-1] != [-1, -2, -3]:
                counts.append(json.loads(lines.readline())["counts"])
            received.append(counts)
        assert all(len(now) < len(before) for before, now in pairwise(received))
        for client, lines in clients:
            lines.close()
            client.close()


def test_a_client_that_does_not_read_is_dropped_and_blocks_nobody():
    """It gets whole lines without a gap until its buffer was full, and then the end."""
    port, count = free_port(), 6000  # 3 MB
    with open_output(f"tcp:{port}") as output:
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", port))
        send_until_read(output, slow)
        quick, quick_lines = dial(port)
        send_until_read(output, quick)
        longest = 0.0
        for k in range(count):
            start = time.monotonic()
            output.send(report(-k))
            longest = max(longest, time.monotonic() - start)
            while json.loads(quick_lines.readline())["counts"][0] != -k:
                pass
        with slow.makefile("r") as lines:
            *whole, _ = lines.read().split("\n")
        quick_lines.close()
        quick.close()
        slow.close()
    read = [json.loads(line)["counts"][0] for line in whole]
    first = read.index(0)
    assert read[first:] == [-k for k in range(len(read) - first)]
    assert len(read) - first < count
    assert longest < 1.0  # it never waits for the slow client, which would last for ever


def test_a_client_that_disconnects_or_sends_rubbish_is_no_trouble():
    port = free_port()
    with open_output(f"tcp:{port}") as output:
        for _ in range(30):
            client, lines = dial(port)
            client.sendall(b"\0" * 1000)
            send_until_read(output, client)
            lines.close()
            client.close()
            output.send(report(1))
        half, lines = dial(port)
        half.shutdown(socket.SHUT_WR)  # as a shell's client without input
        send_until_read(output, half)
        assert json.loads(lines.readline())["counts"][1:] == [0, 0]
        lines.close()
        half.close()


def test_closing_ends_the_connections_and_frees_the_port():
    port = free_port()
    for _ in range(3):
        with open_output(f"tcp:{port}") as output:
            client, lines = dial(port)
            send_until_read(output, client)
        assert lines.read().endswith("\n")
        lines.close()
        client.close()


def test_a_port_in_use_is_refused():
    port = free_port()
    with open_output(f"tcp:{port}"):
        assert (
            refused(f"tcp:{port}")
            == f"tcp:{port}: Address already in use; stop the other program, or take another port"
        )
        assert "Address already in use" in probe(f"tcp:{port}")[0].text
    assert probe(f"tcp:{port}")[0].text == f"port {port} of 127.0.0.1 is free"
    assert refused("tcp:9,origin=x").startswith("tcp:9,origin=x: unknown key origin")


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)])
def test_only_an_open_door_is_warned_of(host, warned, capsys):
    with open_output(f"tcp:{host}:{free_port()}") as output:
        assert isinstance(output, LineServer)
    assert ("other computers can connect" in capsys.readouterr().err) is warned
