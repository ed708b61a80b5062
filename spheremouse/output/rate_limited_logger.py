"""Limit the rate of repeated log lines: one line of a kind a second, with the number of suppressed ones."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

_INTERVAL = 1.0  # s
_MAX_KINDS = 256  # the kind that was logged longest ago is forgotten


def strip_digits(text: str) -> str:
    return "".join(c for c in text if not c.isdigit())


@dataclass(slots=True)
class _Kind:
    logged_at: float  # s, time of the last line
    suppressed: int = 0  # lines since then
    last: str = ""  # the last suppressed line


class RateLimitedLogger:
    """Logs one line of each kind a second, and counts suppressed ones. Lines of a kind differ in digits alone."""

    def __init__(self, log: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock = log, clock
        self._kinds: dict[str, _Kind] = {}
        self._lock = threading.Lock()  # not held during `log`

    def __call__(self, text: str) -> None:
        """Log a line now or suppress it, from any thread."""
        now, name = self._clock(), strip_digits(text)
        with self._lock:
            kind = self._kinds.pop(name, None)
            if kind is not None and now - kind.logged_at < _INTERVAL:
                kind.suppressed, kind.last = kind.suppressed + 1, text
                self._kinds[name] = kind
                return
            self._kinds[name] = _Kind(now)
            if len(self._kinds) > _MAX_KINDS:
                del self._kinds[next(iter(self._kinds))]
        self._log(_with_count(text, 0 if kind is None else kind.suppressed))

    def flush(self, end: bool = False) -> None:
        """Log the last suppressed line of each kind if its second is over. At the `end`, log that of every kind."""
        now, due = self._clock(), list[_Kind]()
        with self._lock:
            for name, kind in self._kinds.items():
                if kind.suppressed and (end or now - kind.logged_at >= _INTERVAL):
                    due.append(kind)
                    self._kinds[name] = _Kind(now)
        for kind in due:
            self._log(_with_count(kind.last, kind.suppressed - 1))


def _with_count(text: str, suppressed: int) -> str:
    return f"{text} ({suppressed} more like it)" if suppressed else text
