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


class Made:
    """One thing made in a thread; an error of it comes out where it is waited for."""

    def __init__(self, make: Callable[[], None]) -> None:
        self._make = make
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="making", daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        """Is it made? Waits at most so long."""
        self._thread.join(seconds)
        if self._thread.is_alive():
            return False
        if self._error is not None:
            raise self._error
        return True

    def _run(self) -> None:
        try:
            self._make()
        except Exception as e:
            self._error = e
