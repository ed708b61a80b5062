"""The control socket's server: one thread with an asyncio loop. Its clients cannot slow the tracker.

A client has one request under way at a time. `Limits` bounds the work of this thread for all clients together, because
it shares the interpreter with the tracker. `asyncio.start_unix_server` reads and accepts as fast as clients
send, so the loop's socket functions are used directly.
"""

import asyncio
import contextlib
import os
import select
import socket
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ControlError, SpheremouseError, one_line
from spheremouse.session.control import socket_file
from spheremouse.session.control.metrics import MetricsServer
from spheremouse.session.control.protocol import (
    MAX_LINE,
    BadRequestError,
    Request,
    Set,
    Watch,
    done,
    encode,
    internal_error,
    parse,
    refused,
)
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.control.socket_file import socket_path
from spheremouse.session.control.status import StatusReport
from spheremouse.session.process.threads import begin
from spheremouse.session.settings import ControlSettings, MetricsSettings

Handle = Callable[[PendingRequest], None]

# Settings that a member of the group may not `set`: the files, devices and addresses that the daemon opens.
PLACES = ("source", "output", "rig", "camera_file", "map", "camera.controls", "control", "record", "metrics", "wand")

_CHUNK = 4096  # bytes read at a time; each read counts as an action
_POLL = 0.1  # s between two checks for a disconnected client
_GOODBYE = 0.5  # s in which the last replies are sent at the end


@dataclass(frozen=True, slots=True)
class Limits:
    """The most that clients may cost."""

    rate: float = 100.0  # actions per s of all clients: connections, reads, requests, status events
    burst: float = 50.0  # of them at once
    idle: float = 30.0  # s in which a client must send a request, unless it watches
    answer: float = 60.0  # s in which the daemon must answer
    stalled: float = 5.0  # s in which a client must read a line
    events: int = 1000  # that wait for a client that watches


