"""Lines by UDP, to a receiver that may come and go."""

import json
import socket
from dataclasses import replace

from reporting import PATIENCE, report

from spheremouse.output import open_output, probe
from spheremouse.tracker import Status


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


def test_fictracs_own_client_reads_its_lines():
    """The loop of FicTrac's scripts/socket_client.py: receive 1024 bytes, cut at the newline, split at the commas."""
    bound, port = receiver()
    data = ""
    with bound, open_output(f"udp:{port},format=fictrac") as output:
        for k in range(1, 4):
            sample = report(rotation=(0.1 * k, 0, 0)).samples[0]
            tracked = sample.estimate._replace(status=Status.TRACKING, sequence=k, stamp=float(k))
            output.send(report()._replace(samples=(replace(sample, estimate=tracked),)))
            data += bound.recv(1024).decode("UTF-8")
            end = data.find("\n")
            tokens, data = data[:end].split(", "), data[end + 1 :]
            assert (len(tokens), tokens[0]) == (26, "FT")
            assert (int(tokens[1]), int(tokens[23])) == (k + 1, k)
            assert abs(float(tokens[7]) - 0.1 * k) < 1e-12
    assert data == ""


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
    assert "unknown host" in probe("udp:nowhere.invalid:9")[0].text
