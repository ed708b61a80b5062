"""The control socket and the metrics port of a run."""

import contextlib
import time
from collections.abc import Callable
from typing import Any

from spheremouse.errors import ControlError, SpheremouseError
from spheremouse.session.control.metrics import MetricsServer
from spheremouse.session.control.places import socket_path
from spheremouse.session.control.server import ControlServer, Handle
from spheremouse.session.settings.control import ControlSettings, MetricsSettings

_RETRY_INTERVAL = 30.0  # s between two attempts to open the control socket


class Endpoints:
    """Open from `open` until `close`."""

    def __init__(self, handle: Handle, log: Callable[[str], None]) -> None:
        """`handle` is the control server's."""
        self._handle, self._log = handle, log
        self._stack = contextlib.ExitStack()
        self._server: ControlServer | None = None
        self._retry_at = 0.0  # s

    def open(self, control: ControlSettings, metrics: MetricsSettings, status: Callable[[], dict[str, Any]]) -> None:
        """Open both. ControlError if a configured socket cannot be opened; other failures are logged."""
        try:
            self._listen(control)
        except ControlError as e:
            if control.socket is not None:
                raise
            self._log(f"control: {e}: `spheremouse ctl` cannot ask this run until that is over")
            self._retry_at = time.monotonic() + _RETRY_INTERVAL
        if metrics.port is not None:
            try:
                server = self._stack.enter_context(MetricsServer(metrics.port, metrics.address, status, self._log))
                self._log(f"metrics: {server.url}")
            except SpheremouseError as e:
                self._log(f"{e}; going on without")

    def retry(self, control: ControlSettings, now: float) -> None:
        """Try again to open the control socket: the daemon that held it may have ended."""
        if self._server is None and now >= self._retry_at:
            self._retry_at = now + _RETRY_INTERVAL
            with contextlib.suppress(ControlError):
                self._listen(control)
                self._log("control: `spheremouse ctl` can ask this run now")

    def publish(self, text: str) -> None:
        """Send a line of the log to the clients that watch, from any thread."""
        if self._server is not None:
            self._server.publish({"event": "log", "text": text})

    def close(self) -> None:
        """Close both."""
        self._stack.close()

    def _listen(self, control: ControlSettings) -> None:
        server = ControlServer(socket_path(control.socket), control, self._handle, self._log)
        self._server = self._stack.enter_context(server)
