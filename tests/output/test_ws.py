"""Lines by WebSocket, read by a browser, by Node.js and by the client of `websockets`."""

import json
import shutil
import socket
import subprocess
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

import pytest
from reporting import PATIENCE, report

from spheremouse.output import open_output

connect = pytest.importorskip("websockets.sync.client").connect
exceptions = pytest.importorskip("websockets.exceptions")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
NODE = shutil.which("node")

PAGE = """<script>
const counts = [], socket = new WebSocket("ws://127.0.0.1:WS");
const answer = text => new Image().src = "http://127.0.0.1:HTTP/answer?" + encodeURIComponent(text);
socket.onerror = () => answer("refused");
socket.onmessage = message => {
  counts.push(JSON.parse(message.data).counts);
  if (counts.length == 5) answer(JSON.stringify(counts));
};
</script>"""
SCRIPT = """const socket = new WebSocket(process.argv[1]), counts = [];
socket.onmessage = message => {
  counts.push(JSON.parse(message.data).counts);
  if (counts.length == 5) socket.close();
};
socket.onclose = () => console.log(JSON.stringify(counts));"""


@pytest.fixture
def port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


class Site(ThreadingHTTPServer):
    """A web server with one page, which sends its answer back."""

    def __init__(self, ws):
        self.answers = []
        super().__init__(("127.0.0.1", 0), Handler)
        self.page = PAGE.replace("WS", str(ws)).replace("HTTP", str(self.server_port))
        threading.Thread(target=self.serve_forever, daemon=True).start()


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        if self.path.startswith("/answer?"):
            self.server.answers.append(unquote(self.path.partition("?")[2]))
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.server.page.encode())

    def log_message(self, *_):
        pass


def is_a_run_of_counts(counts):
    first = counts[0][0]
    return counts == [[first + k, 2, 3] for k in range(5)]


def send_while(output, condition):
    """Send reports of counts 1, 2, 3 and so on while it is so."""
    end, k = time.monotonic() + 3 * PATIENCE, 0
    while condition():
        assert time.monotonic() < end, "no answer"
        output.send(report(k := k + 1, 2, 3))
        time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
@pytest.mark.parametrize(("origin", "option"), [("file", ",origin=null"), ("loopback", ""), ("sandbox", "")])
def test_a_browser(origin, option, port, tmp_path):
    """A page of this computer gets the samples. A sandboxed frame, which any page can have, gets none."""
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    with open_output(f"ws:127.0.0.1:{port}{option}") as output, Site(port) as site:
        address = f"http://127.0.0.1:{site.server_port}/"
        (tmp_path / "page.html").write_text(site.page)
        if origin == "file":
            address = (tmp_path / "page.html").as_uri()
        elif origin == "sandbox":
            (tmp_path / "frame.html").write_text(f'<iframe sandbox="allow-scripts" src="{address}"></iframe>')
            address = (tmp_path / "frame.html").as_uri()
        command = [CHROMIUM, *options, "--remote-debugging-port=0", address]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as browser:
            try:
                send_while(output, lambda: not site.answers)
            finally:
                browser.terminate()
        site.shutdown()
    if origin == "sandbox":
        assert site.answers[0] == "refused"
    else:
        assert is_a_run_of_counts(json.loads(site.answers[0]))


@pytest.mark.skipif(NODE is None, reason="no Node.js here")
def test_node(port):
    with open_output(f"ws:{port}") as output:
        command = [NODE, "--experimental-websocket", "-e", SCRIPT, f"ws://127.0.0.1:{port}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as node:
            send_while(output, lambda: node.poll() is None)
            assert node.stdout is not None
            read = node.stdout.read()
    if not read:
        pytest.skip("this Node.js has no WebSocket")
    assert is_a_run_of_counts(json.loads(read))


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
