"""The way back to who asked: the answer, from any thread, and whether anybody still waits for it."""

from collections.abc import Callable
from typing import Any


class Reply:
    """Called with the answer of one request, once, and always, also where nobody waits for it any more."""

    def __init__(self, send: Callable[[dict[str, Any]], None] = lambda _: None, *, trusted: bool = True) -> None:
        """Without arguments: to nobody, for what the daemon wants of itself."""
        self._send = send
        self.trusted = trusted  # the daemon's own user asks, or root
        self.gone = False  # who asked has hung up: what was asked is not wanted any more

    def __call__(self, message: dict[str, Any]) -> None:
        self._send(message)
