"""Clients that connect, send requests of every kind, close one side and disconnect, in any order, many at once.

The server is real, with a queue and a pool of threads as in the daemon. The pool does the work of a request at once,
or when it may go on.
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
from spheremouse.session.control.request_queue import PendingRequest, RequestQueue
from spheremouse.session.control.server import ControlServer, Limits
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.settings.control import ControlSettings
from tests.fuzz.targets import target

CLIENTS = 6
ASKED: tuple[dict[str, Any], ...] = (
    *({"command": c} for c in ("status", "reinit", "pause", "resume", "reload", "record", "snapshot", "watch")),
    {"command": "set", "assignments": ["motion.scale_x=2"]},
    {"command": "record", "stop": True},
)
PATIENCE = 10.0  # s, for what takes milliseconds


class World:
    """A daemon's socket, queue and pool of threads, and a worker that does nothing but begin requests."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.go_on = threading.Event()
        self.begun: list[PendingRequest] = []
        self._wakeup = threading.Event()
        self.queue = RequestQueue(self._wakeup.set, self.said.append)
        self.workers = WorkerPool(KINDS, self.said.append)
        self.workers.begin()
        limits = Limits(rate=1e6)
        settings = ControlSettings(clients=256)
        self.server = ControlServer(Path("clients.sock").absolute(), settings, self.handle, self.said.append, limits)
        threading.Thread(target=self._work, daemon=True).start()

    def handle(self, pending: PendingRequest) -> None:
        if pending.request.command == "status":
            pending.answer({"state": "tracking"})
        else:
            self.queue.put(pending)

    def _work(self) -> None:
        while True:
            self._wakeup.wait(1.0)
            self._wakeup.clear()
            while (pending := self.queue.take()) is not None:
                assert not self.workers.busy(pending.kind), "two of a kind are under way"
                self.workers.do(pending.kind, partial(self._make, pending))

    def _make(self, pending: PendingRequest) -> Callable[[], None]:
        while not (pending.cancelled or self.go_on.wait(0.001)):
            pass
        self.begun.append(pending)
        return partial(pending.answer, {"made": pending.request.command})


KINDS = ("load", "record", "record --stop", "snapshot", "reinit", "pause", "resume")
_world = cache(World)
_steps = st.tuples(
    st.sampled_from(("ask", "ask", "ask", "half", "hang up", "hang up", "go on", "hold")),
    st.integers(0, CLIENTS - 1),
    st.sampled_from(ASKED),
)


@target("clients that disconnect", lambda: st.lists(_steps, max_size=40))
def check_clients(steps: list[tuple[str, int, dict[str, Any]]]) -> None:
    """Another client is answered at once, and nothing is left of their requests when they have disconnected."""
    world = _world()
    threads = threading.active_count()
    world.go_on.clear()
    with contextlib.ExitStack() as stack:
        crowd: dict[int, socket.socket] = {}
        for what, n, message in steps:
            with contextlib.suppress(OSError):
                if what == "ask":
                    if n not in crowd:
                        crowd[n] = stack.enter_context(contextlib.closing(socket.socket(socket.AF_UNIX)))
                        crowd[n].settimeout(PATIENCE)
                        crowd[n].connect(str(world.server.path))
                    crowd[n].sendall(json.dumps(message).encode() + b"\n")
                elif what == "half" and n in crowd:
                    crowd[n].shutdown(socket.SHUT_WR)
                elif what == "hang up" and n in crowd:
                    crowd.pop(n).close()
                elif what in ("go on", "hold"):
                    world.go_on.set() if what == "go on" else world.go_on.clear()
            assert threading.active_count() <= threads, "a thread for a request"
        begun = time.monotonic()
        with Client(world.server.path) as owner:
            assert owner.ask("status") == {"state": "tracking"}
        assert time.monotonic() - begun < PATIENCE
    with Client(world.server.path) as owner:
        world.go_on.set()
        _until(lambda: _snapshot(owner), "the owner's request is done")
    _until(lambda: not any(world.workers.busy(kind) for kind in KINDS), "no request is under way")
    world.begun.clear()
    assert not world.said, world.said


def _snapshot(owner: Client) -> bool:
    """Whether it is done; False if that of a client that has disconnected has not ended yet."""
    try:
        return owner.ask("snapshot") == {"made": "snapshot"}
    except Exception as e:
        if "ask again when" not in str(e):  # a disconnection is noticed within 0.1 s
            raise
    return False


def _until(condition: Any, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"not reached: {what}"
        time.sleep(0.001)
