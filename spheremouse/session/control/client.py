"""A client of the daemon's control socket."""

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from spheremouse.errors import ControlError, one_line, printable
from spheremouse.files import plain_json
from spheremouse.files.config import key_of
from spheremouse.session.control import socket_file
from spheremouse.session.control.protocol import MAX_LINE, LivePicture
from spheremouse.session.control.socket_file import peer_of
from spheremouse.session.control.status import StatusReport

if TYPE_CHECKING:
    from spheremouse.output.sample import Sample

_RESTART = "if the daemon has another version, restart it"
_START = "start one with `spheremouse run` or `systemctl start spheremouse`"
_TIMEOUTS_S = {"status": 5.0, "watch": 5.0, "picture": 5.0}  # s; other commands may take the daemon a while
_SIGN_OF_LIFE = 5.0  # s between two statuses, which show that the daemon works if no frame comes
_CONNECT_TIMEOUT = 5.0  # s
_DEFAULT_TIMEOUT_S = 65.0  # s; the daemon itself gives up after 60 s
_MAX_PICTURE_BYTES = 1 << 28  # 8K in colour has 100 MB


class NoDaemonError(ControlError):
    """No daemon answers."""


class RefusedError(ControlError):
    """The daemon refuses a request, or the socket's mode refuses this user."""


class Client:
    """A connection to the daemon at `path`, or to the one that `find_socket` finds. It opens with the first request."""

    def __init__(self, path: Path | None = None) -> None:
        self._given = path
        self.path = path or socket_file.find_socket()  # of the socket
        self._socket: socket.socket | None = None
        self._received = bytearray()
        self.dropped = 0  # samples that this client read too slowly

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def has_received(self) -> bool:
        """True if the next event has been read from the socket."""
        return b"\n" in self._received

    @property
    def is_trusted(self) -> bool:
        """True if the server runs as this user or as root, by the kernel's credentials."""
        peer = peer_of(self._connect())
        return peer is not None and peer.uid in (0, os.geteuid())

    def close(self) -> None:
        """Disconnect. The next request connects again."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._received.clear()

    def ask(self, command: str, /, **arguments: Any) -> dict[str, Any]:
        """Return the daemon's reply without `ok`. RefusedError has the daemon's reason; NoDaemonError: none answers."""
        given = {k: v for k, v in arguments.items() if v is not None}
        reply = self._exchange({**given, "command": command}, _TIMEOUTS_S.get(command, _DEFAULT_TIMEOUT_S))
        if reply.pop("ok", None) is not True:
            raise RefusedError(printable(str(reply.get("error", "the daemon refuses without a reason"))))
        return reply

    def status(self) -> StatusReport:
        """Return the daemon's status."""
        return self._parse_status(self.ask("status"))

    def watch(self, interval: float = 1.0) -> Iterator[StatusReport | str]:
        """Yield a status every `interval` s, and each line of the daemon's log. NoDaemonError if the daemon ends."""
        for event in self.events(interval, samples=False):
            yield self._parse_status(event) if event.pop("event", None) == "status" else str(event.get("text", ""))

    def events(self, interval: float, *, samples: bool) -> Iterator[dict[str, Any]]:
        """Yield the events of docs/control.md as JSON objects: each status, log line and, if asked, sample.

        NoDaemonError if the daemon ends.
        """
        self.ask("watch", interval=interval, samples=samples or None)
        while True:
            yield self._receive(max(_TIMEOUTS_S["watch"], 3.0 * interval))

    def sample_objects(self) -> Iterator[dict[str, Any]]:
        """Yield each sample of the run as a JSON object of `output.sample`. NoDaemonError if the daemon ends.

        If this program reads too slowly, the daemon drops samples; `dropped` has their number.
        """
        for event in self.events(_SIGN_OF_LIFE, samples=True):
            if event.get("event") == "sample" and isinstance(sample := event.get("sample"), dict):
                self.dropped = event.get("dropped", 0)
                yield sample

    def picture(self) -> LivePicture:
        """Return the next frame as the camera sent it, with the tracker's marks. RefusedError if none comes."""
        reply = self.ask("picture")
        try:
            size = reply.pop("bytes", None)
            if not isinstance(size, int) or not 0 < size <= _MAX_PICTURE_BYTES:
                raise ValueError("bytes: must be the size of the picture")
            return LivePicture.model_validate({**reply, "pixels": self._receive_bytes(size)})
        except ValueError as e:
            self.close()
            raise NoDaemonError(f"{self.path}: the answer is no picture ({one_line(str(e))})", _RESTART) from None

    def samples(self) -> "Iterator[Sample]":
        """Yield each sample of the run, as `sample_objects` does."""
        from spheremouse.output.sample import from_object  # loads NumPy, which few clients need

        for read in self.sample_objects():
            try:
                yield from_object(read)
            except ValueError as e:
                self.close()
                raise NoDaemonError(f"{self.path}: {printable(str(e))}", _RESTART) from None

    def _parse_status(self, reply: dict[str, Any]) -> StatusReport:
        """Return the report of a reply. Raises NoDaemonError, and closes the connection, if it has another form."""
        try:
            return StatusReport.read(reply)
        except ControlError as e:
            self.close()
            problem = f"{self.path}: the answer is not a status of spheremouse ({printable(str(e))})"
            raise NoDaemonError(problem, _RESTART) from None

    def _exchange(self, message: dict[str, Any], timeout: float) -> dict[str, Any]:
        line = json.dumps(message).encode() + b"\n"
        if len(line) > MAX_LINE:
            raise RefusedError(f"a request of {len(line)} bytes; at most {MAX_LINE} are allowed")
        connection = self._connect()
        try:
            connection.settimeout(timeout)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # its last line may give the reason
                connection.sendall(line)
        except OSError as e:
            self.close()
            raise NoDaemonError(f"{self.path}: the daemon does not listen ({e})") from None
        return self._receive(timeout)

    def _receive(self, timeout: float) -> dict[str, Any]:
        """Return the next message before the timeout."""
        deadline = time.monotonic() + timeout
        try:
            while (end := self._received.find(b"\n")) < 0:
                if len(self._received) > MAX_LINE:
                    raise ValueError
                self._read(timeout, deadline)  # one deadline for the whole line
            message = plain_json.loads(self._take(end + 1), surrogates=True)
            if not isinstance(message, dict):
                raise ValueError
        except ValueError:
            self.close()
            raise NoDaemonError(f"{self.path}: the program that answers is no daemon of spheremouse") from None
        return message

    def _receive_bytes(self, count: int) -> bytes:
        """Return the bytes that follow a message."""
        timeout = _TIMEOUTS_S["picture"]
        deadline = time.monotonic() + timeout
        while len(self._received) < count:
            self._read(timeout, deadline)
        return self._take(count)

    def _read(self, timeout: float, deadline: float) -> None:
        """Add bytes that come before the deadline. Raises NoDaemonError, and closes the connection, without any."""
        connection = self._connect()
        try:
            connection.settimeout(max(deadline - time.monotonic(), 1e-3))
            data = connection.recv(MAX_LINE)
            if not data:
                raise ConnectionResetError
        except TimeoutError:
            self.close()
            raise NoDaemonError(f"{self.path}: no answer within {timeout:g} s; does it hang?") from None
        except OSError:
            self.close()
            raise NoDaemonError(f"{self.path}: the daemon has ended or disconnected", _START) from None
        self._received += data

    def _take(self, count: int) -> bytes:
        taken = bytes(self._received[:count])
        del self._received[:count]
        return taken

    def _connect(self) -> socket.socket:
        if self._socket is not None:
            return self._socket
        if not hasattr(socket, "AF_UNIX"):
            raise NoDaemonError("this system has no Unix sockets, so the daemon cannot be controlled here")
        with contextlib.ExitStack() as stack:
            connection = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            try:
                connection.settimeout(_CONNECT_TIMEOUT)
                connection.connect(str(self.path))
            except PermissionError:
                raise RefusedError(f"{self.path}: permission denied", self._permission_hint()) from None
            except (FileNotFoundError, NotADirectoryError, ConnectionRefusedError):
                raise NoDaemonError(f"no daemon runs (no daemon listens at {self._where()})", _START) from None
            except OSError as e:
                raise NoDaemonError(f"{self.path}: no daemon can be reached there ({e})") from None
            stack.pop_all()
        self._socket = connection
        return connection

    def _where(self) -> str:
        given = self._given is not None or os.environ.get("SPHEREMOUSE_SOCKET")
        return " or ".join(map(str, [self.path] if given else socket_file.candidates()))

    def _permission_hint(self) -> str:
        """Return the remedy for a user who has no access to the socket."""
        import grp  # not on Windows, which gets no further than `_connect`

        try:
            status = self.path.stat()
            if status.st_mode & 0o060 == 0o060:
                return f"join the group {grp.getgrgid(status.st_gid).gr_name} and log in again, or use sudo"
        except (OSError, KeyError):
            pass
        return "use sudo, or run this as the daemon's user"


