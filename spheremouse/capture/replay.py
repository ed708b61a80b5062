"""A recording that people control: pause, step, speed and section, again and again.

Each frame waits until the tracker has released the one before. So every frame is tracked, however slow the tracker is.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from spheremouse.capture import RawFrame, Source, section
from spheremouse.capture.fetch import EndOfSource, Fetched, Streamed
from spheremouse.errors import SpheremouseError
from spheremouse.tracker import Frame

_MAX_GAP_S = 1.0  # a longer gap between two stamps is not waited for


class Controls(NamedTuple):
    """Controls of a replay. `begin` and `end` are s after the first frame."""

    speed: float = 1.0
    loop: bool = True
    begin: float = 0.0
    end: float | None = None  # None: the recording's


class _Shown(Fetched):
    def __init__(self, frame: Frame, released: Callable[[], None]) -> None:
        super().__init__(frame)
        self._released = released

    def release(self) -> None:
        """Let the next frame come."""
        self._released()


class Replay(Streamed):
    """Plays a recording as a camera. Any thread may use its controls."""

    def __init__(self, opened: Source, open_again: Callable[[], Source], name: str) -> None:
        """Play the `opened` recording; `open_again` opens it for each further time."""
        super().__init__(opened, name)
        self._open_again, self.frames = open_again, opened.count
        self._changed = threading.Condition()
        self.controls, self.paused = Controls(), False
        self._steps = 0  # to take although it is paused
        self._released, self._rewinding = True, False
        self._section: Iterator[Frame] = iter(())
        self._next: Frame | None = None  # that was read ahead
        self._number = 0  # of the frame that was read last
        self._is_first = True  # it is the first one of the section
        self._begun: RawFrame | None = None  # the first frame of the section, while it is the present one
        self._shown_at, self._stamp = 0.0, 0.0  # of the present frame: s, monotonic, and its stamp
        self._zero: float | None = None  # stamp of the recording's first frame
        self.frame, self.seconds = 0, 0.0  # number of the present frame, and its time after the first one

    def control(self, controls: Controls, *, steps: int = 0, rewind: bool = False) -> None:
        """Set the controls, and play `steps` more frames in a pause. Another section begins with its first frame."""
        with self._changed:
            self._rewinding |= rewind or controls[2:] != self.controls[2:]
            self.controls, self._shown_at = controls, time.monotonic()
            self._steps += steps
            self._changed.notify()

    def set_paused(self, paused: bool) -> None:
        """Stop after the present frame, or go on."""
        with self._changed:
            self.paused, self._steps, self._shown_at = paused, 0, time.monotonic()
            self._changed.notify()

    def is_first(self, raw: RawFrame) -> bool:
        """Return True if a frame is the first one of the section, for which the tracker must begin again."""
        return raw is self._begun

    def next(self, timeout: float) -> RawFrame | None:
        """Return the next frame when it is due; None if it is not within `timeout`, s.

        Raises EndOfSource with the error if the recording cannot be read.
        """
        deadline = time.monotonic() + timeout
        if self._next is None or self._rewinding:
            self._read_ahead()
        with self._changed:
            while not self._rewinding and (now := time.monotonic()) < deadline:
                due = deadline if not self._released or (self.paused and not self._steps) else self._due()
                if due <= now:
                    return self._show(now)
                self._changed.wait(min(due, deadline) - now)
        return None

    def _due(self) -> float:
        """Return the time at which the next frame is shown, s of the monotonic clock; 0 is at once."""
        assert self._next is not None
        gap = 0.0 if self._is_first else min(max(self._next.stamp - self._stamp, 0.0), _MAX_GAP_S)
        return 0.0 if self._steps else self._shown_at + gap / self.controls.speed

    def _show(self, now: float) -> RawFrame:
        """Return the next frame to the tracker, and set the time from which the following one waits."""
        assert self._next is not None
        self.frame, frame = self._number, self._next
        self._shown_at = max(self._due(), now - _MAX_GAP_S)  # a slow tracker catches up at most so much
        raw = _Shown(frame, self._release)
        self._begun = raw if self._is_first else None
        self._stamp, self.seconds = frame.stamp, frame.stamp - (self._zero or 0.0)
        self._released, self._next, self._steps = False, None, max(0, self._steps - 1)
        return raw

    def _release(self) -> None:
        with self._changed:
            self._released = True
            self._changed.notify()

    def _read_ahead(self) -> None:
        with self._changed:
            rewinding, self._rewinding = self._rewinding, False
        try:
            self._next = None if rewinding else next(self._section, None)
            self._is_first = self._next is None
            if self._next is None:
                self.paused |= not (rewinding or self.controls.loop or self._zero is None)
                self._next = self._first_of(self.controls) or self._first_of(Controls())  # the section may be empty
        except SpheremouseError as e:
            raise EndOfSource(e) from None
        if self._next is None:
            raise EndOfSource

    def _first_of(self, controls: Controls) -> Frame | None:
        """Open the recording again at the first frame of its section; None if the section is empty."""
        if self._zero is not None:
            self._source.__exit__(None, None, None)
            self._source = self._open_again()
            self._frames = iter(self._source.__enter__())
        self._section = section(self._read(), controls.begin, math.inf if controls.end is None else controls.end)
        return next(self._section, None)

    def _read(self) -> Iterator[Frame]:
        for number, frame in enumerate(self._frames):
            self._number, self._zero = number, frame.stamp if self._zero is None else self._zero
            yield frame
