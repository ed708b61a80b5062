"""Ctrl-C and SIGTERM end a run between two frames, never in the middle of one.

A signal that comes while a frame is awaited ends the wait; one that comes while a frame is worked on is heard after it,
so that what was measured is sent and no file is left half written. SIGHUP ends nothing: it is a wish of another kind.
"""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import Any, Self

from spheremouse.tracker import Frame

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SAME = 0.5  # s; `timeout` and shells signal the process and at once its group: one wish, not two


class _Asked(BaseException):
    """Raised by the handler while a frame is awaited; caught where it is awaited."""


class Stopping:
    """Listens to the signals within its `with` block; a second signal does what it would have done without."""

    def __init__(self) -> None:
        self.asked = False
        self._waiting = False
        self._heard = 0.0  # s, when it was asked
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        self._before = {s: signal.signal(s, self._hear) for s in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def frames(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The frames until a signal comes."""
        while not self.asked:
            try:
                self._waiting = True
                if self.asked:  # between the question above and the line before
                    return
                frame = next(frames)
                self._waiting = False
            except (StopIteration, _Asked):
                return
            finally:
                self._waiting = False
            if self.asked:
                return
            yield frame

    def _hear(self, number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if self.asked:
            if now - self._heard > _SAME:
                self._restore()
                signal.raise_signal(number)
            return
        self.asked, self._heard = True, now
        if self._waiting:
            self._waiting = False
            raise _Asked

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}


@contextlib.contextmanager
def on_hang_up(action: Callable[[], None]) -> Iterator[None]:
    """SIGHUP does this meanwhile, between two lines of the main thread; within another thread nothing is changed."""
    if not hasattr(signal, "SIGHUP") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGHUP, lambda _number, _frame: action())
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
