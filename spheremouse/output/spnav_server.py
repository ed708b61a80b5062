"""A server of libspnav's clients over a UNIX socket, as the driver spacenavd is one.

An event is eight native 32-bit integers: type 0 (motion), x, y, z, rx, ry, rz, and ms since the last event. A client
that requests a protocol gets version 0. Its only other request is a 32-bit float, a factor on its units (libspnav 1.0).
"""

import contextlib
import errno
import os
import socket
import struct
import time
from collections.abc import Sequence
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.output.line_server import Client, Server

_CHANGE_PROTOCOL = 0x7FAA5500  # request; its last byte is the version
_GREETING_TIME = 0.1  # s, for a client's first request; libspnav would take an event for the answer
_MAX_FACTOR = 1e6


class _Client(Client):
    def __init__(self) -> None:
        self._sensitivity, self._unread = 1.0, b""
        self._ready_at = time.monotonic() + _GREETING_TIME

    @property
    def ready(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return time.monotonic() >= self._ready_at

    def receive(self, data: bytes) -> tuple[bytes, bool]:
        self._unread, answer = self._unread + data, b""
        while len(self._unread) >= 4:
            request, self._unread = self._unread[:4], self._unread[4:]
            (word,), (value,) = struct.unpack("=I", request), struct.unpack("=f", request)
            if word & 0xFFFFFF00 == _CHANGE_PROTOCOL:
                answer, self._ready_at = struct.pack("=I", _CHANGE_PROTOCOL), 0.0
            elif abs(value) <= _MAX_FACTOR:
                self._sensitivity = value
        return answer, bool(data)

    def event(self, rotation: Sequence[float], period: int) -> bytes:
        """Return the event of a rotation, (3,) units, `period` ms after the last one."""
        units = [round(r * self._sensitivity) for r in rotation]
        return struct.pack("=8i", 0, 0, 0, 0, *units, period)


class SpnavServer(Server[_Client]):
    """Sends events to its clients."""

    def __init__(self, path: Path) -> None:
        self._path, self._last = path, time.monotonic()
        super().__init__("spacenav", _listen(path), _Client)

    def send(self, rotation: Sequence[float]) -> None:
        """Send rx, ry and rz, (3,) units, to each client. One that does not read its events is disconnected."""
        now = time.monotonic()
        period, self._last = min(round(1000.0 * (now - self._last)), 2**31 - 1), now
        self.broadcast(lambda client: client.event(rotation, period))

    def close(self) -> None:
        super().close()
        self._path.unlink(missing_ok=True)


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
        listener.listen()
    except (OSError, ValueError) as e:
        listener.close()
        problem = f"spacenav: {path}: {getattr(e, 'strerror', None) or e}"
        raise OutputError(problem, "stop spacenavd, or name another socket") from None
    return listener
