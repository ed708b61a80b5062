"""The doors of a run: the control socket, tried for again while another run has it, and the figures for Prometheus."""

import contextlib
import time
from collections.abc import Callable
from typing import Any

from spheremouse.errors import ControlError, SpheremouseError
from spheremouse.session.control.metrics import serve as serve_metrics
from spheremouse.session.control.places import socket_path
from spheremouse.session.control.server import ControlServer, Handle
from spheremouse.session.settings.control import ControlSettings, MetricsSettings

_LISTEN_EVERY = 30.0  # s between two tries to have the control socket after all


class Endpoints:
    """Open from `open` until `close`."""

    def __init__(self, handle: Handle, say: Callable[[str], None]) -> None:
        """`handle` is the control server's; `say` takes lines for the log."""
        self._handle, self._say = handle, say
        self._stack = contextlib.ExitStack()
        self._server: ControlServer | None = None
        self._listen_at = 0.0  # s, when the socket is tried for again

    def open(self, control: ControlSettings, metrics: MetricsSettings, status: Callable[[], dict[str, Any]]) -> None:
        """ControlError where a socket that was asked for cannot be had; without the rest it goes on, and says so."""
        try:
            self._listen(control)
        except ControlError as e:
            if control.socket is not None:
                raise
            self._say(f"control: {e}: `spheremouse ctl` cannot ask this run until that is over")
            self._listen_at = time.monotonic() + _LISTEN_EVERY
        try:
            served = serve_metrics(metrics, status)
        except SpheremouseError as e:
            self._say(f"{e}; going on without")
        else:
            if served is not None:
                self._stack.enter_context(served)
                self._say(f"metrics: {served.url}")

    def tend(self, control: ControlSettings, now: float) -> None:
        """Whoever had the socket at our start may be gone."""
        if self._server is None and now >= self._listen_at:
            self._listen_at = now + _LISTEN_EVERY
            with contextlib.suppress(ControlError):
                self._listen(control)
                self._say("control: `spheremouse ctl` can ask this run now")

    def publish(self, text: str) -> None:
        """A line of the log, to whoever watches; from any thread."""
        if self._server is not None:
            self._server.publish({"event": "log", "text": text})

    def close(self) -> None:
        """The last one opened first."""
        self._stack.close()

    def _listen(self, control: ControlSettings) -> None:
        path = socket_path(control.socket)
        self._server = self._stack.enter_context(ControlServer(path, control, self._handle, self._say))