class ControlServer:
    """Listens at `path` until `close`."""

    def __init__(
        self,
        path: Path,
        settings: ControlSettings,
        handle: Handle,
        log: Callable[[str], None] = lambda line: None,
        limits: Limits | None = None,
    ) -> None:
        """`handle` is called in the server's thread and must return at once; it answers then or later."""
        if not hasattr(socket, "AF_UNIX"):
            raise ControlError("this system has no Unix sockets, so the daemon cannot be controlled here")
        self.path = path
        self._settings, self._handle, self._log = settings, handle, log
        self._limits = limits or Limits()
        self._paid = 0.0  # s of the loop's clock, until when past actions fill the rate
        self._users: Counter[int] = Counter()  # connections by uid
        self._clients: dict[asyncio.Task[None], _Client] = {}
        self._watchers = 0
        self._stack = contextlib.ExitStack()
        self._listener = self._stack.enter_context(socket_file.listening(path, settings.group))
        self._listener.setblocking(False)
        self._loop = asyncio.new_event_loop()
        self._ending = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)
        try:
            begin(self._thread)
        except ControlError:
            self._loop.close()
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def publish(self, event: dict[str, Any]) -> None:
        """Send an event to the clients that watch, from any thread. A slow client loses its oldest events."""
        if self._watchers:
            self._call(self._publish, event)

    def close(self) -> None:
        """Send the replies that come within half a second, and remove the socket."""
        self._call(self._ending.set)
        self._thread.join(5.0)
        self._stack.close()

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *arguments)

    # ---- the thread ----

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        accepting = self._loop.create_task(self._accept())
        await self._ending.wait()
        accepting.cancel()
        busy = [task for task, client in self._clients.items() if client.busy]
        if busy:
            await asyncio.wait(busy, timeout=_GOODBYE)

    async def _accept(self) -> None:
        while True:
            await self._pace()
            try:
                connection, _ = await self._loop.sock_accept(self._listener)
            except OSError as e:  # no file descriptor is left
                self._log(f"control: no client can be accepted: {e.strerror}")
                await asyncio.sleep(1.0)
                continue
            client = _Client(connection, self._limits, self._pace)
            task = self._loop.create_task(self._admit(client))
            self._clients[task] = client
            task.add_done_callback(self._clients.pop)

    async def _pace(self) -> None:
        """Wait until the rate of actions allows another one."""
        now, interval = self._loop.time(), 1.0 / self._limits.rate
        self._paid = max(self._paid, now - self._limits.burst * interval) + interval
        if self._paid > now:
            await asyncio.sleep(self._paid - now)

    def _publish(self, event: dict[str, Any]) -> None:
        for client in self._clients.values():
            if client.watching is not None:
                client.push(event)

    # ---- one client ----

    async def _admit(self, client: "_Client") -> None:
        """Serve a client until it disconnects, stalls or breaks a rule."""
        uid, most = client.uid, self._settings.clients
        self._users[uid] += 1
        with client.connection, contextlib.suppress(OSError):
            try:
                if not client.trusted and self._settings.group is None:
                    self._log(f"control: refused user {uid} (process {client.pid})")
                    await client.send(refused(f"user {uid} may not control this daemon; its own user, root may"))
                elif self._users[uid] > most:
                    await client.send(
                        refused(f"busy: user {uid} has {most} connections already; close one and try again")
                    )
                else:
                    await self._converse(client)
            except BadRequestError as e:
                await client.send(refused(str(e)))
            except OSError:
                raise
            except Exception as e:
                self._log(f"control: a client dropped: internal error ({type(e).__name__}: {one_line(str(e))})")
            finally:
                self._users[uid] -= 1
                if client.watching is not None:
                    self._watchers -= 1
                    client.watching.cancel()

    async def _converse(self, client: "_Client") -> None:
        """Read requests and answer them, one by one."""
        while not self._ending.is_set():
            line = await client.line()
            if line is None:  # it only listens from here on
                while client.watching is not None and not client.has_gone and not client.watching.done():
                    await asyncio.sleep(_POLL)
                return
            if not line.strip():
                continue
            client.busy = True
            await self._pace()
            try:
                request = parse(line)
                _check_rights(client.trusted, request)
            except BadRequestError as e:
                reply = refused(str(e), e.id)
            else:
                if isinstance(request, Watch):
                    await client.send(done({}, request.id))
                    self._watch(client, request.interval)
                    client.busy = False
                    continue
                reply = await self._ask(client, request)
            await client.send(reply)
            client.busy = False

    async def _ask(self, client: "_Client", request: Request) -> dict[str, Any]:
        """Return the daemon's reply. If the client disconnects meanwhile, its request is cancelled."""
        reply: asyncio.Future[dict[str, Any]] = self._loop.create_future()
        pending = PendingRequest(request, partial(self._call, _resolve, reply))
        try:
            try:
                pending.attempt(partial(self._handle, pending))
            except Exception as e:
                self._log(f"control: {request.command}: {internal_error(e)}")
            deadline = self._loop.time() + self._limits.answer
            while not reply.done():
                if client.has_gone:
                    raise ConnectionResetError
                if self._loop.time() > deadline:
                    return refused(f"no answer within {self._limits.answer:g} s", request.id)
                await asyncio.wait([reply], timeout=min(_POLL, self._limits.answer))
            return done(reply.result(), request.id)
        finally:
            pending.cancelled = not reply.done()

    def _watch(self, client: "_Client", interval: float) -> None:
        client.interval, client.due = interval, self._loop.time()
        if client.watching is None:
            self._watchers += 1
            client.watching = self._loop.create_task(self._send_events(client))
        else:
            client.push(None)  # wakes it

    async def _send_events(self, client: "_Client") -> None:
        with contextlib.suppress(OSError):
            while True:
                event = None
                try:
                    async with asyncio.timeout_at(client.due):
                        event = await client.events.get()
                except TimeoutError:
                    client.due = max(client.due + client.interval, self._loop.time())
                    await self._pace()
                    status = await self._ask(client, Request(command="status"))
                    body = {k: v for k, v in status.items() if k != "ok"}
                    event = {"event": "status", **body}
                    if not status["ok"]:
                        event = {"event": "log", "text": f"no status: {body['error']}"}
                if event is not None:
                    await client.send(event)
        with contextlib.suppress(OSError):
            client.connection.shutdown(socket.SHUT_RDWR)  # it stalls: dropped


