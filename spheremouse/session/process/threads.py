"""Start threads, with a clear error if the system has none left; and a fixed pool of threads."""

import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterable

from spheremouse.errors import ControlError

_PATIENT = 30.0  # s that a recording may take to be finished when we end

Work = Callable[[], Callable[[], None] | None]


def begin(thread: threading.Thread) -> None:
    """Start it; ControlError where the system gives no thread."""
    try:
        thread.start()
    except RuntimeError:  # what CPython raises for any reason
        raise ControlError(
            "no thread to be had: the system's limit of tasks is reached; end other programs of this user, or raise "
            "TasksMax of the unit (`ulimit -u` by hand)"
        ) from None


class WorkerPool:
    """One thread for each kind of work. All start together, since the system may refuse threads later.

    A thread does its work in order. To avoid a queue, check `busy` first.
    """

    def __init__(self, kinds: Iterable[str], say: Callable[[str], None]) -> None:
        """`say` logs internal errors, from any thread."""
        self._say = say
        self._given: dict[str, queue.SimpleQueue[Work | None]] = {kind: queue.SimpleQueue() for kind in kinds}
        self._left = dict.fromkeys(self._given, 0)  # given and not done
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    def begin(self) -> None:
        """All threads; ControlError where there are not enough."""
        for kind in self._given:
            thread = threading.Thread(target=self._run, args=(kind,), name=kind, daemon=True)
            begin(thread)
            self._threads.append(thread)

    def do(self, kind: str, work: Work) -> None:
        """Do it, elsewhere. From any thread; does not wait.

        What it returns is called when its kind is not busy with it any more: who is answered may ask again at once.
        """
        with self._lock:
            self._left[kind] += 1
        self._given[kind].put(work)

    def make(self, kind: str, work: Callable[[], None]) -> "Task":
        """Do it, elsewhere; what is returned can be waited for."""
        task = Task(work)
        self.do(kind, task.run)
        return task

    def busy(self, kind: str) -> bool:
        """Return True while work of that kind is not done."""
        return self._left[kind] > 0

    def end(self, *kinds: str) -> None:
        """End when all is done that was given; work of these kinds is waited for, though not for ever."""
        for given in self._given.values():
            given.put(None)
        end = time.monotonic() + _PATIENT
        for thread in self._threads:
            if thread.name in kinds:
                thread.join(max(0.0, end - time.monotonic()))

    def _run(self, kind: str) -> None:
        while (work := self._given[kind].get()) is not None:
            then = self._tried(work)
            del work  # with the pictures that it holds
            with self._lock:
                self._left[kind] -= 1
            if then is not None:
                self._tried(then)
                del then

    def _tried(self, work: Work) -> Callable[[], None] | None:
        try:
            return work()
        except Exception:
            self._say("internal error, please report it:\n" + traceback.format_exc().rstrip())
            return None


class Task:
    """One thing done elsewhere; an error of it comes out where it is waited for."""

    def __init__(self, work: Callable[[], None]) -> None:
        self._work, self._done = work, threading.Event()
        self._error: Exception | None = None

    def run(self) -> None:
        """Do it."""
        try:
            self._work()
        except Exception as e:
            self._error = e
        self._done.set()

    def wait(self, seconds: float) -> bool:
        """Is it done? Waits at most so long."""
        if not self._done.wait(seconds):
            return False
        if self._error is not None:
            raise self._error
        return True
