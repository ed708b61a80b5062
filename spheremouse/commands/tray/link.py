"""The tray's line to the daemon: what is asked, and what was last heard."""

import threading
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spheremouse.commands.tray import view as tray
from spheremouse.commands.tray.view import View
from spheremouse.errors import SpheremouseError
from spheremouse.session.control.client import Client

_EVERY = 1.0  # s between two questions
_REMEMBERED = 20.0  # s for which the menu says what became of a click
_RECORD = 60.0  # s


class Link:
    """Asks the daemon in a thread of its own, `on_view(view, note)` each time; does what is clicked in others."""

    def __init__(self, socket: Path | None, on_view: Callable[[View, str], None], every: float = _EVERY) -> None:
        self._path, self._on_view, self._every = socket, on_view, every
        self._wake, self._over = threading.Event(), threading.Event()
        self._note, self._noted = "", 0.0
        self._lock = threading.Lock()
        self._doing: set[str] = set()
        self._view = tray.no_daemon("looking for the daemon")
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def start(self) -> None:
        """Begin to ask."""
        self._thread.start()

    def close(self) -> None:
        """Ask no more; does not wait for an answer that is still to come."""
        self._over.set()
        self._wake.set()

    def do(self, action: str) -> None:
        """Do what an item of the menu stands for; returns at once. The same thing twice at a time is once."""
        with self._lock:
            if action in self._doing:
                return
            self._doing.add(action)
        threading.Thread(target=self._do, args=(action,), name=action, daemon=True).start()

    def say(self, note: str) -> None:
        """A line that the menu shows for a while."""
        with self._lock:
            self._note, self._noted = note, time.monotonic()
        self._wake.set()

    def _run(self) -> None:
        client: Client | None = None
        while not self._over.is_set():
            try:
                client = client or Client(self._path)
                self._view = tray.view(client.ask("status"))
            except SpheremouseError as e:
                client = None  # the next one may be found elsewhere
                self._view = tray.no_daemon(str(e))
            with self._lock:
                fresh = time.monotonic() - self._noted < _REMEMBERED
                note = self._note if fresh else ""
            if not self._over.is_set():
                self._on_view(self._view, note)
            self._wake.wait(self._every)
            self._wake.clear()

    def _do(self, action: str) -> None:
        command, arguments, done = _ACTIONS.get(action, ("", {}, ""))
        try:
            if action == "page":
                if self._view.page is not None:
                    webbrowser.open(self._view.page)
                return
            if action == "reinit":
                self.say("estimating the camera pose ...")
            with Client(self._path) as client:
                reply = client.ask(command, **arguments)
            self.say(done.format(folder=reply.get("folder", "its folder")))
        except SpheremouseError as e:
            self.say(str(e))
        finally:
            with self._lock:
                self._doing.discard(action)


_ACTIONS: dict[str, tuple[str, dict[str, Any], str]] = {
    "reinit": ("reinit", {}, "camera pose estimated anew"),
    "pause": ("pause", {}, "paused"),
    "resume": ("resume", {}, "resumed"),
    "record": ("record", {"seconds": _RECORD}, "recording the ball and the targets into {folder}"),
    "end-record": ("record", {"stop": True}, "recorded into {folder}"),
}
