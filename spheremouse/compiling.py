"""Progress of Numba: the number of kernels to compile, and of those compiled.

The functions of tracking are compiled before the first frame, once after an installation, with a progress message.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event
from numba.core.dispatcher import Dispatcher

_EVERY = 5.0  # s between two lines on standard error


@contextmanager
def report_compilation(log: Callable[[str], None] | None = None) -> Iterator[None]:
    """Report how many kernels are compiled in this block, of how many, and the time left; nothing if all are on disk.

    The thread that compiles calls `log` with each line. By default lines go to standard error, one in 5 s at most.
    """
    progress = _Progress(log or _Lines())
    event.register("numba:compile", progress)
    try:
        yield
    finally:
        event.unregister("numba:compile", progress)


class _Progress(event.Listener):
    def __init__(self, log: Callable[[str], None]) -> None:
        self._log, self._total, self._began = log, 0, 0.0
        self._waiting: set[Dispatcher] = set()

    def on_start(self, event: event.Event) -> None:
        """The first one: all that is to be done is counted."""
        if self._total == 0 and _ours(_kernel(event)):
            self._waiting = {kernel for kernel in _kernels() if not _on_disk(kernel)}
            self._total, self._began = len(self._waiting), time.monotonic()
            self._report("")

    def on_end(self, event: event.Event) -> None:
        """One is done; for types that it was compiled for before, it does not count again."""
        if _kernel(event) in self._waiting:
            self._waiting.remove(_kernel(event))
            left = len(self._waiting) * (time.monotonic() - self._began) / (self._total - len(self._waiting))
            self._report(f", about {left:.0f} s left" if left < 100.0 else f", about {left / 60.0:.0f} min left")

    def _report(self, left: str) -> None:
        done = self._total - len(self._waiting)
        self._log(f"compiling for this machine, once after an installation: {done} of {self._total}{left}")


class _Lines:
    """Prints the first line to standard error, then at most one each 5 s."""

    def __init__(self) -> None:
        self._due = 0.0

    def __call__(self, text: str) -> None:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + _EVERY
            print(f"spheremouse: {text}", file=sys.stderr, flush=True)


def _kernel(event: event.Event) -> Dispatcher:
    assert event.data is not None
    return event.data["dispatcher"]


def _ours(kernel: Dispatcher) -> bool:
    return kernel.py_func.__module__.startswith(f"{__package__}.")


def _kernels() -> Iterator[Dispatcher]:
    """Yield all kernels that have been imported, without those that only become part of others."""
    for name, module in list(sys.modules.items()):
        for one in list(vars(module).values()) if name.startswith(f"{__package__}.") else ():
            if isinstance(one, Dispatcher) and _ours(one) and one.targetoptions.get("inline") != "always":
                yield one


def kernels_on_disk() -> tuple[int, int, str]:
    """Return how many kernels Numba has kept, how many there are, and the folder; empty if it has none."""
    kernels = list(_kernels())
    folders = {str(k.stats.cache_path) for k in kernels if k.stats.cache_path}
    return sum(map(_on_disk, kernels)), len(kernels), os.path.commonpath(folders) if folders else ""


def _on_disk(kernel: Dispatcher) -> bool:
    """Return whether Numba has a kernel in its cache, for any types."""
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)  # None where it has no place to keep anything
    return file is not None and os.path.exists(file._index_path)