def settings_to_save(
    client: Client, config: Path | None = None, assignments: list[str] | None = None
) -> tuple[Path, list[str]] | None:
    """Return the file for settings, and the settings as KEY=VALUE: `assignments`, or None for those of the daemon.

    Returns None if the daemon saves them itself, unless `config` names a file. A server that another user runs may
    report any file and any setting, so its word counts for neither. Raises ControlError if nothing can be saved.
    """
    status = client.status()
    changes = status.changes if assignments is None else assignments
    if given := [key for key in map(key_of, changes) if key in status.given]:
        problem = f"{', '.join(given)}: set on the daemon's command line, which overrides the file"
        raise ControlError(problem, "leave it out there")
    if config is None and status.saved is not None:
        return None
    if not client.is_trusted and (config is None or assignments is None):
        problem = f"{client.path}: another user runs the daemon, so name settings and file yourself"
        raise ControlError(f"{problem}: spheremouse ctl set KEY=VALUE --save --config FILE")
    file = config or (None if status.config is None else Path(status.config))
    if file is not None and not file.is_file():
        raise ControlError(f"{file}: there is no such file", "put it back, and save again")
    if file is None:
        raise ControlError("the daemon has no configuration file; start it with --config FILE to have one")
    return file, changes


def connect(socket: str | Path | None = None) -> "Iterator[Sample]":
    """Yield the samples of the running service, from now on.

    `socket` is the path of its control socket; by default it is found as by `spheremouse ctl`. Raises SpheremouseError
    if no service runs, if you have no access to the socket, or when the service ends. A caller that is too slow loses
    the oldest samples.
    """
    with Client(None if socket is None else Path(socket)) as client:
        yield from client.samples()
