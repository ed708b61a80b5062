"""The control socket: who may, asks; one thread answers, with bounded memory, a bounded pace and no waiting for anyone.

Requests are lines (`protocol`). A client has one of them under way at a time (`connection`). `handle` is called in this
thread and must return at once; its `reply` may be called later, from any thread, and says whether anybody still waits
for it: who hangs up cancels what it asked. Everything that a client can do to the daemon through this door is bounded
by `Limits`.
"""

import contextlib
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ControlError, SpheremouseError, one_line
from spheremouse.output.rate_limited_logger import RateLimitedLogger
from spheremouse.session.control import socket as control_socket
from spheremouse.session.control.connection import Connection
from spheremouse.session.control.limits import Limits, Pace
from spheremouse.session.control.line import encode
from spheremouse.session.control.protocol import (
    BadRequestError,
    Request,
    Set,
    Watch,
    done,
    parse,
    refused,
)
from spheremouse.session.control.reply import Reply
from spheremouse.session.process.threads import begin
from spheremouse.session.settings.control import ControlSettings

Handle = Callable[[Request, Reply], None]

# What a member of the group may not `set`: which files and devices the daemon opens, and what it does for whom.
PLACES = ("source", "output", "rig", "camera_file", "map", "camera.controls", "control", "record", "metrics", "wand")

_WATCHERS = 0  # in place of a client's number
_GONE = select.POLLHUP | select.POLLERR | select.POLLNVAL  # both ways are closed; half of them is no hanging up


