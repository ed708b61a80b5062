"""Where requests wait for the worker: of each kind one is under way at a time, and the owner's are not behind members'.

`put` is called by the thread of the control socket, `take` by the worker between two frames. What is refused is refused
here, before anything is made for it; what waits is little, and nothing once its asker has hung up.
"""

import threading
import time
from collections.abc import Callable
from math import ceil
from typing import Any

from spheremouse.errors import SpheremouseError
from spheremouse.session.control.protocol import Record, Request, internal_error, refused
from spheremouse.session.control.reply import Reply

MOST = 8  # that wait, of members, and as many of the owner's: clients wait one each
SHARE = 0.1  # of the time that a kind of work may go on for members: a reading of files costs the worker turns
CALM = 2.0  # s that the owner waits at most after what was given up, lest a script that is cut off does it all day

_LOAD, _STOP = "load", "record --stop"
_ALREADY = {
    "snapshot": "a snapshot is being written already",
    "record": "a recording is being begun already",
    _STOP: "the recording is being ended already",
    "reinit": "the camera's pose is being estimated already",
}


def _kind(request: Request) -> str:
    if isinstance(request, Record) and request.stop:
        return _STOP
    return _LOAD if request.command in ("set", "reload") else request.command


class Asked:
    """A request and who waits for it: one, or several that are served by the same. Called with the answer, once."""

    def __init__(self, request: Request, reply: Reply, *, quiet: bool = False) -> None:
        """`quiet`: there is nothing to say of it where nothing comes of it."""
        self.request, self.kind, self.trusted, self.quiet = request, _kind(request), reply.trusted, quiet
        self._replies = [reply]
        self._done: Callable[[], None] = lambda: None

    @property
    def gone(self) -> bool:
        """Has everybody hung up who asked?"""
        return all(reply.gone for reply in self._replies)

    def __call__(self, message: dict[str, Any]) -> None:
        self._done()
        for reply in self._replies:
            reply(message)

    def attempt(self, action: Callable[[], None]) -> None:
        """On the way to an answer: whatever goes wrong is one, or nothing of this kind would ever be begun again."""
        try:
            action()
        except (SpheremouseError, OSError) as e:
            self(refused(str(e)))
        except Exception as e:
            self(refused(internal_error(e)))
            raise

    def _joined(self, other: "Asked") -> None:
        self._replies += other._replies
        self.trusted |= other.trusted


class RequestQueue:
    """What is asked and has not been begun, and what of each kind is under way."""

    def __init__(self, wake: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        """`wake` is called, from any thread, when there is something to take."""
        self._wake, self._clock = wake, clock
        self._lock = threading.Lock()
        self._waiting: list[Asked] = []
        self._under_way: dict[str, tuple[Asked, float]] = {}  # kind -> and since when, s
        self._rests: dict[tuple[str, bool], float] = {}  # kind, of the owner? -> s, until when they wait for it

    def put(self, asked: Asked) -> None:
        """It waits for its turn, or is answered that it is refused. From any thread."""
        with self._lock:
            self._waiting = [a for a in self._waiting if not a.gone]
            error = self._refusal(asked)
            if not error:
                self._waiting.append(asked)
        if error:
            asked(refused(error))
        else:
            self._wake()

    def take(self) -> Asked | None:
        """What is to be begun now; its kind is under way until it is answered."""
        if not self._waiting:
            return None
        with self._lock:
            now = self._clock()
            self._waiting = [a for a in self._waiting if not a.gone]
            for asked in sorted(self._waiting, key=lambda a: not a.trusted):
                if asked.kind not in self._under_way and now >= self._rests.get((asked.kind, asked.trusted), now):
                    break
            else:
                return None
            self._waiting.remove(asked)
            if asked.request.command == "reload":  # what is read now is what the others want to be read
                for other in [a for a in self._waiting if a.request.command == "reload"]:
                    self._waiting.remove(other)
                    asked._joined(other)
            self._begin(asked, now)
            return asked

    def begin(self, asked: Asked) -> bool:
        """Begin it at once, unless one of its kind is under way."""
        with self._lock:
            free = asked.kind not in self._under_way
            if free:
                self._begin(asked, self._clock())
            return free

    def _begin(self, asked: Asked, now: float) -> None:
        self._under_way[asked.kind] = asked, now
        asked._done = lambda: self._end(asked)

    def _end(self, asked: Asked) -> None:
        with self._lock:
            of_its_kind, since = self._under_way.get(asked.kind, (None, 0.0))
            if of_its_kind is not asked:  # answered twice
                return
            del self._under_way[asked.kind]
            now = self._clock()
            if asked.gone or not asked.trusted:
                rest = (now - since) * (1.0 / SHARE - 1.0)
                self._rests[asked.kind, asked.trusted] = now + (min(rest, CALM) if asked.trusted else rest)
        self._wake()

    def _refusal(self, asked: Asked) -> str:
        """Why it is not taken in; empty where it is. The owner waits for what a member asked, and for nobody else."""
        same = [a for a in self._waiting if a.kind == asked.kind]
        if asked.kind in _ALREADY:
            if asked.kind in self._under_way:
                same.append(self._under_way[asked.kind][0])
            if any(a.trusted or not asked.trusted for a in same):
                return f"{_ALREADY[asked.kind]}; ask again when it is done"
            left = self._rests.get((asked.kind, False), 0.0) - self._clock()
            if not asked.trusted and left > 0.0:
                return f"{asked.request.command}: there was one just now; ask again in {ceil(left)} s"
        if sum(a.trusted == asked.trusted for a in self._waiting) >= MOST:
            return "too much is asked at once; ask again"
        return ""
