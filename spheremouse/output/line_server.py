"""A server that sends lines to any number of clients, for the outputs `tcp` and `ws`."""

import contextlib
import selectors
import socket
import sys
import threading
import time

from spheremouse.output import Output, Report
from spheremouse.output.address import bind
from spheremouse.output.lines import LineFormat

_BUFFER_BYTES = 1 << 20  # unread lines of a client; the system may allow less
_MAX_CLIENTS = 256


class Client:
    """The protocol of one connection: lines from the start, and no answers."""

    ready = True  # it gets lines

    def receive(self, data: bytes) -> tuple[bytes, bool]:
        """Take received bytes, empty at their end. Return an answer, and False if the connection is over."""
        return b"", True

    def last_bytes(self) -> bytes:
        """Return the bytes to send before the server closes."""
        return b""


class LineServer(Output):
    """Sends lines to all clients of a port. It drops a client whose buffer is full, and never waits for one.

    Its own thread accepts clients and reads from them. `send` writes.
    """

    def __init__(self, name: str, host: str, port: int, form: LineFormat) -> None:
        """Bind the port. Raise OutputError if that fails; `name` begins the message."""
        self._form, self.paced, self._lock = form, form.paced, threading.Lock()
        self._clients: dict[socket.socket, Client] = {}
        self._greeting = self.encode(form.header) if form.header else b""
        self._listener = bind(name, host, port)
        if not self._listener.getsockname()[0].startswith(("127.", "::1")):
            print(f"{name}: other computers can connect, without a password or encryption", file=sys.stderr)
        self._listener.setblocking(False)
        self._stopping, self._stop = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._stopping, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    def connect(self) -> Client:
        """Return the protocol of a new client."""
        return Client()

    def encode(self, line: str) -> bytes:
        """Return a line in the form in which every client gets it."""
        return line.encode() + b"\n"

    def send(self, report: Report) -> None:
        """Send the lines of a report to every client."""
        for line in self._form.lines(report):
            data = self.encode(line)
            with self._lock:
                for connection in [connection for connection, client in self._clients.items() if client.ready]:
                    self._write(connection, data)

    def close(self) -> None:
        """Close the port and all connections."""
        self._stop.close()
        self._thread.join()

    def _write(self, connection: socket.socket, data: bytes) -> None:
        try:
            sent = connection.send(data) if data else 0
        except OSError:  # disconnected, or its buffer is full
            sent = -1
        if sent < len(data):
            self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        if self._clients.pop(connection, None) is not None:
            with contextlib.suppress(KeyError):
                self._selector.unregister(connection)
            connection.close()

    def _serve(self) -> None:
        while True:
            for key, _ in self._selector.select():
                if key.data is None:
                    return self._end()
                try:
                    with self._lock:
                        key.data(key.fileobj)
                except BlockingIOError:
                    continue
                except OSError:  # the process has no file descriptor left
                    time.sleep(0.1)

    def _accept(self, listener: socket.socket) -> None:
        connection, _ = listener.accept()
        if len(self._clients) >= _MAX_CLIENTS:
            return connection.close()
        connection.setblocking(False)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[connection] = client = self.connect()
        self._selector.register(connection, selectors.EVENT_READ, self._read)
        if client.ready:
            self._write(connection, self._greeting)

    def _read(self, connection: socket.socket) -> None:
        client = self._clients.get(connection)
        if client is None:  # dropped meanwhile
            return
        try:
            data, ready = connection.recv(65536), client.ready
        except ConnectionError:
            return self._drop(connection)
        answer, goes_on = client.receive(data)
        self._write(connection, answer if ready or not client.ready else answer + self._greeting)
        if not goes_on:
            self._drop(connection)
        elif not data and connection in self._clients:
            self._selector.unregister(connection)  # it may still read

    def _end(self) -> None:
        for connection, client in tuple(self._clients.items()):
            self._write(connection, client.last_bytes())
            self._drop(connection)
        for end in (self._listener, self._stopping, self._selector):
            end.close()
