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
from collections import deque
from collections.abc import Iterator
from typing import TextIO

from spheremouse.errors import ControlError
from spheremouse.session.process.threads import begin

MAX_QUEUED_CHARACTERS = 256_000  # some minutes of a busy log, or one second of the status table
_MAX_FLUSH_S = 0.5  # at the end


class NonBlockingStderr(io.TextIOBase):
    """A text stream in place of `stream`; `write` returns at once and never fails."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._descriptor = stream, stream.fileno()
        self._queue: deque[str] = deque()
        self._queued = 0  # characters
        self._dropped = 0  # lines
        self._changed = threading.Condition(threading.RLock())  # a signal handler may write during a write
        self._writing = self._closing = False
        self.failed = False  # the last text could not be written
        begin(threading.Thread(target=self._run, name="log", daemon=True))

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Encoding of the stream."""
        return self._stream.encoding

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the descriptor of the stream."""
        return self._descriptor

    def write(self, text: str, /) -> int:
        """Queue a text. If the queue is full, drop the oldest ones."""
        with self._changed:
            self._queue.append(text)
            self._queued += len(text)
            while self._queued > MAX_QUEUED_CHARACTERS and len(self._queue) > 1:
                oldest = self._queue.popleft()
                self._queued -= len(oldest)
                self._dropped += oldest.count("\n")
            self._changed.notify()
        return len(text)

    def finish(self, timeout: float) -> bool:
        """Wait up to `timeout` s for the queue, and end the thread. Return whether all texts were written."""
        end = time.monotonic() + timeout
        with self._changed:
            self._closing = True
            self._changed.notify_all()
            while (self._queue or self._writing) and (left := end - time.monotonic()) > 0.0:
                self._changed.wait(left)
            return not (self._queue or self._writing or self.failed)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._writing = False
                self._changed.notify_all()
                while not (self._queue or self._closing):
                    self._changed.wait()
                if not self._queue:
                    return
                text = self._queue.popleft()
                self._queued -= len(text)
                dropped, self._dropped = self._dropped, 0
                self._writing = True
            note = f"spheremouse: {dropped} lines of the log dropped: standard error was blocked\n" if dropped else ""
            try:
                self._write_all((note + text).encode(self.encoding, "backslashreplace"))
                self.failed = False
            except OSError:
                self.failed = True
                with self._changed:
                    self._dropped += dropped + text.count("\n")

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
