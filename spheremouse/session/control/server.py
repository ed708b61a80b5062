"""The control socket's server: one thread with an asyncio loop.

A client has one request under way at a time. `Limits` bounds its requests, since the thread shares the interpreter with
the tracker.
"""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self

from spheremouse.errors import ControlError, SpheremouseError
from spheremouse.files.config import key_of
from spheremouse.output import Report
from spheremouse.output.lines import json_lines
from spheremouse.session.control import protocol, socket_file
from spheremouse.session.control.connection import Connection, Limits
from spheremouse.session.control.metrics import serve_metrics
from spheremouse.session.control.protocol import BadRequestError, Request, done, internal_error, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.control.socket_file import socket_path
from spheremouse.session.control.status import StatusReport
from spheremouse.session.process.threads import begin
from spheremouse.session.settings import Configuration, ControlSettings

Handle = Callable[[PendingRequest], None]

# Settings that a member of the group may not `set`: the files, devices and addresses that the daemon opens.
PLACES = ("source", "output", "rig", "camera_file", "map", "camera.controls", "control", "record", "metrics", "wand")

_DISCONNECTION_CHECK_S = 0.1  # s between two checks for a disconnected client
_MAX_LAST_REPLIES_S = 0.5  # s in which the last replies are sent at the end
_FEW_SUBSCRIBERS = 8  # sending to more takes so long that the tracker must not wait


