"""Lines by UDP, to a receiver that may come and go."""

import json
import socket

from reporting import PATIENCE, report

from spheremouse.output import open_output, probe


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
    assert "unknown host" in probe("udp:nowhere.invalid:9")[0].text
