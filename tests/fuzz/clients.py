"""Clients that hit and run: connects, requests of every kind, half-closes and hang-ups in any order, many at once.

A real server, with a desk and a crew as the daemon has them; what is asked is made by the crew, in no time or when it
is let go on.
"""

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from spheremouse.session.control.client import Client
from spheremouse.session.control.limits import Limits
from spheremouse.session.control.protocol import Request
from spheremouse.session.control.reply import Reply
from spheremouse.session.control.request_queue import MOST, Asked, RequestQueue
from spheremouse.session.control.server import ControlServer
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.settings.control import ControlSettings
from tests.fuzz.targets import target

CLIENTS = 6
MEMBER = "member"  # the id of a request that counts as one of a member of the group, not the owner
ASKED: tuple[dict[str, Any], ...] = (
    *({"command": c} for c in ("status", "reinit", "pause", "resume", "reload", "record", "snapshot", "watch")),
    {"command": "set", "assignments": ["motion.scale_x=2"]},
    {"command": "record", "stop": True},
)
PATIENCE = 10.0  # s, for what takes milliseconds


class Cabinet:
    """A daemon's doors, desk and crew, and a worker that does nothing but begin what is asked."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.go_on = threading.Event()
        self.begun: list[Asked] = []
        self._bell = threading.Event()
        self.desk = RequestQueue(self._bell.set)
        self.crew = WorkerPool(KINDS, self.said.append)
        self.crew.begin()
        limits = Limits(pace=1e6, burst=1e6)
        settings = ControlSettings(clients=CLIENTS + 2)
        self.server = ControlServer(Path("clients.sock").absolute(), settings, self.handle, self.said.append, limits)
        threading.Thread(target=self._work, daemon=True).start()

    def handle(self, request: Request, reply: Reply) -> None:
        if request.command == "status":
            reply({"state": "tracking"})
        else:
            reply.trusted = request.id != MEMBER
            self.desk.put(Asked(request, reply))

    def _work(self) -> None:
        while True:
            self._bell.wait(1.0)
            self._bell.clear()
            while (asked := self.desk.take()) is not None:
                assert not self.crew.busy(asked.kind), "two of a kind are under way"
                self.crew.do(asked.kind, partial(self._make, asked))

    def _make(self, asked: Asked) -> Callable[[], None]:
        while not (asked.gone or self.go_on.wait(0.001)):
            pass
        self.begun.append(asked)
        return partial(asked, {"made": asked.request.command})


KINDS = ("load", "record", "record --stop", "snapshot", "reinit", "pause", "resume")
_cabinet = cache(Cabinet)
_steps = st.tuples(
    st.sampled_from(("ask", "ask", "ask", "half", "hang up", "hang up", "go on", "hold")),
    st.integers(0, CLIENTS - 1),
    st.builds(lambda message, more: {**message, **more}, st.sampled_from(ASKED), st.sampled_from(({}, {"id": MEMBER}))),
)


@target("hit-and-run clients", lambda: st.lists(_steps, max_size=40))
def check_clients(steps: list[tuple[str, int, dict[str, Any]]]) -> None:
    """Whatever they do, the owner is answered at once, and nothing is left of what they asked when they have gone."""
    cabinet = _cabinet()
    threads = threading.active_count()
    cabinet.go_on.clear()
    with contextlib.ExitStack() as stack:
        crowd: dict[int, socket.socket] = {}
        for what, n, message in steps:
            with contextlib.suppress(OSError):
                if what == "ask":
                    if n not in crowd:
                        crowd[n] = stack.enter_context(contextlib.closing(socket.socket(socket.AF_UNIX)))
                        crowd[n].settimeout(PATIENCE)
                        crowd[n].connect(str(cabinet.server.path))
                    crowd[n].sendall(json.dumps(message).encode() + b"\n")
                elif what == "half" and n in crowd:
                    crowd[n].shutdown(socket.SHUT_WR)
                elif what == "hang up" and n in crowd:
                    crowd.pop(n).close()
                elif what in ("go on", "hold"):
                    cabinet.go_on.set() if what == "go on" else cabinet.go_on.clear()
            assert len(cabinet.desk._waiting) <= 2 * MOST, "more waits than may"
            assert threading.active_count() <= threads, "a thread for a request"
        begun = time.monotonic()
        with Client(cabinet.server.path) as owner:
            assert owner.ask("status") == {"state": "tracking"}
        assert time.monotonic() - begun < PATIENCE
    with Client(cabinet.server.path) as owner:
        cabinet.go_on.set()
        _until(lambda: _snapshot(owner), "the owner's request is done")
    _until(lambda: not (cabinet.desk._waiting or cabinet.desk._under_way), "nothing is left of what was asked")
    cabinet.begun.clear()
    assert not cabinet.said, cabinet.said


def _snapshot(owner: Client) -> bool:
    """Is it done, or is one that somebody asked, who is gone by now, still to end?"""
    try:
        return owner.ask("snapshot") == {"made": "snapshot"}
    except Exception as e:
        if "ask again when it is done" not in str(e):
            raise
    return False


def _until(condition: Any, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"it never came to be: {what}"
        time.sleep(0.001)
