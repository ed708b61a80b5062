"""A server of libspnav's clients over a UNIX socket, as the driver spacenavd is one.

An event is eight native 32-bit integers: type 0 (motion), x, y, z, rx, ry, rz, and ms since the last event. A client
that requests a protocol gets version 0. Its only other request is a 32-bit float, a factor on its units (libspnav 1.0).
"""

import contextlib
import errno
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spheremouse.errors import OutputError

_CHANGE_PROTOCOL = 0x7FAA5500  # request; its last byte is the version
_GREETING_TIME = 0.1  # s, for a client's first request; libspnav would take an event for the answer
_MAX_CLIENTS, _MAX_FACTOR = 16, 1e6


@dataclass(slots=True)
class _Client:
    ready: float  # s, monotonic; no event before
    sensitivity: float = 1.0


class SpnavServer:
    """Sends events to its clients. A thread accepts them and reads their requests."""

    def __init__(self, path: Path) -> None:
        self._path, self._listener = path, _listen(path)
        self._clients: dict[socket.socket, _Client] = {}
        self._lock, self._over, self._last = threading.Lock(), False, time.monotonic()
        self._thread = threading.Thread(target=self._serve, name="spacenav", daemon=True)
        self._thread.start()

    def send(self, rotation: Sequence[float]) -> None:
        """Send rx, ry and rz, (3,) units, to each client. One that does not read its events is disconnected."""
        now = time.monotonic()
        with self._lock:
            for connection, client in self._clients.items():
                if now >= client.ready:
                    units = [round(r * client.sensitivity) for r in rotation]
                    period = min(round(1000.0 * (now - self._last)), 2**31 - 1)
                    _send(connection, struct.pack("=8i", 0, 0, 0, 0, *units, period))
            self._last = now

    def close(self) -> None:
        """End the connections and remove the socket."""
        self._over = True
        self._listener.shutdown(socket.SHUT_RDWR)  # wakes the thread
        self._thread.join()
        for connection in (self._listener, *self._clients):
            connection.close()
        self._path.unlink(missing_ok=True)

    def _serve(self) -> None:
        while not self._over:
            readable, _, _ = select.select([self._listener, *self._clients], [], [])
            for connection in () if self._over else readable:
                with self._lock, contextlib.suppress(OSError):
                    self._accept() if connection is self._listener else self._read(connection)

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        if len(self._clients) < _MAX_CLIENTS:
            self._clients[connection] = _Client(time.monotonic() + _GREETING_TIME)
        else:
            connection.close()

    def _read(self, connection: socket.socket) -> None:
        request = b""
        with contextlib.suppress(OSError):
            request = connection.recv(4, socket.MSG_DONTWAIT)
        if len(request) < 4:
            del self._clients[connection]
            connection.close()
            return
        (word,), (value,) = struct.unpack("=I", request), struct.unpack("=f", request)
        if word & 0xFFFFFF00 == _CHANGE_PROTOCOL:
            _send(connection, struct.pack("=I", _CHANGE_PROTOCOL))
            self._clients[connection].ready = 0.0
        elif abs(value) <= _MAX_FACTOR:
            self._clients[connection].sensitivity = value


def _send(connection: socket.socket, data: bytes) -> None:
    """Send without waiting. A connection that does not take all of it is shut down, and `_read` closes it."""
    with contextlib.suppress(OSError):
        if connection.send(data, socket.MSG_DONTWAIT) == len(data):
            return
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def _listen(path: Path) -> socket.socket:
    """Return a socket that every account may connect to. A socket without a server is replaced."""
    listener = socket.socket(socket.AF_UNIX)
    try:
        with contextlib.suppress(ConnectionRefusedError, FileNotFoundError), socket.socket(socket.AF_UNIX) as other:
            other.connect(str(path))
            raise OSError(errno.EADDRINUSE, "another driver serves it")
        if path.is_socket():
            path.unlink()
        listener.bind(str(path))
        node = os.open(path, os.O_PATH | os.O_NOFOLLOW)
        os.chmod(f"/proc/self/fd/{node}", 0o666)
        os.close(node)
        listener.listen(_MAX_CLIENTS)
    except (OSError, ValueError) as e:
        listener.close()
        problem = f"spacenav: {path}: {getattr(e, 'strerror', None) or e}"
        raise OutputError(problem, "stop spacenavd, or name another socket") from None
    return listener
