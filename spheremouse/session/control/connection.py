"""One connection to the control socket: lines in, messages out, and events and samples that wait."""

import asyncio
import contextlib
import os
import select
import socket
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

from spheremouse.session.control import socket_file
from spheremouse.session.control.protocol import MAX_LINE, BadRequestError, encode, refused


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds on clients."""

    interval: float = 0.005  # s from one request to the next, of all clients together: each takes the interpreter
    idle: float = 30.0  # s in which a client must send a request, unless it watches
    answer: float = 60.0  # s in which the daemon must answer
    stalled: float = 5.0  # s in which a client must read a line, unless it gets samples
    events: int = 1000  # that wait for a client that watches
    samples: int = 240  # that wait for a client that gets them, 2 s of two balls at 60 Hz


class Connection:
    """A client's connection. The server's thread calls all but `push_samples`."""

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
        """Send a message, and the `pixels` of a picture after its line.

        If the client does not read them, drop the client and raise TimeoutError.
        """
        pixels: bytes = message.pop("pixels", b"")
        try:
            line = encode(message)
        except ValueError as e:
            text, pixels = f"{e}; {MAX_LINE} is the most", b""
            line = encode({"event": "log", "text": text} if "event" in message else refused(text, message.get("id")))
        await self._write(line + pixels)

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
