"""Notifications for systemd: READY, STATUS and, after progress, WATCHDOG. Without systemd none is sent.

A watchdog that a timer feeds proves that the timer runs. Here a feed needs a token that changed since the last one:
the number of frames worked on, or of attempts to open the camera.
"""

import math
import os
import time
from collections.abc import Callable
from typing import Any

import sdnotify


def _interval() -> float:
    """Return the watchdog's interval, s; infinite without a watchdog."""
    try:
        if int(os.environ.get("WATCHDOG_PID", os.getpid())) != os.getpid():
            return math.inf
        return 1e-6 * int(os.environ["WATCHDOG_USEC"])
    except (KeyError, ValueError):
        return math.inf


class Notifier:
    """Sends notifications to the service manager."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        notifier = sdnotify.SystemdNotifier()
        if notifier.socket is not None:  # a manager that does not read must not block: messages are dropped
            notifier.socket.setblocking(False)  # noqa: FBT003  the parameter has no name
        self.send: Callable[[str], Any] = notifier.notify  # READY=1 and the like
        self._clock, self.interval = clock, _interval()
        self._token: Any = None
        self._due = -math.inf
        self._status = ""

    def status(self, text: str) -> None:
        """Send the status in one line, if it has changed."""
        text = " ".join(text.split())  # a line of its own would be an order of its own
        if text != self._status:
            self._status = text
            self.send(f"STATUS={text}".encode().decode("latin-1"))  # which sdnotify encodes as

    def progress(self, token: Any) -> None:
        """Feed the watchdog if the token has changed since the last feed, at most four times an interval."""
        now = self._clock()
        if token == self._token or now < self._due:
            return
        self._token, self._due = token, now + 0.25 * self.interval
        if self.interval < math.inf:
            self.send("WATCHDOG=1")
