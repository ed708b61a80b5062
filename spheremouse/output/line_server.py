"""A server that sends data to any number of clients, for the outputs `tcp`, `ws` and `spacenav`."""

import contextlib
import selectors
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from spheremouse.output import Output, Report
from spheremouse.output.lines import LineFormat
from spheremouse.output.network import bind

_MAX_CLIENTS = 256
_FEW_CLIENTS = 8  # 250 take 2 ms, at times 9 ms, for which the tracker must not wait


class Client:
    """The protocol of one connection: data from the start, and no answers."""

    ready = True  # it gets data

    def receive(self, data: bytes) -> tuple[bytes, bool]:
        """Take received bytes, empty at their end. Return an answer, and False if the connection is over."""
        return b"", True

    def last_bytes(self) -> bytes:
        """Return the bytes to send before the server closes."""
        return b""


ClientType = TypeVar("ClientType", bound=Client)


class Server(Generic[ClientType]):
    """Sends data to all clients of a socket. It drops a client whose buffer is full, and never waits for one.

    Its own thread accepts clients and reads from them. `broadcast` writes.
    """

    greeting = b""  # of each client

    def __init__(self, name: str, listener: socket.socket, connect: Callable[[], ClientType]) -> None:
        """Serve a listening socket; `connect` returns the protocol of a new client."""
        self._connect, self._lock, self._listener = connect, threading.Lock(), listener
        self._clients: dict[socket.socket, ClientType] = {}
        self._listener.setblocking(False)  # noqa: FBT003  the parameter has no name
        self._stopping, self._stop = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._stopping, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    def broadcast(self, data_of: Callable[[ClientType], bytes]) -> None:
        """Send each client that is ready its data."""
        with self._lock:
            for connection, client in tuple(self._clients.items()):
                if client.ready:
                    self._write(connection, data_of(client))

    @property
    def has_many_clients(self) -> bool:
        """True if sending to all takes so long that it needs a thread."""
        return len(self._clients) > _FEW_CLIENTS

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
        connection.setblocking(False)  # noqa: FBT003  the parameter has no name
        self._clients[connection] = client = self._connect()
        self._selector.register(connection, selectors.EVENT_READ, self._read)
        if client.ready:
            self._write(connection, self.greeting)

    def _read(self, connection: socket.socket) -> None:
        client = self._clients.get(connection)
        if client is None:  # dropped meanwhile
            return
        try:
            data, ready = connection.recv(65536), client.ready
        except ConnectionError:
            return self._drop(connection)
        answer, goes_on = client.receive(data)
        self._write(connection, answer if ready or not client.ready else answer + self.greeting)
        if not goes_on:
            self._drop(connection)
        elif not data and connection in self._clients:
            self._selector.unregister(connection)  # it may still read

    def _end(self) -> None:
        """Send each client its last bytes without waiting, and close everything."""
        for connection, client in tuple(self._clients.items()):
            self._write(connection, client.last_bytes())
            self._drop(connection)
        for end in (self._listener, self._stopping, self._selector):
            end.close()


class LineServer(Server[Client], Output):
    """Sends the lines of reports to all clients of a port."""

    blocks = False

    def __init__(
        self, name: str, host: str, port: int, form: LineFormat, connect: Callable[[], Client] = Client
    ) -> None:
        """Bind the port. Raise OutputError if that fails; `name` begins the message."""
        self._form, self.paced = form, form.paced
        self.greeting = self.encode(form.header) if form.header else b""
        listener = bind(name, host, port)
        if not listener.getsockname()[0].startswith(("127.", "::1")):
            sys.stderr.write(f"{name}: other computers can connect, without a password or encryption\n")
        super().__init__(name, listener, connect)

    def encode(self, line: bytes) -> bytes:
        """Return a line in the form in which every client gets it."""
        return line

    def send(self, report: Report) -> None:
        data = b"".join([self.encode(line) for line in self._form.lines(report)])
        self.broadcast(lambda _: data)
        self.blocks = self.has_many_clients