class ControlServer:
    """Listens at `path` from its making until `close`. `say` gets a line about what an operator should know of."""

    def __init__(
        self,
        path: Path,
        settings: ControlSettings,
        handle: Handle,
        say: Callable[[str], None] = lambda line: None,
        limits: Limits | None = None,
    ) -> None:
        if not hasattr(socket, "AF_UNIX"):
            raise ControlError("this system has no Unix sockets, so the daemon cannot be controlled here")
        self._path, self._settings, self._handle = path, settings, handle
        self._limits = limits or Limits()
        self._group = None if settings.group is None else control_socket.group_id(settings.group)
        self._clients: dict[int, Connection] = {}
        self._replies: deque[tuple[int, Reply, dict[str, Any]]] = deque()  # client
        self._events: deque[dict[str, Any]] = deque(maxlen=self._limits.events)
        self._count = 0
        self._watchers = False
        self._complain = RateLimitedLogger(
            say, 10.0, lambda _: ""
        )  # of whatever kind: a log is not to be filled from outside
        self._paces = {trusted: Pace(self._limits.pace, self._limits.burst) for trusted in (True, False)}
        self._connections = Pace(self._limits.pace, self._limits.burst)
        self._accept_again = 0.0
        self._ending = threading.Event()
        self._lock = control_socket.lock(path)
        try:
            self._listener = control_socket.listen(path, settings.group)
        except BaseException:
            os.close(self._lock)
            raise
        found = path.lstat()
        self._identity = (found.st_dev, found.st_ino)
        self._wake_read, self._wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self._wake_write.setblocking(False)
        self._waking = threading.Lock()
        self._poll = select.poll()  # unlike what `selectors` has it tells of a hang-up where nothing else is wanted
        self._poll.register(self._wake_read, select.POLLIN)
        self._numbers: dict[int, int] = {}  # of the clients, by their descriptors
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)
        try:
            begin(self._thread)
        except ControlError:
            self._remove()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def path(self) -> Path:
        """Where it listens."""
        return self._path

    def publish(self, event: dict[str, Any]) -> None:
        """Send an event to all who watch, from any thread; where they are too slow for it the oldest are dropped."""
        if self._watchers:
            self._events.append(event)
            self._wake()

    def close(self) -> None:
        """Send what is to be sent, for half a second at most, and remove the socket."""
        if self._ending.is_set():
            return
        self._ending.set()
        self._wake()
        self._thread.join(5.0)
        self._remove()

    def _remove(self) -> None:
        """The socket and its lock."""
        self._listener.close()
        with contextlib.suppress(OSError):
            found = self._path.lstat()
            if (found.st_dev, found.st_ino) == self._identity:
                self._path.unlink()
            control_socket.lock_path(self._path).unlink()
        os.close(self._lock)

    def _wake(self) -> None:
        with self._waking, contextlib.suppress(OSError):  # full: it will wake anyway; closed: nobody is there to wake
            self._wake_write.send(b"\0")

    # ---- the thread ----

    def _run(self) -> None:
        self._look()
        while not self._ending.is_set():
            try:
                self._round(self._patience())
            except Exception as e:  # a slip of ours shall not cost the operator the socket
                self._complain(f"control: internal error ({type(e).__name__}: {one_line(str(e))})")
                self._ending.wait(0.1)
        self._finish()

    def _round(self, patience: float | None) -> None:
        """Wait for something to happen, and do what follows from it."""
        self._poll.poll(None if patience is None else 1e3 * patience)
        self._look()  # all have a turn, not only who has requests waiting here
        ready = dict(self._poll.poll(0))
        for descriptor, events in ready.items():
            if events & _GONE and descriptor in self._numbers:
                self._drop(self._numbers[descriptor])
        for number, client in list(self._clients.items()):  # before new ones are let in: they shall not crowd it out
            self._guarded(number, self._serve, number, client)
        if self._wake_read.fileno() in ready:
            with contextlib.suppress(BlockingIOError):
                self._wake_read.recv(4096)
        for descriptor, events in ready.items():
            if (number := self._numbers.get(descriptor)) is not None and (client := self._clients.get(number)):
                self._guarded(number, client.transfer, events)
        if self._listener.fileno() in ready:
            self._accept()
        self._ask_status(time.monotonic())
        self._pass_on()
        now = time.monotonic()
        for number, client in list(self._clients.items()):
            self._guarded(number, client.tend, now)
        self._watchers = any(c.interval is not None for c in self._clients.values())
        self._look()

    def _guarded(self, number: int, action: Callable[..., None], *arguments: Any) -> None:
        """Do something for a client; what goes wrong with it costs nobody but the client."""
        try:
            action(*arguments)
        except OSError:
            self._drop(number)
        except Exception as e:
            self._complain(f"control: a client dropped: internal error ({type(e).__name__}: {one_line(str(e))})")
            self._drop(number)

    def _patience(self) -> float | None:
        """Seconds until something must be done though nothing happens; None for ever."""
        if self._replies or self._events:
            return 0.0
        now = time.monotonic()
        times = [c.next_turn(now) for c in self._clients.values()]
        if not self._listening:
            times.append(max(self._accept_again, now + self._connections.wait()))
        return max(0.0, min(times) - now) if times else None

    def _look(self) -> None:
        """What matters now: what is not to be read yet must not wake us; a hang-up always does."""
        self._listening = self._connections.free() and time.monotonic() >= self._accept_again
        if not self._ending.is_set():
            self._poll.register(self._listener, select.POLLIN if self._listening else 0)
        for client in self._clients.values():
            self._poll.register(client.socket, client.wanted())

    def _finish(self) -> None:
        """Send replies that are there or come within half a second, to those who read; then leave."""
        with contextlib.suppress(KeyError):  # it never listened
            self._poll.unregister(self._listener)
        self._listener.close()
        end = time.monotonic() + 0.5
        with contextlib.suppress(Exception):
            self._pass_on()
            while time.monotonic() < end and any(c.unsent or c.asked is not None for c in self._clients.values()):
                self._round(0.05)
        for number in list(self._clients):
            self._drop(number)
        self._wake_read.close()
        with self._waking:
            self._wake_write.close()

    # ---- connections ----

    def _accept(self) -> None:
        """Let one in; the next only when this one has had its look."""
        try:
            connection, _ = self._listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError as e:  # no descriptors left: theirs to close, not ours to spin
            self._complain(f"control: a client cannot be let in: {e.strerror}")
            self._accept_again = time.monotonic() + 1.0
            return
        self._connections.take(1.0)
        try:
            connection.setblocking(False)
            self._admit(connection)
        except OSError:
            connection.close()

    def _admit(self, connection: socket.socket) -> None:
        peer = control_socket.peer_of(connection)
        trusted = peer is None or peer.uid in (os.geteuid(), 0)  # without credentials the file's mode alone decides
        if not trusted and (self._group is None or peer is None or self._group not in peer.groups):
            uid, pid = (peer.uid, peer.pid) if peer else (-1, -1)
            self._complain(f"control: refused user {uid} (process {pid})")
            _last_word(connection, f"user {uid} may not control this daemon; its own user, root{self._others()} may")
            return
        most = self._settings.clients
        others = sum(not c.trusted for c in self._clients.values())
        full = len(self._clients) >= most
        if (full or (not trusted and others >= max(1, most // 2))) and not self._make_room(trusted):
            _last_word(connection, f"busy: all places for clients are taken ({most}); close one and try again")
            return
        self._count += 1
        self._clients[self._count] = Connection(connection, trusted, self._paces[trusted], self._limits)
        self._numbers[connection.fileno()] = self._count
        self._poll.register(connection, 0)

    def _others(self) -> str:
        return f" and the group {self._settings.group}" if self._settings.group else ""

    def _make_room(self, trusted: bool) -> bool:
        """Drop who has been silent longest, so that nobody keeps the operator out by doing nothing."""
        silent = [
            (client.heard, number)
            for number, client in self._clients.items()
            if client.silent and (trusted or not client.trusted)
        ]
        if not silent:
            return False
        self._drop(min(silent)[1])
        return True

    def _drop(self, number: int) -> None:
        client = self._clients.pop(number, None)
        if client is None:
            return
        del self._numbers[client.socket.fileno()]
        self._poll.unregister(client.socket)
        client.close()

    # ---- requests ----

    def _serve(self, number: int, client: Connection) -> None:
        """Handle one request of a client, if there is one and it is its turn."""
        if not client.has_request or not client.pace.free():
            return
        self._clients[number] = self._clients.pop(number)  # to the end: the others come first next time
        line = client.take_line()
        if not line.strip():
            return
        try:
            request = parse(line)
            self._check_rights(client, request)
        except BadRequestError as e:
            client.send(refused(str(e), e.id))
            return
        if isinstance(request, Watch):
            client.interval, client.due = request.interval, client.heard
            self._watchers = True  # before the client can know
            client.send(done({}, request.id))
            return
        client.asked, client.id = client.heard, request.id
        client.reply = self._hand_on(request, number, client.trusted)

    def _check_rights(self, client: Connection, request: Request) -> None:
        if client.trusted or not isinstance(request, Set):
            return
        for assignment in request.assignments:
            key = assignment.partition("=")[0].strip()
            if any(key == place or key.startswith(place + ".") for place in PLACES):
                raise BadRequestError(
                    f"set: {key[:60]} says what the daemon opens; only its own user and root may set it", request.id
                )

    def _hand_on(self, request: Request, number: int, trusted: bool = True) -> Reply:
        def send(message: dict[str, Any]) -> None:
            self._replies.append((number, reply, message))
            self._wake()

        reply = Reply(send, trusted=trusted)
        try:
            self._handle(request, reply)
        except SpheremouseError as e:
            reply(refused(str(e)))
        except Exception as e:
            what = f"internal error ({type(e).__name__}: {one_line(str(e))})"
            self._complain(f"control: {request.command}: {what}")
            reply(refused(f"{what}; please report it"))
        return reply

    def _ask_status(self, now: float) -> None:
        """Ask for the status once for all watchers whose time has come."""
        asked = False
        for client in self._clients.values():
            if client.interval is not None and client.status_asked is None and client.due <= now:
                client.status_asked, client.due = now, max(client.due + client.interval, now)
                asked = True
        if asked:
            self._hand_on(Request(command="status"), _WATCHERS)

    def _pass_on(self) -> None:
        """Replies and events to whom they belong."""
        for _ in range(len(self._replies)):
            number, reply, message = self._replies.popleft()
            if number == _WATCHERS:
                self._status_to_watchers(message)
                continue
            client = self._clients.get(number)
            if client is not None and client.asked is not None and client.reply is reply:
                self._guarded(number, client.answer, done(message, client.id))
        for _ in range(len(self._events)):
            self._to_watchers(self._events.popleft(), [n for n, c in self._clients.items() if c.interval is not None])

    def _status_to_watchers(self, message: dict[str, Any]) -> None:
        numbers = [n for n, c in self._clients.items() if c.status_asked is not None]
        for number in numbers:
            self._clients[number].status_asked = None
        body = {k: v for k, v in message.items() if k not in ("ok", "id")}
        failed = not message.get("ok", True)
        event = {"event": "log", "text": f"no status: {body.get('error')}"} if failed else {"event": "status", **body}
        self._to_watchers(event, numbers)

    def _to_watchers(self, event: dict[str, Any], numbers: list[int]) -> None:
        if not numbers:
            return
        try:
            line = encode(event)
        except ValueError as e:
            line = encode({"event": "log", "text": f"an event was left out: {e}"})
        for number in numbers:
            if (client := self._clients.get(number)) is not None:
                self._guarded(number, client.send_line, line)


def _last_word(connection: socket.socket, error: str) -> None:
    """One line to who may not stay; a fresh connection has room for it."""
    with contextlib.suppress(OSError):
        connection.send(encode(refused(error)))
    connection.close()
