"""The control socket's server: one thread with an asyncio loop.

A client has one request under way at a time. `Limits` bounds its requests, since the thread shares the interpreter with
the tracker.
"""

import asyncio
import contextlib
import os
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

from spheremouse.errors import ControlError, SpheremouseError, one_line
from spheremouse.files.config import key_of
from spheremouse.output import Report
from spheremouse.output.lines import json_lines
from spheremouse.session.control import socket_file
from spheremouse.session.control.metrics import serve_metrics
from spheremouse.session.control.pictures import PictureRing
from spheremouse.session.control.protocol import (
    MAX_LINE,
    BadRequestError,
    Request,
    Save,
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
from spheremouse.session.settings import Configuration, ControlSettings

Handle = Callable[[PendingRequest], None]

# Settings that a member of the group may not `set`: the files, devices and addresses that the daemon opens.
PLACES = ("source", "output", "rig", "camera_file", "map", "camera.controls", "control", "record", "metrics", "wand")

_DISCONNECTION_CHECK_S = 0.1  # s between two checks for a disconnected client
_MAX_LAST_REPLIES_S = 0.5  # s in which the last replies are sent at the end
_FEW_SUBSCRIBERS = 8  # sending to more takes so long that the tracker must not wait


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds on clients."""

    interval: float = 0.005  # s from one request to the next, of all clients together: each takes the interpreter
    idle: float = 30.0  # s in which a client must send a request, unless it watches
    answer: float = 60.0  # s in which the daemon must answer
    stalled: float = 5.0  # s in which a client must read a line, unless it gets samples
    events: int = 1000  # that wait for a client that watches
    samples: int = 240  # that wait for a client that gets them, 2 s of two balls at 60 Hz


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
        self._clients: dict[asyncio.Task[None], _Client] = {}
        self._subscribers: tuple[_Client, ...] = ()  # to samples; replaced as a whole, since the worker reads it
        self._stack = contextlib.ExitStack()
        self._listener = self._stack.enter_context(socket_file.listening(path, settings.group))
        self._loop = asyncio.new_event_loop()
        self._waking, self._wake = socket.socketpair()  # a third less processor time than `call_soon_threadsafe`
        for end in (self._waking, self._wake):
            end.setblocking(False)  # noqa: FBT003  the parameter has no name
            self._stack.callback(end.close)
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
            with contextlib.suppress(OSError):  # full, so the thread wakes anyway, or closed
                self._wake.send(b"\0")

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
        self._loop.add_reader(self._waking, self._send_samples)
        server = await asyncio.start_unix_server(
            self._admit, sock=self._listener, limit=MAX_LINE, backlog=socket_file.BACKLOG
        )
        await self._ending.wait()
        server.close()
        busy = [task for task, client in self._clients.items() if client.busy]
        if busy:
            await asyncio.wait(busy, timeout=_MAX_LAST_REPLIES_S)

    def _publish(self, event: dict[str, Any]) -> None:
        """Send an event to all clients that watch."""
        for client in self._clients.values():
            if client.watching is not None:
                client.push(event)

    def _send_samples(self) -> None:
        """Have the tasks of the subscribers send the samples that wait."""
        self._waking.recv(4096)
        for client in self._subscribers:
            client.has_events.set()

    # ---- one client ----

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client until it disconnects, stalls or breaks a rule."""
        task, client, most = asyncio.current_task(), _Client(reader, writer, self._limits), self._settings.clients
        assert task is not None
        self._clients[task] = client
        try:
            if not client.trusted and self._settings.group is None:
                self._log(f"control: refused user {client.uid} (process {client.pid})")
                error = f"user {client.uid} may not control this daemon; its own user, root may"
                await client.send(refused(error))
            elif sum(other.uid == client.uid for other in self._clients.values()) > most:
                error = f"busy: user {client.uid} has {most} connections already; close one and try again"
                await client.send(refused(error))
            else:
                await self._converse(client)
        except BadRequestError as e:
            with contextlib.suppress(OSError):
                await client.send(refused(str(e)))
        except (OSError, asyncio.CancelledError):  # asyncio logs a task that ends cancelled
            pass
        except Exception as e:
            self._log(f"control: a client dropped: internal error ({type(e).__name__}: {one_line(str(e))})")
        finally:
            del self._clients[task]
            self._subscribe(client, wanted=False)
            if client.watching is not None:
                client.watching.cancel()
            writer.close()

    async def _converse(self, client: "_Client") -> None:
        """Read requests and answer them, one by one."""
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
                request = parse(line)
                _check_rights(client.trusted, request)
            except BadRequestError as e:
                await client.send(refused(str(e), e.id))
            else:
                if isinstance(request, Watch):
                    await client.send(done({}, request.id))
                    self._watch(client, request)
                else:
                    await client.send(await self._ask(client, request))
            client.busy = False

    async def _pace(self) -> None:
        """Wait until the next request may begin."""
        due = max(self._next, self._loop.time())
        self._next = due + self._limits.interval
        await asyncio.sleep(due - self._loop.time())

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
                await asyncio.wait([reply], timeout=min(_DISCONNECTION_CHECK_S, self._limits.answer))
            return done(reply.result(), request.id)
        finally:
            pending.cancelled = not reply.done()

    def _watch(self, client: "_Client", request: Watch) -> None:
        """Begin to send events to a client, or change their kinds and the interval of its statuses."""
        if client.watching is not None:
            client.watching.cancel()
        self._subscribe(client, wanted=request.samples)
        client.watching = self._loop.create_task(self._send_events(client, request.interval))

    def _subscribe(self, client: "_Client", *, wanted: bool) -> None:
        client.subscribe(wanted=wanted)
        self._subscribers = tuple(other for other in self._clients.values() if other.subscribed)

    async def _send_events(self, client: "_Client", interval: float) -> None:
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

    async def _status_event(self, client: "_Client") -> dict[str, Any]:
        await self._pace()
        status = await self._ask(client, Request(command="status"))
        if not status["ok"]:
            return {"event": "log", "text": f"no status: {status['error']}"}
        return {"event": "status", **{k: v for k, v in status.items() if k != "ok"}}


class _Client:
    """A connection: lines in, messages out, and events that wait."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, limits: Limits) -> None:
        self._reader, self._writer, self._limits = reader, writer, limits
        self._socket = writer.get_extra_info("socket")
        peer, own = socket_file.peer_of(self._socket), os.geteuid()
        self.pid, self.uid = (-1, own) if peer is None else (peer.pid, peer.uid)  # without: the file's mode decides
        self.trusted = self.uid in (own, 0)
        self.busy = False  # a request is under way
        self.watching: asyncio.Task[None] | None = None
        self._lock = threading.Lock()  # of the lines and samples below, and of what is written
        self._direct: socket.socket | None = None  # to send samples from other threads; None: not subscribed
        self._idle = True  # the system has all that was written
        self._rest = b""  # of a line that the system took in part
        self.has_events = asyncio.Event()  # events or samples wait
        self._events: deque[dict[str, Any]] = deque(maxlen=limits.events)
        self._samples: deque[bytes] = deque(maxlen=limits.samples)  # JSON objects
        self._dropped = 0  # samples
        self._ring: PictureRing | None = None  # whose memory the client has
        writer.transport.set_write_buffer_limits(0)  # `drain` then waits until the system has all of it

    @property
    def subscribed(self) -> bool:
        """True if the client gets samples."""
        return self._direct is not None

    def subscribe(self, *, wanted: bool) -> None:
        """Start or stop sending samples."""
        with self._lock:
            if wanted == self.subscribed:
                return
            if self._direct is not None:
                self._direct.close()
            self._direct = self._socket.dup() if wanted else None

    @property
    def has_gone(self) -> bool:
        """True if the client has closed the connection, not only its writing side."""
        if self._socket.fileno() < 0:
            return True
        poll = select.poll()
        poll.register(self._socket, 0)
        return bool(poll.poll(0))

    async def line(self) -> bytes | None:
        """Return the next line; None if the client sends no more. TimeoutError if it is too slow."""
        try:
            async with asyncio.timeout(self._limits.idle if self.watching is None else None):
                return await self._reader.readuntil()
        except asyncio.IncompleteReadError:
            return None
        except asyncio.LimitOverrunError:
            raise BadRequestError(f"a line of more than {MAX_LINE} bytes; send one JSON object a line") from None

    async def send(self, message: dict[str, Any]) -> None:
        """Send a message. If the client does not read it, drop the client and raise TimeoutError.

        The first message with a `ring` carries its memory.
        """
        ring, memory = message.pop("ring", None), None
        if isinstance(ring, PictureRing) and ring is not self._ring:
            try:
                memory, self._ring, message = ring.duplicate(), ring, message | {"fresh": True}
            except ControlError as e:
                message = refused(str(e), message.get("id"))
        try:
            line = encode(message)
        except ValueError as e:
            text = f"{e}; {MAX_LINE} is the most"
            line = encode({"event": "log", "text": text} if "event" in message else refused(text, message.get("id")))
        if memory is not None:
            line = line[await self._send_memory(line, memory) :]
        await self._write(line)

    async def send_next(self) -> None:
        """Send an event or else a sample, if one waits."""
        if self._events:
            await self.send(self._events.popleft())
        elif self._rest or self._samples:
            with self._lock:
                line = self._sample_line(self._samples.popleft()) if self._samples else b""
            await self._write(line)
        else:
            self.has_events.clear()

    async def _send_memory(self, line: bytes, memory: int) -> int:
        """Send a descriptor with a line (SCM_RIGHTS), which streams of asyncio cannot. Return the bytes sent."""
        try:
            while not self._take_turn():  # another line is under way
                await self._write(b"")
            with self._socket.dup() as connection:
                return socket.send_fds(connection, [line], [memory])
        except BlockingIOError:  # the client does not read
            self.drop()
            raise
        finally:
            os.close(memory)

    def _take_turn(self) -> bool:
        """Return True if the system has all lines; then no other thread sends until `_write` has ended."""
        with self._lock:
            idle, self._idle = self._idle and not self._rest, False
        return idle

    async def _write(self, line: bytes) -> None:
        with self._lock:
            line, self._rest, self._idle = self._rest + line, b"", False
            self._writer.write(line)
        try:
            async with asyncio.timeout(None if self.subscribed else self._limits.stalled):
                await self._writer.drain()
        except TimeoutError:
            self.drop()
            raise
        with self._lock:
            self._idle = not self._writer.transport.get_write_buffer_size()

    def push(self, event: dict[str, Any]) -> None:
        """Add an event; if too many wait, the oldest is dropped."""
        self._events.append(event)
        self.has_events.set()

    def push_samples(self, samples: list[bytes], *, at_once: bool) -> bool:
        """Send samples, as JSON objects, from any thread. Return False if the client's task must send them.

        They wait unless they are to be sent `at_once` and the client has read all before. If too many wait, the oldest
        are dropped and counted.
        """
        with self._lock:
            if at_once and self._direct is not None and self._idle and not (self._rest or self._samples):
                data, sent = b"".join(map(self._sample_line, samples)), 0
                with contextlib.suppress(OSError):  # full, or disconnected, which the client's task notices
                    sent = self._direct.send(data)
                self._rest = data[sent:] if sent else b""
                if sent:
                    return not self._rest
            self._dropped += max(0, len(self._samples) + len(samples) - self._limits.samples)
            self._samples.extend(samples)
            return False

    def _sample_line(self, sample: bytes) -> bytes:
        return b'{"event":"sample","dropped":%d,"sample":%b}\n' % (self._dropped, sample.rstrip(b"\n"))

    def drop(self) -> None:
        """Disconnect at once."""
        self.subscribe(wanted=False)
        self._writer.transport.abort()


def _check_rights(trusted: bool, request: Request) -> None:
    if isinstance(request, Save) and not trusted:
        raise BadRequestError("save: only the daemon's own user and root may", request.id)
    if trusted or not isinstance(request, Set):
        return
    for assignment in request.assignments:
        key = key_of(assignment)
        if any(key == place or key.startswith(place + ".") for place in PLACES):
            raise BadRequestError(
                f"set: {key[:60]} names a file or device that the daemon opens; only its own user and root may set it",
                request.id,
            )


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
