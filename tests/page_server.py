"""The page's server in a thread, and browsers by `websockets`."""

import asyncio
import json
import socket
import struct
import threading
import time
from contextlib import contextmanager
from http.client import HTTPConnection

from websockets.sync.client import connect

from spheremouse.view.access import Access
from spheremouse.view.guide import GuideOptions
from spheremouse.view.server import application, server

TOKEN = "a-token-of-more-than-32-characters"
PATIENCE = 40.0  # s


@contextmanager
def serving(daemon, port=0, cabinet=None, source=None, address="127.0.0.1"):
    """Run the page of a daemon's socket in a thread; yields its port."""
    listener = socket.create_server((address, port), backlog=256)
    port = listener.getsockname()[1]
    running = server(application(daemon, Access(TOKEN, port), GuideOptions(cabinet, source)), address, port)
    thread = threading.Thread(target=lambda: asyncio.run(running.serve([listener])))
    thread.start()
    try:
        yield port
    finally:
        running.should_exit = True
        thread.join(PATIENCE)
        assert not thread.is_alive()


class Browser:
    """A browser's side of the WebSocket."""

    def __init__(self, port, owner=True, **headers):
        cookie = {"Cookie": f"spheremouse-{port}={TOKEN}"} if owner else {}
        address = f"127.0.0.1:{port}"
        given = {"origin": f"http://{address}", "additional_headers": cookie, "max_size": None} | headers
        self._connection = connect(f"ws://{address}/live", **given)
        self.socket = self._connection.__enter__()
        self.seen, self._id = [], 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._connection.__exit__(None, None, None)

    def _next(self, what, condition):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            self.seen.append(read(self.socket.recv(timeout=PATIENCE)))
            if condition(self.seen[-1]):
                return self.seen[-1]
        raise AssertionError(f"no {what}: {[m['type'] for m in self.seen]}")

    def until(self, kind, condition=lambda m: True):
        """The next message of a kind for which the condition holds."""
        return self._next(kind, lambda m: m["type"] == kind and condition(m))

    def ask(self, type_, **words):
        self._id += 1
        self.socket.send(json.dumps({"type": type_, "id": self._id, **words}))
        return self._next("answer", lambda m: m.get("id") == self._id and m["type"] != "progress")

    def frame(self):
        self.socket.send('{"type":"next"}')
        return self.until("frame")

    def picture(self):
        """The next frame that has a picture."""
        while not (frame := self.frame())["jpeg"]:
            pass
        return frame


def read(received):
    if isinstance(received, str):
        return json.loads(received)
    (length,) = struct.unpack(">I", received[:4])
    return {**json.loads(received[4 : 4 + length]), "jpeg": received[4 + length :]}


def act(browser, action, **arguments):
    return browser.ask("do", action=action, arguments=arguments)


def get(port, path="/", **headers):
    connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()
