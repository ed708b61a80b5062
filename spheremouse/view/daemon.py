"""The link to the daemon: its events, settings and scene, for all browsers together.

The connection is open only while a browser looks, so the page costs the daemon nothing otherwise.
"""

import asyncio
import contextlib
import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client, RefusedError

Message = dict[str, Any]
Values = dict[str, Any]

STATUS_INTERVAL = 0.5  # s
_UNKNOWN_VECTOR = [None] * 3  # of a vector
_RECONNECT_INTERVAL_S = 0.5  # s between two attempts to connect
_SAMPLE_POLL_S = 0.05  # s between two looks for samples, since each costs more than the samples
_LOG_LINES = 200
_MAX_SAMPLES = 1500  # samples kept for slow browsers: 10 s of two balls at 60 Hz
_UNDO_STEPS = 100
_REBUILD_INTERVAL = 0.1  # s between two changes of settings for which the daemon builds another tracker
_SET_INTERVAL = 0.04  # s between two changes of others
_AT_ONCE = ("motion", "pointer", "record")  # sections that build nothing
_DESCRIBED_KEYS = ("discs_known", "rig", "tracker", "changes", "config", "pid")  # that change with settings or scene


class Description(NamedTuple):
    """Parts of `hello` that the daemon has."""

    settings: list[Message]
    scene: Message | None
    profiles: dict[str, list[str]]


class DaemonLink:
    """The link to the daemon at `socket`, or to the one that `Client` finds. All methods are called in the event loop.

    A thread reads the events. It stores samples itself, since 60 a second would wake the loop too often.
    """

    def __init__(self, socket: Path | None, publish: Callable[[Message], None]) -> None:
        """`publish` takes each message for all browsers, in the event loop."""
        self.socket, self.publish = socket, publish
        self.status: Message | None = None
        self.trouble = ControlError("connecting to the daemon")  # why there is no status
        self.log: deque[tuple[float, str]] = deque(maxlen=_LOG_LINES)  # time since 1970, s, and text
        self.count = 0  # samples since the start
        self._rows: deque[list[Any]] = deque(maxlen=_MAX_SAMPLES)
        self._storing = threading.Lock()
        self.described = Description(settings=[], scene=None, profiles={})
        self._undo: deque[tuple[str, Values]] = deque(maxlen=_UNDO_STEPS)
        self._setting = asyncio.Lock()  # one `set` is under way
        self._next_change = 0.0  # s, monotonic
        self._refreshing: asyncio.Task[None] | None = None
        self._described_for: list[Any] = []  # `_described_by` of the status for which `described` was read
        self._loop = asyncio.get_running_loop()
        self._wanted, self._closed = threading.Event(), False
        threading.Thread(target=self._run, name="daemon", daemon=True).start()

    def set_watched(self, watched: bool) -> None:
        """Open the connection if a browser watches, else close it."""
        self._wanted.set() if watched else self._wanted.clear()

    def close(self) -> None:
        """Close the connection for good."""
        self._closed = True
        self._wanted.set()

    def switch(self, socket: Path | None) -> None:
        """Connect to another daemon, if it is another one."""
        if socket != self.socket:
            self.socket = socket
            self._undo.clear()
            self._publish_trouble(ControlError("connecting to the daemon"))

    def hello(self) -> Message:
        """Return settings, profiles, scene and log for a browser."""
        settings, scene, profiles = self.described
        return {"type": "hello", "settings": settings, "profiles": profiles, "scene": scene, "log": list(self.log)}

    def state(self) -> Message:
        """Return the message of the present status, or why there is none."""
        return {"type": "status", "status": self.status, "reason": self.trouble.problem, "hint": self.trouble.hint}

    def values(self) -> Message:
        """Return the values of all settings, the keys of those that are not saved, and the number of undo steps."""
        settings = self.described.settings
        return {
            "type": "values",
            "values": {about["key"]: about["value"] for about in settings},
            "unsaved": [about["key"] for about in settings if about["value"] != about.get("saved", about["value"])],
            "undo": len(self._undo),
        }

    def rows(self, after: int) -> tuple[list[list[Any]], int]:
        """Return the samples after the first `after`, as far as they are kept, and the number of all so far."""
        with self._storing:
            return list(islice(reversed(self._rows), self.count - after))[::-1], self.count

    async def ask(self, command: str, /, **arguments: Any) -> Message:
        """Return the daemon's reply. Raises ControlError if it refuses or does not answer."""
        return await asyncio.to_thread(self._ask, command, arguments)

    async def set(self, values: Values, gesture: str) -> Message:
        """Change settings, and return the daemon's reply. It has `values`, the old and the new value of each key.

        `gesture` is an id. Successive changes with the same id, as of a slider, are one step of undo, to the first old
        values. Without a change there is no step. Raises ControlError if the daemon refuses or does not answer.
        """
        async with self._setting:
            reply = await self._change(values)
            before = {key: old for key, (old, new) in reply.get("values", {}).items() if old != new}
            if before and self._undo and self._undo[-1][0] == gesture:
                before |= self._undo.pop()[1]
            if before:
                self._undo.append((gesture, before))
            self._update({key: new for key, (_, new) in reply.get("values", {}).items()})
        return reply

    async def undo(self) -> Message:
        """Change the settings of the last gesture back. Raises ControlError without one, or if the daemon refuses."""
        async with self._setting:
            if not self._undo:
                raise ControlError("undo: nothing was changed on this page")
            _, before = self._undo[-1]
            reply = await self._change(before)
            self._undo.pop()
            self._update(before)
        return reply

    async def _change(self, values: Values) -> Message:
        """Have the daemon set values, at most so often that it keeps up. Return its reply."""
        rebuilds = any(key.partition(".")[0] not in _AT_ONCE for key in values)
        await asyncio.sleep(max(0.0, self._next_change - time.monotonic()))
        self._next_change = time.monotonic() + (_REBUILD_INTERVAL if rebuilds else _SET_INTERVAL)
        return await self.ask("set", assignments=[f"{key}={json.dumps(v)}" for key, v in values.items()])

    def _ask(self, command: str, arguments: Message) -> Message:
        with Client(self.socket) as client:
            return client.ask(command, **arguments)

    def _update(self, values: Values) -> None:
        """Take over new values, and publish them."""
        for about in self.described.settings:
            about["value"] = values.get(about["key"], about["value"])
        self._described_for = []  # another client may change them back before a status shows this change
        self.publish(self.values())

    def _publish_trouble(self, trouble: ControlError) -> None:
        self.status, self.trouble = None, trouble
        self.publish(self.state())

    def _receive(self, event: Message) -> None:
        """Store and publish a log line or a status.

        If the status shows a change, read settings, scene and profiles again. One reading is under way at a time. After
        a failed one, the next status starts another.
        """
        kind = event.pop("event", None)
        if kind == "log":
            self.log.append((time.time(), str(event.get("text", ""))))
            self.publish({"type": "log", "lines": [self.log[-1]]})
        elif kind == "status":
            self.status = event
            self.publish(self.state())
            if _described_by(event) != self._described_for and (self._refreshing is None or self._refreshing.done()):
                self._refreshing = self._loop.create_task(self._refresh_description(_described_by(event)))

    async def _refresh_description(self, described_for: list[Any]) -> None:
        with contextlib.suppress(ControlError):
            async with self._setting:  # else an older value could replace one that was just set
                before, self.described = self.described, await asyncio.to_thread(_describe, self.socket)
            self._described_for = described_for
            _, scene, profiles = self.described
            bare = [[{**about, "value": None, "saved": None} for about in d.settings] for d in (before, self.described)]
            if bare[0] != bare[1] or profiles != before.profiles:
                self.publish(self.hello())
            elif scene != before.scene:
                self.publish({"type": "scene", "scene": scene})
            self.publish(self.values())

    def _run(self) -> None:
        """Keep a connection to the daemon while a browser watches, and pass its events to the loop."""
        while self._wanted.wait() and not self._closed:
            socket = self.socket
            try:
                with Client(socket) as client:
                    self._described_for = []  # the first status has all settings read
                    for event in client.events(STATUS_INTERVAL, samples=True):
                        if self._closed or not self._wanted.is_set() or socket is not self.socket:
                            break
                        if event.get("event") == "sample":
                            self._store(event["sample"])
                        else:
                            self._post(self._receive, event)
                        if not client.has_received:
                            time.sleep(_SAMPLE_POLL_S)
            except ControlError as e:
                if socket is self.socket:
                    self._post(self._publish_trouble, e)
                    time.sleep(_RECONNECT_INTERVAL_S)

    def _store(self, sample: Message) -> None:
        row = _row_of(sample)
        with self._storing:
            self._rows.append(row)
            self.count += 1

    def _post(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the loop's thread."""
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *arguments)


