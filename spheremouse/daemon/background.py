"""What takes its time and must not keep the worker waiting: each in a thread, waited for at the end."""

import threading
from collections.abc import Callable

_PATIENT = 30.0  # s that a recording may take to be finished when we end


class Background:
    """Threads that end by themselves."""

    def __init__(self) -> None:
        self._threads: list[threading.Thread] = []

    def begin(self, work: Callable[[], None]) -> None:
        """Do it now, elsewhere."""
        self._threads = [t for t in self._threads if t.is_alive()]
        thread = threading.Thread(target=work, name="background", daemon=True)
        self._threads.append(thread)
        thread.start()

    def join(self) -> None:
        """Wait for all that has been begun."""
        for thread in self._threads:
            thread.join(_PATIENT)