class _Client:
    """A connection: lines in, messages out, and events that wait."""

    def __init__(self, connection: socket.socket, limits: Limits, pace: Callable[[], Awaitable[None]]) -> None:
        peer = socket_file.peer_of(connection)
        own = os.geteuid()
        self.pid, self.uid = (-1, own) if peer is None else (peer.pid, peer.uid)  # without: the file's mode decides
        self.trusted = self.uid in (own, 0)
        self.connection = connection
        self.busy = False  # a request is under way
        self.interval = self.due = 0.0  # s; of its status events
        self.watching: asyncio.Task[None] | None = None
        self.events: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue(limits.events)
        self._limits, self._pace = limits, pace
        self._received = bytearray()
        self._sending = asyncio.Lock()

    @property
    def has_gone(self) -> bool:
        """True if the client has closed the connection, not only its writing side."""
        poll = select.poll()
        poll.register(self.connection, 0)
        return bool(poll.poll(0))

    async def line(self) -> bytes | None:
        """Return the next line; None if the client sends no more. TimeoutError if it is too slow."""
        async with asyncio.timeout(self._limits.idle if self.watching is None else None):
            while (end := self._received.find(b"\n")) < 0 and len(self._received) < MAX_LINE:
                await self._pace()
                data = await asyncio.get_running_loop().sock_recv(self.connection, _CHUNK)
                if not data:
                    return None
                self._received += data
        if not 0 <= end < MAX_LINE:
            raise BadRequestError(f"a line of more than {MAX_LINE} bytes; send one JSON object a line")
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        return line

    async def send(self, message: dict[str, Any]) -> None:
        """Send a message. TimeoutError if the client does not read it."""
        try:
            line = encode(message)
        except ValueError as e:
            text = f"{e}; {MAX_LINE} is the most"
            line = encode({"event": "log", "text": text} if "event" in message else refused(text, message.get("id")))
        async with self._sending, asyncio.timeout(self._limits.stalled):
            await asyncio.get_running_loop().sock_sendall(self.connection, line)

    def push(self, event: dict[str, Any] | None) -> None:
        """Add an event; if too many wait, the oldest is dropped."""
        if self.events.full():
            self.events.get_nowait()
        self.events.put_nowait(event)


def _check_rights(trusted: bool, request: Request) -> None:
    if trusted or not isinstance(request, Set):
        return
    for assignment in request.assignments:
        key = assignment.partition("=")[0].strip()
        if any(key == place or key.startswith(place + ".") for place in PLACES):
            raise BadRequestError(
                f"set: {key[:60]} names a file or device that the daemon opens; only its own user and root may set it",
                request.id,
            )


def _resolve(reply: asyncio.Future[dict[str, Any]], message: dict[str, Any]) -> None:
    """Set a reply; a second one is ignored."""
    if not reply.done():
        reply.set_result(message)


_RETRY_INTERVAL = 30.0  # s between two attempts to open the control socket


class Endpoints:
    """Open from `open` until `close`."""

    def __init__(self, handle: Handle, log: Callable[[str], None]) -> None:
        """`handle` is the control server's."""
        self._handle, self._log = handle, log
        self._stack = contextlib.ExitStack()
        self._server: ControlServer | None = None
        self._retry_at = 0.0  # s

    def open(self, control: ControlSettings, metrics: MetricsSettings, status: Callable[[], StatusReport]) -> None:
        """Open both. ControlError if a configured socket cannot be opened; other failures are logged."""
        try:
            self._listen(control)
        except ControlError as e:
            if control.socket is not None:
                raise
            self._log(f"control: {e}: `spheremouse ctl` cannot ask this run until that is over")
            self._retry_at = time.monotonic() + _RETRY_INTERVAL
        if metrics.port is not None:
            try:
                server = self._stack.enter_context(MetricsServer(metrics.port, metrics.address, status, self._log))
                self._log(f"metrics: {server.url}")
            except SpheremouseError as e:
                self._log(f"{e}; going on without")

    def retry(self, control: ControlSettings, now: float) -> None:
        """Try again to open the control socket: the daemon that held it may have ended."""
        if self._server is None and now >= self._retry_at:
            self._retry_at = now + _RETRY_INTERVAL
            with contextlib.suppress(ControlError):
                self._listen(control)
                self._log("control: `spheremouse ctl` can ask this run now")

    def publish(self, text: str) -> None:
        """Send a line of the log to the clients that watch, from any thread."""
        if self._server is not None:
            self._server.publish({"event": "log", "text": text})

    def close(self) -> None:
        """Close both."""
        self._stack.close()

    def _listen(self, control: ControlSettings) -> None:
        server = ControlServer(socket_path(control.socket), control, self._handle, self._log)
        self._server = self._stack.enter_context(server)