class ControlServer:
    """Listens at `path` until `close`."""

    def __init__(
        self,
        path: Path,
        settings: ControlSettings,
        handle: Handle,
        log: Callable[[str], None] = lambda line: None,
        limits: Limits | None = None,
        claim: Callable[[], object] = lambda: None,
    ) -> None:
        """The server's thread calls `claim` first, to get its priority.

        It then calls `handle`, which must return at once and answers then or later.
        """
        self.path = path
        self._settings, self._handle, self._log = settings, handle, log
        self._limits, self._claim = limits or Limits(), claim
        self._next = 0.0  # s of the loop's clock, of the next request
        self._clients: dict[asyncio.Task[None], Connection] = {}
        self._subscribers: tuple[Connection, ...] = ()  # to samples; replaced as a whole, since the worker reads it
        self._stack = contextlib.ExitStack()
        self._listener = self._stack.enter_context(socket_file.listening(path, settings.group))
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

    def __exit__(self, *_: object) -> None:
        self.close()

    def publish(self, event: dict[str, Any]) -> None:
        """Send an event to the clients that watch, from any thread. A slow client loses its oldest events."""
        if self._clients:
            self._call(self._publish, event)

    def submit(self, report: Report) -> None:
        """Send the samples of a frame to the clients that subscribe, from any thread. It never waits for one.

        A slow client loses its oldest samples and gets their number with the next one.
        """
        subscribers = self._subscribers
        if not subscribers:
            return
        lines, few = json_lines(report), len(subscribers) <= _FEW_SUBSCRIBERS
        if [client for client in subscribers if not client.push_samples(lines, at_once=few)]:
            self._call(self._send_samples)

    def close(self) -> None:
        """Send the replies that come within half a second, and remove the socket."""
        self._call(self._ending.set)
        self._thread.join(5.0)
        self._stack.close()

    def _call(self, function: Callable[..., object], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *arguments)

    # ---- the thread ----

    def _run(self) -> None:
        self._claim()
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        """Serve clients until the end is requested, and wait shortly for replies under way."""
        self._loop.set_exception_handler(lambda _, context: self._log(f"control: {context['message']}"))
        server = await asyncio.start_unix_server(
            self._admit, sock=self._listener, limit=protocol.MAX_LINE, backlog=socket_file.BACKLOG
        )
        await self._ending.wait()
        server.close()
        busy = [task for task, client in self._clients.items() if client.busy]
        if busy:
            await asyncio.wait(busy, timeout=_MAX_LAST_REPLIES_S)

    def _publish(self, event: dict[str, Any]) -> None:
        for client in self._clients.values():
            if client.watching is not None:
                client.push(event)

    def _send_samples(self) -> None:
        """Have the tasks of the subscribers send the samples that wait."""
        for client in self._subscribers:
            client.has_events.set()

    # ---- one client ----

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client until it disconnects, stalls or breaks a rule."""
        task, client, most = asyncio.current_task(), Connection(reader, writer, self._limits), self._settings.clients
        assert task is not None
        self._clients[task] = client
        try:
            if not client.trusted and self._settings.group is None:
                self._log(f"control: refused user {client.uid} (process {client.pid})")
                raise BadRequestError(f"user {client.uid} may not control this daemon; its own user, root may")
            if sum(other.uid == client.uid for other in self._clients.values()) > most:
                problem = f"busy: user {client.uid} has {most} connections already"
                raise BadRequestError(f"{problem}; close one and try again")
            await self._converse(client)
        except BadRequestError as e:
            with contextlib.suppress(OSError):
                await client.send(refused(str(e)))
        except (OSError, asyncio.CancelledError):  # asyncio logs a task that ends cancelled
            pass
        except Exception as e:
            self._log(f"control: a client dropped: {internal_error(e)}")
        finally:
            del self._clients[task]
            self._subscribe(client, wanted=False)
            if client.watching is not None:
                client.watching.cancel()
            writer.close()

    async def _converse(self, client: Connection) -> None:
        while not self._ending.is_set():
            line = await client.line()
            if line is None:  # it only listens from here on
                while client.watching is not None and not client.has_gone:
                    await asyncio.sleep(_DISCONNECTION_CHECK_S)
                return
            if not line.strip():
                continue
            client.busy = True
            await self._pace()
            try:
                request = protocol.parse(line)
                _check_rights(client.trusted, request)
            except BadRequestError as e:
                await client.send(refused(str(e), e.id))
            else:
                if isinstance(request, protocol.Watch):
                    await client.send(done({}, request.id))
                    self._watch(client, request)
                else:
                    await client.send(await self._ask(client, request))
            client.busy = False

    async def _pace(self) -> None:
        due = max(self._next, self._loop.time())
        self._next = due + self._limits.interval
        await asyncio.sleep(due - self._loop.time())

    async def _ask(self, client: Connection, request: Request) -> dict[str, Any]:
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
                await asyncio.wait([reply], timeout=min(_DISCONNECTION_CHECK_S, self._limits.answer))
            return done(reply.result(), request.id)
        finally:
            pending.cancelled = not reply.done()

    def _watch(self, client: Connection, request: protocol.Watch) -> None:
        """Begin to send events to a client, or change their kinds and the interval of its statuses."""
        if client.watching is not None:
            client.watching.cancel()
        self._subscribe(client, wanted=request.samples)
        client.watching = self._loop.create_task(self._send_events(client, request.interval))

    def _subscribe(self, client: Connection, *, wanted: bool) -> None:
        client.subscribe(wanted=wanted)
        self._subscribers = tuple(other for other in self._clients.values() if other.subscribed)

    async def _send_events(self, client: Connection, interval: float) -> None:
        due = self._loop.time()
        with contextlib.suppress(OSError):
            while True:
                if self._loop.time() >= due:
                    due = max(due + interval, self._loop.time())
                    await client.send(await self._status_event(client))
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout_at(due):
                        await client.has_events.wait()
                await client.send_next()
        client.drop()

    async def _status_event(self, client: Connection) -> dict[str, Any]:
        await self._pace()
        status = await self._ask(client, Request(command="status"))
        if not status["ok"]:
            return {"event": "log", "text": f"no status: {status['error']}"}
        return {"event": "status", **{k: v for k, v in status.items() if k != "ok"}}


def _check_rights(trusted: bool, request: Request) -> None:
    if isinstance(request, protocol.Save) and not trusted:
        raise BadRequestError("save: only the daemon's own user and root may", request.id)
    keys = [] if trusted or not isinstance(request, protocol.Set) else map(key_of, request.assignments)
    for key in keys:
        if any(key == place or key.startswith(place + ".") for place in PLACES):
            rule = "names a file or device that the daemon opens; only its own user and root may set it"
            raise BadRequestError(f"set: {key[:60]} {rule}", request.id)


def _resolve(reply: asyncio.Future[dict[str, Any]], message: dict[str, Any]) -> None:
    """Set a reply; a second one is ignored."""
    if not reply.done():
        reply.set_result(message)


def open_endpoints(
    stack: contextlib.ExitStack,
    configuration: Configuration,
    handle: Handle,
    status: Callable[[], StatusReport],
    log: Callable[[str], None],
    claim: Callable[[], object],
) -> ControlServer | None:
    """Open the control socket and the metrics until the stack closes; `handle` and `claim` are the server's.

    Return the server; None if the usual socket cannot be opened, which is logged like a failure of the metrics. Raises
    ControlError if a configured socket cannot be opened.
    """
    control, metrics, server = configuration.control, configuration.metrics, None
    try:
        server = stack.enter_context(ControlServer(socket_path(control.socket), control, handle, log, claim=claim))
    except ControlError as e:
        if control.socket is not None:
            raise
        log(f"control: {e}: `spheremouse ctl` cannot ask this run")
    if metrics.port is not None:
        try:
            log(f"metrics: {stack.enter_context(serve_metrics(metrics.port, metrics.address, status))}")
        except SpheremouseError as e:
            log(f"{e}; going on without")
    return server
