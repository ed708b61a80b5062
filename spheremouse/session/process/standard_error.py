"""Standard error for a run that must not wait: what is written waits in a short queue, and a thread writes it on.

A reader that has gone, a full disk or a pipe that nobody reads delay or end nothing: the oldest text is left out, and
when there is room again its lines are counted.
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

_MOST = 256_000  # characters that wait: some minutes of a busy log, a second of pictures of the table
_LAST = 0.5  # s that the end waits for what is not written yet


class NonBlockingStderr(io.TextIOBase):
    """A text stream in place of `stream`; `write` returns at once and never fails."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._descriptor = stream, stream.fileno()
        self._texts: deque[str] = deque()
        self._waiting = 0  # characters
        self._left_out = 0  # lines
        self._changed = threading.Condition(threading.RLock())  # a signal's handler may write in the midst of a write
        self._writing = self._over = False
        self.failed = False  # the last text could not be written
        begin(threading.Thread(target=self._run, name="log", daemon=True))

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """As that of the stream."""
        return self._stream.encoding

    def writable(self) -> bool:
        """Always."""
        return True

    def isatty(self) -> bool:
        """As the stream."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """As the stream."""
        return self._descriptor

    def write(self, text: str, /) -> int:
        """Hand it over; where too much waits the oldest is left out."""
        with self._changed:
            self._texts.append(text)
            self._waiting += len(text)
            while self._waiting > _MOST and len(self._texts) > 1:
                self._leave_out(self._texts.popleft())
            self._changed.notify()
        return len(text)

    def _leave_out(self, text: str) -> None:
        self._waiting -= len(text)
        self._left_out += text.count("\n")

    def finish(self, seconds: float) -> bool:
        """Wait so long at most until all is written, and end; was it?"""
        end = time.monotonic() + seconds
        with self._changed:
            self._over = True
            self._changed.notify_all()
            while (self._texts or self._writing) and (left := end - time.monotonic()) > 0.0:
                self._changed.wait(left)
            return not (self._texts or self._writing or self.failed)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._writing = False
                self._changed.notify_all()
                while not (self._texts or self._over):
                    self._changed.wait()
                if not self._texts:
                    return
                text = self._texts.popleft()
                self._waiting -= len(text)
                left_out, self._left_out = self._left_out, 0
                self._writing = True
            if left_out:
                text = f"spheremouse: {left_out} lines of the log left out: nobody took them\n{text}"
            try:
                self._write_on(text.encode(self.encoding, "backslashreplace"))
                self.failed = False
            except OSError:
                self.failed = True
                with self._changed:
                    self._left_out += left_out + text.count("\n") - bool(left_out)

    def _write_on(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # somebody else has made it so
                time.sleep(0.05)


@contextlib.contextmanager
def unhurried() -> Iterator[None]:
    """`sys.stderr` is such a stream; afterwards what it was or, where it takes nothing, one that says nothing."""
    before = sys.stderr
    try:
        made = NonBlockingStderr(before)
    except (OSError, ValueError, AttributeError, ControlError):  # no file (a test's, or none at all), or no thread
        yield
        return
    sys.stderr = made
    try:
        yield
    finally:
        taken = made.finish(_LAST)
        sys.stderr = before if taken else open(os.devnull, "w")  # noqa: SIM115  until the end