def _describe(socket: Path | None) -> Description:
    with Client(socket) as client:
        settings, scene, profiles = (_ask_if_known(client, command) for command in ("settings", "scene", "profile"))
    return Description(settings.get("settings", []), scene or None, profiles.get("profiles", {}))


def _ask_if_known(client: Client, command: str) -> Message:
    """Return the reply; nothing if the daemon starts, or if it is of another version."""
    try:
        return client.ask(command)
    except RefusedError:
        return {}


def _described_by(status: Message) -> list[Any]:
    """Return the parts of a status that change only if settings or scene do; the age of a pose is none of them."""
    return [*map(status.get, _DESCRIBED_KEYS), (status.get("pose") or {}).get("position_m")]


def _row_of(sample: dict[str, Any]) -> list[Any]:
    """Return a sample in the form of `frame`: stamp, ball, confirmed, quaternion, rate and its standard deviations,
    counts, latency, discs, position. Unknown values are None. Units as in docs/samples.md.
    """
    covariance = sample.get("rate_covariance")
    sigma = [math.sqrt(max(0.0, covariance[k][k])) for k in range(3)] if covariance else _UNKNOWN_VECTOR
    return [
        sample["stamp"], sample["ball"], sample["confirmed"], *(sample.get("quaternion") or [None] * 4),
        *(sample.get("rate") or _UNKNOWN_VECTOR), *sigma, *sample["counts"], sample.get("latency"),
        sample.get("statistics", {}).get("discs_used"), *(sample.get("position") or _UNKNOWN_VECTOR),
    ]  # fmt: skip
