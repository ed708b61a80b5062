"""Connect the tray with the daemon: poll its status, and send the actions of the menu."""

import threading
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spheremouse.commands.tray import view as tray
from spheremouse.commands.tray.view import View
from spheremouse.commands.view import page_address
from spheremouse.errors import SpheremouseError
from spheremouse.files.token import token_files
from spheremouse.session.control.client import Client
from spheremouse.view.access import ADDRESS, PORT

_POLL_S = 1.0
_NOTE_S = 20.0  # how long the menu shows the result of an action
_RECORD_S = 60.0


class Link:
    """Polls the daemon in a thread and calls `on_view(view, note)` each time. Each action runs in another thread."""

    def __init__(self, socket: Path | None, on_view: Callable[[View, str], None], every: float = _POLL_S) -> None:
        self._path, self._on_view, self._every = socket, on_view, every
        self._wake, self._closing = threading.Event(), threading.Event()
        self._note, self._noted = "", 0.0
        self._lock = threading.Lock()
        self._running: set[str] = set()
        self._view = tray.no_daemon("looking for the daemon")
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Stop to poll. Does not wait for a pending reply."""
        self._closing.set()
        self._wake.set()

    def do(self, action: str) -> None:
        """Start an action of the menu. If the same action is running, do nothing."""
        with self._lock:
            if action in self._running:
                return
            self._running.add(action)
        threading.Thread(target=self._do, args=(action,), name=action, daemon=True).start()

    def show(self, note: str) -> None:
        """Show a line in the menu for 20 s."""
        with self._lock:
            self._note, self._noted = note, time.monotonic()
        self._wake.set()

    def _run(self) -> None:
        client: Client | None = None
        while not self._closing.is_set():
            try:
                client = client or Client(self._path)
                self._view = tray.view(client.status())
            except SpheremouseError as e:
                client = None  # the next daemon may have another socket
                self._view = tray.no_daemon(str(e))
            with self._lock:
                fresh = time.monotonic() - self._noted < _NOTE_S
                note = self._note if fresh else ""
            if not self._closing.is_set():
                self._on_view(self._view, note)
            self._wake.wait(self._every)
            self._wake.clear()

    def _do(self, action: str) -> None:
        try:
            if action == "page":
                opened = webbrowser.open(page_address(ADDRESS, PORT, token_files()))  # as its owner
                page = f"open http://{ADDRESS}:{PORT} in a browser"
                self.show("the live page is in the browser" if opened else page)
                return
            command, arguments, done = _ACTIONS[action]
            if action == "reinit":
                self.show("estimating the camera pose ...")
            with Client(self._path) as client:
                reply = client.ask(command, **arguments)
            self.show(done.format(folder=reply.get("folder", "its folder")))
        except SpheremouseError as e:
            self.show(str(e))
        finally:
            with self._lock:
                self._running.discard(action)


_ACTIONS: dict[str, tuple[str, dict[str, Any], str]] = {
    "reinit": ("reinit", {}, "camera pose estimated again"),
    "pause": ("pause", {}, "paused"),
    "resume": ("resume", {}, "resumed"),
    "record": ("record", {"seconds": _RECORD_S}, "recording the ball and the targets into {folder}"),
    "end-record": ("record", {"stop": True}, "recorded into {folder}"),
}
