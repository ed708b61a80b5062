"""Notice that a call of an output hangs: its own thread makes the calls, and other threads look at them."""

from collections.abc import Callable
from time import monotonic

# s for which callers must see the same call pending before it counts as hanging. A call takes microseconds, and the
# load of a machine adds milliseconds. The time starts at a caller's first look, so callers that were delayed themselves
# raise no false alarm.
HANG_TIMEOUT = 0.4

Call = tuple[str, str]  # what a hang means for a message, and its usual reason or nothing


class CallWatch:
    """Watches the calls of one output."""

    def __init__(self, log: Callable[[str], None]) -> None:
        """`log` gets the reason of a hang, once for each call."""
        self._log = log
        self.pending: Call | None = None  # set by the output's thread
        # The one that a caller saw last, and the time of the first sight, s
        self._seen: tuple[Call, float] | None = None
        self._hung: Call | None = None  # the last one that hung

    def run(self, call: Call, function: Callable[..., object], *arguments: object) -> bool:
        """Make a call, which may never return. Return True if it hung."""
        self.pending = call
        try:
            function(*arguments)
        finally:
            self.pending = None
        return self.hung(call)

    def hung(self, call: Call | None) -> bool:
        """Return whether this call was the last one that hung; False for None."""
        return call is not None and call is self._hung

    def look(self) -> str | None:
        """Return the reason if the pending call hangs. The first such look logs it."""
        call, now = self.pending, monotonic()
        if call is None:
            return None
        if self._seen is None or self._seen[0] is not call:
            self._seen = call, now
        took = now - self._seen[1]
        if took < HANG_TIMEOUT:
            return None
        what, hint = call
        reason = f"the output hangs: {what}{f' ({hint})' if hint else ''} for {took:.1f} s"
        if not self.hung(call):
            self._hung = call
            self._log(reason)
        return reason
