"""Ctrl-C and SIGTERM end a run between two frames. SIGHUP runs an action and ends nothing.

A signal during the wait for a frame ends the wait. A signal during the processing of a frame takes effect after it, so
that its motion is sent and every file is complete.
"""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, Self

from spheremouse.tracker import Frame

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_DUPLICATE_SIGNAL_S = 0.5  # `timeout` and shells signal the process and then its group: both mean one request


class _StopRequest(BaseException):
    """Raised by the handler during the wait for a frame."""


class SignalHandler:
    """Handle SIGINT and SIGTERM within the `with` block. A second signal has its usual effect."""

    def __init__(self) -> None:
        self.stop_requested = False
        self._waiting = False  # `frames` waits for a frame
        self._first_time = 0.0  # s, monotonic, of the first signal
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        self._before = {s: signal.signal(s, self._handle) for s in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()

    def frames(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Yield the frames until a signal arrives."""
        while not self.stop_requested:
            try:
                self._waiting = True
                if self.stop_requested:  # a signal arrived before `_waiting` was set
                    return
                frame = next(frames)
                self._waiting = False
            except (StopIteration, _StopRequest):
                return
            finally:
                self._waiting = False
            if self.stop_requested:
                return
            yield frame

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        """Request the end of the run at the first signal; a second one has the effect that it has outside the block.

        A second one within `_DUPLICATE_SIGNAL_S` is ignored. Raises _StopRequest during the wait for a frame.
        """
        now = time.monotonic()
        if self.stop_requested:
            if now - self._first_time > _DUPLICATE_SIGNAL_S:
                self._restore()
                signal.raise_signal(number)
            return
        self.stop_requested, self._first_time = True, now
        if self._waiting:
            self._waiting = False
            raise _StopRequest

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}


@contextlib.contextmanager
def on_hang_up(action: Callable[[], None]) -> Iterator[None]:
    """Run the action at every SIGHUP within the block. In other threads than the main thread, do nothing."""
    if not hasattr(signal, "SIGHUP") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGHUP, lambda _number, _frame: action())
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
