"""Requests and calls that wait for the worker's thread. Of each kind of request, one is under way at a time."""

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from spheremouse.errors import SpheremouseError, internal_error_text
from spheremouse.session.control.protocol import Record, Request, internal_error, refused

MAX_WAITING = 8  # requests

_STOP = "record --stop"
_BUSY_MESSAGES = {
    "snapshot": "a snapshot is being written already",
    "record": "a recording is already starting",
    _STOP: "the recording is already ending",
    "reinit": "the camera's pose is being estimated already",
}


class PendingRequest:
    """A request that has no reply yet."""

    def __init__(
        self, request: Request, send: Callable[[dict[str, Any]], None] = lambda _: None, *, quiet: bool = False
    ) -> None:
        """`send` passes the reply on, from any thread.

        `quiet`: nothing is logged if nothing changes, and the request does not wait for another of its kind.
        """
        self.request, self.quiet = request, quiet
        self.cancelled = False  # its client has disconnected
        self._send = send
        self._finish: Callable[[], None] = lambda: None

    @property
    def kind(self) -> str:
        """Requests of one kind exclude each other."""
        if isinstance(self.request, Record) and self.request.stop:
            return _STOP
        return "load" if self.request.command in ("set", "profile", "save", "reload") else self.request.command

    def answer(self, message: dict[str, Any]) -> None:
        """Send the reply, and let the next request of this kind begin. From any thread."""
        self._finish()
        self._send(message)

    def attempt(self, action: Callable[[], None]) -> None:
        """Run a part of the work. An error becomes the reply; an internal error is raised too."""
        try:
            action()
        except (SpheremouseError, OSError) as e:
            self.answer(refused(str(e)))
        except Exception as e:
            self.answer(refused(internal_error(e)))
            raise


class RequestQueue:
    """Other threads add requests and calls; the worker's thread runs them between two frames."""

    def __init__(self, wake: Callable[[], None], log: Callable[[str], None]) -> None:
        """`wake` wakes the worker, from any thread."""
        self._wake, self._log = wake, log
        self._calls: deque[Callable[[], None]] = deque()
        self._lock = threading.Lock()
        self._waiting: list[PendingRequest] = []
        self._under_way: dict[str, PendingRequest] = {}  # by kind

    def call(self, action: Callable[[], None]) -> None:
        """Run an action in the worker's thread. From any thread and from signal handlers."""
        self._calls.append(action)
        self._wake()

    def put(self, pending: PendingRequest) -> None:
        """Add a request, or refuse it. From any thread."""
        with self._lock:
            self._waiting = [p for p in self._waiting if not p.cancelled]
            busy = pending.kind in self._under_way or any(p.kind == pending.kind for p in self._waiting)
            error = ""
            if busy and (pending.quiet or pending.kind in _BUSY_MESSAGES):
                error = f"{_BUSY_MESSAGES.get(pending.kind, 'one is under way')}; ask again when it is done"
            elif len(self._waiting) >= MAX_WAITING:
                error = f"{MAX_WAITING} requests wait already; ask again when they are done"
            else:
                self._waiting.append(pending)
        if error:
            pending.answer(refused(error))
        else:
            self._wake()

    def take(self) -> PendingRequest | None:
        """Return the next request, which is then under way until its answer; None if none may begin."""
        if not self._waiting:
            return None
        with self._lock:
            self._waiting = [p for p in self._waiting if not p.cancelled]
            pending = next((p for p in self._waiting if p.kind not in self._under_way), None)
            if pending is not None:
                self._waiting.remove(pending)
                self._under_way[pending.kind], pending._finish = pending, partial(self._end, pending)
            return pending

    def run(self, handle: Callable[[PendingRequest], None]) -> None:
        """Run the calls and begin the requests, in the worker's thread. `handle` answers at once or later."""
        while self._calls:
            self._guard(self._calls.popleft())
        while (pending := self.take()) is not None:
            self._guard(partial(pending.attempt, partial(handle, pending)))

    def _end(self, pending: PendingRequest) -> None:
        """Let the next request of this kind begin. A second answer has no effect."""
        with self._lock:
            if self._under_way.get(pending.kind) is not pending:  # a second answer
                return
            del self._under_way[pending.kind]
        self._wake()

    def _guard(self, action: Callable[[], None]) -> None:
        """Log an error in place of ending the run."""
        try:
            action()
        except SpheremouseError as e:
            self._log(str(e))
        except Exception:
            self._log(internal_error_text())
