"""A fuzz test checks examples that hypothesis draws: damaged input, or extreme values.

An example may be refused by a SpheremouseError with a message, and by nothing else. It may take 10 s of a core, 90 s on
a clock and 1 GB. `FUZZ_EXAMPLES` is the number of examples of a test. A failure prints what repeats it. If an example
hangs, the process ends, and `spheremouse-fuzz.txt` in the folder for temporary files has the example and the stack.
"""

import contextlib
import faulthandler
import os
import tempfile
import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spheremouse.errors import SpheremouseError

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "200"))
SLOWDOWN = float(os.environ.get("FUZZ_SLOWDOWN", "1"))  # by sanitizers
MAX_CORE_SECONDS = 10.0 * SLOWDOWN
MAX_SECONDS = 90.0 * SLOWDOWN
MAX_MEMORY = 1_000_000_000  # bytes that the process takes during an example

Check = Callable[[Any], None]


def fuzz(strategy: Callable[[], st.SearchStrategy[Any]]) -> Callable[[Check], Callable[[], None]]:
    """Return a decorator that makes a check of one example a test. The strategy is made when the test runs."""
    options = settings(
        max_examples=EXAMPLES, deadline=None, database=None, print_blob=True, suppress_health_check=list(HealthCheck)
    )

    def decorate(check: Check) -> Callable[[], None]:
        @wraps(check)
        def once(example: Any) -> None:
            bounded(check, example)

        del once.__wrapped__  # pytest would take its parameters for fixtures
        return options(given(st.deferred(strategy))(once))

    return decorate


def bounded(check: Check, example: Any) -> None:
    """Check an example within the bounds of time and memory."""
    with (Path(tempfile.gettempdir()) / "spheremouse-fuzz.txt").open("w") as file:
        file.write(f"{repr(example)[:5000]}\n")
        file.flush()
        _forget_peak()
        before, begun = _memory("VmRSS"), time.process_time()
        faulthandler.dump_traceback_later(MAX_SECONDS, exit=True, file=file)
        try:
            check(example)
        finally:
            faulthandler.cancel_dump_traceback_later()
    seconds, taken = time.process_time() - begun, _memory("VmHWM") - before
    assert seconds < MAX_CORE_SECONDS, f"{seconds:.1f} s of a core"
    assert taken < MAX_MEMORY, f"{taken / 1e6:.0f} MB"


def refused(action: Callable[[], Any]) -> Any:
    """Return the result of the action; None if it is refused by an error with a message."""
    try:
        return action()
    except SpheremouseError as e:
        message = str(e)
    assert message.strip(), "an empty message"
    return None


def file(content: str | bytes, name: str = "file.yaml") -> Path:
    path = Path(name)
    path.write_bytes(content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content)
    return path


def _memory(which: str) -> int:
    """Bytes that this process has (VmRSS), or had at most since `_forget_peak` (VmHWM)."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:  # not on every system
        return 0
    return 1024 * int(status.partition(f"{which}:")[2].split()[0])


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
