"""Write to standard error without waiting: texts enter a short queue, and a thread writes them.

A closed pipe, a full disk or a pipe without a reader must not stop or end tracking. If the queue is full, the thread
drops the oldest texts. Before the next text that it can write, it writes the number of dropped lines.
"""

import contextlib
import io
import os
import sys
import threading
import time
from collections.abc import Iterator
from queue import Empty, SimpleQueue
from typing import TextIO

from spheremouse.errors import ControlError
from spheremouse.session.process.threads import begin

MAX_QUEUED_TEXTS = 2_000  # some minutes of a busy log
_MAX_FLUSH_S = 0.5  # at the end


class NonBlockingStderr(io.TextIOBase):
    """A text stream in place of `stream`; `write` returns at once and never fails."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._descriptor = stream, stream.fileno()
        self._queue: SimpleQueue[str] = SimpleQueue()  # a signal handler may write during a write
        self._counting = threading.RLock()
        self._dropped = 0  # lines
        self._closing = self._failed = False  # failed: the last text could not be written
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        begin(self._thread)

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._stream.encoding

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the descriptor of the stream."""
        return self._descriptor

    def write(self, text: str, /) -> int:
        """Queue a text. If the queue is full, drop the oldest one."""
        self._queue.put(text)
        if self._queue.qsize() > MAX_QUEUED_TEXTS:
            with contextlib.suppress(Empty):  # the thread has taken it
                self._drop(self._queue.get_nowait().count("\n"))
        return len(text)

    def finish(self, timeout: float) -> bool:
        """Wait up to `timeout` s for the queue, and end the thread. Return whether all texts were written."""
        self._closing = True
        self._queue.put("")  # wakes the thread
        self._thread.join(timeout)
        return not (self._thread.is_alive() or self._failed)

    def _drop(self, lines: int) -> None:
        with self._counting:
            self._dropped += lines

    def _run(self) -> None:
        """Write queued texts, and report how many were dropped, until the queue is closed and empty."""
        while not (self._closing and self._queue.empty()):
            text = self._queue.get()
            with self._counting:
                dropped, self._dropped = self._dropped, 0
            note = f"spheremouse: {dropped} lines of the log dropped: standard error was blocked\n" if dropped else ""
            try:
                self._write_all((note + text).encode(self.encoding, "backslashreplace"))
                self._failed = False
            except OSError:
                self._failed = True
                self._drop(dropped + text.count("\n"))

    def _write_all(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another program has set the descriptor to non-blocking
                time.sleep(0.05)


@contextlib.contextmanager
def nonblocking_stderr() -> Iterator[None]:
    """Replace `sys.stderr` by a `NonBlockingStderr` in this block.

    If that cannot write all texts at the end, later texts are discarded.
    """
    before = sys.stderr
    try:
        stream = NonBlockingStderr(before)
    except (OSError, ValueError, AttributeError, ControlError):  # not a file, as in tests, or no thread
        yield
        return
    sys.stderr = stream
    try:
        yield
    finally:
        complete = stream.finish(_MAX_FLUSH_S)
        sys.stderr = before if complete else open(os.devnull, "w")  # noqa: SIM115  until the process ends
