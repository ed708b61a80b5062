"""One client's connection to the control socket: what it has sent, what waits for it, and for how long either may.

Nothing here waits: the server says when the socket can be read or written (`transfer`) and that time passes (`tend`).
OSError from any of it means that the client is to be dropped.
"""

import select
import socket
import time
from dataclasses import dataclass, field
from typing import Any

from spheremouse.session.control.limits import Limits, Pace
from spheremouse.session.control.line import MAX_LINE, encode
from spheremouse.session.control.protocol import Id, refused
from spheremouse.session.control.reply import Reply


@dataclass(slots=True, eq=False)
class Connection:
    """A client's socket and what is under way on it. Times are s of the monotonic clock."""

    socket: socket.socket
    trusted: bool  # the daemon's own user, or root
    pace: Pace  # of all its like: the owner does not stand behind members
    limits: Limits
    heard: float = field(
        default_factory=time.monotonic
    )  # when it was last no fault of the client that nothing happened
    received: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    sent: float = 0.0  # when something of `unsent` last went, or began to wait
    asked: float | None = None  # when the request under way was handed on
    reply: Reply | None = None  # to it
    paced: bool = False  # what it sends is not read yet: its like have had their share
    id: Id | None = None
    interval: float | None = None  # of a watcher
    due: float = 0.0  # its next status
    status_asked: float | None = None
    ended: bool = False  # it sends nothing any more
    closing: bool = False  # it goes as soon as it has read what waits

    def close(self) -> None:
        """It has gone, or has to; what it asked is not wanted any more."""
        if self.reply is not None:
            self.reply.gone = True
        self.socket.close()

    # ---- bytes ----

    def wanted(self) -> int:
        """Events of the socket that matter now."""
        reading = not (self.ended or self.closing) and len(self.received) < MAX_LINE
        self.paced = reading and not self.pace.free()
        return (select.POLLIN if reading and not self.paced else 0) | (select.POLLOUT if self.unsent else 0)

    def transfer(self, events: int) -> None:
        """Send and receive what can be by the socket's `events`."""
        if events & select.POLLOUT:
            self._flush()
        if events & select.POLLIN and not self.closing:
            self.pace.take(self.limits.reading)
            try:
                data = self.socket.recv(MAX_LINE)
            except (BlockingIOError, InterruptedError):
                return
            self.received += data
            if not data:
                self.ended = True
                self.socket.send(b"")  # an error where it has gone, and does not only say nothing more

    def send(self, message: dict[str, Any]) -> None:
        """Send a reply, or that it is too long."""
        try:
            line = encode(message)
        except ValueError as e:
            line = encode(refused(f"the answer is {e}, and {MAX_LINE} is the most", message.get("id")))
        self.send_line(line)

    def send_line(self, line: bytes) -> None:
        """Send what can be sent at once; the rest waits."""
        if len(self.unsent) + len(line) > self.limits.unsent:
            raise TimeoutError  # it does not read: dropped
        if not self.unsent:
            self.sent = time.monotonic()
        self.unsent += line
        self._flush()

    def _flush(self) -> None:
        try:
            n = self.socket.send(self.unsent)
        except (BlockingIOError, InterruptedError):
            return
        if n:
            del self.unsent[:n]
            self.sent = self.heard = time.monotonic()

    # ---- requests ----

    @property
    def has_request(self) -> bool:
        """Has it sent a whole request, or too long a one, and nothing else under way?"""
        ready = self.asked is None and not self.unsent and not self.closing
        return ready and (len(self.received) >= MAX_LINE or b"\n" in self.received)

    @property
    def silent(self) -> bool:
        """Does nothing go on for which it would be kept?"""
        return self.asked is None and self.interval is None and not self.has_request

    def take_line(self) -> bytes:
        """The line of the request that is there; empty, with an answer, where it is too long."""
        end = self.received.find(b"\n", 0, MAX_LINE)
        if end < 0:
            self.closing = True
            self.send(refused(f"a line of more than {MAX_LINE} bytes; send one JSON object a line"))
            self.received.clear()
            return b""
        line = bytes(self.received[:end])
        del self.received[: end + 1]
        self.heard = time.monotonic()
        self.pace.take(1.0 + self.limits.kilobyte * len(line) / 1024.0)
        return line

    def answer(self, message: dict[str, Any]) -> None:
        """Send the reply to the request under way, which is done with that."""
        self.asked, self.reply, self.heard = None, None, time.monotonic()
        self.send(message)

    # ---- time ----

    def next_turn(self, now: float) -> float:
        """When something must be done for it though nothing happens."""
        times = [self._deadline()]
        if self.interval is not None and self.status_asked is None:
            times.append(self.due)
        if self.has_request or self.paced:
            times.append(now + self.pace.wait())
        return min(times)

    def tend(self, now: float) -> None:
        """What the passing of time means to it."""
        if now >= self._deadline():
            if self.unsent or (self.asked is None and self.interval is None):
                raise TimeoutError
            if self.asked is not None:
                if self.reply is not None:
                    self.reply.gone = True  # who was told that nothing came does not want it later
                self.answer(refused(f"no answer within {self.limits.answer:g} s", self.id))
            self.status_asked = None
        if (self.closing or (self.ended and self.silent)) and not self.unsent:
            raise ConnectionResetError

    def _deadline(self) -> float:
        """When we have waited for it, or for the daemon on its behalf, long enough."""
        if self.unsent:
            return self.sent + self.limits.stalled
        if self.asked is not None:
            return self.asked + self.limits.answer
        if self.interval is not None:
            return self.status_asked + self.limits.answer if self.status_asked is not None else float("inf")
        return self.heard + self.limits.idle
