"""What is said again and again, said sparingly: one line of a kind in a while, with the number of the others."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

_KINDS = 256  # told apart at a time


def strip_digits(text: str) -> str:
    """A text without its numbers."""
    return "".join(c for c in text if not c.isdigit())


@dataclass(slots=True)
class _Kind:
    said: float  # s, when one was
    more: int = 0  # that were kept back since
    last: str = ""  # of these


class RateLimitedLogger:
    """Says texts, but of each kind one in a while; how many it kept back it says with the next, or with the last."""

    def __init__(
        self,
        say: Callable[[str], None],
        every: float = 1.0,
        kind: Callable[[str], str] = strip_digits,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`every` so many s one of each `kind`: texts that differ in their numbers alone are one."""
        self._say, self._every, self._kind, self._clock = say, every, kind, clock
        self._kinds: dict[str, _Kind] = {}
        self._lock = threading.Lock()  # never held while something is said

    def __call__(self, text: str) -> None:
        """Say it now, or keep it back; from any thread."""
        now, name = self._clock(), self._kind(text)
        with self._lock:
            kind = self._kinds.pop(name, None)
            if kind is not None and now - kind.said < self._every:
                kind.more, kind.last = kind.more + 1, text
                self._kinds[name] = kind
                return
            self._kinds[name] = _Kind(now)
            if len(self._kinds) > _KINDS:
                del self._kinds[next(iter(self._kinds))]  # the one not heard of for longest
        self._say(_with_count(text, 0 if kind is None else kind.more))

    def tend(self, end: bool = False) -> None:
        """Say the last of what was kept back, where it is time for it, or at the `end`."""
        now, due = self._clock(), list[_Kind]()
        with self._lock:
            for name, kind in self._kinds.items():
                if kind.more and (end or now - kind.said >= self._every):
                    due.append(kind)
                    self._kinds[name] = _Kind(now)
        for kind in due:
            self._say(_with_count(kind.last, kind.more - 1))


def _with_count(text: str, more: int) -> str:
    return f"{text} ({more} more like it)" if more else text
