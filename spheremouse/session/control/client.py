"""A client of the daemon's control socket: a command in, the reply as a dict out; errors in words."""

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ControlError, printable
from spheremouse.files import plain_json
from spheremouse.session.control import places
from spheremouse.session.control.line import MAX_LINE
from spheremouse.session.control.socket import peer_of
from spheremouse.session.control.status import misfit

_START = "start one with `spheremouse run` or `systemctl start spheremouse`"
_PATIENCE = {"status": 5.0, "watch": 5.0}  # s; other commands may take the daemon a while
_CONNECT = 5.0  # s
_LONGEST = 65.0  # s; the daemon itself says after 60 that there is no answer


class NoDaemonError(ControlError):
    """Nobody is there to be asked."""


class RefusedError(ControlError):
    """The daemon, or the socket's file, says no."""


class Client:
    """A connection to the daemon at `path`, or at the place where one is found. Made when first used."""

    def __init__(self, path: Path | None = None) -> None:
        self._given = path
        self._path = path or places.find_socket()
        self._socket: socket.socket | None = None
        self._received = bytearray()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def path(self) -> Path:
        """The socket it speaks to."""
        return self._path

    @property
    def is_trusted(self) -> bool:
        """Whether the server at the other end runs as this user or as root, by the kernel's word."""
        peer = peer_of(self._connected())
        return peer is not None and peer.uid in (0, os.geteuid())

    def close(self) -> None:
        """Hang up; the next question calls again."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._received.clear()

    def ask(self, command: str, **arguments: Any) -> dict[str, Any]:
        """The daemon's reply without `ok`. RefusedError with its reason, NoDaemonError where none runs."""
        given = {k: v for k, v in arguments.items() if v is not None}
        reply = self._exchange({"command": command, **given}, _PATIENCE.get(command, _LONGEST))
        if reply.pop("ok", None) is not True:
            raise RefusedError(printable(str(reply.get("error", "the daemon refuses and does not say why"))))
        return self._status(reply) if command == "status" else reply

    def watch(self, interval: float = 1.0) -> Iterator[dict[str, Any]]:
        """Events, `status` every `interval` s and `log`, until the daemon ends, which is a NoDaemonError."""
        self.ask("watch", interval=interval)
        while True:
            event = self._receive(max(_PATIENCE["watch"], 3.0 * interval))
            yield self._status(event) if event.get("event") == "status" else event

    def _status(self, status: dict[str, Any]) -> dict[str, Any]:
        """A status as it came, every value of its kind."""
        if (wrong := misfit(status)) is not None:
            self.close()
            raise NoDaemonError(
                f"{self._path}: what answers there gives no status of spheremouse ({printable(wrong)}); is the daemon "
                "of another version? Start it anew"
            )
        return status

    def _exchange(self, message: dict[str, Any], patience: float) -> dict[str, Any]:
        line = json.dumps(message).encode() + b"\n"
        if len(line) > MAX_LINE:
            raise RefusedError(f"a request of {len(line)} bytes; {MAX_LINE} is the most")
        connection = self._connected()
        try:
            connection.settimeout(patience)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # there may be a reason to read
                connection.sendall(line)
        except OSError as e:
            self.close()
            raise NoDaemonError(f"{self._path}: the daemon does not listen ({e})") from None
        return self._receive(patience)

    def _receive(self, patience: float) -> dict[str, Any]:
        connection, deadline = self._connected(), time.monotonic() + patience
        try:
            while (end := self._received.find(b"\n")) < 0:
                connection.settimeout(max(deadline - time.monotonic(), 1e-3))  # in all: bytes may come one by one
                data = connection.recv(MAX_LINE)
                if not data:
                    raise ConnectionResetError
                self._received += data
                if len(self._received) > 2 * MAX_LINE:
                    raise ValueError
            line = bytes(self._received[:end])
            del self._received[: end + 1]
            message = plain_json.loads(line, surrogates=True)
            if not isinstance(message, dict):
                raise ValueError
        except TimeoutError:
            self.close()
            raise NoDaemonError(f"{self._path}: no answer within {patience:g} s; does the daemon hang?") from None
        except OSError:
            self.close()
            raise NoDaemonError(f"{self._path}: the daemon has ended, or hung up; {_START}") from None
        except ValueError:
            self.close()
            raise NoDaemonError(f"{self._path}: what answers there is no daemon of spheremouse") from None
        return message

    def _connected(self) -> socket.socket:
        if self._socket is not None:
            return self._socket
        if not hasattr(socket, "AF_UNIX"):
            raise NoDaemonError("this system has no Unix sockets, so no daemon can be asked here")
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(_CONNECT)
            _connect(connection, str(self._path))
        except PermissionError:
            connection.close()
            raise RefusedError(f"{self._path}: you may not; {self._who_may()}") from None
        except (FileNotFoundError, NotADirectoryError, ConnectionRefusedError):
            connection.close()
            raise NoDaemonError(f"no daemon runs ({self._where()}); {_START}") from None
        except OSError as e:
            connection.close()
            raise NoDaemonError(f"{self._path}: no daemon can be reached there ({e})") from None
        self._socket = connection
        return connection

    def _where(self) -> str:
        """Where was looked."""
        if self._given is not None or os.environ.get("SPHEREMOUSE_SOCKET"):
            return f"nobody listens at {self._path}"
        return f"nobody listens at {' or '.join(str(p) for p in places.candidates())}"

    def _who_may(self) -> str:
        import grp  # not on every system

        try:
            found = self._path.stat()
            if found.st_mode & 0o060 == 0o060:
                return f"join the group {grp.getgrgid(found.st_gid).gr_name} and log in anew, or use sudo"
        except (OSError, KeyError):
            pass
        return "use sudo, or the user whose daemon it is"


def _connect(connection: socket.socket, path: str) -> None:
    """Connect; where many want in at once, as soon as there is room in the queue."""
    end = time.monotonic() + _CONNECT
    while True:
        try:
            connection.connect(path)
            return
        except BlockingIOError:
            if time.monotonic() > end:
                raise TimeoutError("no room in its queue") from None
            time.sleep(0.01)
